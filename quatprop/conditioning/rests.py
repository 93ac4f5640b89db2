"""Stationary periods from which the bias is estimated: one, or several over time."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from quatprop.conditioning.quantisation import StepFinder, levels_of
from quatprop.conditioning.static_detection import find_static_periods, static_period_between
from quatprop.conditioning.time_range import absolute_ns
from quatprop.conditioning.window_sums import between, window_sums

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from quatprop.arrays import Float64, Int64
    from quatprop.conditioning import GyroCorrectionInputs
    from quatprop.conditioning.static_period import StaticPeriod
    from quatprop.conditioning.time_range import EndsFinder
    from quatprop.conditioning.window_sums import Rows
    from quatprop.series import GyroSeries
    from quatprop.settings.static_bias import StaticBias


def find_rests(
    read: Callable[[Callable[[Int64], object]], Iterable[GyroSeries]],
    finder: EndsFinder,
    static: StaticBias,
    inputs: GyroCorrectionInputs,
    frame: str,
) -> tuple[StaticPeriod, ...]:
    """Return the stationary periods from which the bias is estimated, in order of time.

    `read`: reads the samples, rad/s, sensor axes, and passes their timestamps to a function
    `finder`: finder of the ends of the log
    `frame`: frame in which the rates are resolved: ``"body"`` or ``"inertial"``
    """
    steps = StepFinder()
    rows = ((each.t_ns, steps.noted(each.rate)) for each in read(finder.add))
    sums = window_sums(rows, static.window_ns // 2 or 1)

    def again(first_ns: int, last_ns: int) -> Rows:
        samples = read(lambda _: None)
        return between(((each.t_ns, each.rate) for each in samples), first_ns, last_ns)

    if static.start is not None and static.end is not None:
        part = (absolute_ns(instant, finder.ends()) for instant in (static.start, static.end))
        named = window_sums(again(*part), 1 << 62)
        rests = [static_period_between(named, static, sums, inputs, frame)]
    else:
        rests = find_static_periods(sums, inputs, static, frame)
    coarse = steps.above([rest.scatter_rad_s for rest in rests])
    if np.any(coarse):
        ranges = [(rest.first_ns, rest.last_ns) for rest in rests]
        levels = levels_of(again(ranges[0][0], ranges[-1][1]), ranges, coarse)
        rests = [rest._replace(levels=each) for rest, each in zip(rests, levels, strict=True)]
    return tuple(rests)


def worst_of(rests: Sequence[StaticPeriod]) -> StaticPeriod:
    """Return the period with the largest spread, and then quantisation error, for remarks."""
    return max(rests, key=lambda rest: (rest.spread_rad_s, rest.quantisation_rad_s))


class RestBiases:
    """The bias over time, from several stationary periods.

    `rests`: the periods, in order of time
    `interpolated`: whether it is interpolated between them, instead of taking the nearest
    """

    def __init__(self, rests: Sequence[StaticPeriod], *, interpolated: bool) -> None:
        self._means = np.array([rest.mean_rad_s for rest in rests])
        ends = [(rest.first_ns, rest.last_ns) for rest in rests]
        self._ends_ns = np.array(ends).ravel() if interpolated else None
        self._middles_ns = np.array([(a[1] + b[0]) // 2 for a, b in pairwise(ends)], np.int64)

    def at(self, t_ns: Int64) -> Float64:
        """Return the bias at times, ``(N, 3)``, rad/s."""
        if self._ends_ns is None:
            nearest = np.searchsorted(self._middles_ns, t_ns, side="right")
            return np.asarray(self._means[nearest])
        wanted, known = t_ns - self._ends_ns[0], self._ends_ns - self._ends_ns[0]
        means = np.repeat(self._means, 2, axis=0)
        return np.stack([np.interp(wanted, known, axis) for axis in means.T], axis=1)
