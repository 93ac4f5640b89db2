"""Integrals of the rotation rate of a source, in body and in reference axes, at any time.

The mean rate over a window is the difference of two integrals: it does not depend on the sample
rate, and rates and attitudes become the same thing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.kinematics.propagate import rotation_vectors_between
from quatprop.kinematics.quaternion import rotate

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.base.arrays import Bool, Float64, Int64

GAP: Final = 10.0
"""Intervals longer than this many median ones are gaps."""

MAX_POINTS: Final = 1 << 20
"""Maximum number of integrals that are kept."""

BODY, REFERENCE = "body", "reference"
"""The axes in which a rotation rate is resolved."""


class Turning(NamedTuple):
    """The integrals of one source.

    `seconds`: times since a common zero, shape ``(N,)``, s
    `body`: integral of the rate in body axes, shape ``(N, 3)``, rad
    `reference`: the same in reference axes; None for rates, of which they are unknown
    `wxyz`: attitudes at `seconds`, shape ``(N, 4)``; None for rates
    `interval`: the median interval, s
    `gap_begins`, `gap_ends`: intervals that are left out: gaps and jumps, s
    `shown`: which body axes are measured, shape ``(3,)``
    """

    seconds: Float64
    body: Float64
    reference: Float64 | None
    wxyz: Float64 | None
    interval: float
    gap_begins: Float64
    gap_ends: Float64
    shown: Bool

    def axes(self) -> tuple[str, ...]:
        """Return the axes in which the rate is known."""
        return (BODY,) if self.reference is None else (BODY, REFERENCE)

    def shown_in(self, axes: str) -> Bool:
        """Return which of the given axes are measured."""
        return self.shown if axes == BODY else np.ones(3, np.bool_)

    def mean_rate(self, axes: str, begin: Float64, length: float) -> Float64:
        """Return the mean rates over windows, shape ``(M, 3)``, rad/s."""
        total = self.body if axes == BODY or self.reference is None else self.reference
        return (self._at(total, begin + length) - self._at(total, begin)) / length

    def _at(self, total: Float64, times: Float64) -> Float64:
        """Return integrals at the given times, shape ``(M, 3)``, held before and after all."""
        times = np.clip(times, self.seconds[0], self.seconds[-1])
        after = np.clip(np.searchsorted(self.seconds, times), 1, len(self.seconds) - 1)
        first, last = self.seconds[after - 1], self.seconds[after]
        part = ((times - first) / (last - first))[:, None]
        before = total[after - 1]
        return np.asarray(before + part * (total[after] - before))

    def is_clear(self, begin: Float64, end: Float64) -> Bool:
        """Return which windows contain no part of a gap."""
        begun = np.searchsorted(self.gap_begins, end)
        ended = np.searchsorted(self.gap_ends, begin, side="right")
        return np.asarray(begun <= ended)

    def attitude_near(self, times: Float64) -> Float64 | None:
        """Return the attitudes next to the given times, shape ``(M, 4)``; None for rates."""
        if self.wxyz is None:
            return None
        return self.wxyz[np.clip(np.searchsorted(self.seconds, times), 0, len(self.wxyz) - 1)]


def turning_of_rates(
    t_ns: Int64, rate: Float64, zero_ns: int, shown: Bool, *, is_average: bool = False
) -> Turning:
    """Return the integrals of body rates.

    `zero_ns`: the common zero of time
    `is_average`: whether each rate is the average over the interval before its timestamp
    """

    def turns(rows: slice) -> tuple[Float64, ...]:
        part = rate[rows]
        after = part[1:] if is_average else (part[1:] + part[:-1]) / 2
        return (after * (np.diff(t_ns[rows]) / NS_PER_S)[:, None],)

    interval, gap = _intervals(t_ns)
    kept, (body,) = _totals(len(t_ns), turns, 1)
    seconds = (t_ns[kept] - zero_ns) / NS_PER_S
    return Turning(seconds, body, None, None, interval, *_ends(t_ns, zero_ns, gap), shown)


def turning_of_attitudes(
    t_ns: Int64, wxyz: Float64, zero_ns: int, shown: Bool, jumps: Bool | None = None
) -> Turning:
    """Return the integrals of attitudes.

    `jumps`: intervals in which the frame jumps, shape ``(N - 1,)``
    """
    interval, gap = _intervals(t_ns)
    left_out = gap if jumps is None else gap | jumps

    def turns(rows: slice) -> tuple[Float64, ...]:
        part = wxyz[rows]
        body = rotation_vectors_between(part)
        body[left_out[rows.start : rows.stop - 1]] = 0.0
        return body, rotate(part[:-1], body)

    kept, (body, reference) = _totals(len(t_ns), turns, 2)
    seconds = (t_ns[kept] - zero_ns) / NS_PER_S
    gaps = _ends(t_ns, zero_ns, left_out)
    return Turning(seconds, body, reference, wxyz[kept], interval, *gaps, shown)


BLOCK: Final = 1 << 15
"""Intervals at a time, so that intermediate arrays stay in the cache."""


def _intervals(t_ns: Int64) -> tuple[float, Bool]:
    """Return the median interval, s, and which ones are gaps."""
    steps = np.diff(t_ns)
    median = float(np.median(steps))
    return median / NS_PER_S, np.asarray(steps > GAP * median)


def _ends(t_ns: Int64, zero_ns: int, left_out: Bool) -> tuple[Float64, Float64]:
    """Return the begin and end times of omitted intervals, s."""
    (at,) = np.nonzero(left_out)
    return (t_ns[at] - zero_ns) / NS_PER_S, (t_ns[at + 1] - zero_ns) / NS_PER_S


def _totals(
    count: int, turns: Callable[[slice], tuple[Float64, ...]], axes: int
) -> tuple[slice, list[Float64]]:
    """Return which integrals are kept, every n-th, which stay exact at these times, and those.

    `turns`: returns the rotation vectors between the samples of some rows, in each kind of axes
    """
    every = -(-count // MAX_POINTS)
    kept = slice(None, None, every)
    totals = [np.zeros((-(-count // every), 3)) for _ in range(axes)]
    sums = [np.zeros(3) for _ in range(axes)]
    length = every * max(BLOCK // every, 1)
    for first in range(0, count - 1, length):
        rows = slice(first, min(first + length + 1, count))
        for k, turned in enumerate(turns(rows)):
            reached = np.cumsum(turned, axis=0) + sums[k]
            own = reached[every - 1 :: every]
            begin = first // every + 1
            totals[k][begin : begin + len(own)] = own
            sums[k] = reached[-1]
    return kept, totals
