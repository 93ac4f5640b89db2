"""Rotations over windows, which are independent of reference frames and constant biases.

The body angle of a series is the sum of its small rotations in the body frame; its difference over
a window is the integral of the body rate. A constant bias adds a constant to all windows, which is
removed with their mean; a slow drift hardly matters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Bool, Float64, Int64
    from quatprop.series import AttitudeSeries

    Times = Float64 | Int64


LENGTHS_S = (0.1, 0.2, 0.5, 1.0, 2.0)
"""Lengths of windows, s, of which the one with the lowest uncertainty is used."""

MAX_SAMPLES = 100_000
"""Maximum number of samples of either series, from the start: over more, clocks drift."""

MAX_WINDOWS = 20_000
"""Maximum number of windows."""

MIN_LENGTHS = 20
"""Windows are shortened until this many fit into the common time."""

MIN_WINDOWS = 40
"""Minimum number of windows."""

PER_WINDOW = 4
"""Overlap: number of windows that begin within the length of one."""

EDGE = 0.2
"""Maximum share of the common time left free at each end for time offsets."""

MAX_EDGE_S = 0.5
"""Maximum time left free at each end, s: larger offsets could match another motion."""


class BodyAngle(NamedTuple):
    """The integral of a body rate.

    `seconds`: times since a common origin, shape ``(N,)``, s
    `angle`: integral up to these times in the body frame, shape ``(N, 3)``, rad
    """

    seconds: Float64
    angle: Float64

    def over(self, begin: Float64, length: float) -> Float64:
        """Return the integrals over windows without the effect of a bias, ``(M, 3)``, rad."""
        return centred(self.between(begin, begin + length))

    def between(self, begin: Float64, end: Float64) -> Float64:
        """Return the integrals between times, ``(M, 3)``, rad."""
        columns = [
            np.interp(end, self.seconds, angle) - np.interp(begin, self.seconds, angle)
            for angle in self.angle.T
        ]
        return np.stack(columns, axis=1)


def common_beginning(a: AttitudeSeries, b: AttitudeSeries) -> tuple[AttitudeSeries, AttitudeSeries]:
    """Return the start of the common time, at most :data:`MAX_SAMPLES` samples of each."""
    start = max(a.t_ns[0], b.t_ns[0])
    begins = [max(int(np.searchsorted(series.t_ns, start)) - 1, 0) for series in (a, b)]
    return a[begins[0] :][:MAX_SAMPLES], b[begins[1] :][:MAX_SAMPLES]


def window_grids(a: Float64, b: Float64) -> Iterator[tuple[float, Float64]]:
    """Yield lengths of windows, s, and the start times of windows of this length, s.

    `a`, `b`: times of two series, rising, s
    """
    interval = max(float(np.median(np.diff(times))) for times in (a, b))
    begin, end = max(a[0], b[0]), min(a[-1], b[-1])
    edge = min(MAX_EDGE_S, EDGE * (end - begin))
    longest = (end - begin) / MIN_LENGTHS
    lengths = sorted({max(min(length, longest), 2 * interval) for length in LENGTHS_S})
    for length in lengths:
        last = end - length - edge
        spacing = max(length / PER_WINDOW, (last - begin - edge) / MAX_WINDOWS)
        starts = np.arange(begin + edge, last, spacing)
        for times in (a, b):
            starts = starts[~over_gap(times, starts, starts + length)]
        if len(starts) < MIN_WINDOWS:
            return
        yield length, starts


def over_gap(times: Times, begin: Times, end: Times) -> Bool:
    """Return which spans of time contain a part of a gap between the times of a series."""
    intervals = np.diff(times)
    after = np.flatnonzero(intervals > GAP_FACTOR * np.median(intervals)) + 1
    # Without one, as many gaps begin before the end as end before the beginning.
    begun = np.searchsorted(times[after - 1], end)
    return np.asarray(begun > np.searchsorted(times[after], begin, side="right"))


def centred(values: Float64) -> Float64:
    """Return rows minus their mean."""
    return np.asarray(values - values.mean(axis=0))


def body_angle(series: AttitudeSeries, first_ns: int) -> BodyAngle:
    """Return the body angle of a series, with times since `first_ns`."""
    total = np.zeros((3, len(series))).T  # by column, as each is interpolated
    np.cumsum(rotation_vectors_between(series.wxyz), axis=0, out=total[1:])
    return BodyAngle((series.t_ns - first_ns) / NS_PER_S, total)
