"""Message definitions as trees of types, and dotted paths into them."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

from quatprop.errors import SchemaError
from quatprop.text import did_you_mean, listed, quoted

if TYPE_CHECKING:
    from pathlib import Path

    from quatprop.messages.blocks import Channel

MAX_DEPTH = 50
"""Definitions nested deeper than this are refused: none are in practice, and searches recurse."""

MAX_SEARCHED_ITEMS = 16
"""A search looks into the elements of fixed arrays up to this length."""

_NAME_PART = re.compile(r"[./]|::")
_STEP = re.compile(r"(?:^|(?<=.)\.)([^.\[\]]+)|\[(\d+)\]", re.ASCII)


class BadDefinitionError(Exception):
    """A definition cannot be used; says why, without naming the log."""


@dataclass(frozen=True, slots=True)
class Primitive:
    """A number, of one size everywhere.

    `code`: numpy's type string without byte order: ``"f8"``, ``"u4"``, ``"b1"``
    `size`: bytes
    """

    code: str
    size: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", int(self.code[1:]))


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
    """A type without a definition; an error only where a wanted field lies behind it."""

    name: str


@dataclass(frozen=True, slots=True, eq=False)
class Struct:
    """A message or a part of one; compared by identity, to be cheap as a dictionary key.

    `name`: type name, ``package/msg/Name``
    `fields`: names and types, in the order of the bytes
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
Steps: TypeAlias = tuple[str | int, ...]


@lru_cache(maxsize=1024)
def ros_name(type_name: str) -> str:
    """Return the name of a type in ROS; of other spellings, package and name count."""
    parts = [part for part in _NAME_PART.split(type_name) if part != "msg"]
    return "/msg/".join(parts[-2:])


@lru_cache(maxsize=1024)
def steps(field_path: str) -> Steps | None:
    """Return the names and indices of a dotted path, or None for another text."""
    names: list[str | int] = []
    end = 0
    for match in _STEP.finditer(field_path):
        if match.start() != end:
            return None
        end = match.end()
        name, index = match.groups()
        names.append(name if index is None else int(index))
    return tuple(names) if names and end == len(field_path) else None


@lru_cache(maxsize=1024)
def find(root: Struct, field_path: str) -> Type | None:
    """Return the type that a dotted path leads to, or None where it leads nowhere."""
    here: Type | None = root
    for step in steps(field_path) or ("",):
        here = None if here is None else _below(here, step)
    return here


def field_at(root: Struct, field_path: str, path: Path | str) -> tuple[Steps, Type]:
    """Return where a dotted path leads.

    `field_path`: such as ``"header.stamp.sec"`` or ``"covariance[0]"``
    """
    way = steps(field_path)
    if way is None:
        raise SchemaError(
            path, f"{quoted(field_path)} is not a field path; write it as a.b.c or a[0].b"
        )
    kind = find(root, field_path)
    if kind is None:
        raise SchemaError(path, _dead_end(root, field_path, way))
    return way, kind


@lru_cache(maxsize=1024)
def numeric_layout(kind: Type | None) -> tuple[Primitive, int] | None:
    """Return the type and count of equal numbers that `kind` is made of, or None if it is not.

    A struct such as ``geometry_msgs/Vector3`` is three float64; equal numbers lie without gaps in
    every encoding, so they are fetched as one.
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


def numeric_layout_at(
    channel: Channel, root: Struct, field_path: str, path: Path | str
) -> tuple[Steps, Type, Primitive, int]:
    """Return where a dotted path leads, the field there, and the equal numbers it is made of."""
    way, kind = field_at(root, field_path, path)
    shape = numeric_layout(kind)
    if shape is None:
        raise SchemaError(
            path,
            f"field {quoted(field_path)} of {quoted(channel.type_name)} is not made of equal "
            "numbers; name a number, or a struct or fixed array of them",
        )
    return way, kind, *shape


def _below(kind: Type, step: str | int) -> Type | None:
    if isinstance(kind, Struct) and isinstance(step, str):
        return kind.field(step)
    if isinstance(kind, Array) and isinstance(step, int) and step < kind.length:
        return kind.element
    return None


def _dead_end(root: Struct, field_path: str, way: Steps) -> str:
    """Return where a dotted path leads nowhere, and what is there instead."""
    here: Type = root
    for step in way:
        below = _below(here, step)
        if below is None:
            break
        here = below
    no_field = f"{quoted(root.name)} has no field {quoted(field_path)}"
    if isinstance(here, Struct):
        names = [name for name, _ in here.fields]
        hint = did_you_mean(str(step), names)
        return f"{no_field}; {quoted(here.name)} has {listed(names)}{hint}"
    if isinstance(here, Array):
        return f"{no_field}; the array there takes an index from [0] to [{here.length - 1}]"
    if isinstance(here, Sequence):
        return f"{no_field} in every message: a sequence may be empty; name a field outside it"
    return f"{no_field}; a number or a string has no fields"
