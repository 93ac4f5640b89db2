"""Quaternion arithmetic on arrays ``(..., 4)`` in the order w, x, y, z.

Hamilton product, ij = k, scalar first: q = w + x i + y j + z k (eq. 1). An attitude transforms body
coordinates to reference coordinates, v_ref = q v_body q* (eq. 3). Leading dimensions broadcast.

Equation numbers here and in the other modules are those of the article "quaternion kinematics and
angular velocity" of PhysicsLibrary (object 1105, version 3).
"""

from __future__ import annotations

from math import factorial, pi
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from quatprop.base.arrays import Float64

    Pairs = NDArray[np.complex128]
    Wxyz = tuple[float, float, float, float]


# Cosine and sine of half an angle of any size, rounded alike on every processor.
#
# The sines of math libraries differ in the last place between processors, so only additions,
# multiplications, divisions and square roots are used here.


TERMS = 5
"""Number of terms of the series for cosine and ratio: enough for steps of 11 degrees."""

_COSINE = [(-1) ** k / (4**k * factorial(2 * k)) for k in range(TERMS)]
_RATIO = [(-1) ** k / (2 * 4**k * factorial(2 * k + 1)) for k in range(TERMS)]
_REACH = 4 * (2.0**-55 * factorial(2 * TERMS)) ** (1 / TERMS)
"""Square of the largest angle, rad^2, at which the series are exact to a quarter ulp."""

_LONG_COSINE = [(-1) ** k / factorial(2 * k) for k in range(2, 9)]
_LONG_SINE = [(-1) ** k / factorial(2 * k + 1) for k in range(1, 9)]
"""Taylor coefficients of all but the leading terms. At an eighth of a turn the first omitted term
is 5e-19 and 3e-20."""

_QUARTER = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
"""A quarter turn, rad, in parts: multiples of the first two, up to 2**20, are exact."""

_MANY_TURNS = 2 * pi * 2**17
"""Multiples of this angle, rad, are removed from longer ones, within their own rounding."""


def half_angle(square: Float64) -> tuple[Float64, Float64]:
    """Return cos(a/2) and sin(a/2)/a from the squares of the angles a.

    Both are power series in a squared, smooth through zero; for larger angles, in the remainder of
    quarter turns. Each result depends only on its own angle, to the bit.

    `square`: squares of angles, rad^2, any shape
    `Returns`: cos(a/2) and sin(a/2)/a, the latter 1/2 at zero; 1/rad
    """
    square = np.asarray(square)
    with np.errstate(over="ignore", invalid="ignore"):
        cosine, ratio = _series(_COSINE, square), _series(_RATIO, square)
        beyond = square > _REACH
        if beyond.any():
            angle = np.sqrt(square[beyond])
            cosine[beyond], sine = _cosine_and_sine(angle / 2)
            ratio[beyond] = sine / angle
    return cosine, ratio


def _cosine_and_sine(angle: Float64) -> tuple[Float64, Float64]:
    """Return cosine and sine of angles of any size, rad.

    References
    ----------
    fdlibm, Sun Microsystems, 1993: the rounding errors of the leading terms are added to the
    smaller ones.
    """
    angle = np.fmod(angle, _MANY_TURNS)
    quarters = np.rint(angle / (pi / 2))
    high, middle, low = (quarters * part for part in _QUARTER)
    angle -= high
    x = angle - middle
    rounding = (angle - x - middle) - low
    square = x * x
    half = square / 2
    leading = 1 - half
    small = square * square * _series(_LONG_COSINE, square) - x * rounding
    cosine = leading + (1 - leading - half + small)
    sine = x + (x * (square * _series(_LONG_SINE, square)) + leading * rounding)
    odd, sign = quarters % 2 == 1, np.where(quarters % 4 >= 2, -1.0, 1.0)  # noqa: PLR2004  # halves
    return sign * np.where(odd, -sine, cosine), sign * np.where(odd, cosine, sine)


def _series(coefficients: list[float], x: Float64) -> Float64:
    """Return the polynomial with these coefficients, lowest first, by Horner's rule."""
    lowest, *middle, highest = coefficients
    total = np.multiply(x, highest, out=np.empty_like(x))
    for coefficient in reversed(middle):
        total += coefficient
        total *= x
    total += lowest
    return total


IDENTITY: Float64 = np.array([1.0, 0.0, 0.0, 0.0])
"""The attitude of a body whose axes are those of the reference."""
IDENTITY.setflags(write=False)

NEARER = 4
"""Steps of the power method: errors of 1e-3 in a matrix leave 1e-14."""

