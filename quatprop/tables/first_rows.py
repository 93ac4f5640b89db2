"""The first rows of a table, decoded once for all that looks at them."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

from quatprop.containers.merge import Columns
from quatprop.errors import QuatpropError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.tables.model import Group, Stamp, Table

ENOUGH_ROWS = 20_000
"""Rows that are held at most; who looks at more of them reads those by itself."""


class FirstRows:
    """The first rows of a table: all columns that may be looked at, decoded together.

    `stamps`, `groups`: these columns
    """

    def __init__(self, table: Table, stamps: Sequence[Stamp], groups: Sequence[Group]) -> None:
        self._table, self._stamps, self._groups = table, stamps, groups
        self._held: list[Columns] = []
        self._rest = table.peek(stamps, groups, is_strict=True)
        self._rows = 0
        self._is_whole = self._is_misfit = False

    def read(self, stamps: Sequence[Stamp], groups: Sequence[Group]) -> Iterator[Columns]:
        """Yield times, ns, and groups of columns, from the first row on; nothing is noted.

        Rows that do not fit are left out: those of other columns than these are not.
        """
        count = 0
        if {*stamps} <= {*self._stamps} and {*groups} <= {*self._groups}:
            places = [self._stamps.index(stamp) for stamp in stamps]
            places += [len(self._stamps) + self._groups.index(group) for group in groups]
            while count < len(self._held) or self._read_on():
                rows = self._held[count]
                count += 1
                # They are converted in place.
                values = tuple(rows.values[place].copy("K") for place in places)
                yield Columns(rows.log_ns, values, rows.not_before_ns)
            if self._is_whole:
                return
        yield from islice(self._table.peek(stamps, groups), count, None)

    def _read_on(self) -> bool:
        """Hold more rows; False where there are no more, enough, or some that do not fit."""
        if self._is_whole or self._is_misfit or self._rows >= ENOUGH_ROWS:
            return False
        try:
            rows = next(self._rest, None)
        except QuatpropError:
            self._is_misfit = True
            return False
        if rows is None:
            self._is_whole = True
            return False
        self._held.append(rows)
        self._rows += len(rows)
        return True
