"""Mistakes in rates: a scale, a bias, a steady drift."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.rendering import decimals_of
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.comparison.association import interval_ns, shifted
from quatprop.comparison.clock_offset import ClockError, clock_errors
from quatprop.comparison.mistakes import (
    Mistake,
    Sides,
    rates_changed,
    remedy_if_propagated,
    scaling_remedy,
)
from quatprop.comparison.statistics import S_PER_H
from quatprop.kinematics.propagate import rotation_vectors_between
from quatprop.kinematics.quaternion import conjugate, exp, log, multiply, rotate, shorter

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64
    from quatprop.comparison.alignment import Alignment


RATES = (
    *("", "rate bias", "nominal scale", "scale", "biased scale and rate bias"),
    *("drift in body", "drift in reference"),
)
"""Mistakes in rates, apart from the integration rule."""


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
    # The bias of a gyroscope at rest is not a scaled motion.
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
    biases = [",".join(_figures(each, 9)) + "rad/s" for each in (of_a, rotate(mount, -bias))]
    return Mistake(
        "rate bias",
        "a constant rate between them",
        f"B's body rates minus A's are a constant {', '.join(_deg_h(-bias, 4))} deg/h",
        f"{remedy_if_propagated('bias', *biases)}, in addition to any other",
        rates_changed(1.0, bias),
    )


def _deg_h(rate: Float64, digits: int) -> list[str]:
    return _figures(np.degrees(rate) * S_PER_H, digits)


def _figures(values: Float64, digits: int) -> list[str]:
    """Return numbers as text; rounding errors are zero."""
    least = 1e-9 * float(np.abs(values).max())
    return [f"{value if abs(value) > least else 0.0:.{digits}g}" for value in values]


def _steps(sides: Sides, mount: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the rotations between pairs in A's body axes, and the intervals, s."""
    of_a, of_b, seconds = sides.steps()
    return of_a, rotate(conjugate(mount), of_b), seconds


MAX_RAMP = 2.0
"""Maximum error, rad, for which its rotation vector is about proportional to time."""


def drift(sides: Sides, alignment: Alignment, frame: str) -> Mistake | None:
    """Return an error that grows at a constant rate about an axis fixed in a frame of B."""
    body, aligned = frame == "body", alignment.apply(sides.b.wxyz)
    to_a = conjugate(sides.mended(alignment.mount_wxyz).a.wxyz)
    between = (to_a, aligned) if body else (aligned, to_a)
    vectors = log(shorter(multiply(*between)))
    if np.abs(vectors).max() > MAX_RAMP:
        return None
    intervals = np.diff(sides.a.t_ns) / NS_PER_S
    if sides.crossing is not None:
        intervals[sides.crossing] = 0.0
    seconds = np.append(0.0, np.cumsum(intervals))
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
        f"B drifts away at a steady {size:.4g} deg/h about an axis fixed in the {frame} frame",
        f"turn B back by {', '.join(_deg_h(slope, 6))} deg/h about the axes x, y, z of its "
        f"{frame} frame",
        undo,
    )


# Mistakes in timestamps: an offset and a drift of B's clock.


SIGNIFICANT = 5.0
"""A clock drift is significant above this many standard deviations."""


def clock_mistakes(
    sides: Sides, begin_ns: int, coarse_ns: int, given_ns: int, *, turned: bool
) -> tuple[Mistake | None, Mistake | None]:
    """Return the offset and the drift of B's clock, each None if the motion does not show it.

    `begin_ns`: first timestamp of all of B, ns
    `coarse_ns`: approximate offset, ns
    `given_ns`: time already added to B's timestamps, ns
    `turned`: whether the body frames may differ
    """
    found = clock_errors(sides.a, sides.b, coarse_ns, turned=turned)
    if found is None:
        return None, None
    offset, change, first_ns = found
    return (
        _offset(offset, coarse_ns, given_ns, interval_ns(sides.a))
        if math.isfinite(offset.std)
        else None,
        _clock_drift(change, coarse_ns, begin_ns, first_ns)
        if abs(change.ratio) > SIGNIFICANT * change.std
        else None,
    )


MAX_DRIFT = 0.01
"""Maximum drift of a clock: that of the worst crystal is far smaller."""


