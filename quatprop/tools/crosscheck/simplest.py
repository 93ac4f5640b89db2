"""The fewest differences that explain how one source follows from another.

Some motions trade one difference for another: a steady precession a mounting for a clock offset,
and a scale for a bias. So parameters are estimated only where the motion is not explained without
them; each in turn, the one that explains most first.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.estimation.relation import BIAS, CLOCK, DRIFT, OFFSET, PRIOR, SCALE, TURN, relate
from quatprop.kinematics.signed_axes import SIGNED_PERMUTATIONS
from quatprop.tools.crosscheck.classes import NEAR, turn_angle

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64
    from quatprop.estimation.relation import Relation
    from quatprop.estimation.turning import Turning

GROUPS: Final[tuple[slice | int, ...]] = (BIAS, OFFSET, TURN, SCALE, DRIFT, CLOCK)
"""Parameters that are estimated together, the most usual difference first."""

EXPECTED_SCALES: Final = (1.0, math.pi / 180, 180 / math.pi)
"""Scales of equal units, and of rad and deg."""

GAIN: Final = 15.0
"""Noise may exceed the least by this share, divided by the number of measurements."""

CLEAR: Final = 0.9
"""Share of the motion that is left above which nothing is explained."""

LEAST: Final = 0.003
MOST: Final = 0.12
"""Limits of this share."""


def tolerated(fit: Relation) -> float:
    """Return by which share of the noise two relations may differ and explain the motion equally.

    About five standard deviations of one parameter, of errors that are not white
    """
    measured = fit.windows * fit.shown.sum()
    return float(np.clip(GAIN * max(fit.inflation, 1.0) / measured, LEAST, MOST))


def chance(fit: Relation) -> float:
    """Return by which share noise differs between two offsets: three standard deviations."""
    measured = fit.windows * fit.shown.sum()
    return float(min(3 * math.sqrt(max(fit.inflation, 1.0) / measured), MOST))


def simplest(a: Turning, b: Turning, fit: Relation, *, is_far: bool) -> Relation:
    """Return the fit with the fewest parameters that explains the motion as the given one does.

    `is_far`: whether the clocks have different zeros, so that there is an offset
    """
    free = np.zeros(len(PRIOR), np.bool_)
    free[OFFSET] = is_far
    free[TURN] = _nearest(fit.matrix) is None
    groups, least = list(GROUPS), fit
    if not is_far:
        at_once = fit.free.copy()
        at_once[[OFFSET, CLOCK]] = False
        zero = _restricted(a, b, fit, at_once)
        # Another offset is another draw of the noise.
        if zero is not None and zero.noise <= (1 + chance(fit)) * fit.noise:
            groups, least = [each for each in GROUPS if each not in (OFFSET, CLOCK)], zero
        else:
            free[OFFSET] = True
    # Noise of A lessens the scale and the noise of the fit; without differences, neither.
    limit = (1 + tolerated(fit)) * least.noise / math.sqrt(1 - min(fit.score, CLEAR) ** 2)
    best = _restricted(a, b, fit, free)
    while best is None or best.noise > limit:
        tries = []
        for group in groups:
            if not np.all(free[group]) and np.any(fit.free[group]):
                more = free.copy()
                more[group] = True
                if (found := _restricted(a, b, fit, more)) is not None:
                    tries.append((found.noise, found, more))
        if not tries:
            return least
        _, best, free = min(tries, key=lambda each: each[0])
    return best._replace(is_flat=fit.is_flat)


def _restricted(a: Turning, b: Turning, fit: Relation, free: Bool) -> Relation | None:
    """Return the fit of some parameters; the others have the nearest value without a difference."""
    matrix = None if free[TURN].all() else _nearest(fit.matrix)
    scale = fit.scale if free[SCALE] else _expected(fit.scale)
    axes, starts = (fit.axes_a, fit.axes_b), {fit.offset, 0.0} if free[OFFSET] else {0.0}
    found = [
        one
        for start in sorted(starts)
        if (
            one := relate(
                a,
                b,
                axes,
                start,
                fit.length,
                hand=fit.hand,
                free=free,
                begin=(fit.matrix if matrix is None else matrix, scale),
            )
        )
        is not None
    ]
    return min(found, key=lambda each: each.noise, default=None)


def _nearest(matrix: Float64) -> Float64 | None:
    """Return the exchange of axes that is near to a rotation; None if none is."""
    hand = np.sign(np.linalg.det(matrix))
    every = (each for each in SIGNED_PERMUTATIONS if np.sign(np.linalg.det(each)) == hand)
    nearest = min(every, key=lambda each: turn_angle(matrix @ each.T))
    return nearest if turn_angle(matrix @ nearest.T) < NEAR else None


def _expected(scale: float) -> float:
    return min(EXPECTED_SCALES, key=lambda each: abs(math.log(scale / each)))
