"""Covariance of the attitude at every sample, due to the errors of a gyroscope.

An error e of the body rate rotates the attitude by the integral of R e in reference axes, with R
the rotation matrix body -> reference. So the covariance needs only integrals of R, which are sums
over the samples:

    P = P0  +  N^2 t I  +  b^2 S S'  +  s^2 G0 G0'  +  m^2 (G1 G1' + G2 G2')

    S = int R dt     Gk = int R diag(w of the axes k further) dt

with the covariance P0 of the first attitude, the angle random walk N, and the standard deviations b
of the bias, s of the scale factors and m of the misalignments, equal and independent on all axes. A
bias with a random walk is in :mod:`quatprop.kinematics.uncertainty`. P is the covariance of small
rotations about reference axes, R' P R that of the same rotations about body axes.

Misalignments are the six small angles by which each sensitive axis is tilted towards the two
others: e_i = m_ij w_j + m_ik w_k. If the whole sensor is rotated by small angles, m_ij is
-m_ji; its errors are at most sqrt(2) times those of six angles of the same size.

An error e of an inertial rate rotates the attitude by the integral of R' e in body axes. With R' in
place of R, P is then the covariance about body axes, and R P R' that about reference axes.

References
----------
P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed.,
Artech House, 2013, section 4.4, on scale factor and cross-coupling errors.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.kinematics.increments import is_inertial
from quatprop.kinematics.matrix_elements import (
    DIAGONAL,
    TILE,
    TRANSPOSED,
    UPPER,
    PrefixSums,
    mean_rotation,
    rotate_covariance,
    rotated,
    rotation_elements,
    symmetric_product,
    trace,
    with_previous,
    write_covariance,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.kinematics.series import GyroSeries


# Covariance of the attitude due to the error of a bias that is known from rests.
#
# A bias that is measured at rest has the error of that mean, and then walks away from it until the
# next rest, where it is measured again. Over a stretch of time the covariance is
#
#     since a rest       b^2 V V'                  +  K^2 (u S S' - S A' - A S' + B)
#     until a rest       b^2 V V'                  +  K^2 ((T - u) S S' + B)
#     between two        b^2 (V - C / T) (...)' + b'^2 C C' / T^2
#                                                  +  K^2 (u S S' - S A' - A S' + B - C C' / T)
#
#     S = int R dt     A = int S dt     B = int S S' dt     C = u S - A = int u R dt
#
# with the time u since the beginning of the stretch of length T, the rotation matrix R body ->
# reference, the errors b and b' of the means at both ends, and the rate random walk K; V is S plus
# the integral for the same mean over earlier stretches. Between two rests the bias is interpolated,
# and the rest of the walk is a Brownian bridge. The same covariance results from a bias that jumps
# at a random time between two rests, with K^2 T the square of the jump. Before the first and after
# the last rest the bias walks as it did between them. A bias that was not measured at rest is known
# at the first sample.
#
# While the sensor is at rest, the errors of its mean and of the rates cancel, since the mean is
# that of the same rates. A Brownian bridge of their noise remains in between.


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

    `sigma`: standard deviation of a constant bias, rad/s
    `walk`: rate random walk, rad/s/sqrt(s)
    `rests`: stationary periods that determine the bias; None: it is known at the first sample, with
        the standard deviation `sigma`
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


LARGE_ANGLE: Final = 0.1
"""rad: if the body rotates further in an interval, R is integrated along the rotation, instead of
by the mean of both ends, whose relative error is the square of the angle / 12."""


class SensorErrors(NamedTuple):
    """Standard deviations of the errors of a gyroscope, the same on all axes.

    `noise_density`: angle random walk N, the density of white noise, rad/s/sqrt(Hz), which is
        rad/sqrt(s)
    `bias_sigma`: constant bias, rad/s
    `random_walk`: rate random walk K of the bias, rad/s^2/sqrt(Hz), which is rad/s/sqrt(s)
    `scale_sigma`: scale factors, a ratio
    `misalignment_sigma`: angles by which each sensitive axis is tilted towards the two others, rad
    """

    noise_density: float = 0.0
    bias_sigma: float = 0.0
    random_walk: float = 0.0
    scale_sigma: float = 0.0
    misalignment_sigma: float = 0.0


BY_RATE: Final = (("scale_sigma", (0,)), ("misalignment_sigma", (1, 2)))
"""Errors proportional to rates, and the offsets from the affected axis to the axes of the rates."""


class ErrorGrowth:
    """The covariance of the attitude, sample by sample.

    `rates`: ``"body"`` or ``"inertial"``: the axes in which rates and their errors are resolved
    `method`: the integration rule, which defines the rate of an interval for scale factors
    `mount`: sensor axes to body axes, shape ``(3, 3)``, for scale factors; None if they are the
        same
    `q0`: covariance of the first attitude, about reference axes for body rates and about body axes
        for inertial ones, shape ``(3, 3)``, rad^2; None if it is exact
    `rests`: rests from which the bias is known; None: it is known at the first sample
    `final`: the covariance at the last sample so far, shape ``(3, 3)``, rad^2
    `variances`: contributions to its trace, rad^2, by name of an error in :class:`SensorErrors` or
        ``"q0_sigma"``

    Notes
    -----
    Tiles begin at fixed sample indices, and sums up to a sample do not depend on later samples: the
    covariances of the first samples are those of the whole log, to the bit.
    """

    def __init__(  # noqa: PLR0913  # all parameters of the error model
        self,
        errors: SensorErrors,
        rates: str = "body",
        method: str = "start",
        mount: Float64 | None = None,
        *,
        q0: Float64 | None = None,
        rests: RestErrors | None = None,
    ) -> None:
        self._errors, self._inertial = errors, is_inertial(rates)
        self._method, self._mount, self._rests = method, mount, rests
        self._q0 = None if q0 is None else np.array([[q0[element]] for element in UPPER])
        self.begin(restart=True)

    def begin(self, *, restart: bool) -> None:
        """Begin a segment: at a known attitude, or at the last one, without rotation."""
        self._is_after_gap = not restart
        if not restart:
            return
        self._first_ns = np.int64(0)
        self._last_ns: np.int64 | None = None
        self._integrated_ns = np.int64(0)
        self._previous: tuple[GyroSeries, Float64] | None = None
        self._sums = PrefixSums()
        self._bias = BiasGrowth(self._errors.bias_sigma, self._errors.random_walk, self._rests)
        self.variances: dict[str, float] = {}
        self.final: Float64 = np.zeros((3, 3))

    def advance(self, gyro: GyroSeries, wxyz: Float64, *, to_end: bool = False) -> Float64:
        """Return the covariance of the next attitudes.

        `wxyz`: the attitudes, body -> reference, shape ``(N, 4)``
        `to_end`: return only the covariance of the last one
        `Returns`: covariances of small rotations about body axes, shape ``(N, 3, 3)`` or ``(1, 3,
            3)``, rad^2
        """
        self._rows = slice(-1, None) if to_end else slice(None)
        covariance = np.zeros((3, 3, 1 if to_end else len(gyro)))
        if self._last_ns is None:
            self._first_ns = self._last_ns = gyro.t_ns[0]
        before_ns = np.concatenate([[self._last_ns], gyro.t_ns[:-1]])
        spans_ns = self._spans_ns(gyro, before_ns)
        self._last_ns = gyro.t_ns[-1]
        # The covariance of noise is the same in all axes.
        integrated_ns = self._integrated_ns + np.cumsum(self._noisy_ns(spans_ns, gyro, before_ns))
        self._integrated_ns = integrated_ns[-1]
        noise = self._errors.noise_density**2 / NS_PER_S * integrated_ns[self._rows]
        np.maximum(noise, 0.0, out=noise)  # rounding may make it negative after a rest
        self.variances = {"noise_density": 3 * float(noise[-1])}
        if self._q0 is not None or self._errors._replace(noise_density=0.0) != SensorErrors():
            for start in range(0, len(gyro), TILE):
                tile = slice(start, start + TILE)
                rotation = rotation_elements(wxyz[tile])
                if self._inertial:
                    rotation = rotation[TRANSPOSED, :]
                fixed = self._fixed(
                    gyro[tile], rotation, spans_ns[tile] / NS_PER_S, before_ns[tile]
                )
                out = covariance if to_end else covariance[..., tile]
                if self._inertial:
                    write_covariance(fixed, out=out)
                else:
                    rotate_covariance(fixed, rotation[:, self._rows], out=out)
        for axis in range(3):
            covariance[axis, axis] += noise
        self.final = covariance[..., -1].copy()
        return np.moveaxis(covariance, -1, 0)

    def _noisy_ns(self, spans_ns: Int64, gyro: GyroSeries, before_ns: Int64) -> Int64:
        """Return the effective time of noise in each interval, ns; see `RestErrors.noise_ns`."""
        if self._rests is None or not (inside := self._rests.inside(before_ns, gyro.t_ns)).any():
            return spans_ns
        noisy_ns = spans_ns.copy()
        noisy_ns[inside] = self._rests.noise_ns(
            before_ns[inside], gyro.t_ns[inside], self._first_ns
        )
        return noisy_ns

    def _spans_ns(self, gyro: GyroSeries, before_ns: Int64) -> Int64:
        """Return the integration time of the interval that ends at each sample, ns."""
        spans_ns = gyro.t_ns - before_ns
        if gyro.integration_time_ns is not None:
            spans_ns = np.where(spans_ns > 0, gyro.integration_time_ns, 0)
        if self._is_after_gap:
            spans_ns[0], self._is_after_gap = 0, False
        return spans_ns

    def _fixed(
        self, gyro: GyroSeries, rotation: Float64, span: Float64, before_ns: Int64
    ) -> Float64:
        """Return the covariance without noise, ``(6, n)``, about the axes in which it is a sum.

        These are reference axes for body rates, and body axes for inertial ones.
        """
        rows = self._rows
        if self._previous is None:
            self._previous = gyro[:1], rotation[:, :1]
        last, last_rotation = self._previous
        self._previous = gyro[-1:], rotation[:, -1:].copy()
        # The integral of R over the interval that ends at each sample.
        step = with_previous(rotation, last_rotation)
        step *= span / 2
        # A bound of all angles first; which intervals are large does not depend on others.
        extremes = [edge(one.rate) for one in (gyro, last) for edge in (np.max, np.min)]
        if math.sqrt(3) * np.abs(extremes).max() * span.max() > LARGE_ANGLE:
            rotvec = self._rate(gyro, last) * (-span if self._inertial else span)
            large = np.flatnonzero((rotvec**2).sum(axis=0) > LARGE_ANGLE**2)
            begin = np.where(large > 0, rotation[:, large - 1], last_rotation)
            step[:, large] = mean_rotation(begin, rotvec[:, large]) * span[large]
        fixed = np.zeros((6, 1 if rows.start else len(gyro)))
        if self._q0 is not None:
            fixed += self._q0
            self.variances["q0_sigma"] = trace(self._q0)
        if self._errors.scale_sigma or self._errors.misalignment_sigma:
            fixed += self._by_rate(step, self._rate(gyro, last))
        if self._errors.bias_sigma or self._errors.random_walk:
            fixed += self._bias.add(step, span, gyro.t_ns, before_ns, rows)
            names = ("bias_sigma", "random_walk")
            self.variances |= dict(zip(names, self._bias.variances, strict=True))
        return fixed

    def _by_rate(self, step: Float64, rate: Float64) -> Float64:
        """Return the contributions of errors that are proportional to the rates."""
        rows_of_step = step.reshape(3, 3, -1)
        if (mount := self._mount) is not None:
            rate = rotated(rate, mount)
            rows_of_step = np.stack([rotated(row, mount) for row in rows_of_step])
        total = np.zeros((6, 1))
        for name, further in BY_RATE:
            if not (sigma := getattr(self._errors, name)):
                continue
            square = np.zeros((6, 1))
            for axes in further:
                steps = rows_of_step * (sigma * np.roll(rate, -axes, axis=0))
                g = self._sums.after(f"G{axes}", steps.reshape(9, -1))[:, self._rows]
                square = square + symmetric_product(g, g)
            self.variances[name] = trace(square)
            total = total + square
        return total

    def _rate(self, gyro: GyroSeries, last: GyroSeries) -> Float64:
        """Return the rate in the interval that ends at each sample, by the method, ``(3, n)``."""
        # In rows: one operation on columns would be slower than all others on rows.
        rate, before = np.ascontiguousarray(gyro.rate.T), last.rate.T
        if self._method == "end" or gyro.is_integrated(self._method):
            return rate
        if self._method == "start":
            return np.concatenate([before, rate[:, :-1]], axis=1)
        mean = with_previous(rate, before)
        mean /= 2
        return mean
