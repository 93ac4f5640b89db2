"""The numbers in a lock, compared with those of a run by arithmetic of its own.

The comparison of attitudes uses the same product, conversions and angles as their propagation. A
mistake there could pass unnoticed, so the numbers that a person reads in the lock are compared by
rotation matrices, and share no code with either.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.settings.command_options import ERROR_LIMITS
from quatprop.tools.check.lock import FRAMES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.base.arrays import Float64
    from quatprop.tools.check.case import Case, CaseRun
    from quatprop.tools.check.lock import Pin

SAME_DEG = 1e-5
"""Upper bound on the rounding of the angles in a lock, deg."""

SAME_SHARE = 1e-6
"""Relative difference of total angles that does not count as a change."""


def final_apart_deg(pin: Pin, final_wxyz: Sequence[float] | Float64) -> float:
    """Return the angle between the pinned attitude at the last sample and another, deg.

    Near a pitch of 90 deg the differences of roll and yaw do not show it.
    """
    roll, pitch, yaw = (math.radians(pin.final_deg[name]) for name in ("roll", "pitch", "yaw"))
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    pinned = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return _apart_deg(pinned, _matrix(final_wxyz))


def moved_deg(old: Sequence[float] | None, new: Sequence[float] | None) -> float:
    """Return the angle between two rotations in locks, wxyz, deg; 0 if one is missing."""
    return 0.0 if old is None or new is None else _apart_deg(_matrix(old), _matrix(new))


def changed_numbers(case: Case, pin: Pin, run: CaseRun) -> Iterator[str]:
    """Yield how the numbers of a run differ from those in the lock, beyond the tolerance."""
    if not case.strict:
        return
    result, limit = run.report.result, _limit_deg(case)
    if (apart := final_apart_deg(pin, result.final_wxyz)) > limit + SAME_DEG:
        yield f"the attitude at the last sample is {apart:.6g} deg from the one in the lock"
    total = math.degrees(result.path_angle_rad)
    if abs(total - pin.total_angle_deg) > SAME_DEG + SAME_SHARE * pin.total_angle_deg + limit:
        yield f"the total angle is {total:.9g} deg, and {pin.total_angle_deg:.9g} in the lock"


def moved_frames(case: Case, pin: Pin, new: Pin) -> Iterator[str]:
    """Yield which frame of an independent series was aligned by another rotation than pinned.

    An alignment would hide exchanged axes. Where the log may differ from the pinned one, it may
    begin at another attitude, which the reference frame is relative to, unless q0 is of the log or
    a file.
    """
    is_absolute = case.options.get("q0") == "log" or "q0" in case.inputs
    for frame in FRAMES if case.pins_log or is_absolute else FRAMES[1:]:
        turned, limit = moved_deg(pin.alignment.get(frame), new.alignment.get(frame)), 2.0
        limit = min(limit, _limit_deg(case)) + SAME_DEG
        if turned > limit:
            yield (
                f"the {frame} frame of the reference is aligned by a rotation that is {turned:.6g} "
                f"deg from the one in the lock"
            )


def _limit_deg(case: Case) -> float:
    """Return the largest limit on an error, deg; infinite without one."""
    limits = [getattr(case.comparison, name) for name in ERROR_LIMITS]
    return math.degrees(max((x for x in limits if isinstance(x, float)), default=math.inf))


def _matrix(wxyz: Sequence[float] | Float64) -> Float64:
    """Return the rotation matrix of a quaternion, shape ``(3, 3)``."""
    w, x, y, z = (float(part) for part in wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _apart_deg(a: Float64, b: Float64) -> float:
    """Return the angle between two rotation matrices, deg: ``2 sqrt(2) sin(angle / 2)`` apart."""
    distance = math.sqrt(float(np.sum((a - b) ** 2)))
    return math.degrees(2 * math.asin(min(1.0, distance / math.sqrt(8))))
