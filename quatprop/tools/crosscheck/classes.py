"""Effects of misreadings on a body rate: layouts, directions, exchanged and mirrored axes.

A quaternion whose components are permuted and have signs changed is p q r or p q* r of the true
one, with constant p and r. Its body rate is then that of the body with its axes turned by r, or
minus the rate about the axes of the reference. So 384 signed permutations are 48 classes of 8 that
a gyroscope can distinguish; see docs/conventions.md.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.estimation.turning import BODY, REFERENCE
from quatprop.kinematics.conventions import signed_axes
from quatprop.kinematics.signed_axes import SIGNED_PERMUTATIONS

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64


class Reading(NamedTuple):
    """How an orientation may have been meant.

    `name`: for sentences: ``"it is ..."``
    `settings`: options that read it so
    `axes`: those of the orientation, as it was read, in which the true body rate is resolved
    `matrix`: from these to the true body axes, of either hand, shape ``(3, 3)``
    """

    name: str
    settings: tuple[tuple[str, str], ...]
    axes: str
    matrix: Float64


_DIRECTION = ("from_direction", "ref-to-body")


def _readings(other: str, of_layout: str, of_both: str) -> tuple[Reading, ...]:
    layout = ("from_layout", other)
    return (
        Reading("as read", (), BODY, np.eye(3)),
        Reading("conjugate (reference to body)", (_DIRECTION,), REFERENCE, -np.eye(3)),
        Reading(f"stored {other}", (layout,), REFERENCE, signed_axes(of_layout)),
        Reading(f"stored {other}, and conjugate", (layout, _DIRECTION), BODY, signed_axes(of_both)),
    )


READINGS: Final = {
    "scalar-first": _readings("scalar-last", "-z,y,-x", "z,y,-x"),
    "scalar-last": _readings("scalar-first", "z,-y,-x", "z,-y,x"),
}
"""Layout in which an orientation was read -> how it may have been meant."""


def readings_of(layout: str) -> tuple[Reading, ...]:
    """Return how an orientation that was read in a layout may have been meant."""
    return READINGS.get(layout, READINGS["scalar-first"][:2])


def turn_angle(matrix: Float64) -> float:
    """Return the angle of the rotation in an orthogonal matrix of either hand, rad."""
    trace = float(np.trace(matrix * np.sign(np.linalg.det(matrix))))
    return math.acos(max(-1.0, min(1.0, (trace - 1) / 2)))


class Axes(NamedTuple):
    """The exchange of axes that is nearest to a rotation.

    `matrix`: a signed permutation
    `angle`: rotation between it and the given one, as far as the motion shows it, rad
    `is_partial`: whether the motion shows only a part of the rotation
    """

    matrix: Float64
    angle: float
    is_partial: bool

    @property
    def are_same(self) -> bool:
        """Whether no axes are exchanged."""
        return bool(np.array_equal(self.matrix, np.eye(3)))

    @property
    def are_mirrored(self) -> bool:
        """Whether the hand of the axes changes."""
        return bool(np.linalg.det(self.matrix) < 0)


NEAR: Final = math.radians(15.0)
"""Axes within this angle are named as the same, or as exchanged."""

PARTLY: Final = math.radians(3.0)
"""Angle by which an exchange must be nearer than a simpler one if some axes are not shown, rad."""


def nearest_axes(matrix: Float64, excited: Float64, noise: float, *, either_hand: bool) -> Axes:
    """Return the nearest exchange of axes: the simplest that the motion does not contradict.

    `matrix`: R, orthogonal
    `excited`: covariance of the rates that it is applied to, (rad/s)^2, shape ``(3, 3)``
    `noise`: RMS of the residuals, in the units of these rates, rad/s
    `either_hand`: whether the motion does not distinguish mirrored axes
    """
    power, directions = np.linalg.eigh(excited)
    shown = directions[:, power > max(4e-4 * power[-1], 4 * noise**2)]
    if not shown.shape[1]:
        shown = directions[:, -1:]
    is_partial = either_hand or shown.shape[1] < 2  # noqa: PLR2004  # two axes show a rotation
    hand = np.sign(np.linalg.det(matrix))
    best = Axes(np.eye(3), math.inf, is_partial)
    for axes in SIGNED_PERMUTATIONS:
        own = np.sign(np.linalg.det(axes))
        if own != hand and not either_hand:
            continue
        if is_partial:
            half = float(np.linalg.norm((matrix - axes) @ shown, 2)) / 2
            angle = 2 * math.asin(min(1.0, half))
        else:
            angle = turn_angle(matrix @ axes.T)
        if either_hand and own < 0:
            angle += NEAR  # a mirror only if no rotation does
        if angle < NEAR and np.array_equal(axes, np.eye(3)):
            return Axes(axes, angle, is_partial)
        if angle < best.angle - (PARTLY if is_partial else 0.01):
            best = Axes(axes, angle, is_partial)
    return best
