"""Rotations over windows: what two series have in common whatever their frames and biases are.

The body angle of a series is the sum of its small rotations, resolved in the body frame: its
difference over a window is the integral of the body rate. It does not depend on the reference
frame; a bias adds a constant to it, which is taken out, and a slow drift hardly anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.kinematics.quaternion import rotate
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64, Int64
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

GAP_INTERVALS = 10
"""An interval this many times the median one is a gap: no window contains it."""


LAYOUTS = {"layout": [3, 0, 1, 2], "layout-first": [1, 2, 3, 0]}
"""Which components of B, as they were read, are w, x, y and z; for A the other one of the two."""


@dataclass(frozen=True, slots=True)
class BodyAngle:
    """The integral of a body rate.

    Parameters
    ----------
    seconds
        Times from a common beginning, shape ``(N,)``, s.
    angle
        Integral up to there, shape ``(N, 3)``, rad, resolved in the body frame.
    """

    seconds: Float64
    angle: Float64

    def over(self, begin: Float64, length: float) -> Float64:
        """Return the integrals over windows of one length, rad, shape ``(M, 3)``."""
        return self._at(begin + length) - self._at(begin)

    def _at(self, seconds: Float64) -> Float64:
        return np.stack(
            [np.interp(seconds, self.seconds, column) for column in self.angle.T], axis=1
        )

    def negated(self) -> BodyAngle:
        """Return the angle of the opposite rate."""
        return BodyAngle(self.seconds, -self.angle)

    def turned(self, wxyz: Float64) -> BodyAngle:
        """Return the angle in other body axes: q v q*."""
        return BodyAngle(self.seconds, rotate(wxyz, self.angle))


def common_beginning(a: AttitudeSeries, b: AttitudeSeries) -> tuple[AttitudeSeries, AttitudeSeries]:
    """Return both from where the later one begins, up to :data:`MAX_SAMPLES` of each."""
    start = max(a.t_ns[0], b.t_ns[0])
    begins = [max(int(np.searchsorted(series.t_ns, start)) - 1, 0) for series in (a, b)]
    return a[begins[0] :][:MAX_SAMPLES], b[begins[1] :][:MAX_SAMPLES]


def body_angle(t_ns: Int64, wxyz: Float64, first_ns: int, *, inertial: bool = False) -> BodyAngle:
    """Return the integral of the rates that lead from each attitude to the next.

    Parameters
    ----------
    t_ns
        Rising times, shape ``(N,)``.
    wxyz
        Unit quaternions, shape ``(N, 4)``.
    first_ns
        Where seconds are counted from.
    inertial
        Take the rates that multiply on the left (eq. 33) instead of those that multiply on the
        right (eq. 36).
    """
    steps = rotation_vectors_between(wxyz, rates="inertial" if inertial else "body")
    angle = np.zeros((len(wxyz), 3))
    np.cumsum(steps, axis=0, out=angle[1:])
    return BodyAngle((t_ns - first_ns) / NS_PER_S, angle)


def window_grids(a: Float64, b: Float64) -> Iterator[tuple[float, Float64]]:
    """Yield lengths of windows, s, and where windows of that length begin, s.

    Parameters
    ----------
    a, b
        Rising times of two series, s.
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


def _without_gap(times: Float64, starts: Float64, length: float, interval: float) -> Float64:
    """Tell which windows contain no gap of a series."""
    gaps = np.diff(times) > GAP_INTERVALS * interval
    passed = np.concatenate([[0], np.cumsum(gaps)])
    before = np.maximum(np.searchsorted(times, starts, side="right") - 1, 0)
    after = np.minimum(np.searchsorted(times, starts + length), len(times) - 1)
    return np.asarray(passed[after] == passed[before])


class Angles(NamedTuple):
    """Body angles of A and B, after a misreading of one of them was undone.

    Parameters
    ----------
    name
        The misreading; empty where nothing was undone.
    side
        Which series it was undone in: ``"a"``, ``"b"`` or neither.
    a, b
        The angles.
    """

    name: str
    side: str
    a: BodyAngle
    b: BodyAngle

    def over(self, begin: Float64, length: float) -> tuple[Float64, Float64]:
        """Return the angles of A and B over windows, less the constant that a bias adds, rad."""
        return centred(self.a.over(begin, length)), centred(self.b.over(begin, length))

    @property
    def interpolation(self) -> float:
        """RMS error, rad, of interpolation half-way between samples: 1/8 of second differences."""
        errors = [np.diff(angle.angle, 2, axis=0) / 8 for angle in (self.a, self.b)]
        return float(sum(np.sqrt((error**2).sum(axis=1).mean()) for error in errors))


def centred(values: Float64) -> Float64:
    """Return rows less their mean."""
    return np.asarray(values - values.mean(axis=0))


def undone_misreadings(a: AttitudeSeries, b: AttitudeSeries) -> Iterator[Angles]:
    """Yield the body angles as they are, and with each misreading undone in either series.

    The body rates of a conjugate are the opposite of the inertial rates. Rates that were composed
    on the wrong side are the inertial rates of the result.
    """
    first = min(int(a.t_ns[0]), int(b.t_ns[0]))
    body = {"a": body_angle(a.t_ns, a.wxyz, first), "b": body_angle(b.t_ns, b.wxyz, first)}
    yield Angles("", "", body["a"], body["b"])
    for side, series in (("b", b), ("a", a)):

        def of(name: str, angle: BodyAngle, side: str = side) -> Angles:
            angles = {**body, side: angle}
            return Angles(name, side, angles["a"], angles["b"])

        inertial = body_angle(series.t_ns, series.wxyz, first, inertial=True)
        yield of("conjugate", inertial.negated())
        yield of("side", inertial)
        orders = list(LAYOUTS.values())
        for name, order in zip(LAYOUTS, orders if side == "b" else orders[::-1], strict=True):
            wxyz = np.ascontiguousarray(series.wxyz[:, order])
            yield of(name, body_angle(series.t_ns, wxyz, first))
            inertial = body_angle(series.t_ns, wxyz, first, inertial=True)
            yield of(f"{name} and conjugate", inertial.negated())
    yield Angles("rate sign", "", body["a"], body["b"].negated())
