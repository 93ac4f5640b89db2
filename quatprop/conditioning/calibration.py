"""Calibration of a gyroscope: scale factors, misalignment and bias, read from a file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.settings.yaml_file import read_yaml, unusable
from quatprop.text import did_you_mean, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from quatprop.arrays import Float64


_unusable = partial(unusable, "calibration")

LARGEST_CONDITION = 1e3
"""A matrix with a larger condition number is no calibration: it loses a direction."""

OWN_KEYS = ("matrix", "bias")
"""Keys of a file in our own form."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """How calibrated rates follow from raw ones: w = M (w_raw - b).

    Parameters
    ----------
    matrix
        M: scale factors, misalignment and the rotation to the axes of the sensor, ``(3, 3)``;
        None for the identity.
    bias_rad_s
        b, in the axes of the raw rates, shape ``(3,)``, rad/s; None where the file has none.
    remarks
        What of the file is not applied.
    """

    matrix: Float64 | None = None
    bias_rad_s: Float64 | None = None
    remarks: tuple[str, ...] = ()


def read_calibration(path: Path | str, topic: str = "") -> Calibration:
    """Read a calibration.

    Parameters
    ----------
    path
        YAML or JSON: ``matrix``, three rows of three numbers, and perhaps ``bias``, three numbers
        in rad/s. Or what kalibr writes of an IMU with its model ``scale-misalignment``.
    topic
        Which IMU to take of several that kalibr has calibrated, by its topic.

    Raises
    ------
    UsageError
        The file cannot be read, or holds no calibration that can be applied.

    References
    ----------
    kalibr, ``IccSensors.py``, IccScaledMisalignedImu: the measured rate is
    M C_gyro_i w + A C_gyro_i a + b.
    """
    content = _imu(path, read_yaml("calibration", path), topic)
    if "matrix" in content:
        for key in map(str, content):
            if key not in OWN_KEYS:
                raise _unusable(path, f"no key {quoted(key)}{did_you_mean(key, OWN_KEYS)}")
        bias = content.get("bias")
        return Calibration(
            _matrix(path, "matrix", content["matrix"]),
            None if bias is None else _numbers(path, "bias", bias, (3,)),
        )
    gyroscopes = content.get("gyroscopes")
    if not (isinstance(gyroscopes, dict) and "M" in gyroscopes):
        raise _unusable(
            path,
            "it holds no calibration; write matrix: [[...], [...], [...]] and bias: [x, y, z], "
            "or take kalibr's file with gyroscopes: M",
        )
    turn = _numbers(path, "C_gyro_i", gyroscopes.get("C_gyro_i", np.eye(3)), (3, 3))
    measured = _matrix(path, "M", gyroscopes["M"]) @ turn
    by_force = _numbers(path, "A", gyroscopes.get("A", np.zeros((3, 3))), (3, 3))
    uncorrected = (
        f"{plain(path)}: the effect of acceleration on the rates (A of kalibr) is not corrected"
    )
    inverse = np.linalg.inv(_checked(path, "M C_gyro_i", measured)).astype(np.float64)
    return Calibration(inverse, None, (uncorrected,) if by_force.any() else ())


def _imu(path: Path | str, content: Mapping[str, object], topic: str) -> Mapping[str, object]:
    """Return the part of a file that is about one IMU: imu0, imu1... of kalibr, or all of it."""
    imus = {
        name: part
        for name, part in content.items()
        if isinstance(part, dict) and str(name).startswith("imu")
    }
    if len(imus) > 1:
        ours = {name: part for name, part in imus.items() if part.get("rostopic") == topic}
        if len(ours) != 1:
            raise _unusable(
                path,
                f"it has several IMUs ({listed(imus)}), and none with rostopic {quoted(topic)}",
            )
        imus = ours
    return next(iter(imus.values()), content)


def _matrix(path: Path | str, name: str, value: object) -> Float64:
    return _checked(path, name, _numbers(path, name, value, (3, 3)))


def _checked(path: Path | str, name: str, matrix: Float64) -> Float64:
    """Return a matrix that can be inverted, or refuse it."""
    condition = float(np.linalg.cond(matrix)) if matrix.any() else np.inf
    if not condition <= LARGEST_CONDITION:
        raise _unusable(
            path, f"{name} is singular (condition number {condition:.3g}), so it is no calibration"
        )
    if np.linalg.det(matrix) < 0:
        raise _unusable(path, f"{name} mirrors the axes (its determinant is negative)")
    return matrix


def _numbers(path: Path | str, name: str, value: object, shape: tuple[int, ...]) -> Float64:
    """Return finite numbers of a shape, or refuse them."""
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        what = "three rows of three numbers" if len(shape) > 1 else "three numbers"
        raise _unusable(path, f"{name} is not {what}")
    return numbers
