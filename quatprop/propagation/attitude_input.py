"""Attitude series in files, read into memory or batch by batch."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from quatprop.base.errors import LogError, NoSamplesError, TimelineError
from quatprop.base.places import without_secret
from quatprop.base.provenance import entry_of
from quatprop.base.rendering import count_text
from quatprop.base.text import Remark, Setting
from quatprop.base.times import duration_text
from quatprop.kinematics.resample import PIECE, Steady, interpolate, with_columns
from quatprop.kinematics.series import AttitudeSeries
from quatprop.propagation.recording import ReadInput, errors_of, open_recording
from quatprop.propagation.report import lag_ns, sensitivity
from quatprop.readers.attitude_quality import QuaternionCheck, QuaternionCounts
from quatprop.settings import parse_all
from quatprop.settings.reading import (
    READ_ATTITUDES,
    AttitudeSelection,
    GyroCorrection,
    RateSelection,
)
from quatprop.stores.objects import split_topic
from quatprop.timeline.stamps import GAP_FACTOR, marked
from quatprop.timeline.time_range import Ends, EndsFinder, TimeRange

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from fractions import Fraction

    from quatprop.base.errors import Loss
    from quatprop.base.provenance import JsonObject
    from quatprop.kinematics.series import MethodSensitivity
    from quatprop.propagation.recording import Recording
    from quatprop.readers.signal import AttitudeSignal, Rows
    from quatprop.readers.tables.model import Group


# Attitude series of recordings: read, cut to the time range, checked.


@dataclass(frozen=True, slots=True)
class AttitudeInput:
    """Which attitude series to read.

    `path`: any log or table with attitudes, or ``"-"``
    `kind`: a key of :data:`quatprop.stores.kinds.READERS`; None: detected from content, then
        suffix
    `normalize`: scale quaternions of any nonzero length to unit length
    `drop`: omit invalid quaternions instead of refusing the series
    `part`: time range to read, ends included
    `side`: side of a comparison, ``"a"`` or ``"b"``, for errors
    `positions`, `covariances`: also read those next to the attitudes, where there are any
    `otherwise`: the way out if the orientation was never set
    """

    path: str
    kind: str | None = None
    selection: AttitudeSelection = field(default_factory=AttitudeSelection)
    normalize: bool = False
    drop: bool = False
    part: GyroCorrection = field(default_factory=GyroCorrection)
    side: str = ""
    positions: bool = False
    covariances: bool = True
    otherwise: str = f"choose another {Setting('topic')}"


@dataclass(frozen=True, slots=True)
class ReadAttitudes:
    """Facts about an attitude series, after reading it.

    `first_ns`, `last_ns`: earliest and latest timestamp, ns
    `counts`: valid and invalid rows
    """

    input: AttitudeInput
    kind: str
    signal: AttitudeSignal
    samples: int
    first_ns: int
    last_ns: int
    counts: QuaternionCounts
    losses: tuple[Loss, ...]

    @property
    def data_lost(self) -> bool:
        """Whether any attitude was lost or invalid."""
        return self.about.data_lost

    @property
    def about(self) -> ReadInput:
        """Its losses, remarks and invalid rows."""
        return ReadInput(self.input.path, self.losses, self.signal.remarks, self.counts.invalid)

    def report(self) -> JsonObject:
        """Return the facts, ready for JSON."""
        return {
            "path": self.input.path,
            "kind": self.kind,
            "name": self.signal.name,
            "type": self.signal.type_name,
            "quaternion": self.signal.field,
            "layout": self.signal.layout,
            "meaning": asdict(self.signal.meaning),
            "clock": self.signal.clock,
            "samples": self.samples,
            "first_ns": self.first_ns,
            "last_ns": self.last_ns,
            "rows": asdict(self.counts),
            "losses": [loss._asdict() for loss in self.losses],
            "remarks": list(self.signal.remarks),
        }


@dataclass(frozen=True, slots=True)
class LoadedAttitudes(ReadAttitudes):
    """An attitude series in memory, with its facts."""

    series: AttitudeSeries


def attitude_input(path: str, options: Mapping[str, object], side: str = "") -> AttitudeInput:
    """Return the attitude series to read, ``LOG`` or ``LOG:TOPIC``, from settings by name."""
    values = parse_all(options, READ_ATTITUDES)
    path, values["topic"] = split_topic(path, values.get("topic"))
    return AttitudeInput(
        path,
        values.get("kind"),
        AttitudeSelection.from_settings(values),
        normalize=values.get("normalize", False),
        drop=values.get("on_invalid") == "drop",
        part=GyroCorrection(start=values.get("start"), end=values.get("end")),
        side=side,
    )


def load_attitudes(wanted: AttitudeInput) -> LoadedAttitudes:
    """Read an attitude series into memory."""
    with open_attitudes(wanted) as attitudes:
        return attitudes.load(attitudes.batches())


def open_attitudes(wanted: AttitudeInput) -> OpenAttitudes:
    """Open an attitude series, to be read batch by batch."""
    selection = RateSelection(topic=wanted.selection.topic, msg_path=wanted.selection.msg_path)
    with errors_of(wanted.side), ExitStack() as stack:
        recording = stack.enter_context(open_recording([wanted.path], selection, wanted.kind))
        attitudes = OpenAttitudes(recording, wanted, stack)
        attitudes.opened = stack.pop_all()
        return attitudes


class RecordedAttitudes:
    """An attitude series of a recording.

    `signal`: the attitudes as they were recorded
    `counts`: valid and invalid rows, of the latest reading
    `range`: the time range, with the number of rows outside of it, of the latest reading
    """

    def __init__(self, recording: Recording, wanted: AttitudeInput) -> None:
        self.recording, self._wanted = recording, wanted
        self.signal = recording.attitude_signal(wanted.selection)
        self.range = TimeRange(GyroCorrection())
        self._ends: Ends | None = None
        self._check = QuaternionCheck(wanted.path)
        self._zeros = self._first_ns = self._last_ns = 0

    @property
    def counts(self) -> QuaternionCounts:
        """Valid and invalid rows, of the latest reading."""
        return self._check.counts

    def rows(
        self, *, positions: bool = False, covariances: bool = False, others: Group = ()
    ) -> Rows:
        """Read the rows in the time range, not checked; each call starts again."""
        part, signal = self._wanted.part, self.signal
        rows = signal.read(positions=positions, covariances=covariances, others=others)
        return rows if part.start is None and part.end is None else self._inside(rows)

    def batches(
        self,
        *,
        positions: bool | None = None,
        covariances: bool | None = None,
        others: Group = (),
    ) -> Iterator[AttitudeSeries]:
        """Read the valid attitudes, at least one, batch by batch; each call starts again.

        `positions`, `covariances`: whether to read them too; None: as is wanted, if there are any
        `others`: further columns of numbers
        """
        wanted, signal = self._wanted, self.signal
        with errors_of(wanted.side):
            signal.refuse_placeholder(wanted.path, wanted.otherwise)
        if positions is None:
            positions = wanted.positions and signal.has_positions
        if covariances is None:
            covariances = wanted.covariances and signal.may_have_covariances
        self._check = QuaternionCheck(wanted.path, normalize=wanted.normalize, drop=wanted.drop)
        rows = self.rows(positions=positions, covariances=covariances, others=others)
        self._zeros = 0
        ends: list[int] = []
        with errors_of(wanted.side):
            for batch in self._check.apply(rows):
                self._zeros += int(np.count_nonzero(batch.t_ns == 0))
                ends += int(batch.t_ns.min()), int(batch.t_ns.max())
                yield batch
            if not ends:
                raise self.nothing()
        self._first_ns, self._last_ns = min(ends), max(ends)

    def nothing(self) -> LogError:
        """Return the error for a series without rows."""
        if self._check.counts.samples_read:
            return self._check.refusal()
        return NoSamplesError(
            self._wanted.path,
            self.signal.name,
            self.range.outside,
            losses=self.recording.losses,
            length=self.range.length,
        )

    def _inside(self, rows: Rows) -> Rows:
        """Yield the rows in the time range."""
        part = self._wanted.part
        if part.looks_ahead and self._ends is None:
            finder = EndsFinder()
            for t_ns, outliers, _ in marked((t for t, _ in self.signal.rows()), lambda t: t):
                finder.add(t_ns[~outliers])
            self._ends = finder.ends()
        self.range = TimeRange(part, self._ends)
        numbered = ((AttitudeSeries(*row), row[0]) for row in rows)
        for series, _ in self.range.apply(numbered):
            yield tuple(getattr(series, field.name) for field in fields(series))

    def load(self, batches: Iterator[AttitudeSeries]) -> LoadedAttitudes:
        """Return the series in memory."""
        series = replace(
            AttitudeSeries.gathered(batches),
            read_layout=self.signal.layout,
            lag_ns=_recorded_lag_ns(self.signal.provenance),
            sensitivity=recorded_sensitivity(self.signal.provenance),
        )
        facts = self.facts()
        named = {name: getattr(facts, name) for name in ReadAttitudes.__slots__}
        return LoadedAttitudes(**named, series=series)

    def facts(self) -> ReadAttitudes:
        """Return the facts, after all batches were read."""
        counts, signal = self._check.counts, self.signal
        found = *self.range.remarks(), *self.recording.remarks
        signal = replace(signal, remarks=(*signal.remarks, *found))
        # One zero may be the start of the series.
        if signal.clock == "header" and self._zeros > 1:
            text = f"{self._zeros} of {counts.samples_used} header timestamps are zero"
            remark = Remark("zero-stamps", text)
            signal = replace(signal, remarks=(*signal.remarks, remark))
        return ReadAttitudes(
            input=replace(self._wanted, path=without_secret(self._wanted.path)),
            kind=self.recording.kind,
            signal=signal,
            samples=counts.samples_used,
            first_ns=self._first_ns,
            last_ns=self._last_ns,
            counts=counts,
            losses=self.recording.losses,
        )


def _recorded_lag_ns(provenance: JsonObject) -> int | None:
    """Return the lag of the attitudes in a file by its metadata, ns; None: not recorded."""
    convention = entry_of(provenance, "convention", dict)
    interval_ns = entry_of(entry_of(provenance, "counts", dict), "median_dt_ns", int)
    rule = entry_of(convention, "samples", str), entry_of(convention, "method", str)
    return lag_ns(*rule, interval_ns or None)


def recorded_sensitivity(provenance: JsonObject) -> MethodSensitivity | None:
    """Return by how much a better integration rule changes attitudes, by their metadata."""
    convention, result = (entry_of(provenance, name, dict) for name in ("convention", "result"))
    rule = entry_of(convention, "samples", str), entry_of(convention, "method", str)
    better, angle_rad = (
        entry_of(result, "next_method", str),
        entry_of(result, "method_sensitivity_rad", float),
    )
    return sensitivity(*rule, better, angle_rad)


class OpenAttitudes(RecordedAttitudes):
    """An attitude series of a recording that a ``with`` block closes."""

    def __init__(self, recording: Recording, wanted: AttitudeInput, opened: ExitStack) -> None:
        super().__init__(recording, wanted)
        self.opened = opened

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.opened.close()


# Interpolate an attitude series at a constant rate.


class Resampling:
    """Interpolates an attitude series, held in memory, at a constant rate.

    `rate`: output rate, Hz, from the first attitude on
    `interpolation_error_rad`: approximate largest interpolation error so far, rad
    """

    def __init__(self, path: str, rate: Fraction) -> None:
        self._path = path
        self._times = Steady(rate)
        self._gaps = self._gap_ns = 0
        self.interpolation_error_rad = 0.0

    def applied(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield the interpolated attitudes with their other columns; none within gaps."""
        parts = list(batches)
        if not parts:
            return
        series = AttitudeSeries.joined(parts)
        steps = np.diff(series.t_ns)
        if len(wrong := np.flatnonzero(steps <= 0)):
            raise TimelineError(
                self._path,
                "attitudes are interpolated only between rising timestamps, not between "
                f"{series.t_ns[wrong[0]]} ns and {series.t_ns[wrong[0] + 1]} ns; omit "
                f"{Setting('rate')}",
            )
        self._gap_ns = GAP_FACTOR * int(np.median(steps)) if len(steps) else 0
        cuts = np.flatnonzero(steps > self._gap_ns) + 1
        self._gaps = len(cuts)
        for start, stop in zip([0, *cuts], [*cuts, len(series)], strict=True):
            yield from self._between(series[int(start) : int(stop)])

    def _between(self, series: AttitudeSeries) -> Iterator[AttitudeSeries]:
        """Yield the interpolated attitudes of a stretch without gaps."""
        self._times.refuse_excess(series.t_ns)
        wanted = list(self._times.up_to(int(series.t_ns[0]), int(series.t_ns[-1])))
        if not wanted:
            return
        t_ns = np.concatenate(wanted)
        # The only time within a single sample is its own.
        wxyz = series.wxyz.copy()
        if len(series) > 1:
            wxyz, interpolation_error_rad = interpolate(series, t_ns)
            self.interpolation_error_rad = max(
                self.interpolation_error_rad, interpolation_error_rad
            )
        # Samples at these times are kept exactly: interpolation normalises.
        at = np.searchsorted(series.t_ns, t_ns)
        known = series.t_ns[at] == t_ns
        wxyz[known] = series.wxyz[at[known]]
        for first in range(0, len(t_ns), PIECE):
            rows = slice(first, first + PIECE)
            yield with_columns(series, t_ns[rows], wxyz[rows], "body")

    def remarks(self) -> Iterator[Remark]:
        """Yield a remark on gaps, if there are any."""
        if self._gaps:
            yield Remark(
                "gaps-kept",
                f"no attitudes are interpolated across {count_text(self._gaps, 'gap')} longer than "
                f"{duration_text(self._gap_ns)}",
            )
