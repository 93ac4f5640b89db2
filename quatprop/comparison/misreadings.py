"""Mistakes without parameters: layouts, directions, signs, sides and axes."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.mistakes import (
    Mistake,
    Sides,
    rates_changed,
    recomposed,
    remedy_if_propagated,
    scaling_remedy,
)
from quatprop.kinematics.quaternion import conjugate
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.text import Setting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from quatprop.arrays import Float64

CONJUGATE = (
    "B is the conjugate of A: the direction (reference to body) or the JPL convention of one of "
    "them was not taken into account"
)
AS_READ = [0, 1, 2, 3]
LAYOUTS = {"last": [3, 0, 1, 2], "first": [1, 2, 3, 0]}
"""True position of the scalar -> indices of w, x, y and z in quaternions read the other way."""

SIGNED_AXES = sorted(
    (
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ),
    key=lambda matrix: -np.trace(matrix),
)[1:-1]
"""Signed permutations of the axes, those with the fewest changes first; without I and -I."""

SAME_FIT = 1e-3
"""Relative tolerance within which signed permutations fit equally well."""


def misreadings(sides: Sides) -> tuple[list[Mistake], list[Mistake]]:
    """Return wrong directions and signs, and wrong layouts and frames of rates.

    Directions come first: where the motion does not distinguish one from a sign of rates, it is
    the simpler cause, since it only concerns the quaternions that are compared.

    `sides`: the series as read; the alternative layout is the one they were not read with
    """
    sign = "the rates of A and B have opposite signs"
    rate_sign = Mistake(
        "rate sign", "rates of the opposite sign", sign, scaling_remedy(-1), rates_changed(-1.0)
    )
    of_sides = [
        [*_misread("b", sides.b.layout, sides.a.layout)],
        [*_misread("a", sides.a.layout, sides.b.layout)],
    ]
    frames = [
        Mistake(
            "side",
            "body rates treated as inertial rates",
            "one of A and B treats the rates as body-frame, the other as reference-frame",
            remedy_if_propagated("rates", wanted, own),
            _with_rates_in(own, wanted),
        )
        for own, wanted in (("inertial", "body"), ("body", "inertial"))
    ]
    conjugated = [of_side[0] for of_side in of_sides]
    return [*conjugated, rate_sign], [*of_sides[0][1:], *of_sides[1][1:], *frames]


def _misread(side: str, layout: str | None, other_layout: str | None) -> Iterator[Mistake]:
    """Yield a wrong direction, a wrong layout, and both together, of a series.

    `layout`, `other_layout`: as which it and the other series were read
    """

    def reread(order: list[int], *, conjugated: bool) -> Callable[[Sides], Sides]:
        def undo(sides: Sides) -> Sides:
            series = getattr(sides, side)
            wxyz = np.ascontiguousarray(series.wxyz[:, order])
            wxyz = conjugate(wxyz) if conjugated else wxyz
            return sides._replace(**{side: replace(series, wxyz=wxyz)})

        return undo

    direction = f"{Setting('from_direction', 'ref-to-body', side)} or "
    direction += Setting("from_convention", "jpl", side)
    remedy = f"if it is {side.upper()}, read it with "
    label = "a wrong direction or JPL convention"
    yield Mistake(
        "conjugate",
        label,
        CONJUGATE,
        remedy + direction,
        reread(AS_READ, conjugated=True),
        side=side,
    )
    # A series from memory is scalar-first by definition.
    true, assumed = ("first", "last") if layout == "scalar-last" else ("last", "first")
    name = "layout" if (true == "last") == (side == "b") else "layout-first"
    sentence = f"{side.upper()} is scalar-{true} and was read as scalar-{assumed}"
    setting = Setting("from_layout", f"scalar-{true}", side)
    undo = reread(LAYOUTS[true], conjugated=False)
    either, remedies = sentence, remedy + setting
    if other_layout == f"scalar-{true}":
        # The opposite mistake, made with the other series, relates them in the same way.
        other = "ab".replace(side, "")
        either += f", or {other.upper()} is scalar-{assumed} and was read as scalar-{true}"
        opposite = Setting("from_layout", f"scalar-{assumed}", other)
        remedies += f"; if it is {other.upper()}, with {opposite}"
    yield Mistake(name, "a wrong layout", either, remedies, undo, side=side)
    yield Mistake(
        f"{name} and conjugate",
        f"a wrong layout with {label}",
        f"{sentence}; also, {CONJUGATE}",
        f"{remedy}{setting} and {direction}",
        reread(LAYOUTS[true], conjugated=True),
        side=side,
    )


def swapped_axes(sides: Sides) -> Iterator[Mistake]:
    """Yield the best right-handed and the best left-handed signed permutation of the axes."""
    of_a, of_b = (rotation_vectors_between(series.wxyz) for series in sides)
    common = of_a.T @ of_b
    for handed in (1.0, -1.0):
        kept = [matrix for matrix in SIGNED_AXES if np.linalg.det(matrix) * handed > 0]
        fits = np.array([float((matrix * common).sum()) for matrix in kept])
        # y = M x, x in B's axes and y in A's.
        matrix = kept[int(np.argmax(fits >= fits.max() - SAME_FIT * abs(fits.max())))]
        sentence = f"the body axes x, y, z of A are {_signed(matrix)} of B"
        mounts = _signed(matrix.T), _signed(matrix)
        if handed > 0:
            remedy = remedy_if_propagated("mount", *(mount.replace(" ", "") for mount in mounts))
            remedy += ", after any other"
        else:
            sentence += ", which is left-handed: an axis is reversed, or two are swapped"
            remedy = (
                f"if A was propagated, read its rates as {mounts[0]}; if B was, read its rates as "
                f"{mounts[1]} (no option does that: the driver or the log is to be mended)"
            )
        undo, mount = rates_changed(matrix.T), matrix.T if handed > 0 else None
        yield Mistake("axes", "swapped or reversed axes", sentence, remedy, undo, mount=mount)


def _signed(matrix: Float64) -> str:
    signs = [("-" if row.sum() < 0 else "") + "xyz"[np.argmax(np.abs(row))] for row in matrix]
    return ", ".join(signs)


def _with_rates_in(own: str, wanted: str) -> Callable[[Sides], Sides]:
    """Return a function that resolves A's rates in another frame."""

    def undo(sides: Sides) -> Sides:
        steps = rotation_vectors_between(sides.a.wxyz, rates=own)
        return sides._replace(a=recomposed(sides.a, steps, wanted))

    return undo
