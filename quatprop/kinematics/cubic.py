"""The cubic integration rule: the rate in an interval is a cubic through four samples.

Between the samples k and k + 1, a time s after the first, the rate is the line through both plus

    s (s - h) (a + b s)

with h the length of the interval. The cubic through the samples k - 1 to k + 2 is a blend of the
two parabolas through three of them, so a and b follow from the second divided differences of the
rate at the samples k and k + 1. The first two terms of the Magnus series (W. Magnus, Comm. Pure
Appl. Math. 7, 1954) then give the rotation vector, with an error of fifth order in h.

If samples are averages over the intervals, or increments, the integral of the rate is known at the
samples. The cubic through four of its values has the same form, with the averages as slopes, and
the rate is a parabola; only the second term of the Magnus series must be added.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Bool, Float64, Int64, Intp


MAX_RATIO: Final = 4.0
"""Neighbouring intervals that differ by more than this factor are not used for one cubic: it would
amplify noise, and a long interval is probably a gap."""

MAX_RATIO_ONE_SIDED: Final = 2.0
"""The same for a parabola through the samples of one side only, which extrapolates more. For
averages the limit is :data:`MAX_RATIO` here too, since only the coning term depends on it."""

MAX_SPAN_RATIO: Final = 1.5
"""Timestamps more than this many integration times apart: an increment is missing."""


class Curvature(NamedTuple):
    """The terms that neighbouring samples add to the line between two samples.

    `a`: shape ``(3, M)``, rad/s^3
    `b`: shape ``(3, M)``, rad/s^4
    `h`: lengths of the intervals, shape ``(M,)``, s
    """

    a: Float64
    b: Float64
    h: Float64

    def rate(self, s: Float64) -> Float64:
        """Return the deviation of the rate from the line, ``(3, M)``, rad/s.

        `s`: time since the start of the interval, shape ``(M,)``, s
        """
        return s * (s - self.h) * (self.a + self.b * s)

    def rotation(self, s: Float64) -> Float64:
        """Return the correction of the method ``coning`` with the rate at the time s.

        `s`: time since the start of the interval, shape ``(M,)``, s
        `Returns`: to be added to the rotation vector, shape ``(3, M)``, rad. For a whole interval
            it is -h^3/6 (a + b h/2)
        """
        weight = s**2 * s / -6
        return weight * (self.a + self.b * (1.5 * s - self.h))

    def rotation_of_averages(self, average: Float64, s: Float64) -> Float64:
        """Return the correction of the average rate multiplied by the time s.

        `average`: average rates over the intervals, shape ``(3, M)``, rad/s
        `s`: time since the start of the interval, shape ``(M,)``, s
        `Returns`: to be added to the rotation vector, shape ``(3, M)``, rad. For a whole interval
            it is the coning term h^3/6 v x (a + b h/2), with v the average
        """
        deviation = self.rate(s)
        # s/2 times the deviation less its integral from 0 to s.
        lever = self.a * (s / 3 - self.h / 2)
        lever += self.b * (s * (s / 4 - self.h / 3))
        lever *= -(s**2)
        lever += s / 2 * deviation
        deviation += cross(average, lever)
        return deviation

    def at(self, intervals: Intp) -> Curvature:
        """Return the curvature in some intervals."""
        return Curvature(self.a[:, intervals], self.b[:, intervals], self.h[intervals])


def curvature(t_ns: Int64, rate: Float64, gap_ns: int | None = None) -> Curvature:
    """Return the curvature of the rate in the intervals between samples.

    `t_ns`: timestamps, shape ``(N,)``, int64, ns; N is at least 2
    `rate`: angular rates, shape ``(3, N)``, rad/s
    `gap_ns`: intervals longer than this are gaps; None for no gaps
    """
    steps = np.diff(t_ns)
    h = steps / NS_PER_S
    # In C order, which NumPy then keeps: each component is contiguous.
    slope = np.diff(np.ascontiguousarray(rate), axis=1)
    slope /= np.where(h > 0, h, 1.0)
    return _of_slopes(slope, h, _no_gaps(steps, gap_ns))


def curvature_of_averages(
    t_ns: Int64,
    rate: Float64,
    integration_time_ns: Int64 | None = None,
    *,
    gap_ns: int | None = None,
    causal: bool = False,
) -> Curvature:
    """Return the curvature of the integral of the rate in the intervals between samples.

    `t_ns`: timestamps, shape ``(N,)``, int64, ns; N is at least 2
    `rate`: average rates over the intervals that end at the timestamps, shape ``(3, N)``, rad/s;
        that of the first sample, whose interval begins earlier, is not used
    `integration_time_ns`: for increments: the integration time of each, shape ``(N,)``, int64, ns
    `causal`: use no later samples: a parabola through the sample before, for ``coning``
    """
    steps = np.diff(t_ns)
    valid = _no_gaps(steps, gap_ns)
    h = steps / NS_PER_S
    if integration_time_ns is not None:
        h = integration_time_ns[1:] / NS_PER_S
        # A repeated message has no interval; after a lost message a rotation is missing.
        moves = steps > 0
        follows = (moves & (steps <= MAX_SPAN_RATIO * integration_time_ns[1:]))[1:] & moves[:-1]
        valid &= follows
    average = np.ascontiguousarray(rate[:, 1:])
    return _of_slopes(average, h, valid, MAX_RATIO, causal=causal)


def _no_gaps(steps: Int64, gap_ns: int | None) -> Bool:
    """Return for each sample between two intervals whether neither is a gap."""
    within = steps <= (np.iinfo(np.int64).max if gap_ns is None else gap_ns)
    return np.asarray(within[:-1] & within[1:])


def _of_slopes(
    slope: Float64,
    h: Float64,
    valid: Bool,
    max_ratio_one_sided: float = MAX_RATIO_ONE_SIDED,
    *,
    causal: bool = False,
) -> Curvature:
    """Return the curvature of values with known slopes over the intervals.

    `slope`: differences of neighbouring values over the lengths of the intervals, ``(3, M)``
    `h`: lengths of the intervals, ``(M,)``, s
    `valid`: whether a parabola may pass through each sample between two intervals, ``(M - 1,)``
    """
    before, after = h[:-1], h[1:]
    shorter, longer = np.minimum(before, after), np.maximum(before, after)
    wide = (shorter > 0) & (longer <= MAX_RATIO * shorter)
    wide &= valid
    second = np.zeros((3, len(h) + 1))
    np.divide(slope[:, 1:] - slope[:, :-1], before + after, out=second[:, 1:-1], where=wide)
    if causal:
        return Curvature(second[:, :-1], np.zeros(slope.shape), h)
    previous, following = np.zeros(len(h)), np.zeros(len(h))
    previous[1:], following[:-1] = before, after
    left, right = second[:, :-1], second[:, 1:]
    # The first and the last interval have neighbours on one side only.
    usable = np.zeros((2, len(h) + 1), np.bool_)
    usable[0, 1:-1] = wide
    np.logical_and(wide, longer <= max_ratio_one_sided * shorter, out=usable[1, 1:-1])
    lone = np.flatnonzero(~(usable[0, :-1] & usable[0, 1:]))
    b = right - left
    a = left.copy()
    # There an unusable D_k or D_k+1 is replaced by the other, if that may be used alone.
    a[:, lone] = usable[1, lone] * left[:, lone] + usable[1, lone + 1] * right[:, lone]
    b[:, lone] = 0.0
    b /= previous + np.where(h > 0, h, 1.0) + following
    a += previous * b
    return Curvature(a, b, h)


def cross(u: Float64, v: Float64) -> Float64:
    """Return the cross products of columns, ``(3, M)``."""
    product = np.empty(u.shape)
    for x, y, z in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(u[y], v[z], out=product[x])
        product[x] -= u[z] * v[y]
    return product
