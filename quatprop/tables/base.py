"""What a table is: named or numbered columns, and which of them to read."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from quatprop.errors import UnsupportedLogError, UsageError
from quatprop.progress import with_progress
from quatprop.tables.counters import counted_rows
from quatprop.tables.log import Log
from quatprop.text import Setting, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from quatprop.arrays import Float64, Int64
    from quatprop.provenance import JsonObject
    from quatprop.tables.file_table import FileTable
    from quatprop.tables.model import Span, Stamp, TableNotes

    Batches = Iterator[tuple[Int64, Float64]]


OTHER_DATES = "dates that are not of ISO 8601"
"""The unit of a column of dates and times of day that nobody can read without being told how."""


class TimedColumns(NamedTuple):
    """Which columns of a table to read as numbers, and which as the time.

    `parts`: which of the parts of :meth:`TableLog.spans` to read; None for all
    `series`: columns and the labels that the rows to read have in them
    """

    numbers: tuple[int, ...]
    stamp: Stamp
    parts: frozenset[int] | None = None
    series: tuple[tuple[int, str], ...] = ()

    @property
    def used(self) -> set[int]:
        """All columns that are needed."""
        return {*self.stamp.columns, *self.numbers, *(k for k, _ in self.series)}


class TableLog(Log):
    """Rows of named or numbered columns: text, Arrow, NumPy and JSON Lines files.

    `other_rows`: how many rows of other series were passed over; grows while the log is read
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._losses_at_opening: int | None = None
        self.other_rows = 0

    def _forget_earlier_reading(self) -> None:
        """Remove the losses of rows that are about to be read again."""
        self.other_rows = 0
        if self._losses_at_opening is None:
            self._losses_at_opening = len(self.losses)
        self.losses.restart(self._losses_at_opening)

    def tables(self, topic: str | None = None) -> list[FileTable]:
        """Return the file as the only table; no topic has a name here."""
        from quatprop.tables.file_table import FileTable

        return [] if topic is not None else [FileTable(self)]

    @property
    @abstractmethod
    def notes(self) -> TableNotes:
        """What is declared besides the column names."""

    @abstractmethod
    def columns(self) -> list[str]:
        """Return the column names in order; ``"0"``, ``"1"``... for a table without a header."""

    @abstractmethod
    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:
        """Return cells of the first rows, as they are stored; empty where they cannot be read."""

    @abstractmethod
    def label_columns(self) -> Mapping[int, bool]:
        """Return the columns that begin with text or a whole number, and whether it is a number."""

    def provenance(self) -> JsonObject:
        """Return how the content came about, as written beside it; empty where it is not."""
        return {}

    def row_count(self) -> int | None:
        """Return about how many rows there are, where that is known without reading them."""
        return None

    def spans(self, columns: TimedColumns) -> list[Span] | None:  # noqa: ARG002  # of some kinds
        """Return which stamps each part of the table has; None where nothing says it."""
        return None

    def metered_rows(self, columns: TimedColumns) -> Batches:
        """Return :meth:`rows`, whose progress an interface may show."""
        return with_progress(self.rows(columns), self.row_count(), lambda batch: len(batch[0]))

    def rows(self, columns: TimedColumns) -> Batches:
        """Yield stamps in ns, shape ``(N,)``, and numbers as stored, shape ``(N, k)``.

        Rows that do not fit are left out and noted in :attr:`losses`.
        """
        batches = self._stored_rows(columns)
        if columns.series:
            batches = self._of_series(batches, columns.series)
        stamp = columns.stamp
        if stamp.columns and stamp.sample_rate is not None:
            return self._counted(batches, columns)
        if stamp.utc_offset_ns:
            return ((t_ns - stamp.utc_offset_ns, numbers) for t_ns, numbers in batches)
        return batches

    def _counted(self, batches: Batches, columns: TimedColumns) -> Batches:
        """Yield rows at the times of their counter."""
        rate = columns.stamp.sample_rate or 1.0
        name = quoted(self.columns()[columns.stamp.columns[0]])

        def note_lost(count: int) -> None:
            remark = f"{count} sample{'s' * (count > 1)} lost by the counter {name}"
            self.remarks = [*(one for one in self.remarks if one != remark), remark]

        try:
            yield from counted_rows(batches, rate, note_lost)
        except OverflowError:
            raise UnsupportedLogError(
                self.path,
                f"at {float(rate):g} Hz, the counts in column {name} do not fit in int64 ns; count "
                f"rows with {Setting('sample_rate', f'{float(rate):g}')} and "
                f"{Setting('time_col', 'none')}",
            ) from None

    def _of_series(self, batches: Batches, series: tuple[tuple[int, str], ...]) -> Batches:
        """Yield rows of a series, and remark on how many there are of others."""
        count = 0
        for batch in batches:
            count += len(batch[0])
            yield batch
        names = self.columns()
        which = " and ".join(f"{quoted(label)} in column {quoted(names[k])}" for k, label in series)
        if not count:
            raise UsageError(
                f"{plain(self.path)}: no row is of the series {which}; check {Setting('series')}"
            )
        remark = f"{self.other_rows} rows of other series than {which} were not read"
        if self.other_rows and remark not in self.remarks:
            self.remarks = [*self.remarks, remark]

    @abstractmethod
    def _stored_rows(self, columns: TimedColumns) -> Batches:
        """Yield :meth:`rows` with the stamps, or the counts of samples, that columns hold."""


def refuse_second_file(path: Path, begin: int) -> NoReturn:
    """Refuse a file to which another one was joined, at a byte."""
    reason = f"another file begins in it at byte {begin}; split it there into two"
    raise UnsupportedLogError(path, reason)
