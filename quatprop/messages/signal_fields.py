"""Which fields of a message are a rate or an orientation.

Recognised types (:mod:`quatprop.messages.message_types`) are found at the top of a message and
inside it; any other field can be named.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Literal, TypeAlias

from quatprop.conventions.layout import SCALAR_FIRST, SCALAR_LAST, Layout
from quatprop.errors import SchemaError
from quatprop.messages.decoders import DECODERS
from quatprop.messages.definitions import message_type
from quatprop.messages.message_types import (
    MESSAGE_TYPES,
    OrientationField,
    RateField,
    SignalFields,
    fields_of_type,
)
from quatprop.messages.schema import Struct, Type, find, numbers, structs
from quatprop.messages.stamps import Stamp, stamps_around
from quatprop.text import quoted

if TYPE_CHECKING:
    from pathlib import Path

    from quatprop.containers.base import Channel

Kind: TypeAlias = Literal["rate", "orientation"]

AXES = 3
"""Numbers in a rate."""

COMPONENTS = 4
"""Numbers in a quaternion."""


def signal_fields(channel: Channel, path: Path | str, kind: Kind) -> list[SignalFields]:
    """Return the fields of recognised types that messages are or contain.

    Parameters
    ----------
    channel
        A topic.
    path
        The log, for errors.
    kind
        Which field they must have.

    Returns
    -------
    list of SignalFields
        Outermost first, with paths from the root of the message; what a version of a type lacks is
        None. Empty where the encoding is not read or no recognised type is found.

    Raises
    ------
    SchemaError
        The definition of a recognised type cannot be read.
    """
    row = fields_of_type(channel.type_name)
    is_recognised = row is not None and getattr(row, kind) is not None
    # The text of the definition tells cheaply that no recognised type is inside.
    is_named = any(name.rpartition("/")[2].encode() in channel.schema for name in MESSAGE_TYPES)
    if channel.encoding not in DECODERS or not (is_recognised or is_named):
        return []
    try:
        root = message_type(channel, path)
    except SchemaError:
        if is_recognised:
            raise
        return []
    return list(_recognised(root, kind))


def fields_beside(channel: Channel, rate_field: str, path: Path | str) -> SignalFields:
    """Return what else is in the part of a message that a rate is in."""
    for fields in signal_fields(channel, path, "rate"):
        if fields.rate and fields.rate.name == rate_field:
            return fields
    return SignalFields()


def rate_fields(channel: Channel, path: Path | str) -> list[RateField]:
    """Return the body rates of recognised types in the messages of a channel.

    Raises
    ------
    SchemaError
        The definition of a recognised type cannot be read.
    """
    return [fields.rate for fields in signal_fields(channel, path, "rate") if fields.rate]


def orientation_fields(channel: Channel, path: Path | str) -> list[OrientationField]:
    """Return the orientations of recognised types in the messages of a channel.

    Raises
    ------
    SchemaError
        The definition of a recognised type cannot be read.
    """
    recognised = signal_fields(channel, path, "orientation")
    return [fields.orientation for fields in recognised if fields.orientation]


def rate_field_at(channel: Channel, rate_field: str, path: Path | str) -> RateField | None:
    """Return the rate at a dotted path, or None where this channel has no such field.

    Parameters
    ----------
    channel
        A topic.
    rate_field
        Path of three numbers, or three paths with commas between them.
    path
        The log, for errors.

    Returns
    -------
    RateField or None
        That of a recognised type where the path leads to its rate; otherwise with the unit in its
        name, and with the stamps of the headers around it.

    Raises
    ------
    SchemaError
        The field is there but is not three numbers.
    """
    names = tuple(name.strip() for name in rate_field.split(","))
    root = _root_with(channel, names, path)
    if root is None:
        return None
    for fields in _recognised(root, "rate"):
        if fields.rate and fields.rate.fields == names:
            return fields.rate
    if sum(_count(find(root, name)) for name in names) != AXES:
        raise SchemaError(
            path,
            f"field {quoted(rate_field)} of {quoted(channel.type_name)} is not three numbers; "
            "name a field of x, y, z or three numbers as a,b,c",
        )
    from quatprop.tables.matching.column_names import rate_unit_of

    return RateField(names, unit=rate_unit_of(names), stamps=stamps_around(root, names[0]))


def orientation_field_at(
    channel: Channel, quat_field: str, path: Path | str
) -> OrientationField | None:
    """Return the orientation at a dotted path, or None where this channel has no such field.

    Parameters
    ----------
    channel
        A topic.
    quat_field
        Path of a struct with fields w, x, y, z, or of an array of four numbers.
    path
        The log, for errors.

    Returns
    -------
    OrientationField or None
        That of a recognised type where the path leads to it; otherwise with the stamps of
        the headers around it, and without a layout for an array.

    Raises
    ------
    SchemaError
        The field is there but is not a quaternion.
    """
    root = _root_with(channel, (quat_field,), path)
    if root is None:
        return None
    for fields in _recognised(root, "orientation"):
        if fields.orientation and fields.orientation.name == quat_field:
            return fields.orientation
    components, layout = _quaternion(root, quat_field)
    if not components:
        raise SchemaError(
            path,
            f"field {quoted(quat_field)} of {quoted(channel.type_name)} is not a quaternion; "
            "name a field with parts w, x, y, z or an array of four numbers",
        )
    stamps = stamps_around(root, components[0])
    return OrientationField(quat_field, layout, fields=components, stamps=stamps)


def _root_with(channel: Channel, names: tuple[str, ...], path: Path | str) -> Struct | None:
    """Return the definition of a channel's messages if it has all of some fields."""
    if channel.encoding not in DECODERS:
        return None
    try:
        root = message_type(channel, path)
    except SchemaError:
        return None
    return None if any(find(root, name) is None for name in names) else root


