"""Mistakes without parameters: layouts, directions, signs, sides and axes."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.undoing import (
    Sides,
    Undoing,
    if_propagated,
    recomposed,
    scaled,
    with_rates,
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
"""Where the scalar of a series is -> which components, as they were read, are w, x, y and z."""

SIGNED_AXES = sorted(
    (
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ),
    key=lambda matrix: -np.trace(matrix),
)[1:-1]
"""Matrices of all orders and signs of axes, those with the fewest changes first; without the one
that changes nothing, and the one that reverses everything."""

SAME_FIT = 1e-3
"""Orders and signs that fit as well, as a share: the motion does not show the axis of change."""


def misreadings(read: Sides) -> tuple[list[Undoing], list[Undoing]]:
    """Return wrong directions and signs, and wrong layouts and rates resolved in another frame.

    Where the motion does not tell a direction from a sign of rates, the direction is named: reading
    it otherwise changes the very numbers that are compared, and other rates lead to the opposite
    ones only if nothing else was done to them.

    `read`: the series as they were read: what is wrong with a layout is that it is not the other
    """
    sign = "the rates of A and B have opposite signs"
    rate_sign = Undoing(
        "rate sign", "rates of the opposite sign", sign, scaled(-1), with_rates(-1.0)
    )
    of_sides = [[*_misread(side, getattr(read, side).layout)] for side in "ba"]
    sides = [
        Undoing(
            "side",
            "body rates treated as inertial rates",
            "one of A and B treats the rates as body-frame, the other as reference-frame",
            if_propagated("rates", wanted, own),
            _on_other_side(own, wanted),
        )
        for own, wanted in (("inertial", "body"), ("body", "inertial"))
    ]
    opposite = [of_side[0] for of_side in of_sides]
    return [*opposite, rate_sign], [*of_sides[0][1:], *of_sides[1][1:], *sides]


def _misread(side: str, layout: str | None) -> Iterator[Undoing]:
    """Yield the other layout, direction and convention of a series, and both."""

    def read(order: list[int], *, opposite: bool) -> Callable[[Sides], Sides]:
        def apply(sides: Sides) -> Sides:
            series = getattr(sides, side)
            wxyz = np.ascontiguousarray(series.wxyz[:, order])
            wxyz = conjugate(wxyz) if opposite else wxyz
            return sides._replace(**{side: replace(series, wxyz=wxyz)})

        return apply

    direction = f"{Setting('from_direction', 'ref-to-body', side)} or "
    direction += Setting("from_convention", "jpl", side)
    way = f"if it is {side.upper()}, read it with "
    other = "a wrong direction or JPL convention"
    yield Undoing(
        "conjugate", other, CONJUGATE, way + direction, read(AS_READ, opposite=True), side=side
    )
    # What was not read is scalar-first by definition.
    own, taken = ("first", "last") if layout == "scalar-last" else ("last", "first")
    name = "layout" if (own == "last") == (side == "b") else "layout-first"
    said = f"{side.upper()} is scalar-{own} and was read as scalar-{taken}"
    setting = Setting("from_layout", f"scalar-{own}", side)
    apply = read(LAYOUTS[own], opposite=False)
    yield Undoing(name, "a wrong layout", said, way + setting, apply, side=side)
    yield Undoing(
        f"{name} and conjugate",
        f"a wrong layout with {other}",
        f"{said}; also, {CONJUGATE}",
        f"{way}{setting} and {direction}",
        read(LAYOUTS[own], opposite=True),
        side=side,
    )


def axes(sides: Sides) -> Iterator[Undoing]:
    """Yield the best orders and signs of axes, right- and left-handed."""
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
            remedy = if_propagated("mount", *(mount.replace(" ", "") for mount in mounts))
        else:
            sentence += ", which is left-handed: an axis is reversed, or two are swapped"
            remedy = (
                f"if A was propagated, read its rates as {mounts[0]}; if B was, read its rates as "
                f"{mounts[1]}"
            )
        undone, mount = with_rates(matrix.T), matrix.T if handed > 0 else None
        yield Undoing("axes", "swapped or reversed axes", sentence, remedy, undone, mount=mount)


def _signed(matrix: Float64) -> str:
    signs = [("-" if row.sum() < 0 else "") + "xyz"[np.argmax(np.abs(row))] for row in matrix]
    return ", ".join(signs)


def _on_other_side(own: str, wanted: str) -> Callable[[Sides], Sides]:
    def apply(sides: Sides) -> Sides:
        steps = rotation_vectors_between(sides.a.wxyz, rates=own)
        return sides._replace(a=recomposed(sides.a, steps, wanted))

    return apply
