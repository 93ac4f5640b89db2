"""A file of rows: a log with one table. Subclasses read the rows of a format."""

from __future__ import annotations

from abc import abstractmethod
from contextlib import suppress
from functools import cached_property, lru_cache
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, Self

import numpy as np

from quatprop.errors import MessageError, UnsupportedLogError, UsageError
from quatprop.progress import with_progress
from quatprop.tables.batches import RowBatch, without_misfits
from quatprop.tables.column_names import parse_name
from quatprop.tables.counters import counted_rows
from quatprop.tables.log import Log
from quatprop.tables.model import Stamp, Table, TablePart
from quatprop.text import Remark, Setting, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from fractions import Fraction
    from pathlib import Path

    from quatprop.arrays import AnyArray, Float64, Int64
    from quatprop.tables.model import Column, Convert, Group, Within

    Batches = Iterator[tuple[Int64, Float64]]


OTHER_DATES = "dates that are not of ISO 8601"
"""The unit of a column of dates in an unknown format."""

_COUNTED = Stamp(sample_rate=1)
"""A timestamp for rows of which the times are not needed."""


@lru_cache(maxsize=16)
def _matches_of(_columns: tuple[Column, ...]) -> dict[object, Any]:
    """Return the shared cache of matches in columns, which many logs have in common."""
    return {}


class TimedColumns(NamedTuple):
    """Columns of a file to read as numbers, and as timestamps.

    `parts`: the parts of :meth:`Table.spans` to read; None: all
    """

    numbers: tuple[int, ...]
    stamp: Stamp
    parts: frozenset[int] | None = None

    @property
    def used(self) -> set[int]:
        """All columns that are needed."""
        return {*self.stamp.columns, *self.numbers, *(k for k, _ in self.stamp.series)}


