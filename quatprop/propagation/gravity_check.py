"""Rates against the accelerometer next to them: gravity turns in the sensor as its rates say.

Nothing is changed here. A finding needs a unit or a choice of axes with which both agree: of
accelerations alone, motion explains anything.
"""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.text import Remark
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, multiply, rotate
from quatprop.kinematics.signed_axes import SIGNED_PERMUTATIONS, axes_text
from quatprop.propagation.checks.units import other_unit
from quatprop.timeline.stamps import spread

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.kinematics.series import GyroSeries

SPAN: Final = 0.5
"""Time over which gravity turns, s: long enough for noise, short enough for drift."""

SMOOTH: Final = 0.05
"""Time over which accelerations are averaged, s."""

MOST_SPANS: Final = 2000
"""Times that are compared."""

FEWEST_SPANS: Final = 40

STEADY: Final = 0.05
"""Accelerations whose size is within this share of the usual one are those of gravity."""

TURNED: Final = math.radians(4.0)
"""rad: gravity that turns less, usually, shows nothing."""

AGREED: Final = 0.9
"""Agreement, 1 for equal turns, above which the rates are not in question."""

SHOWN: Final = 0.05
"""Largest disagreement with which another unit or other axes are shown."""

DISTINCT: Final = 3.0
"""How many times as large it is with all others."""

DEG: Final = math.radians(1.0)


class _Reading(NamedTuple):
    """How the rates could be meant: times a factor, about other axes, which may be mirrored."""

    factor: float
    axes: str


AS_READ: Final = _Reading(1.0, "x,y,z")


def against_gravity(gyro: GyroSeries, t_ns: Int64, force: Float64, unit: str) -> Remark | None:
    """Return a remark if gravity turns as the rates would in another unit or about other axes.

    `gyro`: rates from the beginning of the log, sensor axes, rad/s
    `t_ns`, `force`: specific forces in sensor axes, any unit and sign, shape ``(N, 3)``
    `unit`: that of the rates in the log
    """
    stamps, places, own_places = np.intersect1d(gyro.t_ns, t_ns, return_indices=True)
    is_usable = len(stamps) > FEWEST_SPANS and np.isfinite(gyro.rate).all()
    if not is_usable or (np.diff(gyro.t_ns) <= 0).any():
        return None
    gravity, is_steady = _gravity(stamps, force[own_places])
    begins, ends = _spans(stamps, is_steady)
    if len(begins) < FEWEST_SPANS:
        return None
    turned = gravity[ends] - gravity[begins]
    if float(np.sqrt((turned**2).sum(axis=1).mean())) < TURNED:
        return None
    found: dict[_Reading, float] = {}
    for reading, by_rates in _turns(gyro, places, begins, ends, gravity):
        found[reading] = _agreement(turned, by_rates)
        if reading == AS_READ and found[reading] > AGREED:
            return None
    (second, best), reading = sorted(found.values())[-2:], max(found, key=found.__getitem__)
    is_shown = 1 - best < min(SHOWN, (1 - second) / DISTINCT)
    return _remark(reading, unit) if is_shown else None


def _remark(reading: _Reading, unit: str) -> Remark:
    begin = "the rates contradict the accelerometer next to them"
    axes = ", ".join(reading.axes.split(","))
    of_axes = (
        f"gravity turns about its x, y, z as the rates do about {axes}, so what is taken from both "
        "is wrong, such as an initial attitude by gravity: turn one of them into the axes of the "
        "other before"
    )
    if reading.factor == 1:
        return Remark("gravity-other-axes", f"{begin}: {of_axes}")
    size = "large" if reading.factor < 1 else "small"
    ratio = max(reading.factor, 1 / reading.factor)
    advice = other_unit(unit, are_too_large=reading.factor < 1)
    also = "" if reading.axes == AS_READ.axes else f"; and {of_axes}"
    text = (
        f"{begin}: they are {ratio:.3g} times too {size} for the turns of gravity: {advice}{also}"
    )
    return Remark("gravity-off-scale", text)


def _gravity(stamps: Int64, force: Float64) -> tuple[Float64, Bool]:
    """Return averaged directions of forces, and where these are those of gravity, ``(N,)``."""
    interval = spread(np.diff(stamps))[1] / NS_PER_S
    count = max(round(SMOOTH / interval), 1)
    kernel = np.full(count, 1 / count)
    return directions(np.stack([np.convolve(axis, kernel, "same") for axis in force.T], axis=1))


def directions(mean: Float64) -> tuple[Float64, Bool]:
    """Return the directions of averaged forces, and where these are those of gravity."""
    size = np.linalg.norm(mean, axis=1)
    finite = size[np.isfinite(size)]
    usual = spread(finite)[1] if len(finite) else 0.0
    is_steady = np.abs(size - usual) < STEADY * usual
    return mean / np.where(size > 0, size, 1.0)[:, None], is_steady


def _spans(stamps: Int64, is_steady: Bool) -> tuple[Int64, Int64]:
    """Return where the times that are compared begin and end; none of them is across a gap."""
    after = np.searchsorted(stamps, stamps + round(SPAN * NS_PER_S))
    begins = np.flatnonzero(after < len(stamps))
    ends = after[begins]
    is_whole = stamps[ends] - stamps[begins] < 1.2 * SPAN * NS_PER_S
    known = is_steady[begins] & is_steady[ends] & is_whole
    begins, ends = begins[known], ends[known]
    stride = max(-(-len(begins) // MOST_SPANS), 1)
    return begins[::stride], ends[::stride]


def _turns(
    gyro: GyroSeries, places: Int64, begins: Int64, ends: Int64, gravity: Float64
) -> Iterator[tuple[_Reading, Float64]]:
    """Yield readings of the rates, and by how much gravity would turn with each, ``(N, 3)``."""
    right_handed = [one for one in SIGNED_PERMUTATIONS if np.linalg.det(one) > 0]
    right_handed.sort(key=lambda one: -np.trace(one))
    for factor, sign in product((1.0, DEG, 1 / DEG), (1.0, -1.0)):
        q = attitudes(gyro.t_ns, sign * factor * gyro.rate)[places]
        step = conjugate(multiply(conjugate(q[begins]), q[ends]))
        for axes in right_handed:
            turned = rotate(step, gravity[begins] @ axes) @ axes.T
            yield _Reading(factor, axes_text(sign * axes)), turned - gravity[begins]


def _agreement(a: Float64, b: Float64) -> float:
    """Return how well changes agree: 1 if they are equal."""
    total = float((a**2).sum() + (b**2).sum())
    return 2 * float((a * b).sum()) / total if total else 1.0
