"""Mean rotation rates over cells of one length: two sources of rotation on one kind of grid.

The mean rate of a rigid body over a cell does not depend on the reference frame; another body frame
rotates it, and another clock moves the cells. Rates and attitudes become the same thing here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.kinematics.propagate import rotation_vectors_between
from quatprop.timeline.stamps import GAP_FACTOR

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.kinematics.series import AttitudeSeries, GyroSeries

    Times = Int64 | Float64

SPIKE: Final = 3.0
"""One attitude is wrong if the steps to and from it are this many times the step across it."""

JUMP: Final = 20.0
"""The frame jumps at an interval this many times as fast as the two on either side."""


class Cells(NamedTuple):
    """Mean rotation rates over consecutive cells.

    `start_ns`: beginning of the first cell, ns
    `length_ns`: length of each cell, ns
    `rate`: mean rates in body axes, rad/s, shape ``(N, 3)``; 0 where they are not known
    `known`: which cells the series covers without a gap, shape ``(N,)``
    """

    start_ns: int
    length_ns: int
    rate: Float64
    known: Bool

    def __len__(self) -> int:
        return len(self.rate)


def cells_of_rates(rates: GyroSeries, length_ns: int, grid_ns: int | None = None) -> Cells:
    """Return the mean body rates over cells.

    `rates`: in order of time, finite
    `grid_ns`: the beginning of a cell, which may be outside the series; None: its first timestamp
    """
    steps_s = np.diff(rates.t_ns)[:, None] / NS_PER_S
    after = rates.rate[1:]
    if not rates.is_integrated("cubic"):
        after = (after + rates.rate[:-1]) / 2
    usual = np.diff(rates.t_ns) <= gap_ns(rates.t_ns)
    return _averaged(rates.t_ns, after * steps_s, usual, length_ns, grid_ns)


def cells_of_attitudes(attitudes: AttitudeSeries, length_ns: int) -> Cells:
    """Return the mean body rates of attitudes over cells; wrong ones and jumps are omitted.

    `attitudes`: in order of time, finite
    """
    attitudes = attitudes[~_spikes(attitudes.wxyz)]
    turns = rotation_vectors_between(attitudes.wxyz)
    steps = np.diff(attitudes.t_ns)
    usual = (steps <= gap_ns(attitudes.t_ns)) & ~_jumps(np.linalg.norm(turns, axis=1) / steps)
    return _averaged(attitudes.t_ns, turns, usual, length_ns, None)


def gap_ns(times: Times) -> float:
    """Return the interval above which there is a gap between times, in their unit."""
    intervals = np.diff(times)
    return GAP_FACTOR * float(np.median(intervals)) if len(intervals) else 0.0


def over_gap(times: Times, begin: Times, end: Times) -> Bool:
    """Return which spans of time contain a part of a gap between the times of a series."""
    after = np.flatnonzero(np.diff(times) > gap_ns(times)) + 1
    # Without one, as many gaps begin before the end as end before the beginning.
    begun = np.searchsorted(times[after - 1], end)
    return np.asarray(begun > np.searchsorted(times[after], begin, side="right"))


def _averaged(
    t_ns: Int64, turns: Float64, usual: Bool, length_ns: int, grid_ns: int | None
) -> Cells:
    """Return mean rates over cells.

    `turns`: rotation vectors of the intervals, shape ``(N - 1, 3)``, rad
    `usual`: which intervals are used, shape ``(N - 1,)``
    """
    first_ns = int(t_ns[0])
    if grid_ns is not None:
        first_ns += (grid_ns - first_ns) % length_ns
    edges = np.arange(first_ns, int(t_ns[-1]) + 1, length_ns)
    since = (t_ns - t_ns[0]).astype(float)
    total = np.zeros((len(t_ns), 3))
    np.cumsum(np.where(usual[:, None], turns, 0.0), axis=0, out=total[1:])
    missing = np.zeros(len(t_ns))
    np.cumsum(~usual, out=missing[1:])
    at = (edges - t_ns[0]).astype(float)
    sums = np.stack([np.interp(at, since, column) for column in (*total.T, missing)], axis=1)
    over = np.diff(sums, axis=0)
    known = over[:, 3] == 0
    rate = np.where(known[:, None], over[:, :3] * (NS_PER_S / length_ns), 0.0)
    return Cells(first_ns, length_ns, rate, known)


def _spikes(wxyz: Float64) -> Bool:
    """Return which attitudes are wrong alone: those next to them are near each other."""
    wrong = np.zeros(len(wxyz), np.bool_)
    if len(wxyz) > 2:  # noqa: PLR2004  # one on each side
        step = np.linalg.norm(rotation_vectors_between(wxyz), axis=1)
        pairs = [rotation_vectors_between(wxyz[first::2]) for first in (0, 1)]
        across = np.empty(len(wxyz) - 2)
        across[::2], across[1::2] = (np.linalg.norm(pair, axis=1) for pair in pairs)
        usual = SPIKE * (across + np.median(step))
        wrong[1:-1] = np.minimum(step[:-1], step[1:]) > usual
    return wrong


def _jumps(speed: Float64) -> Bool:
    """Return the intervals that are far faster than the two on either side."""
    near = np.pad(speed, 2)
    neighbours = np.max([near[k : k + len(speed)] for k in (0, 1, 3, 4)], axis=0)
    return np.asarray(speed > JUMP * (neighbours + np.median(speed)))
