"""Flatten message definitions to table columns."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.messages.schema import MAX_SEARCHED_ITEMS, Array, Primitive, Struct
from quatprop.tables.model import Column, TablePart

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.messages.schema import Type

MAX_VISITS = 20_000
"""Maximum number of fields visited: nested types can multiply the paths."""

MAX_ELEMENTS = 64
"""Longer arrays of numbers give no columns, unless one of their elements is named."""


class Flat(NamedTuple):
    """The columns and parts of a definition, and a cache of searches in them."""

    columns: tuple[Column, ...]
    parts: tuple[TablePart, ...]
    matches: dict[object, Any]


@lru_cache(maxsize=64)
def flattened(root: Struct) -> Flat:
    """Return the numbers and structs outside sequences, as columns and parts.

    The search is breadth first and bounded: types that double at every level have 2^50 leaves, and
    wanted fields are near the top. The columns are in the order of the definition.
    """
    leaves: list[tuple[tuple[int, ...], Column]] = []
    structs: list[tuple[tuple[int, ...], str, str]] = []
    waiting: deque[tuple[tuple[int, ...], str, Type]] = deque([((), "", root)])
    for _ in range(MAX_VISITS):
        if not waiting:
            break
        place, name, kind = waiting.popleft()
        if isinstance(kind, Primitive):
            leaves.append((place, Column(name, name, code=kind.code)))
        elif isinstance(kind, Struct):
            structs.append((place, name and name + ".", kind.name))
            waiting.extend(_below(place, name, kind))
        elif isinstance(kind, Array):
            is_flat = isinstance(kind.element, Primitive)
            if kind.length <= (MAX_ELEMENTS if is_flat else MAX_SEARCHED_ITEMS):
                waiting.extend(_below(place, name, kind))
    leaves.sort(key=lambda leaf: leaf[0])
    places = [place for place, _ in leaves]
    parts = (
        TablePart(
            prefix,
            type_name,
            bisect_left(places, place),
            bisect_left(places, (*place[:-1], place[-1] + 1)) if place else len(places),
        )
        for place, prefix, type_name in structs
    )
    return Flat(tuple(column for _, column in leaves), tuple(parts), {})


def _below(
    place: tuple[int, ...], name: str, kind: Struct | Array
) -> Iterator[tuple[tuple[int, ...], str, Type]]:
    """Yield the place, name and type of each part of a struct or array."""
    if isinstance(kind, Struct):
        prefix = name and name + "."
        for number, (own, below) in enumerate(kind.fields):
            yield (*place, number), prefix + own, below
    else:
        for number in range(kind.length):
            yield (*place, number), f"{name}[{number}]", kind.element


def leaves_of(name: str, kind: Type) -> Iterator[tuple[str, Type]]:
    """Yield the names and types of the numbers and strings in a field, in order."""
    if isinstance(kind, Struct | Array):
        for _, own, below in _below((), name, kind):
            yield from leaves_of(own, below)
    else:
        yield name, kind
