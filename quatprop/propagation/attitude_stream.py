"""The attitudes of one log as a stream, and the report on the run."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Protocol

import numpy as np

from quatprop.base.errors import NoSamplesError, SeriesError, TimelineError, UsageError
from quatprop.base.provenance import Digest
from quatprop.base.text import Remark, Setting, plain
from quatprop.kinematics.array_conversion import stamps_of
from quatprop.kinematics.propagate import Propagation, Sensitivity
from quatprop.kinematics.quaternion import conjugate, geodesic_angle, rotate, rotation_matrix
from quatprop.kinematics.resample import Listed, Steady, Times, at_times, every
from quatprop.kinematics.uncertainty import ErrorGrowth
from quatprop.propagation.conditioning import clipping_remarks, condition
from quatprop.propagation.conditioning.correction_inputs import conditioning_inputs
from quatprop.propagation.gyro_errors import UncertaintyReport, known_errors, uncertainty_report
from quatprop.propagation.initial_attitude import LogContext, first_attitude
from quatprop.propagation.plausibility import log_remarks
from quatprop.propagation.rate_checks import RateChecks
from quatprop.propagation.report import ConventionReport, ResultReport, RunReport, SourceReport
from quatprop.readers.open_log import FilesBeside
from quatprop.readers.tables.table_log import TableLog
from quatprop.settings.parsers import InMemory
from quatprop.settings.quantities import RATES
from quatprop.stores.checksum import crc32
from quatprop.stores.objects import without_secret
from quatprop.timeline import Timeline
from quatprop.timeline.counts import remarks

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from quatprop.kinematics.series import AttitudeSeries, GyroSeries
    from quatprop.propagation.settings import PropagationSettings
    from quatprop.readers.signal import RateSignal
    from quatprop.readers.tables.model import Log

    class Observer(Protocol):
        """Receives the rates and attitudes of a run, for example to plot them."""

        def rates(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
            """Yield the rates unchanged, bias and mounting applied."""

        def attitudes(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
            """Yield the attitudes unchanged, at all samples or at the requested times."""

        def draw(self, report: RunReport) -> None:
            """Draw the data received, with the report."""


# Propagate a log segment by segment, at the samples or at the requested times.
#
# A gap that is not propagated across ends a segment. The next one begins with the attitude before
# the gap, if no rotation is assumed in between, or with q0 again.


class Segments:
    """Propagates a log segment by segment.

    `timeline`: cuts the samples into segments; its policy says how one continues from another
    `q0`: attitude at the first sample, wxyz, unit length
    `times`: requested times; None for every sample
    `final`: the attitude at the last sample so far, wxyz
    `sensitivity`: the sensitivity to method and sampling; None if not requested
    `growth`: the growth of its error; None if the errors of the gyroscope are unknown
    """

    def __init__(  # noqa: PLR0913  # all that determines the attitudes
        self,
        timeline: Timeline,
        q0: NDArray[np.float64],
        *,
        method: str,
        rates: str,
        times: Times | None = None,
        growth: ErrorGrowth | None = None,
    ) -> None:
        self._timeline = timeline
        self._q0 = self.final = q0
        self._method, self._rates = method, rates
        self._times = times
        self.sensitivity: Sensitivity | None = None
        self.growth = growth

    def attitudes(
        self,
        samples: Iterable[GyroSeries],
        *,
        sensitivity: bool = True,
        covariance: bool = False,
        rate: bool = False,
    ) -> Iterator[AttitudeSeries]:
        """Return the attitudes at every sample, or at the requested times."""
        self._covariance, self._rate = covariance, rate
        if sensitivity:
            self.sensitivity = Sensitivity(self._q0, self._method, self._rates)
        segments = map(self._propagated, self._timeline.segments(samples))
        if self._times is None:
            return (series for _, series in chain.from_iterable(segments))
        if self._timeline.policy.on_gap == "split":
            return chain.from_iterable(
                self._resampled(segment, self._times) for segment in segments
            )
        return self._resampled(chain.from_iterable(segments), self._times)

    def _resampled(
        self, propagated: Iterator[tuple[GyroSeries, AttitudeSeries]], times: Times
    ) -> Iterator[AttitudeSeries]:
        """Yield the attitudes at the requested times, also inside gaps if they are known there."""
        first = next(propagated)
        zero = self._timeline.policy.on_gap == "zero"
        yield from at_times(
            chain([first], propagated),
            times,
            method=self._method,
            rates=self._rates,
            gap_limit_ns=self._timeline.counts.gap_limit_ns if zero else None,
        )

    def _propagated(
        self, segment: Iterable[GyroSeries]
    ) -> Iterator[tuple[GyroSeries, AttitudeSeries]]:
        """Yield samples and attitudes, which begin with q0 or the last one before the gap."""
        restart = self._timeline.policy.on_gap == "split"
        propagation = Propagation(self._q0 if restart else self.final, self._method, self._rates)
        if self.sensitivity is not None:
            self.sensitivity.begin(restart=restart)
        if self.growth is not None:
            self.growth.begin(restart=restart)
        for block, attitudes in propagation.run(segment):
            self.final = attitudes.wxyz[-1]
            if self.sensitivity is not None:
                self.sensitivity.add(block, attitudes.wxyz)
            if self.growth is not None:
                to_end = not self._covariance
                covariance = self.growth.advance(block, attitudes.wxyz, to_end=to_end)
                if self._covariance:
                    attitudes = replace(attitudes, covariance=covariance)  # noqa: PLW2901
            if self._rate:
                attitudes = replace(attitudes, rate=self._body_rate(block, attitudes))  # noqa: PLW2901
            yield block, attitudes
        if self.sensitivity is not None:
            self.sensitivity.finish()

    def _body_rate(self, block: GyroSeries, attitudes: AttitudeSeries) -> NDArray[np.float64]:
        return (
            block.rate if self._rates == "body" else rotate(conjugate(attitudes.wxyz), block.rate)
        )


class AttitudeStream:
    """Propagates one source of rates.

    `path`: the log, for errors and the report
    `log`: the open log, which can be read again; None for rates in memory
    `observer`: receives the rates and the attitudes
    `sensitivity`: whether to compute the sensitivity and the error of the final attitude
    """

    def __init__(  # noqa: PLR0913  # a log, what to do with it, and who looks on
        self,
        path: str,
        source: RateSignal,
        settings: PropagationSettings,
        log: Log | None,
        *,
        observer: Observer | None = None,
        sensitivity: bool = True,
        rate: bool = False,
    ) -> None:
        self._path, self._log, self._source, self._settings = path, log, source, settings
        self._observer, self._sensitivity, self._rate = observer, sensitivity, rate
        self._rows = self._crc_t = self._crc_q = 0
        # First, since the beginning of the log may be cached until the main pass.
        read_once = log is not None and str(log.path) == "-"
        self._log_remarks = [] if read_once else log_remarks(log, source, settings.rates)
        chosen_by = "time_col" if isinstance(log, TableLog) else "clock"
        self._method, self._method_from = source.method_used(settings.method)
        self._timeline = Timeline(
            settings.policy, path, chosen_by, method=self._method, rates=settings.rates
        )
        self._beside = FilesBeside()
        self._checks = RateChecks(source.unit, is_given=source.unit_is_given)
        self._batches, self._conditioned = condition(
            source.batches,
            self._timeline,
            settings.conditioning,
            RATES[source.unit],
            conditioning_inputs(
                log, source, settings.selection, settings.conditioning, self._beside
            ),
            # With sorting, samples of the range may be anywhere in the log.
            part_reader=None if settings.policy.on_backwards == "sort" else source.part_reader,
            begun=self._checks.begun,
        )
        self._errors = known_errors(settings.errors, self._conditioned)
        self._times = _times(settings, log, self._beside)

    @property
    def reads_all(self) -> bool:
        """Whether the whole log is read."""
        return self._conditioned.part is None

    def __iter__(self) -> Iterator[AttitudeSeries]:
        """Yield the attitudes in batches, once."""
        rates, settings = self._checks.observe(self._batches), self._settings
        if self._observer is not None:
            rates = self._observer.rates(rates)
        used = self._timeline.measured(rates)
        first = next(used, None)
        if first is None:
            done, dropped = self._conditioned, self._timeline.counts.dropped
            losses = self._log.losses if self._log else ()
            raise NoSamplesError(
                self._path, self._source.name, done.outside, dropped, losses, length=done.length
            )
        self._segments = self._begin(first)
        attitudes = self._segments.attitudes(
            chain([first], used),
            sensitivity=self._sensitivity,
            covariance=settings.errors.sigma,
            rate=self._rate,
        )
        if settings.earth_rate is not None:
            attitudes = settings.earth_rate.taken_off(attitudes, int(first.t_ns[0]))
        if self._observer is not None:
            attitudes = self._observer.attitudes(attitudes)
        try:
            for series in every(attitudes, settings.every or 1):
                self._rows += len(series)
                self._crc_t = crc32(np.ascontiguousarray(series.t_ns, "<i8").data, self._crc_t)
                self._crc_q = crc32(np.ascontiguousarray(series.wxyz, "<f8").data, self._crc_q)
                yield series
        except SeriesError as error:
            if self._log is None:
                raise
            way_out = f"omit others with {Setting('start')} and {Setting('end')}"
            raise TimelineError(self._path, f"{error.text}; {way_out}") from error
        self._timeline.refuse_standing_clock()
        if not self._rows:
            counts = self._timeline.counts
            raise TimelineError(
                self._path,
                f"{self._times_left_out()}; its samples are from {counts.first_ns} to "
                f"{counts.last_ns} ns: are both on the same clock?",
            )

    def _begin(self, first: GyroSeries) -> Segments:
        """Return the propagation, which starts at the first of these samples."""
        settings = self._settings
        context = LogContext(
            self._log,
            self._source,
            settings.selection,
            self._conditioned.mount,
            self._beside,
            in_order=settings.policy.on_backwards != "sort",
            first_ns=self._timeline.first_stamp_ns,
        )
        begin = first_attitude(settings.q0, context, first)
        self._q0 = begin.wxyz
        self._q0_covariance = begin.covariance(settings.errors.q0_sigma)
        return Segments(
            self._timeline,
            self._q0,
            method=self._method,
            rates=settings.rates,
            times=self._times,
            growth=self._growth(),
        )

    def _growth(self) -> ErrorGrowth | None:
        """Return the growth of the errors; None if they are unknown or not requested."""
        settings, q0 = self._settings, self._q0_covariance
        if self._errors is None or not (self._sensitivity or settings.errors.sigma):
            return None
        errors, _, rests = self._errors
        if settings.rates == "inertial":
            # Rates in the reference frame are not rotated by the mounting.
            return ErrorGrowth(errors, settings.rates, self._method, q0=q0, rests=rests)
        turn = rotation_matrix(self._q0)
        return ErrorGrowth(
            errors,
            settings.rates,
            self._method,
            self._conditioned.mount,
            q0=None if q0 is None else turn @ q0 @ turn.T,
            rests=rests,
        )

    def report(self, *, layout: str | None = None, digest: Digest | None = None) -> RunReport:
        """Return the report, after all attitudes were yielded."""
        settings, source, log = self._settings, self._source, self._log
        counts = self._timeline.counts
        span_s = counts.span_ns * 1e-9
        sensitivity, final = self._segments.sensitivity, self._segments.final
        method_rad, sampling_rad = (None, None) if sensitivity is None else sensitivity.angles
        if (earth := settings.earth_rate) is not None:
            # Only the final attitude: the sensitivities do not depend on the reference frame.
            (final,) = earth.against_ground(
                final[None], np.array([counts.last_ns]), counts.first_ns or 0
            )
        return RunReport(
            source=SourceReport(
                path=without_secret(self._path),
                kind="series" if log is None else log.kind,
                digest=digest or Digest(),
                name=source.name,
                type=source.type_name,
                rate=source.field,
                rate_unit=source.unit,
                clock=source.clock,
            ),
            convention=ConventionReport(
                rates=settings.rates,
                method=self._method,
                method_from=self._method_from,
                samples=source.samples,
                layout=layout,
                q0_wxyz=self._q0,
                q0_from=settings.q0.origin,
                earth_rate_rad_s=None if earth is None else earth.rate,
            ),
            policy=settings.policy,
            counts=counts,
            losses=(*(() if log is None else log.losses), *self._beside.losses),
            unchecked_chunks=0 if log is None else log.unchecked_chunks,
            remarks=tuple(self._remarks()),
            conditioning=self._conditioned,
            settings=settings.given,
            uncertainty=self._uncertainty(),
            result=ResultReport(
                samples=counts.used,
                first_ns=counts.first_ns,
                last_ns=counts.last_ns,
                span_s=span_s,
                sample_rate_hz=(counts.used - 1) / span_s if span_s > 0 else None,
                rows=self._rows,
                final_wxyz=final,
                net_rotation_rad=float(geodesic_angle(self._q0, final)),
                method_sensitivity_rad=method_rad,
                next_method=None if sensitivity is None else sensitivity.next_method,
                sampling_sensitivity_rad=sampling_rad,
                path_angle_rad=counts.path_angle_rad,
                attitudes_crc32=f"{self._crc_t:08x}{self._crc_q:08x}",
            ),
        )

    def _remarks(self) -> Iterator[Remark]:
        settings, counts = self._settings, self._timeline.counts
        is_mounted = settings.conditioning.mount is not None
        for remark in self._source.remarks:
            if not (is_mounted and remark.code == "stated-mount"):
                yield remark
        yield from self._source.method_remarks(settings.method)
        yield from remarks(counts, settings.policy, self._timeline.chosen_by)
        yield from clipping_remarks(settings.conditioning, self._conditioned)
        yield from self._conditioned.all_remarks
        yield from self._checks.remarks(counts)
        if left_out := self._times_left_out():
            yield Remark("times-left-out", left_out)
        yield from self._checks.step_remarks()
        for remark in self._log_remarks:
            if not (is_mounted and remark.code == "other-axes"):
                yield remark
        yield from () if self._log is None else self._log.remarks
        yield from self._beside.remarks

    def _times_left_out(self) -> str:
        """Return how many requested times have no attitude, and why; empty if all have one."""
        times, counts = self._times, self._timeline.counts
        if not isinstance(times, Listed) or len(times) <= self._rows:
            return ""
        outside = times.count_outside(counts.first_ns or 0, counts.last_ns or 0)
        in_gaps = len(times) - self._rows - outside
        places = [f"{outside} outside the samples used"] if outside else []
        places += [f"{in_gaps} in gaps"] if in_gaps else []
        left_out = f"{outside + in_gaps} of the {len(times)}" if self._rows else "none of the"
        verb = "have no" if self._rows else "has an"
        return (
            f"{left_out} times asked for with {Setting('at')} {verb} attitude: "
            f"{' and '.join(places)}"
        )

    def _uncertainty(self) -> UncertaintyReport | None:
        growth = self._segments.growth
        if self._errors is None or growth is None:
            return None
        return uncertainty_report(self._errors, self._q0_covariance, growth, self._settings.errors)


def _times(settings: PropagationSettings, log: Log | None, beside: FilesBeside) -> Times | None:
    """Return the requested times; None for the times of the samples."""
    if settings.at is None:
        return None if settings.rate is None else Steady(settings.rate)
    if isinstance(settings.at, InMemory):
        at = settings.at.value
        wanted, name = np.sort(stamps_of("at", getattr(at, "t_ns", at))), Setting("at")
    else:
        from quatprop.propagation.other_logs import stamps_in

        wanted = stamps_in(settings.at, log, settings.selection, beside)
        name = Setting("at", plain(without_secret(settings.at)))
    if not len(wanted):
        raise UsageError(f"{name} holds no timestamps")
    return Listed(wanted)