def drift_by_errors(sides: Sides, alignment: Alignment) -> Mistake | None:
    """Return the drift of B's clock that fits the errors best, whether or not it is significant.

    `sides`: with equal timestamps
    """
    a, b, _ = sides.mended(alignment.mount_wxyz)
    error = log(shorter(multiply(conjugate(a.wxyz), alignment.apply(b.wxyz))))
    seconds = (a.t_ns - a.t_ns[0])[:, None] / NS_PER_S
    rate = np.gradient(np.cumsum(rotation_vectors_between(a.wxyz), axis=0), seconds[1:, 0], axis=0)
    # A delay makes an error of rate times delay.
    design = np.stack([rate.ravel(), (rate * seconds[1:]).ravel()], axis=1)
    (offset, ratio), *_ = np.linalg.lstsq(design, error[1:].ravel(), rcond=None)
    if abs(ratio) > MAX_DRIFT:
        return None
    first_ns = int(a.t_ns[0])
    clock = ClockError(offset, ratio, 0.0, 0.0, 0.0, float(seconds[-1, 0]))
    return _clock_drift(clock, 0, first_ns, first_ns)


NEAR_INTERVAL = 0.02
"""Tolerance of an offset of one interval or half, as a share of the interval."""


def _offset(clock: ClockError, coarse_ns: int, given_ns: int, interval_ns: int) -> Mistake:
    offset_ns = coarse_ns + round(clock.seconds * NS_PER_S)
    late = "late" if offset_ns < 0 else "early"
    amount = _rounded(abs(offset_ns), round(clock.std * NS_PER_S))
    sentence = f"B is {amount} {late}"
    for share, text in ((0.5, "half a sampling interval"), (1.0, "one sampling interval")):
        if abs(abs(offset_ns) / interval_ns - share) <= NEAR_INTERVAL:
            sentence += f" ({text} of A: a clock offset, or another integration rule)"
    setting = Setting("time_offset", f"{(offset_ns + given_ns) / 1e6:.9g}ms")
    return Mistake(
        "time offset",
        f"a time offset of {duration_text(abs(offset_ns))}",
        sentence,
        f"{setting} removes it",
        lambda sides: sides._replace(b=shifted(sides.b, offset_ns)),
    )


def _clock_drift(clock: ClockError, coarse_ns: int, begin_ns: int, first_ns: int) -> Mistake:
    """`first_ns`: origin of the times of the clock error, ns."""
    at_first = np.array((begin_ns - first_ns + coarse_ns) / NS_PER_S)
    # The error of the clock is a function of A's time, the correction a function of B's.
    of_b = 1 / (1 - clock.ratio)
    first_ms = 1e3 * of_b * float(clock.at(at_first)) + coarse_ns / 1e6
    ratio = of_b * clock.ratio
    ppm, std = abs(clock.ratio) * 1e6, max(clock.std * 1e6, 0.01)
    digits = decimals_of(std)
    pace = "slow" if clock.ratio > 0 else "fast"
    moved, span = (
        duration_text(round(value * NS_PER_S))
        for value in (round(abs(clock.ratio) * clock.span, 4), round(clock.span, 1))
    )

    def undo(sides: Sides) -> Sides:
        added = np.rint(first_ms * 1e6 + ratio * (sides.b.t_ns - begin_ns)).astype(np.int64)
        return sides._replace(b=shifted(sides.b, added))

    return Mistake(
        "clock drift",
        f"clocks that differ by {float(f'{ppm:.3g}'):g} ppm",
        f"B's clock is {pace} by {ppm:.{digits}f} +- {std:.{digits}f} ppm against A's: the offset "
        f"between their timestamps changes by {moved} in {span}",
        f"add {first_ms:.6g} ms to B's timestamps, and {ratio * 1e6:.6g} ppm of the time "
        "since its first",
        undo,
    )


def _rounded(amount_ns: int, std_ns: int) -> str:
    """Return a duration with its uncertainty to two digits."""
    if not std_ns or std_ns * 1_000_000 < amount_ns:
        return duration_text(amount_ns)
    digits = max(len(str(std_ns)) - 2, 0)
    amount, std = (duration_text(round(value, -digits)) for value in (amount_ns, std_ns))
    return f"{amount} +- {std}"
