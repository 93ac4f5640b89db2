"""Mounting of the sensor: rotations from sensor to body axes."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.errors import UsageError
from quatprop.kinematics.quaternion import (
    UNIT_TOLERANCE,
    exp,
    from_matrix,
    multiply,
    normalize,
    rotation_matrix,
)
from quatprop.text import quoted

if TYPE_CHECKING:
    from quatprop.arrays import Float64

AXES = {"x": 0, "y": 1, "z": 2}

_TURN = re.compile(r"(?P<axis>[xyz]):(?P<deg>[^,]+?)(deg)?")
"""A rotation about one axis."""


class FrameMounting(NamedTuple):
    """A mounting from the static transforms of a log.

    `matrix`: sensor axes to body axes, shape ``(3, 3)``
    `frames`: frames of the chain from the sensor's to the body's
    """

    matrix: Float64
    frames: tuple[str, ...]


NAMED = {
    "ned-to-enu": "y,x,-z",
    "enu-to-ned": "y,x,-z",
    "frd-to-flu": "x,-y,-z",
    "flu-to-frd": "x,-y,-z",
}
"""Name -> the old axes that become x, y and z."""


def mounting(text: str, what: str = "mounting") -> Float64:
    """Return the rotation matrix from sensor to body axes, or from other old to new axes.

    `text`: three signed old axes that become the new x, y and z, such as ``"x,-y,-z"``; a unit
        quaternion ``"W,X,Y,Z"`` with v_body = m v_sensor m*; fixed-axis angles ``"rpy:R,P,Y"``,
        deg, Rz(Y) Ry(P) Rx(R), as in URDF, or ``"y:30deg"`` about one axis; a key of :data:`NAMED`
    `what`: name of the rotation in errors
    `Returns`: rotation matrix, shape ``(3, 3)``: rate_body = M rate_sensor
    """
    old_to_new = {"mounting": "sensor axes to body axes"}.get(what, "old axes to new ones")
    word = text.strip().lower()
    if turn := _TURN.fullmatch(word):
        word = "rpy:" + ",".join(turn["deg"] if axis == turn["axis"] else "0" for axis in AXES)
    parts = [part.strip() for part in NAMED.get(word, word.removeprefix("rpy:")).split(",")]
    is_angles = word.startswith("rpy:")
    if (
        len(parts) == len(AXES)
        and not is_angles
        and {part.lstrip("+-") for part in parts} == set(AXES)
    ):
        axes = np.zeros((3, 3))
        for row, part in enumerate(parts):
            axes[row, AXES[part[-1]]] = -1.0 if part.startswith("-") else 1.0
        if np.linalg.det(axes) < 0:
            raise UsageError(
                f"the {what} {quoted(text)} is left-handed, so it is not a rotation; "
                "change one sign or swap two axes"
            )
        return axes
    numbers = np.zeros(0)
    with suppress(ValueError):
        numbers = np.array([float(part) for part in parts])
    if np.isfinite(numbers).all():
        if is_angles and numbers.shape == (3,):
            roll, pitch, yaw = exp(np.diag(np.radians(numbers)))
            return rotation_matrix(multiply(yaw, multiply(pitch, roll)))
        if numbers.shape in {(4,), (9,)} and numbers.any() and not is_angles:
            return _matrix(numbers, text, what)
    raise UsageError(
        f"{quoted(text)} is not a {what}; write three signed axes such as x,-y,-z, a quaternion "
        f"W,X,Y,Z that takes {old_to_new}, fixed-axis angles in deg such as rpy:0,30,0 "
        f"or y:30deg, "
        f"{', '.join(NAMED)}{', or tf:FRAME' if what == 'mounting' else ''}"
    )


def _matrix(numbers: Float64, text: str, what: str) -> Float64:
    """Return the rotation matrix of a quaternion, or of nine numbers."""
    wxyz = numbers
    if len(numbers) > len("wxyz"):
        matrix = numbers.reshape(3, 3)
        wxyz = from_matrix(matrix)
        if not np.abs(rotation_matrix(wxyz) - matrix).max() <= UNIT_TOLERANCE:
            raise UsageError(f"the {what} {quoted(text)} is not a rotation matrix")
    length = float(np.linalg.norm(wxyz))
    if abs(length - 1) > UNIT_TOLERANCE:
        raise UsageError(
            f"the {what} {quoted(text)} has the length {length:.6g}, so it is not a rotation; "
            "scale it to 1"
        )
    return rotation_matrix(normalize(wxyz))
