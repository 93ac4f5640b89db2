"""Quaternion arithmetic on arrays ``(..., 4)`` in the order w, x, y, z.

Hamilton product, ij = k, scalar first: q = w + x i + y j + z k (eq. 1). An attitude transforms body
coordinates to reference coordinates, v_ref = q v_body q* (eq. 3). Leading dimensions broadcast.

Equation numbers here and in the other modules are those of the article "quaternion kinematics and
angular velocity" of PhysicsLibrary (object 1105, version 3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.kinematics.half_angle import half_angle

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from quatprop.arrays import Float64


IDENTITY: Float64 = np.array([1.0, 0.0, 0.0, 0.0])
"""The attitude of a body whose axes are those of the reference."""
IDENTITY.setflags(write=False)

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
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(_array(matrix), (-2, -1), (0, 1))
    # Four times the products of the components: each row is the quaternion times one of them.
    rows = [
        [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz],
    ]
    products = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    squares = np.einsum("...ii->...i", products)
    largest = np.argmax(np.where(np.isfinite(squares), squares, -np.inf), axis=-1)
    q = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    with np.errstate(invalid="ignore", over="ignore"):
        return shorter(q / np.linalg.norm(q, axis=-1, keepdims=True))


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
