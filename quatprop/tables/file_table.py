"""A file of rows as a table, the only one of its log."""

from __future__ import annotations

from itertools import chain, pairwise
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import MessageError
from quatprop.tables.base import TimedColumns
from quatprop.tables.batches import RowBatch
from quatprop.tables.column_names import parse_name
from quatprop.tables.model import Stamp, Table, TablePart

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from quatprop.arrays import AnyArray, Float64
    from quatprop.provenance import JsonObject
    from quatprop.tables.base import TableLog
    from quatprop.tables.model import Column, Convert, Group, Span, Within


_COUNTED = Stamp(sample_rate=1)
"""Times where nobody asks for them."""


class FileTable(Table):
    """A file of rows as a table.

    `series`: columns and the labels that the rows to read have in them
    """

    name = type = ""

    def __init__(self, log: TableLog, series: tuple[tuple[int, str], ...] = ()) -> None:
        self._log = log
        self._series = series
        self.path = log.path
        self.kind = log.kind
        self.notes = log.notes
        self.matches = {}
        self._columns = tuple(map(parse_name, log.columns()))

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns, by their names."""
        return self._columns

    @property
    def parts(self) -> tuple[TablePart, ...]:
        """The only part: all of the file."""
        return (TablePart("", "", 0, len(self._columns)),)

    def columns_of(self, name: str) -> Group | None:
        """Return the column of a name, as spelled or as a key."""
        spelled = (k for k, one in enumerate(self._columns) if one.text.strip() == name)
        by_key = (k for k, one in enumerate(self._columns) if one.key == name)
        found = next(spelled, next(by_key, None))
        return None if found is None else (found,)

    def of_series(self, labels: Sequence[str], columns: Group = ()) -> FileTable:
        """Return the rows that have some labels in some columns."""
        series = tuple(zip(columns, labels, strict=True))
        return FileTable(self._log, series) if series else self

    def label_columns(self) -> Mapping[int, bool]:
        """Return the columns that begin with text or a whole number, and whether it is a number."""
        return self._log.label_columns()

    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:
        """Return cells of the first rows."""
        return self._log.head(columns)

    def read(
        self,
        stamp: Stamp,
        groups: Sequence[Group],
        convert: Convert,
        within: Within = None,
    ) -> Iterator[RowBatch]:
        """Yield batches in the order of the file, whose stamps stand for the log times."""
        parts = within if isinstance(within, frozenset) else None
        for t_ns, cells in self._log.metered_rows(self._timed(stamp, groups, parts)):
            values = (t_ns, *_split(cells, groups))
            yield self._converted(RowBatch(t_ns, values), convert)

    def _converted(self, rows: RowBatch, convert: Convert) -> RowBatch:
        """Return rows without those that cannot be converted."""
        try:
            return convert(rows)
        except MessageError as error:
            if not error.positions:
                raise
            first_ns, count = int(rows.log_ns[error.positions[0]]), len(error.positions)
            self._log.losses.note("rows", str(error.reason), count, part=first_ns)
            keep = np.delete(np.arange(len(rows)), error.positions)
            return self._converted(rows.rows(keep), convert)

    def peek(
        self,
        stamps: Sequence[Stamp],
        groups: Sequence[Group],
        *,
        is_strict: bool = False,  # noqa: ARG002  # it is the reader that leaves rows out
    ) -> Iterator[RowBatch]:
        """Yield the first rows, and then, but of stdin, all; with times all at once."""
        if not stamps and (first := self.head([k for group in groups for k in group])):
            cells = np.array([[*map(_number, row)] for row in first])
            yield RowBatch(np.arange(len(first)), _split(cells, groups))
        # Text on stdin is read only once.
        if str(self.path) != "-":
            for t_ns, cells in self._log.rows(self._timed((*stamps, _COUNTED)[0], groups)):
                yield RowBatch(t_ns, (*(t_ns for _ in stamps), *_split(cells, groups)))

    def spans(self, stamp: Stamp) -> list[Span] | None:
        """Return which stamps each part of the file has."""
        return self._log.spans(self._timed(stamp, ()))

    def _timed(
        self, stamp: Stamp, groups: Sequence[Group], parts: frozenset[int] | None = None
    ) -> TimedColumns:
        return TimedColumns(tuple(chain.from_iterable(groups)), stamp, parts, self._series)

    def provenance(self) -> JsonObject:
        """Return how the file was made, if this package made it."""
        return self._log.provenance()

    def remark(self, text: str) -> None:
        """Add a remark on the file, as the last one."""
        self._log.remarks = [*(one for one in self._log.remarks if one != text), text]


def _split(cells: Float64, groups: Sequence[Group]) -> tuple[AnyArray, ...]:
    """Return columns by their groups."""
    ends = pairwise(np.cumsum([0, *map(len, groups)]).tolist())
    return tuple(cells[:, begin if end - begin == 1 else slice(begin, end)] for begin, end in ends)


def _number(cell: object) -> float:
    try:
        return float(f"{cell}".replace(",", "."))
    except ValueError:
        return np.nan
