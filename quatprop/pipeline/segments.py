"""A log propagated stretch by stretch: across gaps, at the times that are wanted.

A gap that is not to be propagated across ends a stretch. The next begins from the attitude before
it, if nothing is to turn in between, or from q0 again.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING

from quatprop.kinematics.propagate import Propagation
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.kinematics.resample import at_times
from quatprop.series import AttitudeSeries, reblock

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.kinematics.resample import Times
    from quatprop.series import GyroSeries
    from quatprop.timeline import Timeline


class Segments:
    """Propagates a log stretch by stretch and knows the attitude reached.

    Parameters
    ----------
    timeline
        Cuts the samples into stretches; its policy says how one goes on from another.
    q0
        Attitude at the first sample, wxyz, unit length.
    method, rates
        As for :func:`quatprop.kinematics.propagate.propagate`.
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
        self._q0 = self.final = self._other_final = q0
        self._method, self._rates = method, rates
        self._other_method = "start" if method == "coning" else "coning"
        self._times = times

    def attitudes(self, batches: Iterable[GyroSeries]) -> Iterator[AttitudeSeries]:
        """Return the attitudes at every sample, or at the times that are wanted."""
        return chain.from_iterable(map(self._wanted, self._timeline.segments(batches)))

    def _wanted(self, stretch: Iterator[GyroSeries]) -> Iterator[AttitudeSeries]:
        propagated = self._propagated(stretch)
        if self._times is None:
            return (series for _, series in propagated)
        return at_times(propagated, self._times, method=self._method, rates=self._rates)

    def _propagated(
        self, stretch: Iterable[GyroSeries]
    ) -> Iterator[tuple[GyroSeries, AttitudeSeries]]:
        """Yield samples with their attitudes; after a gap from q0, or from the one before it."""
        if self._timeline.policy.on_gap == "split":
            self.final = self._other_final = self._q0
        this = Propagation(self.final, self._method, self._rates)
        other = Propagation(self._other_final, self._other_method, self._rates)
        for block in reblock(stretch):
            wxyz = this.advance(block)
            self.final, self._other_final = wxyz[-1], other.advance(block)[-1]
            yield block, AttitudeSeries(block.t_ns, wxyz)

    @property
    def method_sensitivity_rad(self) -> float:
        """Angle between the ends of the coning method and of the one used, rad.

        It tells what the samples leave open: how the body turned between them. For coning it is
        held against start.
        """
        return float(geodesic_angle(self.final, self._other_final))
