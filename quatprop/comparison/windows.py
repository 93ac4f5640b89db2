"""Rotations over windows: what two series have in common whatever their frames and biases are.

The body angle of a series is the sum of its small rotations, resolved in the body frame: its
difference over a window is the integral of the body rate. It does not depend on the reference
frame; a bias adds a constant to it, which is taken out, and a slow drift hardly anything.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.kinematics.quaternion import rotate
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

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

AS_READ, LAST, FIRST = [0, 1, 2, 3], [3, 0, 1, 2], [1, 2, 3, 0]

MISREADINGS: Mapping[str, tuple[list[int], str, float]] = {
    "conjugate": (AS_READ, "inertial", -1.0),
    "side": (AS_READ, "inertial", 1.0),
    "layout": (LAST, "body", 1.0),
    "layout and conjugate": (LAST, "inertial", -1.0),
    "layout-first": (FIRST, "body", 1.0),
    "layout-first and conjugate": (FIRST, "inertial", -1.0),
}
"""How a misreading of B is undone: which components, as they were read, are w, x, y and z (for A
it is the other way round); which rates are integrated; and their sign. The body rates of a
conjugate are the opposite of the inertial rates. Rates that were composed on the wrong side are the
inertial rates of the result."""


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

    def turned(self, wxyz: Float64) -> BodyAngle:
        """Return the angle in other body axes: q v q*."""
        return BodyAngle(self.seconds, rotate(wxyz, self.angle))


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


class Angles(NamedTuple):
    """Body angles of A and B, after a misreading of one of them was undone.

    `name`: the misreading; empty where nothing was undone
    `side`: which series it was undone in: ``"a"``, ``"b"`` or neither
    """

    name: str
    side: str
    a: BodyAngle
    b: BodyAngle

    @property
    def interpolation(self) -> float:
        """RMS error, rad, of interpolation half-way between samples: 1/8 of second differences."""
        errors = [np.diff(angle.angle, 2, axis=0) / 8 for angle in (self.a, self.b)]
        return float(sum(np.sqrt((error**2).sum(axis=1).mean()) for error in errors))


def undone_misreadings(a: AttitudeSeries, b: AttitudeSeries) -> Iterator[Angles]:
    """Yield the body angles as they are, and with each misreading undone in either series."""
    first_ns = min(int(a.t_ns[0]), int(b.t_ns[0]))

    def angle(series: AttitudeSeries, order: list[int], rates: str, sign: float) -> BodyAngle:
        wxyz = np.ascontiguousarray(series.wxyz[:, order])
        total = np.zeros((len(wxyz), 3))
        np.cumsum(sign * rotation_vectors_between(wxyz, rates=rates), axis=0, out=total[1:])
        return BodyAngle((series.t_ns - first_ns) / NS_PER_S, total)

    body = {side: angle(one, AS_READ, "body", 1.0) for side, one in (("a", a), ("b", b))}
    yield Angles("", "", **body)
    for side, series in (("b", b), ("a", a)):
        for name, (order, rates, sign) in MISREADINGS.items():
            components = order if side == "b" else np.argsort(order).tolist()
            yield Angles(name, side, **{**body, side: angle(series, components, rates, sign)})
    yield Angles("rate sign", "", body["a"], angle(b, AS_READ, "body", -1.0))
