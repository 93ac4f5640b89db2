"""Covariance of the attitude due to the error of a bias that is known from rests.

A bias that is measured at rest has the error of that mean, and then walks away from it until the
next rest, where it is measured again. Over a stretch of time the covariance is

    since a rest       b^2 V V'                  +  K^2 (u S S' - S A' - A S' + B)
    until a rest       b^2 V V'                  +  K^2 ((T - u) S S' + B)
    between two        b^2 (V - C / T) (...)' + b'^2 C C' / T^2
                                                 +  K^2 (u S S' - S A' - A S' + B - C C' / T)

    S = int R dt     A = int S dt     B = int S S' dt     C = u S - A = int u R dt

with the time u since the beginning of the stretch of length T, the rotation matrix R body ->
reference, the errors b and b' of the means at both ends, and the rate random walk K; V is S plus
the integral for the same mean over earlier stretches. Between two rests the bias is interpolated,
and the rest of the walk is a Brownian bridge. The same covariance results from a bias that jumps at
a random time between two rests, with K^2 T the square of the jump. Before the first and after the
last rest the bias walks as it did between them. A bias that was not measured at rest is known at
the first sample.

While the sensor is at rest, the errors of its mean and of the rates cancel, since the mean is that
of the same rates. A Brownian bridge of their noise remains in between.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.kinematics.elements import DIAGONAL, symmetric_product, trace
from quatprop.kinematics.prefix_sums import PrefixSums, with_previous
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Bool, Float64, Int64

LAST_NS = np.iinfo(np.int64).max


class RestErrors(NamedTuple):
    """The errors of biases that were measured at rests.

    `first_ns`, `last_ns`: first and last timestamps of the rests in order of time, ``(N,)``, ns
    `sigma`: standard deviations of their mean rates, ``(N,)``, rad/s
    `walk`: rate random walk that explains the differences of neighbours, ``(N - 1,)``,
        rad/s/sqrt(s)
    `interpolated`: whether the bias is interpolated between rests, or that of the nearest one
    `interval_ns`: sampling interval: a mean of n samples covers n intervals, a rest n - 1
    """

    first_ns: Int64
    last_ns: Int64
    sigma: Float64
    walk: Float64
    interpolated: bool = False
    interval_ns: float = 0.0

    @property
    def mean_walk(self) -> float:
        """The rate random walk that explains all differences together, rad/s/sqrt(s)."""
        times = self.first_ns[1:] - self.last_ns[:-1]
        return math.sqrt(np.average(self.walk**2, weights=times)) if times.sum() > 0 else 0.0

    def inside(self, before_ns: Int64, t_ns: Int64) -> Bool:
        """Return which intervals are within a rest."""
        rest = np.searchsorted(self.first_ns, before_ns, side="right") - 1
        return np.asarray((rest >= 0) & (t_ns <= self.last_ns[rest]))

    def noise_ns(self, before_ns: Int64, t_ns: Int64, begin_ns: np.int64) -> Int64:
        """Return the effective times of noise in intervals within rests, ns.

        Noise of the rates and of their mean partly cancels: after the part L of a rest with a mean
        over the time T, the effective time is L - L^2 / T; the differences are returned.
        """
        rest = np.searchsorted(self.first_ns, before_ns, side="right") - 1
        first_ns = self.first_ns[rest]
        mean_ns = self.last_ns[rest] - first_ns + self.interval_ns
        since_ns = np.maximum(first_ns, begin_ns)
        share = 1 - (before_ns - since_ns + t_ns - since_ns) / np.maximum(mean_ns, 1)
        return np.asarray(np.rint(share * (t_ns - before_ns)), np.int64)


class Stretch(NamedTuple):
    """A stretch of time over which the bias is known from the same rests.

    `rest`: index of the rest, or of the first of two
    `kind`: ``"since"`` or ``"until"`` that rest, or ``"between"`` it and the next
    `walk`: rate random walk, rad/s/sqrt(s)
    """

    begin_ns: int
    end_ns: int
    rest: int
    kind: str
    walk: float


def stretches(rests: RestErrors, walk: float, begin_ns: int) -> Iterator[Stretch]:
    """Yield the stretches of a log in order; the time of a rest is part of the one before it.

    `walk`: lower bound of the rate random walk, rad/s/sqrt(s)
    `begin_ns`: first timestamp of the log, ns
    """
    first, last = rests.first_ns.tolist(), rests.last_ns.tolist()
    beyond = max(walk, rests.mean_walk)
    yield Stretch(min(begin_ns, first[0]), first[0], 0, "until", beyond)
    for rest, known in enumerate(rests.walk.tolist()):
        begin, end, between = last[rest], first[rest + 1], max(known, walk)
        if rests.interpolated:
            yield Stretch(begin, end, rest, "between", between)
        else:
            middle = (begin + end) // 2
            yield Stretch(begin, middle, rest, "since", between)
            yield Stretch(middle, end, rest + 1, "until", between)
    yield Stretch(last[-1], LAST_NS, len(first) - 1, "since", beyond)


class Integrals(NamedTuple):
    """Integrals up to some samples: S ``(9, n)``, A ``(9, n)``, B ``(6, n)``, and time, s."""

    s: Float64
    a: Float64
    b: Float64
    time: Float64

    def at(self, part: slice) -> Integrals:
        """Return the integrals at some samples."""
        return Integrals(*(each[:, part] for each in self))

    def since(self, begin: Integrals) -> Integrals:
        """Return the integrals from a sample on."""
        s, a, time = self.s - begin.s, self.a - begin.a, self.time - begin.time
        b = self.b - begin.b - 2 * symmetric_product(a, np.broadcast_to(begin.s, a.shape))
        b += time * symmetric_product(begin.s, begin.s)
        return Integrals(s, a - time * begin.s, b, time)


class BiasGrowth:
    """The contribution of the bias to the covariance, sample by sample.

    `sigma`, `walk`: standard deviation of a constant bias, rad/s, and rate random walk,
        rad/s/sqrt(s)
    `rests`: rests from which the bias is known; None: it is known at the first sample, to `sigma`
    `variances`: contributions of bias and random walk to the trace at the last sample, rad^2
    """

    def __init__(self, sigma: float, walk: float, rests: RestErrors | None) -> None:
        self._sigma, self._walk, self._rests = sigma, walk, rests
        self._is_constant = walk == 0 and (rests is None or len(rests.sigma) == 1)
        self._sums = PrefixSums()
        self._stretches: list[Stretch] = []
        self._number = -1
        self._frozen = np.zeros((2, 6, 1))
        self._carry = np.zeros((9, 1))
        self.variances = (0.0, 0.0)

    def add(
        self, step: Float64, span: Float64, t_ns: Int64, before_ns: Int64, rows: slice
    ) -> Float64:
        """Return the covariance after each of the next intervals, ``(6, n)``, or after the last.

        `step`: integrals of R over the intervals, ``(9, n)``
        `span`: integration times, s
        `t_ns`, `before_ns`: ends and beginnings of the intervals, ns
        `rows`: all, or only the last
        """
        h = (t_ns - before_ns) / NS_PER_S
        if self._rests is not None:
            outside = ~self._rests.inside(before_ns, t_ns)
            step, span, h = step * outside, span * outside, h * outside
        if self._is_constant:
            s = self._sums.after("S", step)[:, rows]
            constant = self._sigma**2 * symmetric_product(s, s)
            self.variances = (trace(constant), 0.0)
            return constant
        last, now = self._integrals(step, span, h)
        return self._in_stretches(last, now, before_ns, rows)

    def _integrals(self, step: Float64, span: Float64, h: Float64) -> tuple[Integrals, Integrals]:
        """Return the integrals at the last sample so far, and after the next intervals."""
        sums = self._sums
        rows = zip("SABT", (9, 9, 6, 1), strict=True)
        last = Integrals(*(sums.last(name, count)[:, None] for name, count in rows))
        s = sums.after("S", step)
        twice = with_previous(s, last.s)
        # S is linear within an interval: the integral of S S' is that of its mean, plus that of
        # the deviation from it, as R is orthogonal.
        square = symmetric_product(twice, twice)
        square *= h / 4
        square[DIAGONAL] += h * span * span / 12
        twice *= h / 2
        a, b = sums.after("A", twice), sums.after("B", square)
        return last, Integrals(s, a, b, sums.after("T", h[None]))

    def _in_stretches(
        self, last: Integrals, now: Integrals, before_ns: Int64, rows: slice
    ) -> Float64:
        """Return the covariance of samples, each by the stretch in which its interval begins."""
        if not self._stretches:
            known = np.array([self._sigma])
            at_first = RestErrors(before_ns[:1], before_ns[:1], known, np.zeros(0))
            rests = self._rests or at_first
            self._stretches = list(stretches(rests, self._walk, int(before_ns[0])))
            self._sigmas = rests.sigma
            self._begins_ns = np.array([each.begin_ns for each in self._stretches])
        numbers = np.searchsorted(self._begins_ns, before_ns, side="right") - 1
        starts = np.flatnonzero(np.diff(numbers, prepend=-1)).tolist()
        covariance = np.empty((6, len(before_ns)))
        for start, end in pairwise([*starts, len(before_ns)]):
            if numbers[start] != self._number:
                before = now.at(slice(start - 1, start)) if start else last
                self._enter(int(numbers[start]), before, int(before_ns[start]))
            part = slice(end - 1 if rows.start else start, end)
            _, parts = self._added(now.at(part))
            parts += self._frozen
            covariance[:, part] = parts.sum(axis=0)
        self.variances = (trace(parts[0]), trace(parts[1]))
        return covariance[:, rows]

    def _enter(self, number: int, now: Integrals, t_ns: int) -> None:
        """Begin another stretch at a sample."""
        stretch = self._stretches[number]
        if self._number >= 0:
            (carry, next_carry), (by_bias, by_walk) = self._added(now)
            left = self._stretches[self._number]
            self._frozen[1] += by_walk
            if stretch.rest == left.rest:
                self._carry = carry
            else:
                own = self._sigmas[left.rest] ** 2 * symmetric_product(carry, carry)
                is_next = left.kind == "between" and stretch.rest == left.rest + 1
                self._frozen[0] += own if is_next else by_bias
                self._carry = next_carry if is_next else np.zeros((9, 1))
        self._number, self._begin = number, now
        self._begun_s = (t_ns - stretch.begin_ns) / NS_PER_S

    def _added(self, now: Integrals) -> tuple[tuple[Float64, Float64], Float64]:
        """Return the contributions of this stretch.

        `Returns`: the factors of the means at both its ends, ``(9, n)`` each, and the covariances
            ``(2, 6, n)`` by the errors of the means and by the walk
        """
        stretch = self._stretches[self._number]
        s, a, b, time = now.since(self._begin)
        u = self._begun_s + time[0]
        length = np.maximum((stretch.end_ns - stretch.begin_ns) / NS_PER_S, u)
        carry, onward = self._carry + s, np.zeros_like(s)
        by_bias = np.zeros((6, s.shape[1]))
        if stretch.kind == "until":
            by_walk = (length - u) * symmetric_product(s, s) + b
        else:
            by_walk = 2 * symmetric_product(s, u / 2 * s - a) + b
        if stretch.kind == "between":
            onward = (u * s - a) / length
            carry -= onward
            square = symmetric_product(onward, onward)
            by_walk -= length * square
            by_bias += self._sigmas[stretch.rest + 1] ** 2 * square
        by_bias += self._sigmas[stretch.rest] ** 2 * symmetric_product(carry, carry)
        return (carry, onward), np.stack([by_bias, stretch.walk**2 * by_walk])
