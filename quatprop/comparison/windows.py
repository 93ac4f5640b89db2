"""Rotations over windows: what two series have in common whatever their frames and biases are.

The body angle of a series is the sum of its small rotations, resolved in the body frame: its
difference over a window is the integral of the body rate. It does not depend on the reference
frame; a bias adds a constant to it, which is taken out, and a slow drift hardly anything.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Bool, Float64
    from quatprop.series import AttitudeSeries


LENGTHS_S = (0.1, 0.2, 0.5, 1.0, 2.0)
"""Lengths of windows: the one in which the motion stands out most clearly is used."""

MAX_SAMPLES = 100_000
"""Samples of either series, from the start, that are looked at: clocks drift over more."""

MAX_WINDOWS = 20_000
"""Windows that are compared at most."""

MIN_LENGTHS = 20
"""Windows of which fewer would follow one another are shortened."""

MIN_WINDOWS = 40
"""Fewer windows show nothing."""

PER_WINDOW = 4
"""Windows overlap: this many begin in the length of one."""

EDGE = 0.2
"""Share of the common time, at most, that is left free at both ends for time offsets."""

MAX_EDGE_S = 0.5
"""At most this time is left free at both ends, s."""


class BodyAngle(NamedTuple):
    """The integral of a body rate.

    `seconds`: times from a common beginning, shape ``(N,)``, s
    `angle`: integral up to there, shape ``(N, 3)``, rad, resolved in the body frame
    """

    seconds: Float64
    angle: Float64

    def over(self, begin: Float64, length: float) -> Float64:
        """Return the integrals over windows, less the constant that a bias adds, ``(M, 3)``."""
        return centred(self.between(begin, begin + length))

    def between(self, begin: Float64, end: Float64) -> Float64:
        """Return the integrals over windows, ``(M, 3)``, rad."""
        columns = [
            np.interp(end, self.seconds, angle) - np.interp(begin, self.seconds, angle)
            for angle in self.angle.T
        ]
        return np.stack(columns, axis=1)


def common_beginning(a: AttitudeSeries, b: AttitudeSeries) -> tuple[AttitudeSeries, AttitudeSeries]:
    """Return the beginning of the common time, at most :data:`MAX_SAMPLES` of each."""
    start = max(a.t_ns[0], b.t_ns[0])
    begins = [max(int(np.searchsorted(series.t_ns, start)) - 1, 0) for series in (a, b)]
    return a[begins[0] :][:MAX_SAMPLES], b[begins[1] :][:MAX_SAMPLES]


def window_grids(a: Float64, b: Float64) -> Iterator[tuple[float, Float64]]:
    """Yield lengths of windows, s, and the times at which windows of that length begin, s.

    `a`, `b`: rising times of two series, s
    """
    interval = max(float(np.median(np.diff(times))) for times in (a, b))
    begin, end = max(a[0], b[0]), min(a[-1], b[-1])
    edge = min(MAX_EDGE_S, EDGE * (end - begin))
    longest = (end - begin) / MIN_LENGTHS
    lengths = sorted({max(min(length, longest), 2 * interval) for length in LENGTHS_S})
    for length in lengths:
        last = end - length - edge
        if last <= begin + edge:
            return
        spacing = max(length / PER_WINDOW, (last - begin - edge) / MAX_WINDOWS)
        starts = np.arange(begin + edge, last, spacing)
        for times in (a, b):
            starts = starts[_without_gap(times, starts, length, interval)]
        if len(starts) < MIN_WINDOWS:
            return
        yield length, starts


def _without_gap(times: Float64, starts: Float64, length: float, interval: float) -> Bool:
    """Tell which windows contain no gap of a series."""
    gaps = np.diff(times) > GAP_FACTOR * interval
    passed = np.concatenate([[0], np.cumsum(gaps)])
    before = np.maximum(np.searchsorted(times, starts, side="right") - 1, 0)
    after = np.minimum(np.searchsorted(times, starts + length), len(times) - 1)
    return np.asarray(passed[after] == passed[before])


def centred(values: Float64) -> Float64:
    """Return rows less their mean."""
    return np.asarray(values - values.mean(axis=0))


def body_angle(series: AttitudeSeries, first_ns: int) -> BodyAngle:
    """Return the body angle of a series; times are from `first_ns`."""
    total = np.zeros((len(series), 3))
    np.cumsum(rotation_vectors_between(series.wxyz), axis=0, out=total[1:])
    return BodyAngle((series.t_ns - first_ns) / NS_PER_S, total)