class TableLog(Log, Table):
    """Rows of named or numbered columns: text, Arrow, NumPy and JSON Lines files.

    `other_rows`: number of rows of other series skipped so far
    """

    name = type = ""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._losses_at_opening: int | None = None
        self.other_rows = 0

    def _forget_earlier_reading(self) -> None:
        """Remove the losses of rows that will be read again."""
        self.other_rows = 0
        if self._losses_at_opening is None:
            self._losses_at_opening = len(self.losses)
        self.losses.restart(self._losses_at_opening)

    def tables(self, topic: str | None = None) -> list[Self]:
        """Return the file as the only table, which has no topic."""
        return [] if topic is not None else [self]

    @property
    @abstractmethod
    def names(self) -> list[str]:
        """Column names in order; ``"0"``, ``"1"``... without a header."""

    @cached_property
    def columns(self) -> Sequence[Column]:
        """The columns, parsed from their names."""
        return tuple(map(parse_name, self.names))

    @cached_property
    def matches(self) -> dict[object, Any]:  # type: ignore[override]
        """Cache of matches in the columns, shared by tables with the same columns."""
        return _matches_of(tuple(self.columns))

    @property
    def parts(self) -> Sequence[TablePart]:
        """The only part: the whole file."""
        return (TablePart("", "", 0, len(self.columns)),)

    def columns_of(self, name: str) -> Group | None:
        """Return a column by its exact name or its key, or None."""
        spelled = (k for k, one in enumerate(self.columns) if one.text.strip() == name)
        by_key = (k for k, one in enumerate(self.columns) if one.key == name)
        found = next(spelled, next(by_key, None))
        return None if found is None else (found,)

    def row_count(self) -> int | None:
        """Return the approximate number of rows; None if unknown before reading."""
        return None

    def read(
        self,
        stamp: Stamp,
        groups: Sequence[Group],
        convert: Convert,
        within: Within = None,
    ) -> Iterator[RowBatch]:
        """Yield batches in the order of the file; log times are the timestamps."""
        parts = within if isinstance(within, frozenset) else None
        rows = self._timed_rows(stamp, groups, parts)
        for batch in with_progress(rows, self.row_count(), len):
            yield without_misfits(convert, batch, self._leave_out)

    def _leave_out(self, rows: RowBatch, error: MessageError) -> RowBatch:
        """Return rows without those that cannot be converted, which are noted as losses."""
        first_ns, count = int(rows.log_ns[error.positions[0]]), len(error.positions)
        self.losses.note("rows", str(error.reason), count, part=first_ns)
        return rows.without(error.positions)

    def peek(
        self,
        stamps: Sequence[Stamp],
        groups: Sequence[Group],
        *,
        is_strict: bool = False,  # noqa: ARG002  # misfits are omitted while reading
    ) -> Iterator[RowBatch]:
        """Yield the first rows, and then all rows, except of stdin."""
        if not stamps and (first := self.head([k for group in groups for k in group])):
            cells = np.array([*map(numbers_of, first)])
            yield RowBatch(np.arange(len(first)), _split(cells, groups))
        # stdin can be read only once.
        if str(self.path) != "-":
            for rows in self._timed_rows((*stamps, _COUNTED)[0], groups):
                times = (rows.log_ns for _ in stamps)
                yield RowBatch(rows.log_ns, (*times, *rows.values[1:]))

    def remark(self, code: str, text: str) -> None:
        """Add a remark on the file; an equal one is replaced."""
        self.remarks = [*(one for one in self.remarks if one != text), Remark(code, text)]

    def _timed_rows(
        self, stamp: Stamp, groups: Sequence[Group], parts: frozenset[int] | None = None
    ) -> Iterator[RowBatch]:
        """Yield times, ns, and groups of columns; rows that do not fit are noted as losses."""
        columns = TimedColumns(tuple(chain.from_iterable(groups)), stamp, parts)
        self._forget_earlier_reading()
        batches = self._stored_rows(columns)
        if stamp.series:
            batches = self._of_series(batches, stamp)
        if stamp.columns and stamp.sample_rate is not None:
            batches = self._counted(batches, stamp.columns[0], stamp.sample_rate)
        for t_ns, numbers in batches:
            utc_ns = t_ns - stamp.utc_offset_ns if stamp.utc_offset_ns else t_ns
            yield RowBatch(utc_ns, (utc_ns, *_split(numbers, groups)))

    def _counted(self, batches: Batches, counter: int, rate: Fraction | float) -> Batches:
        """Yield rows with counts replaced by times."""
        name = quoted(self.names[counter])

        def note_lost(count: int) -> None:
            self.remark(
                "counter-gaps", f"{count} sample{'s' * (count > 1)} lost by the counter {name}"
            )

        try:
            yield from counted_rows(batches, rate, note_lost)
        except OverflowError:
            raise UnsupportedLogError(
                self.path,
                f"at {float(rate):g} Hz, the counts in column {name} do not fit in int64 ns; count "
                f"rows with {Setting('sample_rate', f'{float(rate):g}')} and "
                f"{Setting('time_col', 'none')}",
            ) from None

    def _of_series(self, batches: Batches, stamp: Stamp) -> Batches:
        """Yield rows of a series, and remark on the number of others."""
        count = 0
        for batch in batches:
            count += len(batch[0])
            yield batch
        each = (f"{quoted(label)} in column {quoted(self.names[k])}" for k, label in stamp.series)
        which = " and ".join(each)
        if not count:
            raise UsageError(
                f"{plain(self.path)}: no row is of the series {which}; check {Setting('series')}"
            )
        remark = f"{self.other_rows} rows of other series than {which} were not read"
        if self.other_rows and remark not in self.remarks:
            self.remarks = [*self.remarks, Remark("other-series", remark)]

    @abstractmethod
    def _stored_rows(self, columns: TimedColumns) -> Batches:
        """Yield timestamps, ns, or counts, ``(N,)``, and stored numbers, ``(N, k)``.

        Rows that do not fit are noted in :attr:`losses`.
        """


def refuse_second_file(path: Path, begin: int) -> NoReturn:
    """Refuse a file with another one joined to it, which begins at a byte."""
    reason = f"another file begins in it at byte {begin}; split it there into two"
    raise UnsupportedLogError(path, reason)


def _split(cells: Float64, groups: Sequence[Group]) -> tuple[AnyArray, ...]:
    """Return columns by group; see :data:`quatprop.tables.model.Group`."""
    ends = pairwise(np.cumsum([0, *map(len, groups)]).tolist())
    return tuple(cells[:, begin if end - begin == 1 else slice(begin, end)] for begin, end in ends)


def numbers_of(cells: Sequence[object]) -> Float64:
    """Return the numbers in cells; NaN for other text."""
    numbers = np.full(len(cells), np.nan)
    for k, cell in enumerate(cells):
        with suppress(ValueError):
            numbers[k] = float(f"{cell}".replace(",", "."))
    return numbers
