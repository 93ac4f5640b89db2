"""Propagate a log segment by segment, at the samples or at the requested times.

A gap that is not propagated across ends a segment. The next one begins with the attitude before the
gap, if no rotation is assumed in between, or with q0 again.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING

from quatprop.kinematics.propagate import Propagation
from quatprop.kinematics.quaternion import conjugate, rotate
from quatprop.kinematics.resample import Times, at_times
from quatprop.kinematics.sensitivity import Sensitivity

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.kinematics.uncertainty import ErrorGrowth
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.timeline import Timeline


class Segments:
    """Propagates a log segment by segment.

    `timeline`: cuts the samples into segments; its policy says how one continues from another
    `q0`: attitude at the first sample, wxyz, unit length
    `times`: requested times; None for every sample
    `final`: the attitude at the last sample so far, wxyz
    `sensitivity`: its sensitivity to method and sampling; None if not requested
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
                self.sensitivity.add(block)
            if self.growth is not None:
                to_end = not self._covariance
                covariance = self.growth.advance(block, attitudes.wxyz, to_end=to_end)
                if self._covariance:
                    attitudes = replace(attitudes, covariance=covariance)  # noqa: PLW2901
            if block.log_ns is not None:
                attitudes = replace(attitudes, log_ns=block.log_ns)  # noqa: PLW2901
            if self._rate:
                attitudes = replace(attitudes, rate=self._body_rate(block, attitudes))  # noqa: PLW2901
            yield block, attitudes
        if self.sensitivity is not None:
            self.sensitivity.finish()

    def _body_rate(self, block: GyroSeries, attitudes: AttitudeSeries) -> NDArray[np.float64]:
        return (
            block.rate if self._rates == "body" else rotate(conjugate(attitudes.wxyz), block.rate)
        )
