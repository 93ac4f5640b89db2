"""The body rates of a recording: one list of stages, for everything that reads rates.

The order of the stages is fixed: read, put in order of time, cut to the time range, apply the
policy for non-finite rates, check that they are plausible; then the bias is subtracted in the axes
of the raw rates, scale and misalignment are corrected, and sensor axes are rotated to body axes;
then intervals and gaps are measured. Each stage is a map over batches, so memory is constant.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import LogError, NoSamplesError, QuatpropError
from quatprop.base.text import Setting
from quatprop.kinematics.conventions import mounting
from quatprop.propagation.checks.rate_checks import RateChecks
from quatprop.propagation.conditioning.correction_inputs import correction_inputs
from quatprop.propagation.conditioning.corrections import (
    GyroCorrectionReport,
    calibration_of,
    corrected,
)
from quatprop.propagation.direction_watch import DirectionWatch, ForceWatch, OrientationWatch
from quatprop.propagation.orientation_check import OF_THE_MOUNTING, OF_THE_ORIENTATION
from quatprop.propagation.plausibility import (
    clock_watch_of,
    columns_of_forces,
    columns_of_orientation,
    is_simulated,
    log_remarks,
    range_remarks,
)
from quatprop.readers.tables.table_log import TableLog
from quatprop.settings.bias import StaticBias
from quatprop.settings.quantities import RATES
from quatprop.settings.reading import GyroCorrection
from quatprop.timeline.counts import OBSERVE, Counts, Policy
from quatprop.timeline.counts import remarks as timeline_remarks
from quatprop.timeline.policies import Timeline
from quatprop.timeline.stamps import are_steady
from quatprop.timeline.time_range import Ends, EndsFinder, PartReader, TimeRange

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from quatprop.base.arrays import Float64, Int64
    from quatprop.base.errors import Loss
    from quatprop.base.text import Remark
    from quatprop.kinematics.series import GyroSeries
    from quatprop.propagation.clock_watch import ClockWatch
    from quatprop.propagation.conditioning.biases import BiasSeries
    from quatprop.propagation.conditioning.static_detection import RestBiases
    from quatprop.propagation.conditioning.static_period import Rows, StaticPeriod
    from quatprop.propagation.recording import Recording
    from quatprop.readers.signal import RateSignal
    from quatprop.readers.tables.model import Group, RowBatch, Within

    Passing = Callable[[Iterable[GyroSeries]], Iterator[GyroSeries]]
    """Yields batches unchanged, and looks at them."""


class RateSettings(NamedTuple):
    """How the rates of a recording are handled.

    `policy`: how irregular timestamps and rates are handled
    `correction`: time range, bias, calibration and mounting
    `method`: integration rule that follows; None: what the log says of its samples
    """

    policy: Policy = Policy()
    correction: GyroCorrection = GyroCorrection()
    method: str | None = None


AS_RECORDED = RateSettings(OBSERVE)
"""Change nothing, count everything."""


OF_ATTITUDE = frozenset({"gaps", "jitter", "packets", "repeated-stamps"})
"""Codes of remarks that concern only what is propagated from the rates."""


WITHOUT_REST = frozenset({"beyond-range", "unit-by-steps", "alternating", "dropout"})
"""Codes of remarks on rates because of which a log may show no stationary period."""


class RateStream:
    """The body rates of a recording after all stages: iterate once.

    `source`: the rates as recorded; by default the selected ones
    `counts`: counts of the samples, complete after the last batch
    `correction`: what is corrected, and the time range
    `checks`: plausibility of the rates
    `method`, `method_from`: integration rule for these samples, and its origin
    """

    def __init__(
        self,
        recording: Recording,
        settings: RateSettings = AS_RECORDED,
        source: RateSignal | None = None,
    ) -> None:
        self.source = source = source or recording.rate_signal()
        self._recording, self._settings = recording, settings
        self._direction: DirectionWatch | None = None
        self._clock: ClockWatch | None = None
        policy, wanted = settings.policy, settings.correction
        # First, since the beginning of the log may be cached until the main pass.
        self._log_remarks: list[Remark] = []
        if not recording.is_stream:
            self._log_remarks += log_remarks(
                recording.log, source, recording.selection, wanted.rates
            )
            self._log_remarks += range_remarks(source, wanted)
        self.method, self.method_from = source.method_used(settings.method)
        self._timeline = Timeline(
            policy,
            recording.name,
            self.chosen_by,
            method=self.method,
            rates=wanted.rates,
            steadier=self._steadier,
        )
        self.checks = RateChecks(source.unit, is_given=source.unit_is_given)
        self._inputs = inputs = correction_inputs(recording, source, wanted, self._as_used)
        matrix, bias, remarks = calibration_of(wanted, inputs)
        # With sorting, samples of the range may be anywhere in the log.
        clips = wanted.start is not None or wanted.end is not None
        indexed = clips and policy.on_backwards != "sort"
        parts = source.part_reader(self._watched) if indexed else None
        ends, rests = self._look_ahead(parts)
        self.range = TimeRange(wanted, ends)
        over_time: BiasSeries | RestBiases | None = inputs.biases
        if rests:
            from quatprop.propagation.conditioning.static_detection import RestBiases, worst_of

            found = worst_of(rests).remarks
            bias = rests[0].mean_rad_s
            if len(rests) > 1:
                # That they differ is why the bias changes from one to the next.
                found = tuple(one for one in found if one.code != "rests-differ")
                over_time = RestBiases(rests, interpolated=wanted.interpolates)
            remarks = (*remarks, *found)
        if wanted.bias is not None:
            bias = np.array(wanted.bias.rad_s(RATES[source.unit]))
        given = bias if inputs.biases is None else inputs.biases
        if given is not None and not rests:
            self._log_remarks += self._against_rest(given)
        mount = inputs.mounting.matrix if inputs.mounting else None
        if mount is None and wanted.mount is not None:
            mount = mounting(wanted.mount)
        self._bias = bias if over_time is None else over_time
        self._matrix = _product(mount, matrix) if wanted.rates == "body" else matrix
        selected = parts.read(self.range.start_ns, self.range.end_ns) if parts else None
        part, self._batches = (None, self._watched()) if selected is None else selected
        self.correction = GyroCorrectionReport(
            bias_rad_s=bias if over_time is None else None,
            rest=rests[0] if len(rests) == 1 else None,
            rests=rests if len(rests) > 1 else (),
            interpolated=wanted.interpolates,
            bias_series=None if inputs.biases is None else inputs.biases.report,
            calibration=matrix,
            mount=mount,
            mount_frames=None if inputs.mounting is None else inputs.mounting.frames,
            start_ns=self.range.start_ns,
            end_ns=self.range.end_ns,
            part=part,
            remarks=remarks,
        )

    def __iter__(self) -> Iterator[GyroSeries]:
        """Yield the samples that are used, rad/s, in body axes, in blocks of fixed size."""
        return self.read()

    def read(self, *, raw: Passing = iter, used: Passing = iter) -> Iterator[GyroSeries]:
        """Yield the samples that are used, at least one; see :meth:`__iter__`.

        `raw`: looks at the batches as they are read
        `used`: looks at the samples that are used, before intervals are measured
        """
        timeline = self._timeline
        samples = self.checks.units.inspect_raw(raw(self._batches))
        numbered = timeline.apply_backwards_policy(samples)
        numbered = self.range.apply(numbered)
        # What a sensor repeats or cannot exceed is exact only before it is corrected.
        samples = self.checks.observe(timeline.apply_nonfinite_policy(numbered))
        samples = used(corrected(samples, bias=self._bias, matrix=self._matrix))
        is_empty = True
        for block in timeline.count_intervals(samples):
            is_empty = False
            yield block
        # Samples outside of the range do not count as read.
        self.counts.samples_read -= sum(self.range.outside)
        if is_empty:
            raise NoSamplesError(
                self._recording.name,
                self.source.name,
                self.range.outside,
                self.counts.dropped,
                self._recording.log_losses,
                length=self.range.length,
            )

    @property
    def counts(self) -> Counts:
        """Counts of the samples, complete after the last batch."""
        return self._timeline.counts

    @property
    def timeline(self) -> Timeline:
        """Cuts the samples at gaps."""
        return self._timeline

    @property
    def chosen_by(self) -> str:
        """The setting that chooses timestamps: ``"clock"``, or of a table ``"time_col"``."""
        return "time_col" if isinstance(self._recording.log, TableLog) else "clock"

    def _watched(self, within: Within = None) -> Iterator[GyroSeries]:
        """Yield the samples of the log, or of parts of it; watch clock and what is beside them."""
        beside = self._beside()
        ends = self.range.start_ns, self.range.end_ns
        self._clock = clock_watch_of(self._recording.log, self.source, *ends)
        yield from self.source.batches(within, watch=self._watch, beside=beside)

    def _beside(self) -> Sequence[Group]:
        """Choose what is compared with the rates to their end, and return its columns."""
        recording, source, wanted = self._recording, self.source, self._settings.correction
        said = {one.code for one in self._log_remarks}
        ends = self.range.start_ns, self.range.end_ns
        columns: Sequence[Group] = ()
        if recording.is_stream or recording.log is None:
            return columns
        # An orientation may be that of the body, and rates may contradict it only in a part.
        if wanted.mount is None and not said & {*OF_THE_ORIENTATION} - {"rates-contradict"}:
            columns = columns_of_orientation(recording.log, source, recording.selection)
        if columns:
            self._direction = OrientationWatch(wanted.rates, source.unit, *ends)
        elif wanted.rates == "body" and not any(code.startswith("gravity-") for code in said):
            columns = columns_of_forces(source)
            self._direction = ForceWatch(source.unit, *ends) if columns else None
        return columns

    def _watch(self, rows: RowBatch) -> None:
        if self._clock is not None:
            self._clock.add_rows(rows)
        if self._direction is not None:
            self._direction.add(rows.values[0], rows.values[1], rows.values[-1])

    def _steadier(self) -> str:
        """Return the way to the times of recording, if others are used and these are steady."""
        if self.chosen_by != "clock" or self.source.clock != "header":
            return ""
        if is_simulated(self._recording.log):
            return ""  # times of recording are not those of a simulation
        first = next(iter(self.source.rows(at_first=True)), None)
        if first is None or not are_steady(first.log_ns):
            return ""
        return f"{Setting('clock', 'log')}, whose times are steady"

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Losses of the recording, and of files read with it."""
        return self._recording.losses

    @property
    def reads_all(self) -> bool:
        """Whether the whole log is read."""
        return self.correction.part is None

    def remarks(self) -> Iterator[Remark]:
        """Yield what a reader should know of the rates, after the last batch."""
        settings, is_mounted = self._settings, self._settings.correction.mount is not None
        left_out = {"stated-mount"} if is_mounted else set[str]()
        if is_simulated(self._recording.log):
            left_out.add("unlike-log-times")
        yield from (one for one in self.source.remarks if one.code not in left_out)
        yield from self.source.method_remarks(settings.method)
        yield from timeline_remarks(self.counts, settings.policy, self.chosen_by)
        yield from self.range.remarks(part=self.correction.part)
        yield from self.correction.all_remarks
        yield from self.checks.remarks(self.counts)
        later = {one.code: one for one in self._direction.remarks()} if self._direction else {}
        left_out = {*OF_THE_MOUNTING} if is_mounted else set()
        if "contradicts-later" in later:  # in which part
            left_out.add("rates-contradict")
        of_log = {one.code: one for one in self._log_remarks if one.code not in left_out}
        yield from (later | of_log).values()
        if self._clock is not None:
            yield from self._clock.remarks(of_all=self.reads_all)
        yield from self._recording.remarks

    def stationary_periods(
        self, static: StaticBias, finder: EndsFinder | None = None
    ) -> tuple[StaticPeriod, ...]:
        """Return the stationary periods of the whole recording, in a pass of its own.

        `finder`: receives the timestamps
        """
        from quatprop.propagation.conditioning.static_detection import find_rests

        earliest = self._settings.policy.on_backwards == "sort"
        return find_rests(
            lambda note: self._timeline.preview_at_times(self.source.batches(), note),
            finder or EndsFinder(earliest=earliest),
            static,
            self._inputs,
            self._settings.correction.rates,
        )

    def _as_used(self, rows: Rows, are_beside: bool) -> Rows:
        """Yield rows of another signal as the stages give those of the rates.

        `are_beside`: whether they stand in the rows of the rates
        """
        rates = self.source.batches if are_beside else None
        return self._timeline.preview_other_signal(rows, rates)

    def _against_rest(self, bias: Float64 | BiasSeries) -> list[Remark]:
        """Return a remark if a given bias contradicts the rates at rest."""
        recording, source = self._recording, self.source
        if recording.is_stream:
            return []
        from quatprop.propagation.conditioning.bias_check import bias_remarks

        def bias_at(t_ns: Int64) -> Float64:
            return bias[None] if isinstance(bias, np.ndarray) else bias.interpolated(t_ns)

        known = len(recording.other_remarks)
        batches = self._timeline.preview(source.batches(at_first=True), lambda _: None)
        try:
            return bias_remarks(batches, self._inputs, bias_at, self._settings.correction.rates)
        except QuatpropError:
            # What cannot be read is told by the pass that uses it.
            return []
        finally:
            del recording.other_remarks[known:]

    def _look_ahead(self, parts: PartReader | None) -> tuple[Ends, tuple[StaticPeriod, ...]]:
        """Return the ends of the log and its stationary periods, if they are needed."""
        wanted, timeline = self._settings.correction, self._timeline
        if not wanted.looks_ahead:
            return Ends(0, 0), ()
        static = wanted.static
        if static is None and parts is not None and (ends := parts.ends()) is not None:
            return ends, ()
        finder = EndsFinder(earliest=timeline.policy.on_backwards == "sort")
        if static is None:
            deque(timeline.preview(self.source.batches(), finder.add), maxlen=0)
            return finder.ends(), ()
        from quatprop.propagation.conditioning.static_detection import NoRestError

        try:
            rests = self.stationary_periods(static, finder)
        except NoRestError as error:
            causes = self._likely_causes()
            remedy = f"; perhaps this is why: {causes}; otherwise give" if causes else "; give"
            remedy += f" {Setting('bias', 'X,Y,Z')}"
            if static.window_ns >= StaticBias().window_ns:
                remedy += f", or look for a shorter one with {Setting('bias', 'static:DUR')}"
            raise LogError(self._recording.name, error.text + remedy) from None
        return finder.ends(), rests

    def _likely_causes(self) -> str:
        """Return what is odd in the rates, because of which they may be at rest nowhere."""
        timeline = Timeline(OBSERVE, self._recording.name, self.chosen_by)
        checks = RateChecks(self.source.unit, is_given=self.source.unit_is_given)
        samples = checks.units.inspect_raw(self.source.batches())
        deque(checks.observe(timeline.apply(samples)), maxlen=0)
        found = checks.remarks(timeline.counts)
        return "; ".join(str(one) for one in found if one.code in WITHOUT_REST)


def _product(mount: Float64 | None, matrix: Float64 | None) -> Float64 | None:
    """Return the mounting after the calibration; None for the identity."""
    if mount is None or matrix is None:
        return matrix if mount is None else mount
    return mount @ matrix
