"""Defects that no setting can correct: dead axes, and motion lost in gaps or at a rate limit.

Lost motion is only reported if replacing it by that of the other series removes most of the error.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.alignment import align, aligned_rms, rms_between
from quatprop.comparison.association import associate
from quatprop.comparison.cause import NO_ERROR
from quatprop.comparison.mistakes import recomposed
from quatprop.comparison.windows import body_angle, common_beginning, over_gap
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.rendering import degrees_text
from quatprop.series import AttitudeSeries
from quatprop.text import Remark
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Bool, Float64
    from quatprop.comparison.settings import ComparisonSettings

WINDOWS = 100
"""Approximate number of windows over which rotations are compared, long enough to average noise."""

MIN_TURN = np.radians(1.0)
"""Minimum RMS rotation over windows about each principal axis, rad, of motion about all three."""

MIN_SHARE = 0.05
"""The same, as a share of the largest of the three."""

DEAD = 1e-6
"""Share of the largest variation below which a rate is constant but for rounding."""

NOISE_FACTOR = 2.0
"""Rotations over n samples above this many times sqrt(n) of those over one are not noise."""

AT_LIMIT = 1e-3
"""Tolerance of rates at a limit, as a share of the range of their magnitudes."""

MIN_AT_LIMIT = 0.04
"""Minimum share of samples at a limit; for a sine, it is 0.03."""

MAX_SHARE = 0.5
"""Maximum share of the error that remains when lost motion is replaced."""


def defects(
    a: AttitudeSeries, b: AttitudeSeries, settings: ComparisonSettings
) -> tuple[Remark, ...]:
    """Return remarks on defects that no setting can correct."""
    dead = tuple(dead_axes(a, b))
    # Gaps between the time ranges to judge are not gaps of the series.
    return dead if dead or settings.judge else tuple(_lost_motion(a, b, settings))


def _lost_motion(
    a: AttitudeSeries, b: AttitudeSeries, settings: ComparisonSettings
) -> Iterator[Remark]:
    """Yield gaps and rate limits that cause most of the error."""
    pairs = associate(a, b, settings)
    name = "mount" if settings.align == "mount" else "mean"
    ours, theirs = pairs.a, align(name, pairs.a, pairs.b).apply(pairs.b)
    before = rms_between(ours, theirs)
    if before <= max(NO_ERROR, MAX_SHARE * aligned_rms(settings.align, pairs.a, pairs.b)):
        return  # most of the error comes from different frames
    seconds = np.diff(pairs.t_ns)[:, None] / NS_PER_S
    for of, series, own, other in (("A", a, ours, theirs), ("B", b, theirs, ours)):
        steps, true_steps = rotation_vectors_between(own), rotation_vectors_between(other)
        for lost, where in (
            (
                over_gap(series.t_ns, pairs.t_ns[:-1], pairs.t_ns[1:])[:, None],
                "in gaps of its timestamps",
            ),
            (_at_limit(steps / seconds), "while its rates are at a limit"),
        ):
            mended = recomposed(
                AttitudeSeries(pairs.t_ns, own), np.where(lost, true_steps, steps)
            ).wxyz
            left = aligned_rms("mean", mended, other)
            # Even an error that occurs all the time falls by the share of steps that is replaced.
            if left <= MAX_SHARE * before * (1 - float(lost.mean(axis=0).max())):
                share = f"{float(lost.any(axis=1).mean()):.2%}"
                yield Remark(
                    "motion-lost",
                    f"{of} loses motion {where}, in {share} of the steps: with the motion of the "
                    f"other there, the RMS error with aligned frames is {degrees_text(left, 4)} "
                    f"in place of {degrees_text(before, 4)}",
                )


def _at_limit(rate: Float64) -> Bool:
    """Return which rates are at the limit of their axis, shape ``(N - 1, 3)``."""
    sizes = np.abs(rate)
    at_limit = sizes >= sizes.max(axis=0) - AT_LIMIT * np.ptp(sizes, axis=0)
    return np.asarray(at_limit & (at_limit.mean(axis=0) >= MIN_AT_LIMIT))


def dead_axes(a: AttitudeSeries, b: AttitudeSeries) -> Iterator[Remark]:
    """Yield a remark if one series turns about all axes and the other has constant rates."""
    both = zip("AB", common_beginning(a, b), strict=True)
    spreads = {name: _spreads(series) for name, series in both}
    for name, other in (("A", "B"), ("B", "A")):
        own, whole = spreads[name][0], spreads[other][1]
        axes = [axis for axis, spread in zip("xyz", own, strict=True) if spread <= DEAD * whole[-1]]
        least = whole[-1] if len(axes) == len(own) else whole[0]
        if not least > max(MIN_TURN, MIN_SHARE * whole[-1]):
            continue
        if axes:
            text = f"the rate of {name} about its {' and '.join(axes)} axis never changes, and "
            text += f"{other} turns about all three: are rates missing?"
            if len(axes) == len(own):
                text = (
                    f"the rate of {name} never changes, and the rate of {other} does: is one dead?"
                )
            yield Remark("dead-axis", text)


def _spreads(series: AttitudeSeries) -> tuple[Float64, Float64]:
    """Return the RMS rotations between samples about the body axes, less the mean rate, rad.

    The second result is over windows about the principal axes, smallest first; 0 if it is noise.
    """
    seconds, angle = body_angle(series, int(series.t_ns[0]))
    span = max(float(seconds[-1]), 1e-9)
    varying = angle - seconds[:, None] / span * angle[-1]
    steps = np.diff(varying, axis=0)
    stride = max(len(varying) // WINDOWS, 1)
    windows = np.diff(varying[::stride], axis=0)
    of_steps, powers = (np.linalg.eigvalsh(x.T @ x / len(x)) for x in (steps, windows))
    powers[powers <= NOISE_FACTOR**2 * stride * of_steps] = 0.0
    return np.sqrt((steps**2).mean(axis=0)), np.sqrt(np.maximum(powers, 0.0))
