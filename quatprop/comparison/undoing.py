"""Mistakes that can be undone: in the frames, and what undoing the others has in common.

A was propagated, if one of the two was, and B is what it is compared with; where either may be
wrong, it is undone in A, and the remedy names both ways.
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


class Undoing(NamedTuple):
    """A mistake and how it is undone.

    `other`: what it is called where another mistake explains as much
    `apply`: returns A and B without it
    `align`: the alignment that undoes it, where one does
    `mount`: the matrix by which it turns A's rates, where the remedy is a mounting: a bias is
        subtracted before that
    `side`: ``a`` or ``b``, the series that was misread, where it is only one
    """

    name: str
    other: str
    sentence: str
    remedy: str
    apply: Callable[[Sides], Sides]
    align: str = ""
    mount: Float64 | None = None
    side: str = ""


def if_propagated(setting: str, a: str, b: str) -> str:
    """Return how either series may be propagated to arrive at the other: one may be a truth."""
    of_a, of_b = Setting(setting, a), Setting(setting, b)
    return f"if A was propagated, propagate it with {of_a}; if B was, with {of_b}"


def recomposed(series: AttitudeSeries, steps: Float64, rates: str = "body") -> AttitudeSeries:
    """Return a series with other rotations from sample to sample."""
    # Steps of one second, by the rates that begin them.
    t_ns = np.arange(len(series)) * NS_PER_S
    rate = np.append(steps, np.zeros((1, 3)), axis=0)
    return replace(series, wxyz=attitudes(t_ns, rate, q0=series.wxyz[0], rates=rates))


def with_rates(factor: Float64 | float, less: Float64 | float = 0.0) -> Callable[[Sides], Sides]:
    """Return what multiplies A's rates, by a matrix or a number, and subtracts a rate, rad/s."""
    matrix = np.asarray(factor) * (1 if np.ndim(factor) else np.eye(3))

    def apply(sides: Sides) -> Sides:
        seconds = np.diff(sides.a.t_ns)[:, None] / NS_PER_S
        steps = rotation_vectors_between(sides.a.wxyz) @ matrix.T - seconds * less
        return sides._replace(a=recomposed(sides.a, steps))

    return apply


def scaled(factor: float) -> str:
    """Return how rates are multiplied."""
    return (
        f"if A was propagated, multiply its rates by {factor:.6g}; if B was, multiply its rates by "
        f"{1 / factor:.6g}"
    )


LEVEL = 1e-3
"""Share of a rotation that may be about a level axis where it is one of the heading."""


def frames(asked: Alignment, alignment: Alignment) -> Undoing:
    """Return other frames than those that the alignment asked for lets free."""
    apart = geodesic_angle(asked.reference_wxyz, alignment.reference_wxyz)
    reference, body = (degrees_text(float(angle)) for angle in (apart, alignment.mount_rad))
    name, wanted = alignment.name, alignment.name
    if name == "mean":
        _, x, y, _ = alignment.reference_wxyz
        level = math.hypot(x, y) < LEVEL * math.sin(alignment.reference_rad / 2)
        wanted = "yaw" if level and asked.name in {"none", "first"} else "mean"
    sentence = f"the reference frames differ by {reference}"
    if name == "mount":
        others = f", and the reference frames by {reference}" if asked.name != "mean" else ""
        sentence = f"the body frames differ by {body}{others}"
    return Undoing(
        "body frame" if name == "mount" else "reference frame",
        f"{'body' if name == 'mount' else 'reference'} frames that differ by "
        f"{body if name == 'mount' else reference}",
        sentence,
        f"{Setting('align', wanted)} removes it",
        lambda sides: sides,
        wanted,
    )
