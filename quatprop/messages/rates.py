"""Which field of a message is a body rate, and which is its time."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from quatprop.errors import SchemaError
from quatprop.messages.decoders import DECODERS
from quatprop.messages.definitions import message_type
from quatprop.messages.known_types import KnownTypes
from quatprop.messages.rate_types import RATES, RateField
from quatprop.messages.schema import at, find, numbers
from quatprop.messages.stamps import Stamp, stamp_around, stamp_of
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.containers.base import Channel
    from quatprop.messages.schema import Struct, Type

AXES = 3
"""Numbers in a rate."""

KNOWN = KnownTypes(RATES)


def rate_fields(channel: Channel, path: Path | str) -> list[RateField]:
    """Return the body rates that messages of known types carry, or carry inside them.

    Parameters
    ----------
    channel
        A topic.
    path
        The log, for errors.

    Returns
    -------
    list of RateField
        Outermost first; empty where the encoding is not read or no known type is found.

    Raises
    ------
    SchemaError
        The definition of a known type cannot be read.
    """
    root = KNOWN.root(channel, path)
    return [] if root is None else list(_found(root))


def rate_field_at(channel: Channel, rate_field: str, path: Path | str) -> RateField | None:
    """Return the rate that a dotted path names, or None where this channel has no such field.

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
        The row of a known type where the path leads to its rate; otherwise without unit, and with
        the stamp of the nearest header around it.

    Raises
    ------
    SchemaError
        The field is there but is not three numbers.
    """
    if channel.encoding not in DECODERS:
        return None
    names = tuple(name.strip() for name in rate_field.split(","))
    try:
        root = message_type(channel, path)
    except SchemaError:
        return None
    kinds = [find(root, name) for name in names]
    if None in kinds:
        return None
    known = next((row for row in _found(root) if row.rate == names), None)
    if known is not None:
        return known
    if sum(_count(kind) for kind in kinds) != AXES:
        raise SchemaError(
            path,
            f"field {quoted(rate_field)} of {quoted(channel.type_name)} is not three numbers; "
            "name a field of x, y, z or three numbers as a,b,c",
        )
    return RateField(names, stamp=stamp_around(root, names[0]))


def time_field_at(
    channel: Channel, time_field: str, unit: str | None, path: Path | str
) -> Stamp | None:
    """Return the stamp that a dotted path names.

    Parameters
    ----------
    channel
        A topic.
    time_field
        Path of a ``time`` of seconds and nanoseconds, or of one number.
    unit
        Of one number: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; None where it is not said.
    path
        The log, for errors.

    Returns
    -------
    Stamp or None
        None where the unit of one number is not said.

    Raises
    ------
    SchemaError
        There is no such field, or it is not a time.
    """
    _, kind = at(message_type(channel, path), time_field, path)
    if (stamp := stamp_of(time_field, kind)) is not None:
        return stamp
    if _count(kind) != 1:
        raise SchemaError(
            path,
            f"field {quoted(time_field)} of {quoted(channel.type_name)} is not a time; "
            "name a time of seconds and nanoseconds, or a number",
        )
    return None if unit is None else Stamp((time_field,), unit)


def _found(root: Struct) -> Iterator[RateField]:
    """Yield the rows of known types in a message."""
    return (_placed(row, root, prefix) for prefix, row in KNOWN.inside(root, _fits))


def _fits(row: RateField, kind: Struct, _prefix: str) -> bool:
    """Tell whether this version of a type has the fields of its row."""
    counts = [_count(find(kind, name)) for name in row.rate]
    if row.burst is None:
        needed = row.span.fields if row.span else ()
        whole = sum(counts) == AXES
    else:
        needed = row.burst.fields
        whole = len(set(counts)) == 1 and counts[0] > 0
    return whole and all(_count(find(kind, name)) == 1 for name in needed)


def _placed(row: RateField, root: Struct, prefix: str) -> RateField:
    """Return a row with its paths from the root; what this version of its type lacks is None."""

    def there(name: str | None) -> str | None:
        found = name is not None and find(root, prefix + name) is not None
        return f"{prefix}{name}" if found else None

    stamp = row.stamp and row.stamp.under(prefix)
    if stamp is None or any(find(root, name) is None for name in stamp.fields):
        stamp = stamp_around(root, prefix + row.rate[0])
    return replace(
        row,
        rate=tuple(prefix + name for name in row.rate),
        stamp=stamp,
        absent=there(row.absent),
        orientation=there(row.orientation),
        orientation_absent=there(row.orientation_absent),
        acceleration=there(row.acceleration),
        acceleration_absent=there(row.acceleration_absent),
        span=row.span and row.span.under(prefix),
        burst=row.burst and row.burst.under(prefix),
    )


def _count(kind: Type | None) -> int:
    """Return how many equal numbers a field is, 0 where it is not."""
    found = None if kind is None else numbers(kind)
    return 0 if found is None else found[1]
