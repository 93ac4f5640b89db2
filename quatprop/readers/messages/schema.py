"""Message definitions as trees of types, and dotted paths into them."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from quatprop.base.errors import SchemaError
from quatprop.base.text import did_you_mean, listed, quoted
from quatprop.readers.tables.model import Column, TablePart

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.readers.messages.blocks import Channel


MAX_DEPTH = 50
"""Deeper nested definitions are refused: searches recurse, and real definitions are flatter."""

MAX_SEARCHED_ITEMS = 16
"""Fixed arrays of structs or arrays are searched up to this length."""

_NAME_PART = re.compile(r"[./]|::")
_KEY = re.compile(r"(?:^|(?<=.)\.)([^.\[\]]+)|\[(\d+)\]", re.ASCII)


class BadDefinitionError(Exception):
    """A definition cannot be used; the message states the reason but not the log."""


@dataclass(frozen=True, slots=True)
class Primitive:
    """A number.

    `code`: NumPy's type code without byte order: ``"f8"``, ``"u4"``, ``"b1"``
    `size`: bytes
    """

    code: str
    size: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", int(self.code[1:]))


class TextNumber(Primitive):
    """A number written as text."""

    __slots__ = ()


TIME = Primitive("M8")
"""A time written as text, read as int64 ns."""


@dataclass(frozen=True, slots=True)
class String:
    """A string.

    `wide`: whether its characters are wider than a byte
    """

    wide: bool = False


@dataclass(frozen=True, slots=True)
class Unknown:
    """A type without a definition; an error only if a wanted field follows it."""

    name: str


@dataclass(frozen=True, slots=True, eq=False)
class Struct:
    """A message or a nested message; compared by identity, which makes a fast dictionary key.

    `name`: type name, ``package/msg/Name``
    `fields`: names and types, in the order of encoding
    """

    name: str
    fields: tuple[tuple[str, Type], ...]

    def field(self, name: str) -> Type | None:
        """Return the type of a field, or None."""
        return next((kind for own, kind in self.fields if own == name), None)


@dataclass(frozen=True, slots=True, eq=False)
class Array:
    """A fixed number of elements."""

    element: Type
    length: int


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """A number of elements that differs from message to message."""

    element: Type


Type: TypeAlias = Primitive | String | Unknown | Struct | Array | Sequence
KeyPath: TypeAlias = tuple[str | int, ...]
"""A dotted path as field names and array indices."""


@lru_cache(maxsize=1024)
def ros_name(type_name: str) -> str:
    """Return the ROS spelling of a type name, ``package/msg/Name``."""
    parts = [part for part in _NAME_PART.split(type_name) if part != "msg"]
    return "/msg/".join(parts[-2:])


@lru_cache(maxsize=1024)
def key_path_of(field_path: str) -> KeyPath | None:
    """Return the key path of a dotted path; None if the text is no dotted path."""
    names: list[str | int] = []
    end = 0
    for match in _KEY.finditer(field_path):
        if match.start() != end:
            return None
        end = match.end()
        name, index = match.groups()
        names.append(name if index is None else int(index))
    return tuple(names) if names and end == len(field_path) else None


@lru_cache(maxsize=1024)
def find(root: Struct, field_path: str) -> Type | None:
    """Return the type of the field at a dotted path; None if there is none."""
    here: Type | None = root
    for key in key_path_of(field_path) or ("",):
        here = None if here is None else _child(here, key)
    return here


def field_at(root: Struct, field_path: str, path: Path | str) -> tuple[KeyPath, Type]:
    """Return the key path and the type of a field.

    `field_path`: such as ``"header.stamp.sec"`` or ``"covariance[0]"``
    """
    key_path = key_path_of(field_path)
    if key_path is None:
        raise SchemaError(
            path, f"{quoted(field_path)} is not a field path; write it as a.b.c or a[0].b"
        )
    kind = find(root, field_path)
    if kind is None:
        raise SchemaError(path, _no_such_field(root, field_path, key_path))
    return key_path, kind


@lru_cache(maxsize=1024)
def numeric_layout(kind: Type | None) -> tuple[Primitive, int] | None:
    """Return the type and count of the numbers in `kind`; None if they are not of one type.

    A struct such as ``geometry_msgs/Vector3`` is three float64. Numbers of one type have no gaps in
    any encoding, so they are fetched at once.
    """
    if isinstance(kind, Primitive):
        return kind, 1
    if isinstance(kind, Array):
        inner = numeric_layout(kind.element)
        return inner and (inner[0], inner[1] * kind.length)
    if isinstance(kind, Struct):
        parts = [numeric_layout(part) for _, part in kind.fields]
        present = [part for part in parts if part is not None]
        if len(present) == len(parts) and len({part[0] for part in present}) == 1:
            return present[0][0], sum(count for _, count in present)
    return None


A_LIST = (
    "it is a list of any length, which is not read from such messages; record an array of fixed "
    "length, or write the messages as JSON lines, of which lists are read"
)
"""What to say of a list of numbers."""


def refuse_list(root: Struct, field_path: str, path: Path | str) -> None:
    """Refuse a field whose number of numbers differs from message to message."""
    kind = find(root, field_path)
    if isinstance(kind, Sequence) and isinstance(kind.element, Primitive):
        name = f"field {quoted(field_path)} of {quoted(root.name)}"
        raise SchemaError(path, f"{name} cannot be used: {A_LIST}")


def numeric_layout_at(
    channel: Channel, root: Struct, field_path: str, path: Path | str
) -> tuple[KeyPath, Type, Primitive, int]:
    """Return key path, type, number type and number count of a field of numbers of one type."""
    key_path, kind = field_at(root, field_path, path)
    shape = numeric_layout(kind)
    if shape is None:
        raise SchemaError(
            path,
            f"field {quoted(field_path)} of {quoted(channel.type_name)} is not made of equal "
            "numbers; name a number, or a struct or fixed array of them",
        )
    return key_path, kind, *shape


def _child(kind: Type, key: str | int) -> Type | None:
    if isinstance(kind, Struct) and isinstance(key, str):
        return kind.field(key)
    if isinstance(kind, Array) and isinstance(key, int) and key < kind.length:
        return kind.element
    return None


def _no_such_field(root: Struct, field_path: str, key_path: KeyPath) -> str:
    """Return the sentence for a dotted path without a field, which lists the existing fields."""
    here: Type = root
    for key in key_path:
        child = _child(here, key)
        if child is None:
            break
        here = child
    no_field = f"{quoted(root.name)} has no field {quoted(field_path)}"
    if isinstance(here, Struct):
        names = [name for name, _ in here.fields]
        hint = did_you_mean(str(key), names)
        return f"{no_field}; {quoted(here.name)} has {listed(names)}{hint}"
    if isinstance(here, Array):
        return f"{no_field}; the array there takes an index from [0] to [{here.length - 1}]"
    if isinstance(here, Sequence) and isinstance(here.element, Primitive):
        return f"{no_field} in every message: {A_LIST}"
    if isinstance(here, Sequence):
        return f"{no_field} in every message: a sequence may be empty; name a field outside it"
    return f"{no_field}; a number or a string has no fields"


# Flatten message definitions to table columns.


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
