"""Small matrices of many samples, stored by element, and their sums over the samples so far.

A matrix is nine arrays, in row-major order, and a symmetric one six, those of its upper triangle.
The rounding for a sample does not depend on its position in the batch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.kinematics.increments import cross

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64


UPPER: Final = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Row and column of the stored elements of a symmetric matrix."""

FULL: Final = (0, 1, 2, 1, 3, 4, 2, 4, 5)
"""Indices of the stored elements for the whole matrix, in row-major order."""

TRANSPOSED: Final = (0, 3, 6, 1, 4, 7, 2, 5, 8)
"""Indices of the elements of a matrix for its transpose, in row-major order."""

DIAGONAL: Final = np.array([True, False, False, True, False, True])
"""Which stored elements of a symmetric matrix are on the diagonal."""


def rotation_elements(wxyz: Float64) -> Float64:
    """Return rotation matrices body -> reference by element, ``(9, n)``."""
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


def mean_rotation(rotation: Float64, rotvec: Float64) -> Float64:
    """Return the mean of R exp([v] s), s from 0 to 1, for R ``(9, n)`` and v ``(3, n)``, not 0."""
    angle = np.sqrt((rotvec**2).sum(axis=0))
    first, second = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    rows = []
    for row in (rotation[:3], rotation[3:6], rotation[6:]):
        once = cross(row, rotvec)
        rows.append(row + first * once + second * cross(once, rotvec))
    return np.concatenate(rows)


def rotate_covariance(elements: Float64, rotation: Float64, out: Float64) -> None:
    """Write R' P R as matrices ``(3, 3, n)``, from P ``(6, n)`` and R ``(9, n)``."""
    full = elements[FULL, :]
    term = np.empty(out.shape[-1])
    half = np.empty(out.shape)
    for column in range(3):
        for row in range(3):
            _dot(full[3 * row : 3 * row + 3], rotation[column::3], half[row, column], term)
    for row, column in UPPER:
        _dot(rotation[row::3], half[:, column], out[row, column], term)
        if row == column:
            np.maximum(out[row, row], 0.0, out=out[row, row])
        else:
            out[column, row] = out[row, column]


def write_covariance(elements: Float64, out: Float64) -> None:
    """Write covariances ``(6, n)`` as matrices ``(3, 3, n)``."""
    out[...] = elements[FULL, :].reshape(out.shape)
    for axis in range(3):
        np.maximum(out[axis, axis], 0.0, out=out[axis, axis])


def rotated(vectors: Float64, matrix: Float64) -> Float64:
    """Return M' v of vectors ``(3, n)``; the rounding does not depend on their positions."""
    x, y, z = vectors
    return np.stack([x * column[0] + y * column[1] + z * column[2] for column in matrix.T])


def symmetric_product(u: Float64, v: Float64) -> Float64:
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


def trace(elements: Float64) -> float:
    """Return the trace of the last of some symmetric matrices ``(6, n)``."""
    return float(elements[0, -1] + elements[3, -1] + elements[5, -1])


# Sums over the samples so far, with bits that do not depend on batches.


TILE: Final = 8192
"""Samples that are summed together, from fixed sample indices: few enough for the caches."""


class PrefixSums(dict[str, "Float64"]):
    """Sums up to the last sample so far, by name, each of several rows."""

    def after(self, name: str, steps: Float64) -> Float64:
        """Return a sum after each of its next terms, ``(rows, n)``; n is at most a tile."""
        count = steps.shape[1]
        sums = steps
        if count < TILE:
            # A partly filled tile is summed by the same tree.
            sums = np.zeros((len(steps), TILE))
            sums[:, :count] = steps
        sums[:, 0] += self.last(name, len(steps))
        # Even and odd terms are summed as complex numbers, faster than one by one.
        pairs = np.cumsum(sums.view(np.complex128), axis=1).view(np.float64)
        np.add(pairs[:, 1:], pairs[:, :-1], out=sums[:, 1:])
        self[name] = sums[:, count - 1].copy()
        return sums[:, :count]

    def last(self, name: str, rows: int) -> Float64:
        """Return a sum up to the last sample so far, ``(rows,)``."""
        return self.get(name, np.zeros(rows))


def with_previous(values: Float64, last: Float64) -> Float64:
    """Return each sample, ``(rows, n)``, plus the previous one; `last` precedes the first."""
    sums = np.empty(values.shape)
    np.add(values[:, 1:], values[:, :-1], out=sums[:, 1:])
    np.add(values[:, :1], last, out=sums[:, :1])
    return sums
