"""Time stamps inside messages, as int64 nanoseconds."""

from __future__ import annotations

from decimal import Decimal
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from quatprop.errors import MessageError, SchemaError
from quatprop.messages.definitions import message_type
from quatprop.messages.schema import TIME, Primitive, Struct, Type, around, at, find, numbers
from quatprop.text import Setting, Text, listed, quoted
from quatprop.times import NS_PER_UNIT

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from quatprop.arrays import AnyArray, Int64, Intp
    from quatprop.containers.base import Channel

SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")
"""Names of the two parts of a time, in ROS 1, ROS 2 and related systems."""

STAMPS = ("header.stamp", "stamp", "timestamp")
"""Where a message may have its time, for types that are not in the table."""


class Stamp(NamedTuple):
    """Which fields of a message are its time.

    Parameters
    ----------
    fields
        Dotted path of one number, or of the seconds and of the nanoseconds.
    unit
        Of one number, or of the first of two: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``.
    """

    fields: tuple[str, ...]
    unit: str = "s"

    @classmethod
    def of_time(cls, place: str) -> Self:
        """Return the stamp in a ROS time at a dotted path."""
        return cls((f"{place}.sec", f"{place}.nanosec"))

    @property
    def place(self) -> str:
        """The dotted path of the time, of which there may be two parts."""
        first = self.fields[0]
        return first if len(self.fields) == 1 else first.rpartition(".")[0]

    def under(self, prefix: str) -> Stamp:
        """Return the same stamp in a message inside another."""
        return Stamp(tuple(prefix + name for name in self.fields), self.unit)

    def ns(self, columns: Sequence[AnyArray], path: Path | str) -> Int64:
        """Return the time of every message.

        Parameters
        ----------
        columns
            The `fields`, shape ``(N,)`` each.
        path
            The log, for errors.

        Returns
        -------
        ndarray
            Shape ``(N,)``, int64 ns. Nanoseconds of a second or more carry over.

        Raises
        ------
        MessageError
            A stamp is not finite or does not fit in 64 bits of nanoseconds.

        Examples
        --------
        >>> Stamp.of_time("stamp").ns([np.array([2]), np.array([5])], "log")
        array([2000000005])
        """
        t_ns = self._scaled(columns[0], path)
        for nanoseconds in columns[1:]:
            np.add(t_ns, nanoseconds, out=t_ns, dtype=np.int64, casting="unsafe")
        return t_ns

    def _scaled(self, column: AnyArray, path: Path | str) -> Int64:
        scale = NS_PER_UNIT[self.unit]
        if column.dtype == np.object_:
            return self._exact(column, scale, path)
        floating = column.dtype.kind == "f"
        if floating or column.dtype.itemsize == np.dtype(np.int64).itemsize:
            limit = np.iinfo(np.int64).max // scale
            # Written so that NaN is refused too.
            fits = (column > -limit) & (column < limit)
            if not fits.all():
                raise self._overflow(column, np.flatnonzero(~fits), path)
        t_ns: Int64
        if not floating:
            t_ns = np.multiply(column, scale, dtype=np.int64, casting="unsafe")
            return t_ns
        whole = np.floor(column).astype(np.int64)
        t_ns = whole * scale
        t_ns += np.rint((column - whole) * scale).astype(np.int64)
        return t_ns

    def _exact(self, column: AnyArray, scale: int, path: Path | str) -> Int64:
        """Return the times of integers and decimals."""
        limit = np.iinfo(np.int64).max // scale
        bad = [row for row, value in enumerate(column) if not -limit < value < limit]
        if bad:
            raise self._overflow(column, np.array(bad), path)
        whole = [int((Decimal(value) * scale).to_integral_value()) for value in column]
        return np.array(whole, np.int64)

    def _overflow(self, column: AnyArray, positions: Intp, path: Path | str) -> MessageError:
        return MessageError(
            path,
            Text(
                f"the time {column[positions[0]]} {self.unit} in {listed(self.fields)} does not "
                f"fit in 64 bits of nanoseconds; choose {Setting('clock', 'log')} or another "
                f"{Setting('time_field')}",
            ),
            positions.tolist(),
        )


def stamp_of(place: str, kind: Type) -> Stamp | None:
    """Return the stamp in a time, or None where it is not one.

    Parameters
    ----------
    place
        Dotted path of a struct of seconds and nanoseconds, or of a time as text.
    kind
        Its type.
    """
    if kind == TIME:
        return Stamp((place,), "ns")
    match kind:
        case Struct(fields=((seconds, Primitive() as first), (nanoseconds, Primitive() as second))):
            are_integers = first.code[0] in "iu" and second.code[0] in "iu"
            if are_integers and seconds in SECONDS and nanoseconds in NANOSECONDS:
                return Stamp((f"{place}.{seconds}", f"{place}.{nanoseconds}"))
    return None


def stamps_around(root: Struct, name: str) -> tuple[Stamp, ...]:
    """Return the stamps of the structs around a field, the nearest first.

    Parameters
    ----------
    root
        The message.
    name
        Dotted path of the field.
    """
    stamps = []
    for prefix, kind in around(root, name):
        places = ((place, find(kind, place)) for place in STAMPS)
        own = (stamp_of(prefix + place, field) for place, field in places if field is not None)
        stamps += [stamp for stamp in own if stamp is not None][:1]
    return tuple(stamps)


def time_field_at(
    channel: Channel, time_field: str, unit: str | None, path: Path | str
) -> Stamp | None:
    """Return the stamp at a dotted path.

    Parameters
    ----------
    channel
        A topic.
    time_field
        Path of a ``time`` of seconds and nanoseconds, or of one number.
    unit
        Of one number: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; None where it is not declared.
    path
        The log, for errors.

    Returns
    -------
    Stamp or None
        None where the unit of one number is not declared.

    Raises
    ------
    SchemaError
        There is no such field, or it is not a time.
    """
    _, kind = at(message_type(channel, path), time_field, path)
    if (stamp := stamp_of(time_field, kind)) is not None:
        return stamp
    if (shape := numbers(kind)) is None or shape[1] != 1:
        raise SchemaError(
            path,
            f"field {quoted(time_field)} of {quoted(channel.type_name)} is not a time; "
            "name a time of seconds and nanoseconds, or a number",
        )
    return None if unit is None else Stamp((time_field,), unit)
