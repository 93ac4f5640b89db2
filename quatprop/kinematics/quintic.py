"""The quintic integration rule: the rate in an interval is a quintic through six samples.

A polynomial through the samples k - 2 to k + 3 is evaluated at the three Gauss nodes of the
interval from k to k + 1, and the Magnus series of sixth order (S. Blanes, F. Casas, J. Ros, BIT 40,
2000) of the three rates gives the rotation vector. At ends and beside gaps more of the six samples
are on one side. Without six samples of similar spacing the rule is ``cubic``.

If samples are averages over the intervals, or increments, the polynomial passes through six values
of the integral of the rate, which is known at the samples, and its derivative is the rate.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.kinematics.cubic import MAX_RATIO, MAX_RATIO_ONE_SIDED, MAX_SPAN_RATIO, cross
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Bool, Float64, Int64, Intp

SAMPLES: Final = 6
CENTRED: Final = 2
"""Samples of the polynomial before the interval, if there are as many on both sides."""

BEFORE, AFTER = SAMPLES - 1, SAMPLES - 2
"""Numbers of samples before and after a sample on which the step to it may depend."""

GAUSS: Final = (0.5 - math.sqrt(15) / 10, 0.5, 0.5 + math.sqrt(15) / 10)
"""Gauss nodes of the sixth order in the unit interval."""


class Quintic(NamedTuple):
    """Polynomials of the rate in intervals, in Newton form.

    `nodes`: times of the first five of the six samples since the start of the interval, ``(5, M)``,
        s
    `terms`: divided differences from the first sample on, the lowest order first: of the rates or,
        without the order zero, of their integral; each ``(3, M)``
    `usable`: whether there are six samples, ``(M,)``
    `is_integral`: whether the polynomial is that of the integral of the rate
    """

    nodes: Float64
    terms: list[Float64]
    usable: Bool
    is_integral: bool

    def at(self, intervals: Intp) -> Quintic:
        """Return the polynomials in some intervals."""
        terms = [term[:, intervals] for term in self.terms]
        return self._replace(
            nodes=self.nodes[:, intervals], terms=terms, usable=self.usable[intervals]
        )

    def replace(self, rotvec: Float64, s: Float64) -> None:
        """Overwrite the rotation vectors, ``(3, M)``, of intervals that have six samples."""
        chosen = np.flatnonzero(self.usable)
        if 2 * len(chosen) < len(s):
            rotvec[:, chosen] = self.at(chosen).rotation(s[chosen])
            return
        # Faster than selecting nearly all. The unusable polynomials may overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            np.copyto(rotvec, self.rotation(s), where=self.usable)

    def rotation(self, s: Float64) -> Float64:
        """Return rotation vectors from the start of each interval, ``(3, M)``, rad.

        `s`: time since the start of the interval, shape ``(M,)``, s
        """
        first, middle, last = (self._rate(node * s) for node in GAUSS)
        a1 = middle * s
        a2 = (last - first) * (s * (math.sqrt(15) / 3))
        a3 = first
        a3 += last
        a3 -= middle
        a3 -= middle
        a3 *= s * (10 / 3)
        # For q' = q w / 2; with the rate on the left, cross products change sign.
        c1 = cross(a1, a2)
        a2 -= cross(a1, c1 - 2 * a3) / 60
        rotvec = cross(20 * a1 + a3 + c1, a2)
        rotvec /= 240
        rotvec += a1 + a3 / 12
        return rotvec

    def _rate(self, s: Float64) -> Float64:
        """Return the rates at a time in each interval, ``(3, M)``, rad/s."""
        steps = list(s - self.nodes)
        if self.is_integral:
            return self._slope(steps)
        value = self.terms[-1].copy()
        for term in reversed(self.terms[:-1]):
            value *= steps.pop()
            value += term
        return value

    def _slope(self, steps: list[Float64]) -> Float64:
        """Return the derivative of the polynomial, given the times since its nodes."""
        value = self.terms[-1].copy()
        slope = np.zeros(value.shape)
        for term in reversed(self.terms[:-1]):
            step = steps.pop()
            slope *= step
            slope += value
            value *= step
            value += term
        slope *= steps.pop()
        slope += value
        return slope


def quintic(t_ns: Int64, rate: Float64, gap_ns: int | None = None) -> Quintic:
    """Return the polynomials through samples of the rate.

    `t_ns`: timestamps, shape ``(N,)``, int64, ns; N is at least 2
    `rate`: angular rates, shape ``(3, N)``, rad/s
    `gap_ns`: intervals longer than this are gaps; None for no gaps
    """
    steps = np.diff(t_ns)
    return _through(t_ns, np.ascontiguousarray(rate), windows_over(steps, steps, gap_ns))


def quintic_of_averages(
    t_ns: Int64,
    rate: Float64,
    integration_time_ns: Int64 | None = None,
    gap_ns: int | None = None,
) -> Quintic:
    """Return the polynomials through the integral of the rate.

    `rate`: average rates over the intervals that end at the timestamps, shape ``(3, N)``, rad/s;
        that of the first sample, whose interval begins earlier, is not used
    `integration_time_ns`: for increments: the integration time of each, shape ``(N,)``, int64, ns
    """
    steps, lengths = steps_and_lengths(t_ns, integration_time_ns)
    nodes_ns = np.concatenate([[0], np.cumsum(lengths)])
    average = np.ascontiguousarray(rate[:, 1:])
    return _through(nodes_ns, average, windows_over(steps, lengths, gap_ns), is_integral=True)


def steps_and_lengths(t_ns: Int64, integration_time_ns: Int64 | None) -> tuple[Int64, Int64]:
    """Return the times between timestamps, and the integration times, ``(M,)``, ns."""
    steps = np.diff(t_ns)
    if integration_time_ns is None:
        return steps, steps
    # A repeated message has no interval.
    return steps, np.where(steps > 0, integration_time_ns[1:], 0)


class Windows(NamedTuple):
    """Index of the first of six samples for each interval, and whether there are six, ``(M,)``."""

    start: Intp
    usable: Bool


def windows_over(steps: Int64, lengths: Int64, gap_ns: int | None = None) -> Windows:
    """Choose samples of similar spacing, as many on both sides if possible.

    `steps`: times between timestamps, ``(M,)``, ns
    `lengths`: integration times of the intervals, which may differ from the steps, ``(M,)``, ns
    `gap_ns`: steps longer than this are gaps; None for no gaps
    """
    first, count = np.arange(len(steps)), len(steps) - BEFORE + 1
    if count < 1:
        return Windows(np.zeros(len(steps), np.intp), np.zeros(len(steps), np.bool_))
    shortest, longest = _over_windows(np.minimum, lengths), _over_windows(np.maximum, lengths)
    whole = shortest > 0
    if gap_ns is not None:
        whole &= _over_windows(np.maximum, steps) <= gap_ns
    if lengths is not steps:
        # After a lost message a rotation is missing.
        follows = np.lib.stride_tricks.sliding_window_view(
            steps <= MAX_SPAN_RATIO * lengths, BEFORE
        )
        whole &= follows[:, 1:].all(axis=1)
    alike = whole & (longest <= MAX_RATIO * shortest)
    even = alike & (longest <= MAX_RATIO_ONE_SIDED * shortest)
    if even.all():
        return Windows(np.clip(first - CENTRED, 0, count - 1), np.ones(len(steps), np.bool_))
    start = np.full(len(steps), -1)
    start[CENTRED : CENTRED + count][alike] = first[:count][alike]
    left = np.flatnonzero(start < 0)
    for before in (3, 1, 4, 0):  # the best first
        begin = left - before
        fits = even[np.clip(begin, 0, count - 1)] & (begin >= 0) & (begin < count)
        start[left[fits]] = begin[fits]
        left = left[~fits]
    return Windows(np.maximum(start, 0), start >= 0)


def _over_windows(extreme: np.ufunc, lengths: Int64) -> Int64:
    """Return the minimum or the maximum of each five consecutive lengths."""
    count = len(lengths) - BEFORE + 1
    result = lengths[:count].copy()
    for k in range(1, BEFORE):
        extreme(result, lengths[k : k + count], out=result)
    return result


def _through(
    nodes_ns: Int64, term: Float64, windows: Windows, *, is_integral: bool = False
) -> Quintic:
    """Return the polynomials through values, or through an integral with these slopes."""
    start, usable = windows
    count = len(nodes_ns) - SAMPLES + 1
    first = np.arange(len(start))
    if count < 1:
        return Quintic(np.zeros((BEFORE, len(start))), [np.zeros((3, len(start)))], usable, False)
    lone = np.flatnonzero(start != first - CENTRED)
    terms = []
    for order in range(1 + is_integral, SAMPLES + 1):
        chosen = np.empty((3, len(start)))
        chosen[:, CENTRED : CENTRED + count] = term[:, :count]
        chosen[:, lone] = term[:, start[lone]]
        terms.append(chosen)
        if order < SAMPLES:
            span = (nodes_ns[order:] - nodes_ns[:-order]) / NS_PER_S
            term = np.diff(term, axis=1)
            term /= np.where(span > 0, span, 1.0)
    nodes = [(nodes_ns[start + k] - nodes_ns[:-1]) / NS_PER_S for k in range(BEFORE)]
    return Quintic(np.array(nodes), terms, usable, is_integral)
