"""Mistakes and how to undo them: different frames, and functions that the other mistakes share.

Where either series may be wrong, A is corrected, and the remedy covers both cases.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.rendering import degrees_text
from quatprop.text import Setting
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.arrays import Float64
    from quatprop.comparison.alignment import Alignment
    from quatprop.series import AttitudeSeries


class Sides(NamedTuple):
    """The series A and B."""

    a: AttitudeSeries
    b: AttitudeSeries


class Mistake(NamedTuple):
    """A mistake and how to undo it.

    `label`: short description, for lists of alternatives
    `undo`: returns A and B without the mistake
    `align`: the alignment that removes it, if any
    `mount`: the matrix that rotates A's rates, if the remedy is a mounting; a bias is subtracted
        before it
    `side`: ``"a"`` or ``"b"``: the series that was misread, if it is one
    """

    name: str
    label: str
    sentence: str
    remedy: str
    undo: Callable[[Sides], Sides]
    align: str = ""
    mount: Float64 | None = None
    side: str = ""


def remedy_if_propagated(setting: str, a: str, b: str) -> str:
    """Return a remedy for whichever series was propagated: the other may be a reference."""
    of_a, of_b = Setting(setting, a), Setting(setting, b)
    return f"if A was propagated, propagate it with {of_a}; if B was, with {of_b}"


def recomposed(series: AttitudeSeries, steps: Float64, rates: str = "body") -> AttitudeSeries:
    """Return a series with the rotations between samples replaced.

    `steps`: rotation vectors, shape ``(N - 1, 3)``, rad
    """
    # With intervals of one second, rates are rotation vectors.
    t_ns = np.arange(len(series)) * NS_PER_S
    rate = np.append(steps, np.zeros((1, 3)), axis=0)
    return replace(series, wxyz=attitudes(t_ns, rate, q0=series.wxyz[0], rates=rates))


def rates_changed(factor: Float64 | float, less: Float64 | float = 0.0) -> Callable[[Sides], Sides]:
    """Return a function that multiplies A's rates, and then subtracts a rate, rad/s."""
    matrix = np.asarray(factor) * (1 if np.ndim(factor) else np.eye(3))

    def undo(sides: Sides) -> Sides:
        seconds = np.diff(sides.a.t_ns)[:, None] / NS_PER_S
        steps = rotation_vectors_between(sides.a.wxyz) @ matrix.T - seconds * less
        return sides._replace(a=recomposed(sides.a, steps))

    return undo


def scaling_remedy(factor: float) -> str:
    """Return the remedy for rates that have to be multiplied by a factor."""
    return (
        f"if A was propagated, multiply its rates by {factor:.6g}; if B was, multiply its rates by "
        f"{1 / factor:.6g}"
    )


LEVEL = 1e-3
"""Maximum share of a heading rotation that is about a level axis."""


NEGLIGIBLE = 1e-9
"""Angle, rad, by which frames differ only by rounding."""


def frame_mistake(asked: Alignment, alignment: Alignment) -> Mistake:
    """Return the difference of frames that an alignment removes beside the one asked for."""
    apart = geodesic_angle(asked.reference_wxyz, alignment.reference_wxyz)
    reference, body = (degrees_text(float(angle)) for angle in (apart, alignment.mount_rad))
    name, wanted = alignment.name, alignment.name
    if name == "mean":
        _, x, y, _ = alignment.reference_wxyz
        level = math.hypot(x, y) < LEVEL * math.sin(alignment.reference_rad / 2)
        wanted = "yaw" if level and asked.name in {"none", "first"} else "mean"
    sentence = f"the reference frames differ by {reference}"
    if name == "mount":
        also = asked.name != "mean" and float(apart) > NEGLIGIBLE
        others = f", and the reference frames by {reference}" if also else ""
        sentence = f"the body frames differ by {body}{others}"
    return Mistake(
        "body frame" if name == "mount" else "reference frame",
        f"{'body' if name == 'mount' else 'reference'} frames that differ by "
        f"{body if name == 'mount' else reference}",
        sentence,
        f"{Setting('align', wanted)} removes it",
        lambda sides: sides,
        wanted,
    )
