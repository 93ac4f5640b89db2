"""A log propagated segment by segment: across gaps, at the times that are wanted.

A gap that is not propagated across ends a segment. The next one begins with the attitude before the
gap, if no rotation is assumed in between, or with q0 again.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING

from quatprop.kinematics.propagate import FinalAttitude, Propagation
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.kinematics.resample import at_times

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.kinematics.resample import Times
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.timeline import Timeline


class Segments:
    """Propagates a log segment by segment.

    Parameters
    ----------
    timeline
        Cuts the samples into segments; its policy says how one continues from another.
    q0
        Attitude at the first sample, wxyz, unit length.
    method, rates
        As for :class:`quatprop.kinematics.propagate.Propagation`.
    times
        When attitudes are wanted; None is at every sample.

    Attributes
    ----------
    final
        The attitude at the last sample so far, wxyz.
    """

    def __init__(
        self,
        timeline: Timeline,
        q0: NDArray[np.float64],
        *,
        method: str,
        rates: str,
        times: Times | None = None,
    ) -> None:
        self._timeline = timeline
        self._q0 = self.final = q0
        self._method, self._rates = method, rates
        self._times = times
        self._other_final: NDArray[np.float64] | None = None

    def attitudes(
        self, samples: Iterable[GyroSeries], *, sensitivity: bool = True
    ) -> Iterator[AttitudeSeries]:
        """Return the attitudes at every sample, or at the times that are wanted.

        Parameters
        ----------
        samples
            What the timeline's policy leaves of the log, in blocks.
        sensitivity
            Whether to find out how much the final attitude depends on the method.
        """
        self._other_final = self._q0 if sensitivity else None
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
        """Yield the attitudes at the wanted times; inside gaps too, where they are known."""
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
        """Yield samples with their attitudes; after a gap from q0, or from the one before it."""
        restart = self._timeline.policy.on_gap == "split"
        propagation = Propagation(self._q0 if restart else self.final, self._method, self._rates)
        other = None
        if self._other_final is not None:
            method = other_method(self._method)
            other = FinalAttitude(self._q0 if restart else self._other_final, method, self._rates)
        for block, attitudes in propagation.run(segment):
            self.final = attitudes.wxyz[-1]
            if other is not None:
                other.advance(block)
                self._other_final = other.wxyz
            yield block, attitudes

    @property
    def method_sensitivity_rad(self) -> float | None:
        """Angle between the final attitudes of the method and of :func:`other_method`, rad.

        It shows what the samples leave open: how the body rotated between them. None where it was
        not asked for.
        """
        if self._other_final is None:
            return None
        return float(geodesic_angle(self.final, self._other_final))


def other_method(method: str) -> str:
    """Return the method with which the final attitude of a method is compared."""
    return "start" if method == "coning" else "coning"
