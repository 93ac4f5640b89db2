"""How the sensor is mounted: its axes in those of the body."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.errors import UsageError
from quatprop.kinematics.quaternion import UNIT_TOLERANCE, normalize, rotation_matrix
from quatprop.text import quoted

if TYPE_CHECKING:
    from quatprop.arrays import Float64

AXES = {"x": 0, "y": 1, "z": 2}


class FrameMounting(NamedTuple):
    """A mounting from the static transforms of a log.

    `matrix`: sensor axes to body axes, shape ``(3, 3)``
    `frames`: the frames on the way, from the sensor's to the body's
    """

    matrix: Float64
    frames: tuple[str, ...]


def mounting(text: str) -> Float64:
    """Return the matrix that takes sensor axes to body axes.

    `text`: three signed sensor axes that become the body's x, y and z, such as ``"x,-y,-z"``, or a
        unit quaternion ``"W,X,Y,Z"`` with v_body = m v_sensor m*
    `Returns`: rotation matrix, shape ``(3, 3)``: rate_body = M rate_sensor
    """
    parts = [part.strip().lower() for part in text.split(",")]
    if len(parts) == len(AXES) and {part.lstrip("+-") for part in parts} == set(AXES):
        axes = np.zeros((3, 3))
        for row, part in enumerate(parts):
            axes[row, AXES[part[-1]]] = -1.0 if part.startswith("-") else 1.0
        if np.linalg.det(axes) < 0:
            raise UsageError(
                f"the mounting {quoted(text)} is left-handed, so it is not a rotation; "
                "change one sign or swap two axes"
            )
        return axes
    wxyz = np.zeros(0)
    with suppress(ValueError):
        wxyz = np.array([float(part) for part in parts])
    if wxyz.shape != (4,) or not np.isfinite(wxyz).all() or not wxyz.any():
        raise UsageError(
            f"{quoted(text)} is not a mounting; write three signed axes such as x,-y,-z, "
            "a quaternion W,X,Y,Z that takes sensor axes to body axes, or tf:FRAME"
        )
    length = float(np.linalg.norm(wxyz))
    if abs(length - 1) > UNIT_TOLERANCE:
        raise UsageError(
            f"the mounting {quoted(text)} has the length {length:.6g}, so it is not a rotation; "
            "scale it to 1"
        )
    return rotation_matrix(normalize(wxyz))
