"""Other ways to write a rotation than a quaternion, and the way back.

Rotation vectors, angles about z, y and x, and matrices: each a set of columns whose names say what
is in them, and in which unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.kinematics.quaternion import exp, from_matrix, log, normalize, rotation_matrix

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    Float64 = NDArray[np.float64]

QUATERNION = "quaternion"
"""The representation that is not converted."""

NEAR_VERTICAL_DEG = 0.01
"""deg: closer to pitch +-90 degrees than this, yaw and roll are hardly distinguishable."""

_ROUNDING = 1e-12
_SKEWED = 0.5
"""A matrix whose columns are off orthonormal by more than this is no rotation at all."""


def euler_zyx(wxyz: Float64) -> Float64:
    """Return yaw, pitch and roll: q = q_z(yaw) q_y(pitch) q_x(roll).

    Yaw turns about z, pitch about the new y, roll about the newest x. From half sums and half
    differences of yaw and roll, which stay exact where the two cannot be distinguished (pitch of 90
    degrees); there they are shared equally.

    Parameters
    ----------
    wxyz
        Quaternions, shape ``(N, 4)``; their length does not matter.

    Returns
    -------
    ndarray
        Shape ``(N, 3)``, rad: yaw and roll from -pi to pi, pitch from -pi/2 to pi/2.

    References
    ----------
    Bernardes and Viollet, "Quaternion to Euler angles conversion", PLoS ONE 17(11), 2022.

    Examples
    --------
    >>> euler_zyx(np.array([[np.cos(0.1), 0, 0, np.sin(0.1)]])).round(15).tolist()
    [[0.2, 0.0, 0.0]]
    """
    w, x, y, z = wxyz.T
    half_sum = np.arctan2(x + z, w - y)
    half_difference = np.arctan2(z - x, w + y)
    pitch = 2 * np.arctan2(np.hypot(w + y, z - x), np.hypot(w - y, x + z)) - np.pi / 2
    yaw, roll = half_sum + half_difference, half_sum - half_difference
    return np.stack([_within_half_turn(yaw), pitch, _within_half_turn(roll)], axis=1)


def _within_half_turn(angle: Float64) -> Float64:
    wrapped: Float64 = angle - 2 * np.pi * np.rint(angle / (2 * np.pi))
    return wrapped


def from_euler_zyx(angles: Float64) -> Float64:
    """Return q = q_z(yaw) q_y(pitch) q_x(roll), for angles of any size.

    Parameters
    ----------
    angles
        Yaw, pitch and roll, shape ``(N, 3)``, rad.

    Returns
    -------
    ndarray
        Unit quaternions, shape ``(N, 4)``.

    Examples
    --------
    >>> from_euler_zyx(np.array([[np.pi, 0.0, 0.0]])).round(15).tolist()
    [[0.0, 0.0, 0.0, 1.0]]
    """
    (cz, cy, cx), (sz, sy, sx) = np.cos(angles.T / 2), np.sin(angles.T / 2)
    return np.stack(
        [
            cz * cy * cx + sz * sy * sx,
            cz * cy * sx - sz * sy * cx,
            cz * sy * cx + sz * cy * sx,
            sz * cy * cx - cz * sy * sx,
        ],
        axis=1,
    )


def from_matrices(rows: Float64) -> Float64:
    """Return the quaternions of rotation matrices, with w >= 0.

    What is no rotation is not made one: a matrix that is off orthonormal gives a quaternion whose
    length is off by as much, and one that is no rotation at all, or a reflection, gives NaN.

    Parameters
    ----------
    rows
        Matrices row by row, shape ``(N, 9)``.

    Returns
    -------
    ndarray
        Shape ``(N, 4)``; of unit length where the matrix is a rotation.
    """
    r = rows.reshape(-1, 3, 3)
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(r.transpose(0, 2, 1) @ r - np.eye(3)).max(axis=(1, 2), initial=0.0)
        reflected = np.linalg.det(r) < 0
        attitudes = from_matrix(r) * (1 + np.where(off > _ROUNDING, off, 0.0))[:, None]
    valid = (off <= _SKEWED) & ~reflected
    return np.where(valid[:, None], attitudes, np.nan)


def near_vertical(angles: Float64) -> int:
    """Return in how many rows yaw and roll cannot be distinguished: pitch is +-90 degrees.

    Parameters
    ----------
    angles
        Yaw, pitch and roll, shape ``(N, 3)``, rad.
    """
    return int(np.count_nonzero(np.abs(angles[:, 1]) > np.radians(90 - NEAR_VERTICAL_DEG)))


@dataclass(frozen=True, slots=True)
class Representation:
    """A way to write a rotation other than a quaternion.

    Parameters
    ----------
    columns
        Names of the columns, which say what is in them and in which unit.
    values
        From unit quaternions, shape ``(N, 4)``, to the columns, shape ``(N, k)``.
    attitudes
        From the columns to quaternions, of unit length where the columns are a rotation.
    signed
        Whether q and -q are written differently.
    singular
        Tells in how many rows the columns are not unique; None where they are or nearly are.
    """

    columns: tuple[str, ...]
    values: Callable[[Float64], Float64]
    attitudes: Callable[[Float64], Float64]
    signed: bool = False
    singular: Callable[[Float64], int] | None = None


def _rotation_vectors(wxyz: Float64) -> Float64:
    return log(normalize(wxyz))


def _matrices(wxyz: Float64) -> Float64:
    return rotation_matrix(normalize(wxyz)).reshape(-1, 9)


def _euler_degrees(wxyz: Float64) -> Float64:
    return np.degrees(euler_zyx(wxyz))


def _from_euler_degrees(angles: Float64) -> Float64:
    return from_euler_zyx(np.radians(angles))


def _near_vertical_degrees(angles: Float64) -> int:
    return near_vertical(np.radians(angles))


REPRESENTATIONS: Mapping[str, Representation] = {
    "rotvec": Representation(
        ("rotvec_x_rad", "rotvec_y_rad", "rotvec_z_rad"), _rotation_vectors, exp, signed=True
    ),
    "euler-zyx": Representation(
        ("yaw_rad", "pitch_rad", "roll_rad"), euler_zyx, from_euler_zyx, singular=near_vertical
    ),
    "euler-zyx-deg": Representation(
        ("yaw_deg", "pitch_deg", "roll_deg"),
        _euler_degrees,
        _from_euler_degrees,
        singular=_near_vertical_degrees,
    ),
    "matrix": Representation(
        tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)),
        _matrices,
        from_matrices,
    ),
}
"""Every representation besides quaternions; rows of a matrix follow one another."""