@lru_cache(maxsize=256)
def _recognised(root: Struct, kind: Kind) -> tuple[SignalFields, ...]:
    """Return the fields of recognised types in a message, but for types inside such types."""
    found: dict[str, SignalFields] = {}
    for prefix, struct in structs(root):
        row = fields_of_type(struct.name)
        if row is None or any(prefix.startswith(outer) for outer in found):
            continue
        fields = _placed(row, root, prefix)
        if getattr(fields, kind) is not None:
            found[prefix] = fields
    return tuple(found.values())


def _placed(row: SignalFields, root: Struct, prefix: str) -> SignalFields:
    """Return a row with its paths from the root; what this version of its type lacks is None."""

    def existing(name: str | None) -> str | None:
        has_it = name is not None and find(root, prefix + name) is not None
        return f"{prefix}{name}" if has_it else None

    def stamps_for(name: str) -> tuple[Stamp, ...]:
        stamps = (stamp.under(prefix) for stamp in row.stamps)
        own = (s for s in stamps if all(find(root, field) is not None for field in s.fields))
        return tuple(dict.fromkeys((*own, *stamps_around(root, name))))

    rate, orientation, acceleration = row.rate, row.orientation, row.acceleration
    if rate is not None:
        names = tuple(prefix + name for name in rate.fields)
        rate = rate._replace(
            fields=names,
            stamps=stamps_for(names[0]),
            absent=existing(rate.absent),
            span=rate.span and rate.span.under(prefix),
            burst=rate.burst and rate.burst.under(prefix),
        )
        rate = rate if _is_rate(rate, root) else None
    if orientation is not None:
        components, layout = _quaternion(root, prefix + orientation.name)

        def counted(name: str | None, *counts: int) -> str | None:
            name = existing(name)
            return name if name and _count(find(root, name)) in counts else None

        orientation = orientation._replace(
            name=prefix + orientation.name,
            layout=layout or orientation.layout,
            absent=existing(orientation.absent),
            covariance=counted(orientation.covariance, 9, 36),
            position=counted(orientation.position, AXES),
            fields=components,
            stamps=stamps_for(prefix + orientation.name),
        )
        orientation = orientation if components else None
    if acceleration is not None:
        name = existing(acceleration.name)
        absent = existing(acceleration.absent)
        acceleration = (name and acceleration._replace(name=name, absent=absent)) or None
    return SignalFields(rate, orientation, acceleration)


def _is_rate(rate: RateField, root: Struct) -> bool:
    """Tell whether this version of a type has the fields of its row."""
    counts = [_count(find(root, name)) for name in rate.fields]
    if rate.burst is None:
        needed = rate.span.fields if rate.span else ()
        is_vector = sum(counts) == AXES
    else:
        needed = rate.burst.fields
        is_vector = len(set(counts)) == 1 and counts[0] > 0
    return is_vector and all(_count(find(root, name)) == 1 for name in needed)


def _quaternion(root: Struct, name: str) -> tuple[tuple[str, ...], Layout | None]:
    """Return the paths of the numbers of a quaternion and their order; none for another field."""
    kind = find(root, name)
    shape = numbers(kind)
    if shape is None or shape[1] != COMPONENTS or shape[0].code[0] != "f":
        return (), None
    if not isinstance(kind, Struct):
        return (name,), None
    order = "".join(own for own, _ in kind.fields)
    if sorted(order) != sorted("wxyz"):
        return (), None
    layout = {"wxyz": SCALAR_FIRST, "xyzw": SCALAR_LAST}.get(order)
    return tuple(f"{name}.{part}" for part in "wxyz"), layout


def _count(kind: Type | None) -> int:
    """Return how many equal numbers a field is, 0 where it is not."""
    shape = numbers(kind)
    return 0 if shape is None else shape[1]
