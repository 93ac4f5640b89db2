"""How the errors of a gyroscope grow to an error of the attitude: its covariance at every sample.

A rate that is off by e turns the attitude by the integral of R e in reference axes, R being the
rotation matrix body -> reference. So the covariance needs integrals of R alone, which are sums over
the samples:

    P = N^2 t I  +  b^2 S S'  +  s^2 G G'  +  K^2 (t S S' - S A' - A S' + B)

    S = int R dt     G = int R diag(w) dt     A = int S dt     B = int S S' dt

with the angle random walk N, the standard deviations b of the bias and s of the scale factors, and
the rate random walk K, alike and independent on all axes. The bias is constant; the random walk
begins at zero with the first sample. P is the covariance of small rotations about reference axes,
R' P R of the same rotations about body axes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.kinematics.quaternion import rotation_matrix
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64
    from quatprop.series import GyroSeries


TILE: Final = 8192
"""Samples computed together, from fixed sample indices: few enough for the caches."""

UPPER: Final = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Row and column of the elements of a symmetric matrix that are computed."""

DIAGONAL: Final = np.array([True, False, False, True, False, True])
"""Which of them are on the diagonal."""


class SensorErrors(NamedTuple):
    """Standard deviations of what is wrong with a gyroscope, the same on all axes.

    Parameters
    ----------
    noise_density
        Angle random walk N, the density of white noise, rad/s/sqrt(Hz), which is rad/sqrt(s).
    bias_sigma
        Constant bias, rad/s.
    random_walk
        Rate random walk K of the bias, rad/s^2/sqrt(Hz), which is rad/s/sqrt(s).
    scale_sigma
        Scale factors, a ratio.
    """

    noise_density: float = 0.0
    bias_sigma: float = 0.0
    random_walk: float = 0.0
    scale_sigma: float = 0.0


class ErrorGrowth:
    """The covariance of the attitude, sample by sample.

    Parameters
    ----------
    errors
        Of the gyroscope.
    rates
        ``"body"`` or ``"inertial"``: the axes in which rates, and so their errors, are resolved.

    Attributes
    ----------
    final
        The covariance at the last sample so far, shape ``(3, 3)``, rad^2.
    variances
        What each error, by its name in :class:`SensorErrors`, adds to its trace, rad^2.

    Notes
    -----
    Tiles begin at fixed sample indices, and sums up to a sample do not depend on later ones: the
    covariances of the first samples are those of the whole log, to the bit.
    """

    def __init__(self, errors: SensorErrors, rates: str = "body") -> None:
        self._errors, self._inertial = errors, rates == "inertial"
        self.restart()

    def restart(self) -> None:
        """Begin again: the next attitude is known."""
        self._first_ns: np.int64 | None = None
        self._previous: tuple[GyroSeries, Float64] | None = None
        self._sums = {
            name: np.zeros(rows) for name, rows in (("S", 9), ("G", 9), ("A", 9), ("B", 6))
        }
        self.variances: dict[str, float] = {}
        self.final: Float64 = np.zeros((3, 3))

    def advance(self, gyro: GyroSeries, wxyz: Float64, *, to_end: bool = False) -> Float64:
        """Return the covariance of the next attitudes.

        Parameters
        ----------
        gyro
            Samples that follow the last ones.
        wxyz
            Their attitudes, body -> reference, shape ``(N, 4)``.
        to_end
            Return that of the last of them only, for less work.

        Returns
        -------
        ndarray
            Covariances of small rotations about body axes, shape ``(N, 3, 3)`` or ``(1, 3, 3)``,
            rad^2.
        """
        self._rows = slice(-1, None) if to_end else slice(None)
        covariance = np.zeros((3, 3, 1 if to_end else len(gyro)))
        if self._first_ns is None:
            self._first_ns = gyro.t_ns[0]
        # The covariance of noise is the same in all axes.
        time_s = (gyro.t_ns - self._first_ns) / NS_PER_S
        noise = self._errors.noise_density**2 * time_s[self._rows]
        self.variances = {"noise_density": 3 * float(noise[-1])}
        if self._errors._replace(noise_density=0.0) != SensorErrors():
            for start in range(0, len(gyro), TILE):
                tile = slice(start, start + TILE)
                turn = rotation_elements(wxyz[tile])
                reference = self._reference(gyro[tile], turn, time_s[tile])
                out = covariance if to_end else covariance[..., tile]
                rotate_covariance(reference, turn[:, self._rows], out=out)
        for axis in range(3):
            covariance[axis, axis] += noise
        self.final = covariance[..., -1].copy()
        return np.moveaxis(covariance, -1, 0)

    def _reference(self, gyro: GyroSeries, turn: Float64, time_s: Float64) -> Float64:
        """Return the covariance ``(6, n)`` of rotations about reference axes, but for noise."""
        rows = self._rows
        if self._inertial:
            turn = np.repeat(np.eye(3).reshape(9, 1), len(gyro), axis=1)
        if self._previous is None:
            self._previous = gyro[:1], turn[:, :1]
        last, last_turn = self._previous
        self._previous = gyro[-1:], turn[:, -1:].copy()
        errors = self._errors
        h = np.diff(gyro.t_ns, prepend=last.t_ns) / NS_PER_S
        # The integral of R over the interval that ends at each sample.
        step = _with_previous(turn, last_turn)
        step *= h / 2
        reference = np.zeros((6, 1 if rows.start else len(gyro)))
        if errors.scale_sigma:
            # In rows: an operation on columns would be slower than all that follows.
            rate = errors.scale_sigma * np.ascontiguousarray(gyro.rate.T)
            if gyro.span_ns is None and not gyro.averages:
                rate = _with_previous(rate, errors.scale_sigma * last.rate.T) / 2
            g = self._sum("G", (step.reshape(3, 3, -1) * rate).reshape(9, -1))[:, rows]
            square = _symmetric(g, g)
            self.variances["scale_sigma"] = _trace(square)
            reference += square
        if errors.bias_sigma or errors.random_walk:
            reference += self._of_bias(step, time_s, h)
        return reference

    def _of_bias(self, step: Float64, time_s: Float64, h: Float64) -> Float64:
        """Return what the bias and its random walk contribute."""
        rows, bias, walk = self._rows, self._errors.bias_sigma**2, self._errors.random_walk**2
        before = self._sums["S"]
        s = self._sum("S", step)
        self.variances["bias_sigma"] = bias * float((s[:, -1] ** 2).sum())
        if not walk:
            s = s[:, rows]
            return bias * _symmetric(s, s)
        twice = _with_previous(s, before[:, None])
        # S is linear within an interval: the integral of its square is that of the middle, and
        # h^3/12 for the deviation from it, R being orthogonal.
        square = _symmetric(twice, twice)
        square *= walk / 4 * h
        square[DIAGONAL] += walk / 12 * h * h * h
        twice *= h / 2
        a = self._sum("A", twice)[:, rows]
        b = self._sum("B", square)[:, rows]
        s = s[:, rows]
        # b^2 S S' + K^2 (t S S' - S A' - A S') = S C' + C S'
        c = s * ((bias + walk * time_s[rows]) / 2)
        c -= walk * a
        total = _symmetric(s, c)
        total *= 2
        total += b
        self.variances["random_walk"] = _trace(total) - self.variances["bias_sigma"]
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


