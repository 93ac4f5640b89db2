"""The attitudes of one log as a stream, and the report on the run."""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Protocol

import numpy as np

from quatprop.conditioning import condition
from quatprop.conditioning.time_range import clipping_remarks
from quatprop.errors import NoSamplesError, SeriesError, TimelineError, UsageError
from quatprop.kinematics.quaternion import geodesic_angle, rotation_matrix
from quatprop.kinematics.resample import Listed, Steady, Times, every
from quatprop.kinematics.uncertainty import ErrorGrowth
from quatprop.logs.beside_rates import conditioning_inputs
from quatprop.pipeline.gyro_errors import UncertaintyReport, known_errors, uncertainty_report
from quatprop.pipeline.initial_attitude import LogContext, first_attitude
from quatprop.pipeline.plausibility import log_remarks
from quatprop.pipeline.rate_checks import RateChecks
from quatprop.pipeline.report import ConventionReport, ResultReport, RunReport, SourceReport
from quatprop.pipeline.segments import Segments
from quatprop.provenance import Digest
from quatprop.series.columns import stamps_of
from quatprop.settings.quantities import RATES
from quatprop.settings.rotations import InMemory
from quatprop.stores.objects import without_secret
from quatprop.tables.base import TableLog
from quatprop.text import Remark, Setting, plain
from quatprop.timeline import Timeline
from quatprop.timeline.counts import remarks

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.logs.signals.signal import RateSignal
    from quatprop.pipeline.settings import PropagationSettings
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.tables.log import Log

    class Observer(Protocol):
        """Receives the rates and attitudes of a run, for example to plot them."""

        def rates(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
            """Yield the rates unchanged, bias and mounting applied."""

        def attitudes(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
            """Yield the attitudes unchanged, at all samples or at the requested times."""

        def draw(self, report: RunReport) -> None:
            """Draw the data received, with the report."""


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
        self._rows = 0
        # First, since the beginning of the log may be cached until the main pass.
        read_once = log is not None and str(log.path) == "-"
        self._log_remarks = [] if read_once else log_remarks(log, source, settings.rates)
        chosen_by = "time_col" if isinstance(log, TableLog) else "clock"
        self._method, self._method_from = source.method_used(settings.method)
        self._timeline = Timeline(
            settings.policy, path, chosen_by, method=self._method, rates=settings.rates
        )
        self._checks = RateChecks(source.unit, is_given=source.unit_is_given)
        self._batches, self._conditioned = condition(
            source.batches,
            self._timeline,
            settings.conditioning,
            RATES[source.unit],
            conditioning_inputs(log, source, settings.selection, settings.conditioning),
            # With sorting, samples of the range may be anywhere in the log.
            part_reader=None if settings.policy.on_backwards == "sort" else source.part_reader,
            begun=self._checks.begun,
        )
        self._errors = known_errors(settings.errors, self._conditioned)
        self._times = _times(settings, log)

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
                yield series
        except SeriesError as error:
            if self._log is None:
                raise
            way_out = f"omit others with {Setting('start')} and {Setting('end')}"
            raise TimelineError(self._path, f"{error.text}; {way_out}") from error
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
        method_rad, sampling_rad = (
            (None, None) if sensitivity is None else sensitivity.angles(final)
        )
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
            losses=() if log is None else tuple(log.losses),
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
        yield from self._log_remarks
        yield from () if self._log is None else self._log.remarks

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


def _times(settings: PropagationSettings, log: Log | None) -> Times | None:
    """Return the requested times; None for the times of the samples."""
    if settings.at is None:
        return None if settings.rate is None else Steady(settings.rate)
    if isinstance(settings.at, InMemory):
        at = settings.at.value
        wanted, name = np.sort(stamps_of("at", getattr(at, "t_ns", at))), Setting("at")
    else:
        from quatprop.logs.wanted_times import stamps_in

        wanted = stamps_in(settings.at, log, settings.selection)
        name = Setting("at", plain(without_secret(settings.at)))
    if not len(wanted):
        raise UsageError(f"{name} holds no timestamps")
    return Listed(wanted)
