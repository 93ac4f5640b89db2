"""Representations of a rotation other than a quaternion, and their inverses.

Rotation vectors, Euler angles of every sequence, and matrices: each a set of columns whose names
state their content and unit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.kinematics.quaternion import (
    exp,
    from_matrix,
    log,
    multiply,
    normalize,
    rotation_matrix,
)
from quatprop.settings.choices import EULER_SEQUENCES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from quatprop.arrays import Float64

QUATERNION = "quaternion"
"""The representation that is not converted."""

NEAR_LOCK_DEG = 0.01
"""deg: within this angle of gimbal lock the first and third angle are hardly distinguishable."""

_ROUNDING = 1e-12
_SKEWED = 0.5
"""A matrix is no rotation if an element of R'R - 1 is larger than this."""


def euler_angles(sequence: str, wxyz: Float64) -> Float64:
    """Return the angles of intrinsic rotations about three axes.

    For the sequence ``"xyz"`` q = q_x(first) q_y(second) q_z(third): about x, then about the new
    y, then about the newest z; scipy writes ``"XYZ"``. Extrinsic rotations, about fixed axes, have
    the same angles in reversed order. The half sum and the half difference of the first and the
    third angle are computed. In gimbal lock one of them is still exact; the other is undetermined,
    and is a result of rounding, or zero.

    `wxyz`: quaternions, shape ``(N, 4)``, of any length
    `Returns`: shape ``(N, 3)``, rad: the first and the third from -pi to pi. The second is from
        -pi/2 to pi/2 if all axes differ (Tait-Bryan angles), from 0 to pi if the first axis is the
        third (proper Euler angles)

    References
    ----------
    Bernardes and Viollet, "Quaternion to Euler angles conversion: A direct, general and
    computationally efficient method", PLoS ONE 17(11), 2022.
    """
    i, j, k = ("wxyz".index(axis) for axis in sequence)
    is_proper, other = i == k, 6 - i - j
    sign = (i - j) * (j - other) * (other - i) / 2
    w, first, second, third = wxyz[:, 0], wxyz[:, i], wxyz[:, j], wxyz[:, other]
    # Sine and cosine of the half sum and of the half difference, each pair times a factor. Adding
    # zero removes the sign of -0.0, which would change an angle of 0 to pi.
    if is_proper:
        half_sum, half_difference = (first, w), (sign * third, second)
    else:
        half_sum = (first + third, w + sign * second)
        half_difference = (first - third, w - sign * second)
    (plus, minus), (larger, smaller) = (
        [function(sine, cosine + 0.0) for sine, cosine in (half_sum, half_difference)]
        for function in (np.arctan2, np.hypot)
    )
    if is_proper or sign < 0:
        larger, smaller = smaller, larger
    middle = 2 * np.arctan2(larger, smaller) - (0.0 if is_proper else np.pi / 2)
    return np.stack(
        [_within_half_turn(plus + minus), middle, _within_half_turn(plus - minus)], axis=1
    )


def _within_half_turn(angle: Float64) -> Float64:
    wrapped: Float64 = angle - 2 * np.pi * np.rint(angle / (2 * np.pi))
    return wrapped


def from_euler(sequence: str, angles: Float64) -> Float64:
    """Return the quaternions of angles of any size: the inverse of :func:`euler_angles`.

    `angles`: in the order of the sequence, shape ``(N, 3)``, rad
    `Returns`: unit quaternions, shape ``(N, 4)``
    """
    steps = np.zeros((3, len(angles), 4))
    steps[:, :, 0] = np.cos(angles.T / 2)
    for step, axis, angle in zip(steps, sequence, angles.T, strict=True):
        step[:, "wxyz".index(axis)] = np.sin(angle / 2)
    return multiply(multiply(steps[0], steps[1]), steps[2])


def from_matrices(rows: Float64) -> Float64:
    """Return the quaternions of rotation matrices, with w >= 0.

    Other matrices are not orthonormalised: the length of the quaternion differs from 1 as much as
    R'R differs from 1, and reflections and matrices far from rotations give NaN.

    `rows`: matrices row by row, shape ``(N, 9)``
    `Returns`: shape ``(N, 4)``; of unit length if the matrix is a rotation
    """
    r = rows.reshape(-1, 3, 3)
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(r.transpose(0, 2, 1) @ r - np.eye(3)).max(axis=(1, 2), initial=0.0)
        reflected = np.linalg.det(r) < 0
        attitudes = from_matrix(r) * (1 + np.where(off > _ROUNDING, off, 0.0))[:, None]
    valid = (off <= _SKEWED) & ~reflected
    return np.where(valid[:, None], attitudes, np.nan)


class Representation(NamedTuple):
    """A representation of a rotation other than a quaternion.

    `columns`: names of the columns, which state their content and unit
    `values`: converts unit quaternions, shape ``(N, 4)``, to the columns, shape ``(N, k)``
    `attitudes`: converts the columns to quaternions, of unit length if they are a rotation
    `signed`: whether q and -q have different values
    `lock_deg`: second angles, deg, at which the first and the third cannot be distinguished
    """

    columns: tuple[str, ...]
    values: Callable[[Float64], Float64]
    attitudes: Callable[[Float64], Float64]
    signed: bool = False
    lock_deg: tuple[int, ...] = ()

    def locked(self, values: Float64) -> int:
        """Return the number of rows of columns, shape ``(N, k)``, whose angles are not unique."""
        if not self.lock_deg:
            return 0
        second = values[:, 1] if self.columns[1].endswith("_deg") else np.degrees(values[:, 1])
        distance = np.abs(second[:, None] - self.lock_deg).min(axis=1, initial=np.inf)
        return int(np.count_nonzero(distance < NEAR_LOCK_DEG))


def _euler(sequence: str, unit: str) -> Representation:
    """Return the representation by angles of a sequence in a unit."""
    numbered = [f"euler_{sequence}_{place}" for place in (1, 2, 3)]
    names = ("yaw", "pitch", "roll") if sequence == "zyx" else numbered

    def values(wxyz: Float64) -> Float64:
        angles = euler_angles(sequence, wxyz)
        return np.degrees(angles) if unit == "deg" else angles

    def attitudes(angles: Float64) -> Float64:
        return from_euler(sequence, np.radians(angles) if unit == "deg" else angles)

    lock_deg = (0, 180) if sequence[0] == sequence[2] else (-90, 90)
    columns = tuple(f"{name}_{unit}" for name in names)
    return Representation(columns, values, attitudes, lock_deg=lock_deg)


REPRESENTATIONS: Mapping[str, Representation] = {
    "rotvec": Representation(
        ("rotvec_x_rad", "rotvec_y_rad", "rotvec_z_rad"),
        lambda wxyz: log(normalize(wxyz)),
        exp,
        signed=True,
    ),
    **{f"euler-{sequence}": _euler(sequence, "rad") for sequence in EULER_SEQUENCES},
    **{f"euler-{sequence}-deg": _euler(sequence, "deg") for sequence in EULER_SEQUENCES},
    "matrix": Representation(
        tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)),
        lambda wxyz: rotation_matrix(normalize(wxyz)).reshape(-1, 9),
        from_matrices,
    ),
}
"""All representations besides quaternions; matrices are stored row by row."""
