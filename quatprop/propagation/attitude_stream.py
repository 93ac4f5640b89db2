"""The attitudes of one log as a stream, and the report on the run."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Protocol

import numpy as np

from quatprop.base.errors import SeriesError, TimelineError, UsageError
from quatprop.base.places import without_secret
from quatprop.base.provenance import Digest
from quatprop.base.text import Remark, Setting, plain
from quatprop.kinematics.array_conversion import stamps_of
from quatprop.kinematics.propagate import Propagation
from quatprop.kinematics.quaternion import conjugate, geodesic_angle, rotate, rotation_matrix
from quatprop.kinematics.resample import Listed, Steady, Times, at_times, every
from quatprop.kinematics.sensitivity import Sensitivity
from quatprop.kinematics.uncertainty import ErrorGrowth
from quatprop.propagation.gyro_errors import UncertaintyReport, known_errors, uncertainty_report
from quatprop.propagation.initial_attitude import LogContext, first_attitude
from quatprop.propagation.rate_stream import RateStream
from quatprop.propagation.report import ConventionReport, ResultReport, RunReport, SourceReport
from quatprop.settings.parsers import InMemory
from quatprop.stores.checksum import crc32

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from quatprop.kinematics.series import AttitudeSeries, GyroSeries
    from quatprop.propagation.recording import Recording
    from quatprop.propagation.settings import PropagationSettings
    from quatprop.timeline.policies import Timeline

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
                rate = block.rate
                if self._rates != "body":
                    rate = rotate(conjugate(attitudes.wxyz), rate)
                attitudes = replace(attitudes, rate=rate)  # noqa: PLW2901
            yield block, attitudes
        if self.sensitivity is not None:
            self.sensitivity.finish()


class AttitudeStream:
    """Propagates the rates of a recording.

    `observer`: receives the rates and the attitudes
    `sensitivity`: whether to compute the sensitivity and the error of the final attitude
    `rate`: whether the attitudes have body rates
    """

    def __init__(
        self,
        recording: Recording,
        settings: PropagationSettings,
        *,
        observer: Observer | None = None,
        sensitivity: bool = True,
        rate: bool = False,
    ) -> None:
        self._observer, self._sensitivity, self._rate = observer, sensitivity, rate
        self._rows = self._crc_t = self._crc_q = 0
        self._rates = RateStream(recording, settings.of_rates)
        self._recording = recording
        self._settings = settings.for_rates_of(self._rates.source.matches)
        self._errors = known_errors(settings.errors, self._rates.correction)
        self._times = _times(settings, recording)

    @property
    def reads_all(self) -> bool:
        """Whether the whole log is read."""
        return self._rates.reads_all

    def __iter__(self) -> Iterator[AttitudeSeries]:
        """Yield the attitudes in batches, once."""
        settings, observer = self._settings, self._observer
        used = self._rates.read(used=iter if observer is None else observer.rates)
        first = next(used)
        self._segments = self._begin(first)
        attitudes = self._segments.attitudes(
            chain([first], used),
            sensitivity=self._sensitivity,
            covariance=settings.errors.sigma,
            rate=self._rate,
        )
        if settings.earth_rate is not None:
            attitudes = settings.earth_rate.subtract_earth_rate(attitudes, int(first.t_ns[0]))
        if observer is not None:
            attitudes = observer.attitudes(attitudes)
        try:
            for series in every(attitudes, settings.every or 1):
                self._rows += len(series)
                self._crc_t = crc32(np.ascontiguousarray(series.t_ns, "<i8").data, self._crc_t)
                self._crc_q = crc32(np.ascontiguousarray(series.wxyz, "<f8").data, self._crc_q)
                yield series
        except SeriesError as error:
            if self._recording.log is None:
                raise
            remedy = f"omit others with {Setting('start')} and {Setting('end')}"
            raise TimelineError(self._recording.name, f"{error.text}; {remedy}") from error
        self._rates.timeline.refuse_standing_clock()
        if not self._rows:
            counts = self._rates.counts
            raise TimelineError(
                self._recording.name,
                f"{self._times_left_out()}; its samples are from {counts.first_ns} to "
                f"{counts.last_ns} ns: are both on the same clock?",
            )

    def _begin(self, first: GyroSeries) -> Segments:
        """Return the propagation, which starts at the first of these samples."""
        settings, rates = self._settings, self._rates
        context = LogContext(
            self._recording,
            rates.source,
            rates.correction.mount,
            rates.correction.mount_frames or (),
            settings.rates,
            in_order=settings.policy.on_backwards != "sort",
            first_ns=rates.timeline.first_stamp_ns,
        )
        begin = first_attitude(settings.q0, context, first)
        self._q0 = begin.wxyz
        self._q0_covariance = begin.covariance(settings.errors.q0_sigma)
        return Segments(
            rates.timeline,
            self._q0,
            method=rates.method,
            rates=settings.rates,
            times=self._times,
            growth=self._growth(),
        )

    def _growth(self) -> ErrorGrowth | None:
        """Return the growth of the errors; None if they are unknown or not requested."""
        settings, q0, method = self._settings, self._q0_covariance, self._rates.method
        if self._errors is None or not (self._sensitivity or settings.errors.sigma):
            return None
        errors, _, rests = self._errors
        if settings.rates == "inertial":
            # Rates in the reference frame are not rotated by the mounting.
            return ErrorGrowth(errors, settings.rates, method, q0=q0, rests=rests)
        turn = rotation_matrix(self._q0)
        return ErrorGrowth(
            errors,
            settings.rates,
            method,
            self._rates.correction.mount,
            q0=None if q0 is None else turn @ q0 @ turn.T,
            rests=rests,
        )

    def report(self, *, layout: str | None = None, digest: Digest | None = None) -> RunReport:
        """Return the report, after all attitudes were yielded."""
        settings, rates, recording = self._settings, self._rates, self._recording
        source, counts = rates.source, rates.counts
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
                path=without_secret(recording.name),
                kind=recording.kind,
                digest=digest or Digest(),
                name=source.name,
                type=source.type_name,
                rate=source.field,
                rate_unit=source.unit,
                clock=source.clock,
            ),
            convention=ConventionReport(
                rates=settings.rates,
                method=rates.method,
                method_from=rates.method_from,
                samples=source.samples,
                layout=layout,
                q0_wxyz=self._q0,
                q0_from=settings.q0.origin,
                earth_rate_rad_s=None if earth is None else earth.rate,
            ),
            policy=settings.policy,
            counts=counts,
            losses=recording.losses,
            unchecked_chunks=recording.unchecked_chunks,
            remarks=tuple(self._remarks()),
            correction=rates.correction,
            settings=settings.given,
            uncertainty=self._uncertainty(),
            result=ResultReport(
                samples=counts.samples_used,
                first_ns=counts.first_ns,
                last_ns=counts.last_ns,
                span_s=span_s,
                sample_rate_hz=(counts.samples_used - 1) / span_s if span_s > 0 else None,
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
        if left_out := self._times_left_out():
            yield Remark("times-left-out", left_out)
        yield from self._rates.remarks()

    def _times_left_out(self) -> str:
        """Return how many requested times have no attitude, and why; empty if all have one."""
        times, counts = self._times, self._rates.counts
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


def _times(settings: PropagationSettings, recording: Recording) -> Times | None:
    """Return the requested times; None for the times of the samples."""
    if settings.at is None:
        return None if settings.rate is None else Steady(settings.rate)
    if isinstance(settings.at, InMemory):
        at = settings.at.value
        wanted, name = np.sort(stamps_of("at", getattr(at, "t_ns", at))), Setting("at")
    else:
        from quatprop.propagation.other_logs import stamps_in

        wanted = stamps_in(settings.at, recording)
        name = Setting("at", plain(without_secret(settings.at)))
    if not len(wanted):
        raise UsageError(f"{name} holds no timestamps")
    return Listed(wanted)
