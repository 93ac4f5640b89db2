"""Time stamps inside messages, as int64 nanoseconds."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from quatprop.errors import MessageError
from quatprop.messages.schema import TIME, Primitive, Struct, around, find
from quatprop.text import listed
from quatprop.times import NS_PER_UNIT

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.messages.schema import Type

SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")
"""Names of the two parts of a time, in the generations of ROS and its neighbours."""


STAMPS = ("header.stamp", "stamp", "timestamp")
"""Where a message keeps its time, when nothing says where."""


@dataclass(frozen=True, slots=True)
class Stamp:
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

    def under(self, prefix: str) -> Stamp:
        """Return the same stamp in a message inside another."""
        return Stamp(tuple(prefix + name for name in self.fields), self.unit)

    def ns(self, columns: Sequence[NDArray[Any]], path: Path | str) -> NDArray[np.int64]:
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
            t_ns += nanoseconds.astype(np.int64)
        return t_ns

    def _scaled(self, column: NDArray[Any], path: Path | str) -> NDArray[np.int64]:
        scale = NS_PER_UNIT[self.unit]
        if column.dtype == np.object_:
            return self._exact(column, scale, path)
        floating = column.dtype.kind == "f"
        if floating or column.dtype.itemsize == np.dtype(np.int64).itemsize:
            limit = np.iinfo(np.int64).max // scale
            # Written so that NaN is refused too.
            fits = (column > -limit) & (column < limit)
            if not fits.all():
                raise self._misfit(column, np.flatnonzero(~fits), path)
        whole = np.floor(column).astype(np.int64) if floating else column.astype(np.int64)
        t_ns: NDArray[np.int64] = whole * scale
        return t_ns + np.rint((column - whole) * scale).astype(np.int64) if floating else t_ns

    def _exact(self, column: NDArray[Any], scale: int, path: Path | str) -> NDArray[np.int64]:
        """Return the times of integers and decimals."""
        limit = np.iinfo(np.int64).max // scale
        bad = [row for row, value in enumerate(column) if not -limit < value < limit]
        if bad:
            raise self._misfit(column, np.array(bad), path)
        whole = [int((Decimal(value) * scale).to_integral_value()) for value in column]
        return np.array(whole, np.int64)

    def _misfit(
        self, column: NDArray[Any], positions: NDArray[np.intp], path: Path | str
    ) -> MessageError:
        return MessageError(
            path,
            f"the time {column[positions[0]]} {self.unit} in {listed(self.fields)} does "
            "not fit in 64 bits of nanoseconds; choose --clock log or another --time-field",
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
    if not isinstance(kind, Struct) or len(kind.fields) != len(("sec", "nanosec")):
        return None
    (seconds, first), (nanoseconds, second) = kind.fields
    integers = all(isinstance(t, Primitive) and t.code[0] in "iu" for t in (first, second))
    if integers and seconds in SECONDS and nanoseconds in NANOSECONDS:
        return Stamp((f"{place}.{seconds}", f"{place}.{nanoseconds}"))
    return None


def stamp_around(root: Struct, name: str) -> Stamp | None:
    """Return the stamp of the nearest struct around a field that has one.

    Parameters
    ----------
    root
        The message.
    name
        Dotted path of the field.
    """
    for prefix, kind in around(root, name):
        for place in STAMPS:
            found = find(kind, place)
            stamp = None if found is None else stamp_of(prefix + place, found)
            if stamp is not None:
                return stamp
    return None
