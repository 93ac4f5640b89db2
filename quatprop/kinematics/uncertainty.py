"""Covariance of the attitude at every sample, due to the errors of a gyroscope.

An error e of the body rate rotates the attitude by the integral of R e in reference axes, with R
the rotation matrix body -> reference. So the covariance needs only integrals of R, which are sums
over the samples:

    P = P0  +  N^2 t I  +  b^2 S S'  +  s^2 G0 G0'  +  m^2 (G1 G1' + G2 G2')

    S = int R dt     Gk = int R diag(w of the axes k further) dt

with the covariance P0 of the first attitude, the angle random walk N, and the standard deviations b
of the bias, s of the scale factors and m of the misalignments, equal and independent on all axes. A
bias with a random walk is in :mod:`quatprop.kinematics.bias_growth`. P is the covariance of small
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
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.kinematics.bias_growth import BiasGrowth, RestErrors
from quatprop.kinematics.elements import (
    TRANSPOSED,
    UPPER,
    mean_rotation,
    rotate_covariance,
    rotated,
    rotation_elements,
    symmetric_product,
    trace,
    write_covariance,
)
from quatprop.kinematics.increments import is_inertial
from quatprop.kinematics.prefix_sums import TILE, PrefixSums, with_previous
from quatprop.kinematics.quaternion import rotation_matrix
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.series import GyroSeries


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


def reference_covariance(wxyz: Float64, covariance: Float64) -> Float64:
    """Convert covariances of rotations about body axes to those about reference axes.

    `wxyz`: attitudes body -> reference, shape ``(N, 4)``
    `covariance`: shape ``(N, 3, 3)``, rad^2
    """
    rotation = rotation_matrix(wxyz)
    turned = np.asarray(rotation @ covariance @ rotation.swapaxes(-1, -2))
    variances = np.einsum("...ii->...i", turned)
    np.maximum(variances, 0.0, out=variances)  # rounding may make them negative
    return turned
