"""Mistakes in rates: a scale, a bias, a steady drift."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.statistics import S_PER_H
from quatprop.comparison.undoing import Sides, Undoing, if_propagated, scaled, with_rates
from quatprop.kinematics.quaternion import conjugate, exp, log, multiply, rotate, shorter
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.text import Setting
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64
    from quatprop.comparison.alignment import Alignment

RATES = (
    *("", "rate bias", "scale", "biased scale and rate bias"),
    *("drift in body", "drift in reference"),
)
"""What may be undone in rates, beside the rule by which they are integrated."""


def rate_mistake(
    kind: str, sides: Sides, alignment: Alignment, sensor: Float64 | None
) -> Undoing | None:
    """Return a mistake in rates, if they show it.

    `sensor`: the matrix by which A's rates are turned after their bias is subtracted
    """
    if kind == "rate bias":
        return rate_bias(sides, alignment.mount_wxyz, sensor)
    if kind.endswith("scale"):
        return scale(sides, alignment.mount_wxyz, biased=kind.startswith("biased"))
    return drift(sides, alignment, kind.removeprefix("drift in "))


SCALES = {
    2.0: (": a factor 1/2 is missing in one of them", ""),
    180 / np.pi: (
        ": one of them took degrees for radians",
        f" (see {Setting('rate_unit', 'rad/s|deg/s')})",
    ),
}
"""Ratio of rates -> the mistake that gives it, and the setting."""

SCALE_TOLERANCE = 0.03
"""Relative difference from such a ratio; gyroscopes are not calibrated much better."""

MIN_WINDOWS = 100
"""Windows of which rates are compared, about."""


MIN_CORRELATION = 0.5
"""Correlation of rates, less their means, below which they do not show a ratio."""

MAX_UNSHOWN = 1.5
"""Ratio, at most, of rates that hardly vary."""


def scale(sides: Sides, mount: Float64, *, biased: bool) -> Undoing | None:
    """Return the ratio of rates; `biased`: whatever constant rate there is besides."""
    of_a, of_b, seconds = _steps(sides, mount)
    stride = max(len(of_a) // MIN_WINDOWS, 1)
    first = np.arange(0, len(of_a), stride)
    y, x, time = (np.add.reduceat(each, first) for each in (of_a, of_b, seconds))
    varying = [each - time * each.sum(axis=0) / time.sum() for each in (y, x)]
    sizes = [float((each * each).sum()) for each in varying]
    common = float((varying[0] * varying[1]).sum())
    shows = common > MIN_CORRELATION * math.sqrt(math.prod(sizes))
    if biased:
        y, x = varying
    # A's rates have the noise of a gyroscope, and B's attitudes any: it is in no square.
    power, shared = float((y * y).sum()), float((x * y).sum())
    if not power > 0 or not shared > 0:
        return None
    factor = float(f"{shared / power:.6g}")
    ratio = max(factor, 1 / factor)
    # Of a gyroscope at rest, the bias is not the motion on another scale.
    if not shows and ratio > MAX_UNSHOWN:
        return None
    near = (SCALES[named] for named in SCALES if abs(ratio / named - 1) < SCALE_TOLERANCE)
    meaning, where = next(near, ("", ""))
    return Undoing(
        "scale",
        f"rates that differ by a factor of {ratio:.6g}",
        f"B turns {factor:.6g} times as fast as A{meaning}",
        scaled(factor) + where,
        with_rates(factor),
    )


MAX_BIAS = np.radians(20.0)
"""rad/s: no common gyroscope has a larger bias."""


def rate_bias(sides: Sides, mount: Float64, sensor: Float64 | None) -> Undoing | None:
    """Return the constant rate that one has more than the other."""
    of_a, of_b, seconds = _steps(sides, mount)
    bias = (of_a - of_b).sum(axis=0) / seconds.sum()
    if np.linalg.norm(bias) > MAX_BIAS:
        return None
    of_a = bias if sensor is None else sensor.T @ bias
    biases = [",".join(_figures(each, 9)) for each in (of_a, rotate(mount, -bias))]
    return Undoing(
        "rate bias",
        "a constant rate between them",
        f"B's body rates are larger than A's by a constant {', '.join(_deg_h(-bias, 4))} deg/h",
        f"{if_propagated('bias', *biases)}, in rad/s, beside any other",
        with_rates(1.0, bias),
    )


def _deg_h(rate: Float64, digits: int) -> list[str]:
    return _figures(np.degrees(rate) * S_PER_H, digits)


def _figures(values: Float64, digits: int) -> list[str]:
    """Return numbers as text; those that are zero but for rounding are zero."""
    least = 1e-9 * float(np.abs(values).max())
    return [f"{value if abs(value) > least else 0.0:.{digits}g}" for value in values]


def _steps(sides: Sides, mount: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the rotations from pair to pair of A and of B, in A's body axes, and their times."""
    of_b = rotate(conjugate(mount), rotation_vectors_between(sides.b.wxyz))
    return rotation_vectors_between(sides.a.wxyz), of_b, np.diff(sides.a.t_ns)[:, None] / NS_PER_S


MAX_RAMP = 2.0
"""Error, rad, up to which its rotation vector is proportional to the drift."""


def drift(sides: Sides, alignment: Alignment, frame: str) -> Undoing | None:
    """Return an error that grows at a constant rate about an axis fixed in a frame of B."""
    body, aligned = frame == "body", alignment.apply(sides.b.wxyz)
    between = (conjugate(sides.a.wxyz), aligned) if body else (aligned, conjugate(sides.a.wxyz))
    vectors = log(shorter(multiply(*between)))
    if np.abs(vectors).max() > MAX_RAMP:
        return None
    seconds = (sides.a.t_ns - sides.a.t_ns[0]) / NS_PER_S
    design = np.stack([np.ones_like(seconds), seconds], axis=1)
    (_, slope), *_ = np.linalg.lstsq(design, vectors, rcond=None)
    if body:
        slope = rotate(alignment.mount_wxyz, slope)
    else:
        slope = rotate(conjugate(alignment.reference_wxyz), slope)

    def apply(sides: Sides) -> Sides:
        since = (sides.b.t_ns - sides.b.t_ns[0])[:, None] / NS_PER_S
        back = exp(-since * slope)
        q = sides.b.wxyz
        return sides._replace(
            b=replace(sides.b, wxyz=multiply(q, back) if body else multiply(back, q))
        )

    size = math.degrees(float(np.linalg.norm(slope))) * S_PER_H
    return Undoing(
        "drift",
        f"a steady drift of {size:.4g} deg/h in the {frame} frame",
        f"B drifts away at a steady {size:.6g} deg/h about an axis fixed in the {frame} frame",
        f"turn B back by {', '.join(_deg_h(slope, 6))} deg/h about the axes x, y, z of its "
        f"{frame} frame",
        apply,
    )
