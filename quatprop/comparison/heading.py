"""Components of attitude errors: heading, inclination, and rotations about the reference axes.

Gravity makes roll and pitch observable, but not heading. The rotation from B's attitude to A's,
resolved in the reference frame with z as the vertical, is a rotation about a level axis
(inclination) followed by one about the vertical (heading).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.kinematics.quaternion import conjugate, log, multiply, shorter
from quatprop.series.blocks import blocks

if TYPE_CHECKING:
    from quatprop.comparison.alignment import Alignment
    from quatprop.comparison.association import Pairs


class Extent(NamedTuple):
    """Largest magnitude and root mean square of an error, rad.

    `max`: largest magnitude, rad
    `rms`: root mean square, rad
    """

    max: float
    rms: float


class ErrorParts(NamedTuple):
    """Components of the errors.

    `heading`: rotation about the vertical
    `inclination`: angle between the verticals
    `about_x`, `about_y`, `about_z`: components of the rotation vector in the reference frame
    """

    heading: Extent
    inclination: Extent
    about_x: Extent
    about_y: Extent
    about_z: Extent


def error_parts(pairs: Pairs, alignment: Alignment) -> ErrorParts:
    """Return the components of the errors.

    References
    ----------
    D. Laidig et al., "BROAD - A benchmark for robust inertial orientation estimation", Data 6
    (2021) 72: heading 2 atan |z / w|, inclination 2 acos sqrt(w^2 + z^2).
    """
    largest, squares = np.zeros(5), np.zeros(5)
    for rows in blocks(len(pairs)):
        step = shorter(multiply(pairs.a[rows], conjugate(alignment.apply(pairs.b[rows]))))
        w, x, y, z = step.T
        heading = 2 * np.arctan2(np.abs(z), w)
        inclination = 2 * np.arctan2(np.hypot(x, y), np.hypot(w, z))
        parts = np.column_stack([heading, inclination, np.abs(log(step))])
        largest = np.maximum(largest, parts.max(axis=0))
        squares += (parts**2).sum(axis=0)
    rms = [math.sqrt(total / len(pairs)) for total in squares.tolist()]
    return ErrorParts(*map(Extent, largest.tolist(), rms))
