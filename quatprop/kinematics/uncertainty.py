"""How the errors of a gyroscope grow to an error of the attitude: its covariance at every sample.

A body rate that is off by e turns the attitude by the integral of R e in reference axes, R being
the rotation matrix body -> reference. So the covariance needs integrals of R alone, which are sums
over the samples:

    P = N^2 t I  +  b^2 S S'  +  s^2 G G'  +  K^2 (t S S' - S A' - A S' + B)

    S = int R dt     G = int R diag(w) dt     A = int S dt     B = int S S' dt

with the angle random walk N, the standard deviations b of the bias and s of the scale factors, and
the rate random walk K, alike and independent on all axes. The bias is constant; the random walk
begins at zero with the first sample. P is the covariance of small rotations about reference axes,
R' P R of the same rotations about body axes.

The error of a rate in reference axes rotates with the reference as seen from the body: it turns the
attitude by the integral of R' e in body axes. With R' for R, P is then the covariance about body
axes, and R P R' that about reference axes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.kinematics.elements import (
    DIAGONAL,
    TRANSPOSED,
    mean_on_the_way,
    rotate_covariance,
    rotated,
    rotation_elements,
    symmetric_product,
    trace,
    write_covariance,
)
from quatprop.kinematics.increments import is_inertial
from quatprop.kinematics.quaternion import rotation_matrix
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.series import GyroSeries


TILE: Final = 8192
"""Samples computed together, from fixed sample indices: few enough for the caches."""

LARGE_ANGLE: Final = 0.1
"""rad: over an interval in which the body rotates further, R is integrated by its rotation, not as
the mean of both ends; the mean is off by the square of the angle / 12."""


class SensorErrors(NamedTuple):
    """Standard deviations of what is wrong with a gyroscope, the same on all axes.

    `noise_density`: angle random walk N, the density of white noise, rad/s/sqrt(Hz), which is
        rad/sqrt(s)
    `bias_sigma`: constant bias, rad/s
    `random_walk`: rate random walk K of the bias, rad/s^2/sqrt(Hz), which is rad/s/sqrt(s)
    `scale_sigma`: scale factors, a ratio
    """

    noise_density: float = 0.0
    bias_sigma: float = 0.0
    random_walk: float = 0.0
    scale_sigma: float = 0.0


class ErrorGrowth:
    """The covariance of the attitude, sample by sample.

    `rates`: ``"body"`` or ``"inertial"``: the axes in which rates and their errors are resolved
    `method`: the integration rule: which samples a scale factor acts on in an interval
    `mount`: sensor axes to body axes, shape ``(3, 3)``, for scale factors; None where they are the
        same
    `final`: the covariance at the last sample so far, shape ``(3, 3)``, rad^2
    `variances`: what each error, by its name in :class:`SensorErrors`, adds to its trace, rad^2

    Notes
    -----
    Tiles begin at fixed sample indices, and sums up to a sample do not depend on later ones: the
    covariances of the first samples are those of the whole log, to the bit.
    """

    def __init__(
        self,
        errors: SensorErrors,
        rates: str = "body",
        method: str = "start",
        mount: Float64 | None = None,
    ) -> None:
        self._errors, self._inertial = errors, is_inertial(rates)
        self._method, self._mount = method, mount
        self.begin(restart=True)

    def begin(self, *, restart: bool) -> None:
        """Begin a segment: at an attitude that is known, or at the last one, without rotation."""
        self._is_after_gap = not restart
        if not restart:
            return
        self._first_ns = np.int64(0)
        self._last_ns: np.int64 | None = None
        self._integrated_ns = np.int64(0)
        self._previous: tuple[GyroSeries, Float64] | None = None
        self._sums = {
            name: np.zeros(rows) for name, rows in (("S", 9), ("G", 9), ("A", 9), ("B", 6))
        }
        self.variances: dict[str, float] = {}
        self.final: Float64 = np.zeros((3, 3))

    def advance(self, gyro: GyroSeries, wxyz: Float64, *, to_end: bool = False) -> Float64:
        """Return the covariance of the next attitudes.

        `wxyz`: their attitudes, body -> reference, shape ``(N, 4)``
        `Returns`: covariances of small rotations about body axes, shape ``(N, 3, 3)`` or ``(1, 3,
            3)``, rad^2
        """
        self._rows = slice(-1, None) if to_end else slice(None)
        covariance = np.zeros((3, 3, 1 if to_end else len(gyro)))
        if self._last_ns is None:
            self._first_ns = self._last_ns = gyro.t_ns[0]
        spans_ns = self._spans_ns(gyro, self._last_ns)
        self._last_ns = gyro.t_ns[-1]
        # The covariance of noise is the same in all axes.
        integrated_ns = self._integrated_ns + np.cumsum(spans_ns)
        self._integrated_ns = integrated_ns[-1]
        noise = self._errors.noise_density**2 / NS_PER_S * integrated_ns[self._rows]
        self.variances = {"noise_density": 3 * float(noise[-1])}
        if self._errors._replace(noise_density=0.0) != SensorErrors():
            for start in range(0, len(gyro), TILE):
                tile = slice(start, start + TILE)
                turn = rotation_elements(wxyz[tile])
                if self._inertial:
                    turn = turn[TRANSPOSED, :]
                fixed = self._fixed(gyro[tile], turn, spans_ns[tile] / NS_PER_S)
                out = covariance if to_end else covariance[..., tile]
                if self._inertial:
                    write_covariance(fixed, out=out)
                else:
                    rotate_covariance(fixed, turn[:, self._rows], out=out)
        for axis in range(3):
            covariance[axis, axis] += noise
        self.final = covariance[..., -1].copy()
        return np.moveaxis(covariance, -1, 0)

    def _spans_ns(self, gyro: GyroSeries, last_ns: np.int64) -> Int64:
        """Return over how much time the interval that ends at each sample is integrated, ns."""
        spans_ns = np.diff(gyro.t_ns, prepend=last_ns)
        if gyro.integration_time_ns is not None:
            spans_ns = np.where(spans_ns > 0, gyro.integration_time_ns, 0)
        if self._is_after_gap:
            spans_ns[0], self._is_after_gap = 0, False
        return spans_ns

    def _fixed(self, gyro: GyroSeries, turn: Float64, span: Float64) -> Float64:
        """Return the covariance ``(6, n)`` where it is a sum of integrals, but for noise.

        That is about reference axes for body rates, and about body axes for inertial ones.
        """
        rows = self._rows
        if self._previous is None:
            self._previous = gyro[:1], turn[:, :1]
        last, last_turn = self._previous
        self._previous = gyro[-1:], turn[:, -1:].copy()
        # The integral of R over the interval that ends at each sample.
        step = _with_previous(turn, last_turn)
        step *= span / 2
        # A bound of all angles: whether one of them is large does not depend on the others.
        extremes = [edge(one.rate) for one in (gyro, last) for edge in (np.max, np.min)]
        if math.sqrt(3) * np.abs(extremes).max() * span.max() > LARGE_ANGLE:
            rotvec = self._rate(gyro, last) * (-span if self._inertial else span)
            large = np.flatnonzero((rotvec**2).sum(axis=0) > LARGE_ANGLE**2)
            begin = np.where(large > 0, turn[:, large - 1], last_turn)
            step[:, large] = mean_on_the_way(begin, rotvec[:, large]) * span[large]
        fixed = np.zeros((6, 1 if rows.start else len(gyro)))
        if (scale := self._errors.scale_sigma) != 0:
            rate = scale * self._rate(gyro, last)
            rows_of_step = step.reshape(3, 3, -1)
            if (mount := self._mount) is not None:
                rate = rotated(rate, mount)
                rows_of_step = np.stack([rotated(row, mount) for row in rows_of_step])
            g = self._sum("G", (rows_of_step * rate).reshape(9, -1))[:, rows]
            square = symmetric_product(g, g)
            self.variances["scale_sigma"] = trace(square)
            fixed += square
        if self._errors.bias_sigma or self._errors.random_walk:
            fixed += self._of_bias(step, span, gyro.t_ns, last.t_ns)
        return fixed

    def _rate(self, gyro: GyroSeries, last: GyroSeries) -> Float64:
        """Return the rate in the interval that ends at each sample, by the method, ``(3, n)``."""
        # In rows: an operation on columns would be slower than all that follows.
        rate, before = np.ascontiguousarray(gyro.rate.T), last.rate.T
        if self._method == "end" or gyro.is_integrated(self._method):
            return rate
        if self._method == "start":
            return np.concatenate([before, rate[:, :-1]], axis=1)
        mean = _with_previous(rate, before)
        mean /= 2
        return mean

    def _of_bias(self, step: Float64, span: Float64, t_ns: Int64, last_ns: Int64) -> Float64:
        """Return what the bias and its random walk contribute."""
        rows, bias, walk = self._rows, self._errors.bias_sigma**2, self._errors.random_walk**2
        before = self._sums["S"]
        s = self._sum("S", step)
        self.variances["bias_sigma"] = bias * float((s[:, -1] ** 2).sum())
        if not walk:
            s = s[:, rows]
            return bias * symmetric_product(s, s)
        h = np.diff(t_ns, prepend=last_ns) / NS_PER_S
        time_s = (t_ns[rows] - self._first_ns) / NS_PER_S
        twice = _with_previous(s, before[:, None])
        # S is linear within an interval: the integral of its square is that of the middle, and
        # that of the deviation from it, R being orthogonal.
        square = symmetric_product(twice, twice)
        square *= walk / 4 * h
        square[DIAGONAL] += walk / 12 * h * span * span
        twice *= h / 2
        a = self._sum("A", twice)[:, rows]
        b = self._sum("B", square)[:, rows]
        s = s[:, rows]
        # b^2 S S' + K^2 (t S S' - S A' - A S') = S C' + C S'
        c = s * ((bias + walk * time_s) / 2)
        c -= walk * a
        total = symmetric_product(s, c)
        total *= 2
        total += b
        self.variances["random_walk"] = trace(total) - self.variances["bias_sigma"]
        return total

    def _sum(self, name: str, steps: Float64) -> Float64:
        """Return a sum after each of its next terms ``(rows, n)``, n being at most a tile."""
        count = steps.shape[1]
        sums = steps
        if count < TILE:
            # The same tree for a tile that the series does not fill.
            sums = np.zeros((len(steps), TILE))
            sums[:, :count] = steps
        sums[:, 0] += self._sums[name]
        # Even and odd terms are summed as complex numbers, faster than one by one.
        pairs = np.cumsum(sums.view(np.complex128), axis=1).view(np.float64)
        np.add(pairs[:, 1:], pairs[:, :-1], out=sums[:, 1:])
        self._sums[name] = sums[:, count - 1].copy()
        return sums[:, :count]


def _with_previous(values: Float64, last: Float64) -> Float64:
    """Return samples ``(rows, n)`` with the one before added to each: `last` to the first."""
    sums = np.empty(values.shape)
    np.add(values[:, 1:], values[:, :-1], out=sums[:, 1:])
    np.add(values[:, :1], last, out=sums[:, :1])
    return sums


def reference_covariance(wxyz: Float64, covariance: Float64) -> Float64:
    """Return covariances of rotations about body axes as of rotations about reference axes.

    `wxyz`: attitudes body -> reference, shape ``(N, 4)``
    `covariance`: shape ``(N, 3, 3)``, rad^2
    """
    turn = rotation_matrix(wxyz)
    turned = np.asarray(turn @ covariance @ turn.swapaxes(-1, -2))
    variances = np.einsum("...ii->...i", turned)
    np.maximum(variances, 0.0, out=variances)  # rounding errors may have brought them below 0
    return turned
