"""The cubic integration rule: the rate over an interval as a cubic through four samples.

Between the samples k and k + 1, a time s after the first, the rate is the line through both plus

    s (s - h) (a + b s)

with h the length of the interval. The cubic through the samples k - 1 to k + 2 is the blend of the
two parabolas through three of them, so a and b follow from the second divided differences of the
rate at the samples k and k + 1. The first two terms of the Magnus series (W. Magnus, Comm. Pure
Appl. Math. 7, 1954) then give the rotation vector, with an error of fifth order in h.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

MAX_RATIO: Final = 4.0
"""No cubic passes through samples whose neighbouring intervals differ by more than this factor: it
would amplify noise, and a long interval is likely to be a gap."""

MAX_RATIO_ONE_SIDED: Final = 2.0
"""The same for a parabola through the samples of one side alone, which extrapolates more."""


class Curvature(NamedTuple):
    """What the neighbouring samples add to the line between two samples.

    Parameters
    ----------
    a
        Shape ``(3, M)``, rad/s^3.
    b
        Shape ``(3, M)``, rad/s^4.
    h
        Lengths of the intervals, shape ``(M,)``, s.
    """

    a: Float64
    b: Float64
    h: Float64

    def rate(self, s: Float64) -> Float64:
        """Return the difference of the rate from the line, ``(3, M)``, rad/s.

        Parameters
        ----------
        s
            Time since the start of the interval, shape ``(M,)``, s.
        """
        return s * (s - self.h) * (self.a + self.b * s)

    def rotation(self, s: Float64) -> Float64:
        """Return what the method ``coning``, with the rate after the time s, leaves out.

        Parameters
        ----------
        s
            Time since the start of the interval, shape ``(M,)``, s.

        Returns
        -------
        ndarray
            To be added to the rotation vector, shape ``(3, M)``, rad. For a whole interval it is
            -h^3/6 (a + b h/2).
        """
        weight = s**2 * s / -6
        return weight * (self.a + self.b * (1.5 * s - self.h))

    def at(self, intervals: NDArray[np.intp]) -> Curvature:
        """Return the curvature in some intervals."""
        return Curvature(self.a[:, intervals], self.b[:, intervals], self.h[intervals])


def curvature(t_ns: Int64, rate: Float64, gap_ns: int | None = None) -> Curvature:
    """Return the curvature of the rate in the intervals between samples.

    Parameters
    ----------
    t_ns
        Time stamps, shape ``(N,)``, int64, ns; N is at least 2.
    rate
        Angular rates, shape ``(3, N)``, rad/s.
    gap_ns
        Intervals longer than this are gaps; None: none is.

    Returns
    -------
    Curvature
        Of N - 1 intervals. At the ends of the series, beside gaps, beside repeated stamps and
        where the lengths of neighbouring intervals differ too much, it is that of the parabola
        through the three samples of the other side; zero where that cannot be used either.
    """
    # In C order, which numpy then keeps: each component is contiguous.
    rate = np.ascontiguousarray(rate)
    steps = np.diff(t_ns)
    h = steps / NS_PER_S
    before, after = h[:-1], h[1:]
    shorter, longer = np.minimum(before, after), np.maximum(before, after)
    usable = np.zeros((2, len(t_ns)), np.bool_)
    wide, narrow = usable[:, 1:-1]
    np.logical_and(shorter > 0, longer <= MAX_RATIO * shorter, out=wide)
    if gap_ns is not None:
        gap = steps > gap_ns
        wide &= ~(gap[:-1] | gap[1:])
    np.logical_and(wide, longer <= MAX_RATIO_ONE_SIDED * shorter, out=narrow)
    positive = np.where(h > 0, h, 1.0)
    slope = np.diff(rate, axis=1)
    slope /= positive
    second = np.zeros(rate.shape)
    np.divide(slope[:, 1:] - slope[:, :-1], before + after, out=second[:, 1:-1], where=wide)
    # D_k and D_k+1, each replaced by the other where it cannot be used.
    both = usable[0, :-1] & usable[0, 1:]
    left = np.where(both | usable[1, :-1], second[:, :-1], usable[1, 1:] * second[:, 1:])
    right = np.where(both | usable[1, 1:], second[:, 1:], left)
    previous, following = np.zeros(len(h)), np.zeros(len(h))
    previous[1:], following[:-1] = before, after
    b = right - left
    b /= previous + positive + following
    return Curvature(left + previous * b, b, h)
