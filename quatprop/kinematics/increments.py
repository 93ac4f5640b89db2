"""The integration rules: from rates and times to rotation vectors.

Interval k lies between the samples k and k + 1. Its rotation vector is the axis times the angle of
the body's rotation in it, resolved in the body frame at its start.

Sensors that integrate return the integral of the rate over an interval, or its average, instead.
This is not integrated again: about a fixed axis it is the rotation vector, and in general
``coning`` and ``cubic`` add the effect of the rotating axis, from the neighbouring intervals.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.text import listed, quoted
from quatprop.base.times import NS_PER_S
from quatprop.settings.quantities import CORRECT_CONING, FRAMES, LOOK_AHEAD

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.base.arrays import Bool, Float64, Int64, Intp

    Rule = Callable[[Float64, Float64, Float64], Float64]


# The cubic integration rule: the rate in an interval is a cubic through four samples.
#
# Between the samples k and k + 1, a time s after the first, the rate is the line through both plus
#
#     s (s - h) (a + b s)
#
# with h the length of the interval. The cubic through the samples k - 1 to k + 2 is a blend of the
# two parabolas through three of them, so a and b follow from the second divided differences of the
# rate at the samples k and k + 1. The first two terms of the Magnus series (W. Magnus, Comm. Pure
# Appl. Math. 7, 1954) then give the rotation vector, with an error of fifth order in h.
#
# If samples are averages over the intervals, or increments, the integral of the rate is known at
# the samples. The cubic through four of its values has the same form, with the averages as slopes,
# and the rate is a parabola; only the second term of the Magnus series must be added.


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


# The quintic integration rule: the rate in an interval is a quintic through six samples.
#
# A polynomial through the samples k - 2 to k + 3 is evaluated at the three Gauss nodes of the
# interval from k to k + 1, and the Magnus series of sixth order (S. Blanes, F. Casas, J. Ros, BIT
# 40, 2000) of the three rates gives the rotation vector. At ends and next to gaps more of the six
# samples are on one side. Without six samples of similar spacing the rule is ``cubic``.
#
# If samples are averages over the intervals, or increments, the polynomial passes through six
# values of the integral of the rate, which is known at the samples, and its derivative is the rate.


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


def _start(before: Float64, after: Float64, dt: Float64) -> Float64:  # noqa: ARG001  # one signature
    return np.multiply(before, dt, out=_like(before))


def _end(before: Float64, after: Float64, dt: Float64) -> Float64:  # noqa: ARG001  # one signature
    return np.multiply(after, dt, out=_like(after))


def _mean(before: Float64, after: Float64, dt: Float64) -> Float64:
    rotvec = np.add(before, after, out=_like(before))
    rotvec *= dt / 2
    return rotvec


def _coning(before: Float64, after: Float64, dt: Float64) -> Float64:
    # The rate is linear between the samples, so its direction changes and rotations do not commute:
    # mean dt + dt^2/12 w_k x w_k+1. The term is the first of the Magnus series; the next is of
    # fifth order in dt.
    u, v = _start(before, after, dt), _end(before, after, dt)
    rotvec = np.add(u, v, out=_like(u))
    rotvec *= 0.5
    term = cross(u, v)
    term /= 12
    rotvec += term
    return rotvec


RULES: Final[dict[str, Rule]] = {
    "start": _start,
    "end": _end,
    "mean": _mean,
    "coning": _coning,
    "cubic": _coning,
    "quintic": _coning,
}
"""Integration rules. Arguments are the rates at the start and at the end of intervals, ``(3, M)``,
rad/s, and their lengths, ``(M,)``, s; the result is rotation vectors, ``(3, M)``, rad. For
``cubic``, :mod:`.increments` adds the terms of neighbouring samples; ``quintic`` is
``cubic`` if :mod:`quatprop.kinematics.increments` has too few of them."""


def is_inertial(rates: str) -> bool:
    """Return whether rates are resolved in the inertial frame.

    `rates`: one of :data:`quatprop.settings.FRAMES`
    """
    if rates not in FRAMES:
        raise UsageError(f"there is no frame {quoted(rates)}; choose one of {listed(FRAMES)}")
    return rates == "inertial"


def rotation_vectors(
    t_ns: Int64,
    rate: Float64,
    method: str = "start",
    integration_time_ns: Int64 | None = None,
    *,
    is_interval_average: bool = False,
) -> Float64:
    """Return the rotation vectors between neighbouring samples.

    `t_ns`: timestamps, shape ``(N,)``, int64, ns. Intervals are differences of integers, so they
        are exact for any epoch
    `rate`: angular rates, shape ``(N, 3)``, rad/s, resolved in the body frame. For rates w resolved
        in the inertial frame, -w are body rates of the reference as seen from the body
    `method`: a key of :data:`RULES`: ``"start"``, the rate from k to k + 1 is that of sample k;
        ``"end"``, that of sample k + 1; ``"mean"``, the average of the two; ``"coning"``, linear
        between the two, mean dt + dt^2/12 w_k x w_k+1: of fourth order where the rate is linear, of
        second order elsewhere; ``"cubic"``, a cubic through the samples k - 1 to k + 2, of fourth
        order, see :func:`.curvature`; ``"quintic"``, a quintic through
        the samples k - 2 to k + 3, of sixth order, see :mod:`quatprop.kinematics.increments`
    `integration_time_ns`: for increments: the integration time of each, shape ``(N,)``, int64, ns,
        as in :class:`.GyroSeries`. The rotation in interval k is then the increment
        theta_k of sample k + 1, whatever the length of the interval; zero at a repeated timestamp,
        which is that of a repeated message
    `is_interval_average`: whether rates are averages over the intervals that end at their
        timestamps: theta_k is then the rate of sample k + 1 times the length of the interval. For
        increments with ``"start"``, ``"mean"`` and ``"end"``, and averages with ``"end"``, the
        rotation vector is theta_k. ``"coning"`` adds theta_k-1 x theta_k / 12, and is of third
        order; ``"cubic"`` adds (theta_k-1 x theta_k + theta_k x theta_k+1) / 24, and is of fourth
        order. The weights are those of equal intervals; see
        :func:`.curvature_of_averages`. ``"quintic"`` is of sixth order
    `Returns`: rotation vectors, shape ``(N - 1, 3)``, rad; each of the three columns is contiguous

    References
    ----------
    Eq. 7; a constant rate over the interval as in eqs. 32 to 36.
    """
    if integration_time_ns is not None or (is_interval_average and method not in {"start", "mean"}):
        return _integrated(t_ns, rate.T, method, integration_time_ns).T
    dt = (t_ns[1:] - t_ns[:-1]) / NS_PER_S
    rotvec = RULES[method](rate[:-1].T, rate[1:].T, dt)
    if method in LOOK_AHEAD:
        rotvec += curvature(t_ns, rate.T).rotation(dt)
    if method == "quintic":
        quintic(t_ns, rate.T).replace(rotvec, dt)
    return rotvec.T


def _integrated(
    t_ns: Int64, rate: Float64, method: str, integration_time_ns: Int64 | None
) -> Float64:
    """Return the rotation vectors of averages or increments, ``(3, N - 1)``, rad."""
    average = rate[:, 1:]
    dt = steps_and_lengths(t_ns, integration_time_ns)[1] / NS_PER_S
    rotvec = _end(rate[:, :-1], average, dt)
    if method in CORRECT_CONING:
        curvature = curvature_of_averages(
            t_ns, rate, integration_time_ns, causal=method == "coning"
        )
        rotvec += curvature.rotation_of_averages(average, dt)
    if method == "quintic":
        quintic_of_averages(t_ns, rate, integration_time_ns).replace(rotvec, dt)
    return rotvec


def _like(rows: Float64) -> Float64:
    """Return an empty array ``(3, M)`` in C order, rather than that of the transposed input."""
    return np.empty(rows.shape)