def rotation_elements(wxyz: Float64) -> Float64:
    """Return the elements of rotation matrices body -> reference, ``(9, n)``, row by row."""
    w, x, y, z = np.ascontiguousarray(wxyz.T)
    elements = np.empty((9, len(w)))
    xx, yy, zz = 2 * x * x, 2 * y * y, 2 * z * z
    for diagonal, (u, v) in zip((0, 4, 8), ((yy, zz), (xx, zz), (xx, yy)), strict=True):
        np.subtract(1 - u, v, out=elements[diagonal])
    for (u, v, s), (below, above) in (
        ((x, y, z), (3, 1)),
        ((z, x, y), (2, 6)),
        ((y, z, x), (7, 5)),
    ):
        product, turn = 2 * u * v, 2 * w * s
        np.add(product, turn, out=elements[below])
        np.subtract(product, turn, out=elements[above])
    return elements


def reference_covariance(wxyz: Float64, covariance: Float64) -> Float64:
    """Return covariances of rotations about body axes as of rotations about reference axes.

    Parameters
    ----------
    wxyz
        Attitudes body -> reference, shape ``(N, 4)``.
    covariance
        Shape ``(N, 3, 3)``, rad^2.
    """
    turn = rotation_matrix(wxyz)
    turned = np.asarray(turn @ covariance @ turn.swapaxes(-1, -2))
    variances = np.einsum("...ii->...i", turned)
    np.maximum(variances, 0.0, out=variances)  # rounding errors may have brought them below 0
    return turned


def rotate_covariance(reference: Float64, turn: Float64, out: Float64) -> None:
    """Write R' P R as matrices ``(3, 3, n)``, from P ``(6, n)`` and R ``(9, n)``."""
    full = reference[[0, 1, 2, 1, 3, 4, 2, 4, 5]]
    term = np.empty(out.shape[-1])
    half = np.empty(out.shape)
    for column in range(3):
        for row in range(3):
            _dot(full[3 * row : 3 * row + 3], turn[column::3], half[row, column], term)
    for row, column in UPPER:
        _dot(turn[row::3], half[:, column], out[row, column], term)
        if row == column:
            np.maximum(out[row, row], 0.0, out=out[row, row])
        else:
            out[column, row] = out[row, column]


def _symmetric(u: Float64, v: Float64) -> Float64:
    """Return (U V' + V U') / 2, ``(6, n)``, of matrices ``(9, n)``."""
    result, term = np.empty((6, u.shape[1])), np.empty(u.shape[1])
    other = None if u is v else np.empty(u.shape[1])
    for element, (row, column) in enumerate(UPPER):
        rows, columns = slice(3 * row, 3 * row + 3), slice(3 * column, 3 * column + 3)
        _dot(u[rows], v[columns], result[element], term)
        if other is not None and row != column:
            result[element] += _dot(v[rows], u[columns], other, term)
            result[element] /= 2
    return result


def _dot(u: Float64, v: Float64, out: Float64, term: Float64) -> Float64:
    """Write u[0] v[0] + u[1] v[1] + u[2] v[2]."""
    np.multiply(u[0], v[0], out=out)
    for k in (1, 2):
        np.multiply(u[k], v[k], out=term)
        out += term
    return out


def _trace(elements: Float64) -> float:
    """Return the trace of the last of some symmetric matrices ``(6, n)``."""
    return float(elements[0, -1] + elements[3, -1] + elements[5, -1])
