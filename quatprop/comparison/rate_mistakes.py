"""Mistakes in rates: a scale, a bias, a steady drift."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.mistakes import (
    Mistake,
    Sides,
    rates_changed,
    remedy_if_propagated,
    scaling_remedy,
)
from quatprop.comparison.statistics import S_PER_H
from quatprop.kinematics.quaternion import conjugate, exp, log, multiply, rotate, shorter
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.text import Setting
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64
    from quatprop.comparison.alignment import Alignment

RATES = (
    *("", "rate bias", "nominal scale", "scale", "biased scale and rate bias"),
    *("drift in body", "drift in reference"),
)
"""Mistakes in rates, beside the integration rule."""


def rate_mistake(
    kind: str, sides: Sides, alignment: Alignment, sensor: Float64 | None
) -> Mistake | None:
    """Return a mistake in rates, or None if the rates do not show it.

    `sensor`: matrix that rotates A's rates after the bias is subtracted
    """
    if kind == "rate bias":
        return rate_bias(sides, alignment.mount_wxyz, sensor)
    if kind.endswith("scale"):
        return scale(sides, alignment.mount_wxyz, kind)
    return drift(sides, alignment, kind.removeprefix("drift in "))


SCALES = {
    2.0: (": a factor 1/2 is missing in one of them", ""),
    180 / np.pi: (
        ": one of them took degrees for radians",
        f" (see {Setting('rate_unit', 'rad/s|deg/s')})",
    ),
}
"""Ratio of rates -> its reason, and the setting."""

SCALE_TOLERANCE = 0.01
"""Relative tolerance of such a ratio: gyroscopes are not calibrated much better."""

NEAR_NOMINAL = 0.1
"""The same for trying the exact ratio: if a body turns fast, the estimated one is poor."""

MIN_WINDOWS = 100
"""Approximate number of windows over which rates are compared."""

MIN_CORRELATION = 0.5
"""Minimum correlation of the varying parts of rates that shows a ratio."""

MAX_UNSHOWN = 1.5
"""Maximum ratio of rates without this correlation."""


def scale(sides: Sides, mount: Float64, kind: str) -> Mistake | None:
    """Return the ratio of rates.

    `kind`: ``"biased scale"``: apart from a constant rate; ``"nominal scale"``: one of
        :data:`SCALES`; else ``"scale"``
    """
    of_a, of_b, seconds = _steps(sides, mount)
    stride = max(len(of_a) // MIN_WINDOWS, 1)
    first = np.arange(0, len(of_a), stride)
    y, x, time = (np.add.reduceat(each, first) for each in (of_a, of_b, seconds))
    varying = [each - time * each.sum(axis=0) / time.sum() for each in (y, x)]
    sizes = [float((each * each).sum()) for each in varying]
    common = float((varying[0] * varying[1]).sum())
    shows = common > MIN_CORRELATION * math.sqrt(math.prod(sizes))
    if kind == "biased scale":
        y, x = varying
    # Regression on A's rates: B's noise may be large, and its power would bias the ratio.
    power, shared = float((y * y).sum()), float((x * y).sum())
    if not power > 0 or not shared > 0:
        return None
    factor = float(f"{shared / power:.6g}")
    ratio = max(factor, 1 / factor)
    # The bias of a gyroscope at rest is no scaled motion.
    if factor == 1 or (not shows and ratio > MAX_UNSHOWN):
        return None
    is_nominal = kind == "nominal scale"
    tolerance = NEAR_NOMINAL if is_nominal else SCALE_TOLERANCE
    near = [named for named in SCALES if abs(ratio / named - 1) < tolerance]
    if is_nominal:
        if not near:
            return None
        ratio, factor = near[0], near[0] if factor > 1 else 1 / near[0]
    meaning, where = SCALES[near[0]] if near else ("", "")
    return Mistake(
        "scale",
        f"rates that differ by a factor of {ratio:.6g}",
        f"B turns {factor:.6g} times as fast as A{meaning}",
        scaling_remedy(factor) + where,
        rates_changed(factor),
    )


MAX_BIAS = np.radians(20.0)
"""Maximum bias, rad/s: no common gyroscope has a larger one."""


def rate_bias(sides: Sides, mount: Float64, sensor: Float64 | None) -> Mistake | None:
    """Return the constant difference of the rates."""
    of_a, of_b, seconds = _steps(sides, mount)
    bias = (of_a - of_b).sum(axis=0) / seconds.sum()
    if np.linalg.norm(bias) > MAX_BIAS:
        return None
    of_a = bias if sensor is None else sensor.T @ bias
    biases = [",".join(_figures(each, 9)) for each in (of_a, rotate(mount, -bias))]
    return Mistake(
        "rate bias",
        "a constant rate between them",
        f"B's body rates are larger than A's by a constant {', '.join(_deg_h(-bias, 4))} deg/h",
        f"{remedy_if_propagated('bias', *biases)}, in rad/s, in addition to any other",
        rates_changed(1.0, bias),
    )


def _deg_h(rate: Float64, digits: int) -> list[str]:
    return _figures(np.degrees(rate) * S_PER_H, digits)


def _figures(values: Float64, digits: int) -> list[str]:
    """Return numbers as text; rounding errors are zero."""
    least = 1e-9 * float(np.abs(values).max())
    return [f"{value if abs(value) > least else 0.0:.{digits}g}" for value in values]


def _steps(sides: Sides, mount: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the rotations of A and B between pairs, in A's body axes, and the intervals, s."""
    of_b = rotate(conjugate(mount), rotation_vectors_between(sides.b.wxyz))
    return rotation_vectors_between(sides.a.wxyz), of_b, np.diff(sides.a.t_ns)[:, None] / NS_PER_S


MAX_RAMP = 2.0
"""Maximum error, rad, for which its rotation vector is about proportional to time."""


def drift(sides: Sides, alignment: Alignment, frame: str) -> Mistake | None:
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

    def undo(sides: Sides) -> Sides:
        since = (sides.b.t_ns - sides.b.t_ns[0])[:, None] / NS_PER_S
        back = exp(-since * slope)
        q = sides.b.wxyz
        return sides._replace(
            b=replace(sides.b, wxyz=multiply(q, back) if body else multiply(back, q))
        )

    size = math.degrees(float(np.linalg.norm(slope))) * S_PER_H
    return Mistake(
        "drift",
        f"a steady drift of {size:.4g} deg/h in the {frame} frame",
        f"B drifts away at a steady {size:.6g} deg/h about an axis fixed in the {frame} frame",
        f"turn B back by {', '.join(_deg_h(slope, 6))} deg/h about the axes x, y, z of its "
        f"{frame} frame",
        undo,
    )
