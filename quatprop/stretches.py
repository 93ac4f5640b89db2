"""A log propagated stretch by stretch: across gaps, at the times that are wanted.

A gap that is not to be propagated across ends a stretch. The next begins from the attitude before
it, if nothing is to turn in between, or from q0 again.
"""

from __future__ import annotations

from itertools import chain, tee
from typing import TYPE_CHECKING

from quatprop.propagate import propagate
from quatprop.quaternion import geodesic_angle
from quatprop.resample import at_times

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.resample import Times
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.timeline import Timeline


class Stretches:
    """Propagates a log stretch by stretch and knows the attitude reached.

    Parameters
    ----------
    timeline
        Cuts the samples into stretches; its policy says how one goes on from another.
    q0
        Attitude at the first sample, wxyz, unit length.
    method, rates
        As for :func:`quatprop.propagate.propagate`.
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
        return chain.from_iterable(map(self._wanted, self._timeline.stretches(batches)))

    def _wanted(self, stretch: Iterator[GyroSeries]) -> Iterator[AttitudeSeries]:
        if self._times is None:
            return self._propagated(stretch)
        return at_times(
            stretch, self._propagated, self._times, method=self._method, rates=self._rates
        )

    def _propagated(self, stretch: Iterable[GyroSeries]) -> Iterator[AttitudeSeries]:
        """Propagate one stretch; after a gap from q0, or from the attitude before it."""
        if self._timeline.policy.on_gap == "split":
            self.final = self._other_final = self._q0
        for_this, for_other = tee(stretch)
        this = propagate(for_this, q0=self.final, method=self._method, rates=self._rates)
        other = propagate(
            for_other, q0=self._other_final, method=self._other_method, rates=self._rates
        )
        for series, other_series in zip(this, other, strict=True):
            self.final, self._other_final = series.wxyz[-1], other_series.wxyz[-1]
            yield series

    @property
    def method_difference(self) -> float:
        """Angle between the ends of the coning method and of the one used, rad.

        It tells what the samples leave open: how the body turned between them. For coning it is
        held against start.
        """
        return float(geodesic_angle(self.final, self._other_final))
