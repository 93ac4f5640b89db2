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
LAYOUTS = {"layout": [3, 0, 1, 2], "layout-first": [1, 2, 3, 0]}
"""Which components, as they were read, are w, x, y and z of B, where it is scalar-last or A is
scalar-first, and the other way round."""

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


def misreadings() -> Iterator[Undoing]:
    """Yield wrong layouts, directions and conventions, and rates resolved in another frame."""
    sign = "the rates of A and B have opposite signs"
    yield Undoing("rate sign", "rates of the opposite sign", sign, scaled(-1), with_rates(-1.0))
    for side in "ba":
        yield from _misread(side)
    for own, wanted in (("inertial", "body"), ("body", "inertial")):
        yield Undoing(
            "side",
            "body rates treated as inertial rates",
            "one of A and B treats the rates as body-frame, the other as reference-frame",
            if_propagated("rates", wanted, own),
            _on_other_side(own, wanted),
        )


def _misread(side: str) -> Iterator[Undoing]:
    """Yield wrong layouts, directions and conventions of a series."""

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
    for name, order in LAYOUTS.items():
        last = (name == "layout") == (side == "b")
        own, taken = ("last", "first") if last else ("first", "last")
        said = f"{side.upper()} is scalar-{own} and was read as scalar-{taken}"
        layout = Setting("from_layout", f"scalar-{own}", side)
        numbers = order if side == "b" else np.argsort(order).tolist()
        apply = read(numbers, opposite=False)
        yield Undoing(name, "a wrong layout", said, way + layout, apply, side=side)
        yield Undoing(
            f"{name} and conjugate",
            f"a wrong layout with {other}",
            f"{said}; also, {CONJUGATE}",
            f"{way}{layout} and {direction}",
            read(numbers, opposite=True),
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
