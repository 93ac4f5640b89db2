"""Lines from reduced series: seconds, values, and breaks.

A NaN breaks a line at gaps in time and where an angle wraps: the line leaves the picture at one
edge and enters at the other, without a line across.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.plotting.reduction import Reduced


TURN = 360.0
"""deg."""


class Line(NamedTuple):
    """A line to draw.

    `seconds`, `values`: its points, shape ``(P,)``; NaN in both where it breaks
    """

    seconds: Float64
    values: Float64


class Unwrap:
    """Unwraps angles, which then do not jump from one end of their range to the other.

    Whole turns are added so that every angle is within half a turn of the one before it. The turns
    are counted as integers, so no rounding errors accumulate.
    """

    def __init__(self, traces: int) -> None:
        self._turns = np.zeros((traces, 1), dtype=np.int64)
        self._last: Float64 | None = None

    def applied(self, degrees: Float64) -> Float64:
        """Return the next angles, shape ``(traces, N)``, deg."""
        if not degrees.shape[1]:
            return degrees
        before = degrees[:, :1] if self._last is None else self._last
        steps = np.diff(degrees, axis=1, prepend=before)
        turns = self._turns - np.cumsum(np.rint(steps / TURN).astype(np.int64), axis=1)
        self._turns, self._last = turns[:, -1:].copy(), degrees[:, -1:].copy()
        continued: Float64 = degrees + TURN * turns
        return continued


def gaps_in(reduced: Reduced, limit_ns: int | None) -> Int64:
    """Return the gaps between bins as first and last stamps, shape ``(G, 2)``, int64 ns.

    `limit_ns`: intervals longer than this are gaps, ns; None: there are no gaps
    """
    gaps = reduced.gaps(limit_ns)
    return np.stack([reduced.last_ns[:-1][gaps], reduced.first_ns[1:][gaps]], axis=1)


def line(reduced: Reduced, trace: int, start_ns: int, limit_ns: int | None = None) -> Line:
    """Return one trace as a line.

    `start_ns`: the stamp at which the seconds begin, ns
    `limit_ns`: intervals longer than this are gaps, ns
    """
    # Subtract as integers: timestamps are too large for exact floats.
    begin, end = (reduced.first_ns - start_ns) * 1e-9, (reduced.last_ns - start_ns) * 1e-9
    middle, breaks = (begin + end) / 2, np.full(len(reduced), np.nan)
    first, last = reduced.first[trace], reduced.last[trace]
    low, high = reduced.low[trace], reduced.high[trace]
    # Drawing an extreme that is the first or last value again would make a slope a step.
    drawn = [
        np.ones(len(reduced), dtype=np.bool_),
        ~(low >= np.fmin(first, last)) & ~np.isnan(low),
        ~(high <= np.fmax(first, last)) & ~np.isnan(high),
        ~((begin == end) & (first == last)),
        np.append(reduced.gaps(limit_ns), False),
    ]
    chosen = np.stack(drawn, axis=1)
    return Line(
        np.stack([begin, middle, middle, end, breaks], axis=1)[chosen],
        np.stack([first, low, high, last, breaks], axis=1)[chosen],
    )


def folded(continuous: Line) -> Line:
    """Return a line of angles, deg, wrapped to half a turn about zero and broken there."""
    seconds, values = continuous
    turns = np.floor((values + TURN / 2) / TURN)
    inside = values - TURN * turns
    crossed = np.nan_to_num(np.diff(turns))
    (before,) = np.nonzero(crossed)
    if not len(before):
        return Line(seconds, inside)
    up = np.sign(crossed[before])
    after = before + 1
    leaving = TURN * turns[before] + up * TURN / 2
    entering = TURN * turns[after] - up * TURN / 2
    slope = (seconds[after] - seconds[before]) / (values[after] - values[before])
    left = seconds[before] + (leaving - values[before]) * slope
    entered = seconds[before] + (entering - values[before]) * slope
    edge, breaks = up * TURN / 2, np.full(len(before), np.nan)
    # A step of more than one turn crosses the whole range.
    whole = np.abs(crossed[before]) > 1
    both = np.ones(len(before), dtype=np.bool_)
    inserted = np.stack([both, both, whole, whole, whole, both], axis=1)
    cut_seconds = np.stack([left, breaks, left, entered, breaks, entered], axis=1)[inserted]
    cut_values = np.stack([edge, breaks, -edge, edge, breaks, -edge], axis=1)[inserted]
    places = np.repeat(after, inserted.sum(axis=1))
    return Line(np.insert(seconds, places, cut_seconds), np.insert(inside, places, cut_values))


def lone_points(drawn: Line) -> Line:
    """Return the points of a line without neighbours, which the line does not show."""
    finite = np.isfinite(drawn.values)
    padded = np.concatenate([[False], finite, [False]])
    lone = finite & ~padded[:-2] & ~padded[2:]
    return Line(drawn.seconds[lone], drawn.values[lone])