SETTLED = 1e-9
"""Larger last steps show that it has not converged."""

UNIT_TOLERANCE = 1e-3
"""Maximum deviation of a length from 1, which rounding to three decimals can cause."""


def multiply(p: ArrayLike, q: ArrayLike) -> Float64:
    """Return the Hamilton product p q.

    `p`, `q`: quaternions wxyz, shape ``(..., 4)``
    `Returns`: shape ``(..., 4)``. As rotations: first q, then p
    """
    pw, px, py, pz = _components(p)
    qw, qx, qy, qz = _components(q)
    return _rows(
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )


def conjugate(q: ArrayLike) -> Float64:
    """Return q*, for a unit quaternion the opposite rotation.

    `q`: quaternions wxyz, shape ``(..., 4)``
    `Returns`: shape ``(..., 4)``
    """
    return _array(q) * [1.0, -1.0, -1.0, -1.0]


def normalize(q: ArrayLike) -> Float64:
    """Return q scaled to unit length.

    `q`: quaternions wxyz, shape ``(..., 4)``, finite and not zero
    `Returns`: shape ``(..., 4)``
    """
    q = _array(q)
    # Squares of very large or small components would overflow or underflow.
    scaled: Float64 = q / np.abs(q).max(axis=-1, keepdims=True)
    scaled /= np.sqrt((scaled**2).sum(axis=-1, keepdims=True))
    return scaled


def shorter(q: ArrayLike) -> Float64:
    """Return q or -q, ``(..., 4)``, with w >= 0: the same attitude by the shorter rotation."""
    q = _array(q)
    return np.asarray(np.where(q[..., :1] < 0, -q, q))


def exp(rotvec: ArrayLike) -> Float64:
    """Return the unit quaternion of a rotation vector (eq. 34).

    Smooth through zero, for angles of any size; w is negative for angles between pi and
    3 pi.

    `rotvec`: rotation vectors, shape ``(..., 3)``, rad: the axis times the angle
    `Returns`: unit quaternions wxyz, shape ``(..., 4)``: cos(angle/2) + axis sin(angle/2)

    References
    ----------
    Eqs. 8, 34, 35.
    """
    rotvec = _array(rotvec)
    q = np.empty((*rotvec.shape[:-1], 4))
    with np.errstate(over="ignore", invalid="ignore"):
        q[..., 0], ratio = half_angle((rotvec**2).sum(axis=-1))
        q[..., 1:] = rotvec * ratio[..., None]
    return q


def log(q: ArrayLike) -> Float64:
    """Return the rotation vector of a unit quaternion: the inverse of :func:`exp`.

    `q`: unit quaternions wxyz, shape ``(..., 4)``
    `Returns`: rotation vectors, shape ``(..., 3)``, rad, no longer than 2 pi; longer than pi where
        w is negative. The quaternion -1, a full turn about an undefined axis, gives zero
    """
    q = _array(q)
    w, vector = q[..., :1], q[..., 1:]
    sine = _length(*_components(vector))[..., None]
    ratio = np.zeros_like(sine)
    np.divide(2 * np.arctan2(sine, w), sine, out=ratio, where=sine != 0)
    return vector * ratio


def rotate(q: ArrayLike, v: ArrayLike) -> Float64:
    """Return q v q*: vectors in reference coordinates from body coordinates (eq. 3).

    `q`: unit quaternions wxyz body -> reference, shape ``(..., 4)``
    `v`: vectors resolved in the body frame, shape ``(..., 3)``, any unit
    `Returns`: the vectors resolved in the reference frame, shape ``(..., 3)``
    """
    q, v = _array(q), _array(v)
    w, vector = q[..., :1], q[..., 1:]
    twice = 2 * _cross(vector, v)
    return np.asarray(v + w * twice + _cross(vector, twice))


def rotation_matrix(q: ArrayLike) -> Float64:
    """Return R(q), with v_ref = R v_body (eq. 5).

    `q`: unit quaternions wxyz body -> reference, shape ``(..., 4)``
    `Returns`: shape ``(..., 3, 3)``; its columns are the body axes resolved in the reference frame
    """
    q = _array(q)
    return np.stack([rotate(q, axis) for axis in np.eye(3)], axis=-1)


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


