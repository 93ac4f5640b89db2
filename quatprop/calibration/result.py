"""An estimated calibration: the values, how certain they are, and what they improve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from quatprop.calibration.settings import GROUPS
from quatprop.rendering import degrees_text, lines_of
from quatprop.times import duration_text
from quatprop.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator
    from os import PathLike

    from quatprop.arrays import Float64
    from quatprop.rendering import Row
    from quatprop.text import Remark

SIGNIFICANT = 2.0
"""Standard deviations by which an improvement must differ from none."""


class CalibrationParameter(NamedTuple):
    """One number that was asked for.

    `group`, `axis`: such as ``"scale"`` and ``"x"``; the mounting is a rotation vector
    `value`: rad/s, a ratio, rad or s
    `sigma`: its standard deviation; None where the motion does not show it, and it was held
    """

    group: str
    axis: str
    value: float
    sigma: float | None


@dataclass(frozen=True, slots=True, eq=False)
class GyroCalibration:
    """A calibration of a gyroscope, estimated from a reference attitude.

    Calibrated rates are w = M (w_raw - b), with M = R (I + U): the scale corrections are the
    diagonal of U, those of misalignment the elements above it, and R is the mounting.

    Parameters
    ----------
    matrix
        M, shape ``(3, 3)``: raw rates to body axes.
    bias_rad_s
        b, shape ``(3,)``, rad/s, in the axes of the raw rates.
    mount_wxyz
        R as a unit quaternion, scalar first, v_body = m v_sensor m*, shape ``(4,)``.
    time_offset_ns
        What is to be added to the timestamps of the reference in its middle, ns.
    clock_drift
        What more is to be added, as a share of the time since its middle.
    parameters
        What was asked for, with its standard deviation; None where the motion does not show it.
    covariance
        Of the parameters that have a standard deviation, in their order; SI units.
    window_ns
        Length of the windows over which rotations were compared, ns.
    used
        Number of windows from which the parameters were estimated.
    outliers
        Number of further ones that were left out, since the reference jumps there.
    held_out
        Number of windows that were kept for the two errors.
    before_rad, after_rad
        RMS error of the rotations over those, as given and calibrated, rad.
    gain_sigma_rad
        Standard deviation of the difference of these two, rad.
    remarks
        What else a reader should know.
    """

    matrix: Float64
    bias_rad_s: Float64
    mount_wxyz: Float64
    time_offset_ns: int
    clock_drift: float
    parameters: tuple[CalibrationParameter, ...]
    covariance: Float64
    window_ns: int
    used: int
    outliers: int
    held_out: int
    before_rad: float
    after_rad: float
    gain_sigma_rad: float
    remarks: tuple[Remark, ...] = ()

    def __str__(self) -> str:
        return "\n".join(lines_of(calibration_rows(self), width=12))

    @property
    def is_better(self) -> bool:
        """Whether the error over windows that were not used falls by more than two sigma."""
        return self.before_rad - self.after_rad > SIGNIFICANT * self.gain_sigma_rad

    def write(self, path: str | PathLike[str]) -> None:
        """Write matrix and bias to a file, as `calibration` of :func:`quatprop.propagate` takes it.

        Parameters
        ----------
        path
            Where; YAML. It is replaced when the new content is complete.

        Raises
        ------
        QuatpropError
            The path is not writable.
        """
        from quatprop.writers.atomic import open_atomic

        rows = [f"  - {list(map(float, row))}" for row in self.matrix]
        lines = [
            f"# quatprop {__version__}: rate = matrix (raw - bias), rad/s, body axes",
            *(f"# {label:<12} {value}" for label, value in calibration_rows(self)),
            "matrix:",
            *rows,
            f"bias: {list(map(float, self.bias_rad_s))}",
        ]
        with open_atomic(str(path)) as file:
            file.write("".join(f"{line}\n" for line in lines).encode())


def calibration_rows(result: GyroCalibration) -> Iterator[Row]:
    """Yield the parameters, what they were estimated from, and what they improve."""
    left_out = f", {result.outliers} more left out as outliers" if result.outliers else ""
    yield "windows", f"{result.used} of {duration_text(result.window_ns)}{left_out}"
    held = []
    for name, group in GROUPS.items():
        values = []
        for _, axis, value, sigma in (one for one in result.parameters if one.group == name):
            if sigma is None:
                held.append(f"{name} {axis}".rstrip())
            else:
                # Two digits of the standard deviation show.
                size = group.factor * sigma
                digits = min(max(1 - math.floor(math.log10(size)), 0), 9)
                values.append(f"{axis} {group.factor * value:+.{digits}f} +- {size:.2g}".lstrip())
        if values:
            yield name, f"{'  '.join(values)} {group.unit}"
    if held:
        yield "held", f"{', '.join(held)}: this motion does not show it, so it is not corrected"
    before, after = (degrees_text(angle, 4) for angle in (result.before_rad, result.after_rad))
    yield (
        "error",
        f"{before} RMS before, {after} after, over {result.held_out} windows kept for validation",
    )
    gain = degrees_text(result.before_rad - result.after_rad, 3)
    nothing = "" if result.is_better else ": nothing is to be gained"
    yield "improvement", f"{gain} +- {degrees_text(result.gain_sigma_rad, 2)}{nothing}"
