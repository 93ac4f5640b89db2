"""The first rows of a table, decoded once and shared by all checks of the beginning.

They have all columns that may be a time, a rate or an orientation.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, cast

from quatprop.errors import QuatpropError
from quatprop.logs.matching.find import column_beside, find, marks_of
from quatprop.tables.batches import RowBatch

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.tables.model import Group, Stamp, Table

ENOUGH_ROWS = 20_000
"""Maximum number of rows held; further rows are read again for each check."""


class FirstBatch:
    """The first rows of some columns of a table.

    `stamps`, `groups`: the columns
    """

    def __init__(self, table: Table, stamps: Sequence[Stamp], groups: Sequence[Group]) -> None:
        self._table, self._stamps, self._groups = table, stamps, groups
        self._held: list[RowBatch] = []
        self._rest = table.peek(stamps, groups, is_strict=True)
        self._is_whole = self._is_misfit = False

    def read(self, stamps: Sequence[Stamp], groups: Sequence[Group]) -> Iterator[RowBatch]:
        """Yield times, ns, and groups of columns, from the first row on, without noting losses.

        Rows that cannot be decoded in these columns are omitted.
        """
        count = 0
        if {*stamps} <= {*self._stamps} and {*groups} <= {*self._groups}:
            places = [self._stamps.index(stamp) for stamp in stamps]
            places += [len(self._stamps) + self._groups.index(group) for group in groups]
            while count < len(self._held) or self._read_on():
                rows = self._held[count]
                count += 1
                # Copied, since they are converted in place.
                values = tuple(rows.values[place].copy("K") for place in places)
                yield RowBatch(rows.log_ns, values, rows.watermark_ns)
            if self._is_whole:
                return
        yield from islice(self._table.peek(stamps, groups), count, None)

    def _read_on(self) -> bool:
        """Hold more rows; False if there are no more, enough, or one cannot be decoded."""
        if self._is_whole or self._is_misfit or sum(map(len, self._held)) >= ENOUGH_ROWS:
            return False
        count = len(self._held)
        try:
            self._held += islice(self._rest, 1)
        except QuatpropError:
            self._is_misfit = True
            return False
        self._is_whole = count == len(self._held)
        return not self._is_whole


def first_batch(table: Table, stamps: Sequence[Stamp]) -> FirstBatch:
    """Return the first rows of a table; `stamps`: its possible timestamps."""
    if table.first is None:
        groups = dict.fromkeys(_candidate_groups(table)) if table.is_typed else ()
        table.first = FirstBatch(table, stamps, [*groups])
    return cast("FirstBatch", table.first)


def _candidate_groups(table: Table) -> Iterator[Group]:
    for quantity in ("rate", "quat"):
        for one in find(table, quantity):
            beside = column_beside(table, one.part, one.row.span) or marks_of(one)
            yield from filter(None, (one.sets[0], beside))