def from_matrix(matrix: ArrayLike) -> Float64:
    """Return the unit quaternion of a rotation matrix: the inverse of :func:`rotation_matrix`.

    `matrix`: rotation matrices with v_ref = R v_body, shape ``(..., 3, 3)``
    `Returns`: unit quaternions wxyz body -> reference with w >= 0, shape ``(..., 4)``; NaN where
        the matrix has elements that are not finite

    References
    ----------
    Shepperd, "Quaternion from rotation matrix", Journal of Guidance and Control 1(3), 1978: the
    component with the largest square is used.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        return shorter(_largest_row(_products(_array(matrix))))


def nearest_rotations(matrices: Float64) -> Float64:
    """Return the quaternions of the rotations that are nearest to matrices with small errors.

    `matrices`: finite, shape ``(N, 3, 3)``
    `Returns`: shape ``(N, 4)``, with w >= 0: of the rotations with the least sum of squared
        differences, those of a singular value decomposition. They are the principal eigenvectors
        of their products, to which the largest row is near

    References
    ----------
    Bar-Itzhack, "New method for extracting the quaternion from a rotation matrix", Journal of
    Guidance, Control, and Dynamics 23(6), 2000.
    """
    products = _products(matrices)
    q, before = _largest_row(products), np.zeros((len(products), 4))
    for _ in range(NEARER):
        before = q
        # Element by element, so that a row has the same bits in every batch.
        q = products[..., 0] * before[:, :1]
        for k in range(1, 4):
            q += products[..., k] * before[:, k : k + 1]
        q /= np.linalg.norm(q, axis=-1, keepdims=True)
    (far,) = np.nonzero(np.abs(q - before).max(axis=-1, initial=0.0) > SETTLED)
    q[far] = np.linalg.eigh(products[far])[1][:, :, -1]
    return shorter(q)


def _largest_row(products: Float64) -> Float64:
    """Return the longest row of each :func:`_products`, scaled to unit length, ``(..., 4)``."""
    squares = np.einsum("...ii->...i", products)
    largest = np.argmax(np.where(np.isfinite(squares), squares, -np.inf), axis=-1)
    q = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def _products(matrices: Float64) -> Float64:
    """Return four times the products of the components of quaternions, ``(..., 4, 4)``.

    Each row is the quaternion times one of them.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(matrices, (-2, -1), (0, 1))
    rows = [
        [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def geodesic_angle(p: ArrayLike, q: ArrayLike) -> Float64:
    """Return the angle of the rotation between two attitudes.

    The signs and the lengths of the quaternions do not matter. Exact to rounding at any angle: an
    arc cosine would lose angles below 1e-8 rad.

    `p`, `q`: attitudes wxyz, shape ``(..., 4)``
    `Returns`: angles, shape ``(...)``, rad, from 0 to pi
    """
    pw, px, py, pz = _components(p)
    qw, qx, qy, qz = _components(q)
    # p* q, with its terms in pairs: each pair, and so the angle, is exactly 0 for equal attitudes.
    length = _length(
        (pw * qx - px * qw) - (py * qz - pz * qy),
        (pw * qy - py * qw) - (pz * qx - px * qz),
        (pw * qz - pz * qw) - (px * qy - py * qx),
    )
    scalar = pw * qw + px * qx + py * qy + pz * qz
    return np.asarray(2 * np.arctan2(length, np.abs(scalar)))


def slerp(p: ArrayLike, q: ArrayLike, fraction: ArrayLike) -> Float64:
    """Interpolate between two attitudes: the shortest rotation from p to q at a constant rate.

    `p`, `q`: unit quaternions wxyz, shape ``(..., 4)``; their signs do not matter
    `fraction`: elapsed fraction of the rotation, shape ``(...)``: 0 gives p, 1 gives q or -q
    `Returns`: unit quaternions wxyz, shape ``(..., 4)``
    """
    step = shorter(multiply(conjugate(p), q))
    return normalize(multiply(p, exp(_array(fraction)[..., None] * log(step))))


def _array(values: ArrayLike) -> Float64:
    return np.asarray(values, dtype=np.float64)


def _components(q: ArrayLike) -> list[Float64]:
    q = _array(q)
    return [q[..., k] for k in range(q.shape[-1])]


def _rows(*components: Float64) -> Float64:
    rows = np.empty((*np.shape(components[0]), len(components)))
    for k, component in enumerate(components):
        rows[..., k] = component
    return rows


def _cross(x: Float64, y: Float64) -> Float64:
    (x0, x1, x2), (y0, y1, y2) = _components(x), _components(y)
    return _rows(x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0)


def _length(x: Float64, y: Float64, z: Float64) -> Float64:
    """Return the lengths of vectors; by hypot, since squares of tiny components underflow."""
    return np.asarray(np.hypot(np.hypot(x, y), z))


# The product of many quaternions, as a tree.
#
# A sequential loop of q[k+1] = q[k] dq[k] (eq. 36) is slow in NumPy, one sample at a time. But the
# product is associative, so the steps of a tile are composed as a tree: neighbouring steps are
# multiplied to steps over two intervals, those to steps over four, and so on; then the attitudes in
# between are filled in from the top down. Every level is a few NumPy calls, and rounding errors
# grow with the depth of the tree instead of its width.
#
# A quaternion w + xi + yj + zk is stored as a pair of complex numbers, a = w + xi and b = y + zi,
# arrays ``(2, n)``: the product (a c - b d*, a d + b c*) then takes four complex multiplications.
# NumPy uses fused multiply-add in them if the processor has it (x86 since 2013, and 64-bit ARM); on
# others the last bits differ. Real arithmetic would not depend on it, but takes a third more time
# for all computations from rates to attitudes.


LEVELS: Final = 8
"""Number of levels of the tree. The few steps that remain are composed by a loop, which is faster
than more levels."""

PADDING: Final = 2**LEVELS * 8
"""The steps of a tile are padded to a multiple of this, so that arrays have a multiple of 8
elements on every level: NumPy rounds the remainder, which does not fill a register, differently."""


def tile_steps(rotvec: Float64) -> Pairs:
    """Return the unit quaternions of rotation vectors ``(n, 3)`` (eq. 35), padded for a tree.

    They are padded with identities to a multiple of :data:`PADDING`; products with these are exact.
    """
    x, y, z = rotvec.T
    count = len(x)
    cosine, ratio = half_angle(x * x + y * y + z * z)
    steps = np.empty((2, -(-count // PADDING) * PADDING), np.complex128)
    steps[0, count:], steps[1, count:] = 1, 0
    a, b = steps[:, :count]
    a.real = cosine
    np.multiply(x, ratio, out=a.imag)
    np.multiply(y, ratio, out=b.real)
    np.multiply(z, ratio, out=b.imag)
    return steps


def product_scan(first: Wxyz, steps: Pairs, levels: int = LEVELS) -> Pairs:
    """Return the first attitude and those after each of `n` steps, ``(2, n + 1)``."""
    if not levels:
        return np.array(product_loop(first, steps)).view(np.complex128).T.copy()
    even = steps[:, 0::2]
    every = np.empty((2, steps.shape[1] + 1), np.complex128)
    every[:, 0::2] = every_other = product_scan(first, compose_pairs(steps, 1), levels - 1)
    _multiply(every_other[:, :-1], even, out=every[:, 1::2])
    return every


def compose_pairs(steps: Pairs, levels: int) -> Pairs:
    """Return the steps some levels higher in the tree, each a product of 2**levels steps."""
    for _ in range(levels):
        even, odd = steps[:, 0::2], steps[:, 1::2]
        steps = np.empty_like(odd)
        _multiply(even, odd, out=steps)
    return steps


def product_loop(first: Wxyz, steps: Pairs) -> list[Wxyz]:
    """Return the same as :func:`product_scan`, computed one step after another."""
    # Real numbers: some interpreters compute complex products with fused multiply-add.
    w, x, y, z = first
    attitudes = [first]
    for a, b, c, d in np.ascontiguousarray(steps.T).view(np.float64).tolist():
        w, x, y, z = (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        )
        attitudes.append((w, x, y, z))
    return attitudes


def _multiply(p: Pairs, q: Pairs, out: Pairs) -> None:
    """Write the Hamilton products p q: a c - b d* and a d + b c*."""
    (a, b), (c, d), (left, right) = p, q, out
    np.multiply(a, c, out=left)
    term = d.conj()
    term *= b
    left -= term
    np.multiply(a, d, out=right)
    np.conjugate(c, out=term)
    term *= b
    right += term


def write_rows(pairs: Pairs, rows: Float64) -> None:
    """Write pairs ``(2, n)`` as rows wxyz ``(n, 4)`` of unit length."""
    a, b = pairs
    components = (a.real, a.imag, b.real, b.imag)
    ww, xx, yy, zz = map(np.square, components)
    # 1/sqrt(s) for an s that differs from 1 by rounding errors only.
    scale = 1.5 - 0.5 * (ww + xx + yy + zz)
    for component, column in zip(components, rows.T, strict=True):
        np.multiply(component, scale, out=column)


def unit(wxyz: Wxyz) -> Wxyz:
    """Return an attitude of unit length, rounded as by :func:`write_rows`."""
    w, x, y, z = wxyz
    scale = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
    return w * scale, x * scale, y * scale, z * scale
