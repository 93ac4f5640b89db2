"""Base class of tables with typed columns: convert record batches to timestamps and numbers.

Subclasses list the columns of a format and read record batches; times, units, text and damage are
handled here.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa

from quatprop.base.arrow_arrays import to_arrow, to_numpy
from quatprop.base.errors import LogError, UnsupportedLogError
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.base.times import NS_PER_S
from quatprop.readers.tables.exact_times import (
    TimestampRangeError,
    nanoseconds,
    row_stamps,
    sum_parts,
)
from quatprop.readers.tables.model import Stamp, TableNotes
from quatprop.readers.tables.table_log import TableLog, TimedColumns
from quatprop.readers.tables.time_units import TIME_OF_DAY
from quatprop.readers.tables.turns import Shown, cells_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.readers.tables.model import Group
    from quatprop.readers.tables.table_log import Batches


# Columns of values: fields of structs and elements of short lists are separate columns.


_LONGEST_LIST = 16


class Leaf(NamedTuple):
    """A column of values.

    `path`: name of the column, followed by the fields of a struct
    `element`: index in a list; None if it is not a list
    `length`: number of elements in the list
    """

    path: tuple[str, ...]
    type: pa.DataType
    element: int | None = None
    length: int = 0

    @property
    def column(self) -> str:
        """Name of the column with its fields."""
        return ".".join(self.path)

    @property
    def name(self) -> str:
        """Name for the user."""
        return self.column if self.element is None else f"{self.column}[{self.element}]"


def element_leaves(path: tuple[str, ...], kind: pa.DataType, length: int) -> list[Leaf]:
    """Return a column of lists as one column for each element, if the lists are short."""
    if is_number(kind) and 1 < length <= _LONGEST_LIST:
        return [Leaf(path, kind, index, length) for index in range(length)]
    return [Leaf(path, pa.list_(kind))]


def values_of(batch: pa.RecordBatch | pa.Table, leaf: Leaf) -> pa.Array | pa.ChunkedArray:
    """Return the values of a column; null if a list is too short or too long."""
    column = batch.column(leaf.path[0])
    if leaf.path[1:] or leaf.element is not None:
        import pyarrow.compute as pc  # slow to import, and not needed for CSV
    if leaf.path[1:]:
        column = pc.struct_field(column, list(leaf.path[1:]))
    if leaf.element is not None:
        lengths = pc.list_value_length(column)
        fits = pc.and_(pc.greater(lengths, leaf.element), pc.less_equal(lengths, leaf.length))
        column = pc.list_element(pc.if_else(fits, column, None), leaf.element)
    return column.dictionary_decode() if pa.types.is_dictionary(column.type) else column


def is_number(kind: pa.DataType) -> bool:
    """Return whether values are numbers."""
    return bool(
        pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal128(kind)
    )


def is_text(kind: pa.DataType) -> bool:
    """Return whether values are text."""
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _unit_of(kind: pa.DataType) -> str:
    """Return the unit of a type of times; ``""`` for other types."""
    if pa.types.is_time(kind):
        return TIME_OF_DAY
    return str(kind.unit) if pa.types.is_timestamp(kind) or pa.types.is_duration(kind) else ""


def is_whole(kind: pa.DataType) -> bool:
    """Return whether values are integers."""
    return bool(pa.types.is_integer(kind) or (pa.types.is_decimal128(kind) and kind.scale == 0))


_HEAD_ROWS = 5000
BATCH_ROWS = 1 << 16
"""Number of rows read at once."""


class DamageError(Exception):
    """The rest of a part cannot be read, for the reason in the message."""


DAMAGE = (pa.ArrowException, OSError, DamageError)
"""Exceptions for damaged files. ArrowException includes failed allocations of damaged lengths."""


class RowGroup(NamedTuple):
    """Rows that are read together, and lost together if damaged.

    `place`: their place, for losses
    `rows`: declared number of rows; 0: unknown
    `batches`: the rows; an integer is a number of rows that are not requested or already lost
    """

    place: str
    rows: int
    batches: Iterable[pa.RecordBatch | int]


class TypedTable(TableLog):
    """Typed, named columns in row groups; see :class:`.TableLog`."""

    kind: str

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._leaves: list[Leaf] = []

    @property
    def names(self) -> list[str]:
        """Column names in order, with fields of structs as ``column.field``."""
        return [leaf.name for leaf in self._leaves]

    @property
    def notes(self) -> TableNotes:
        """Units of columns of times, and the columns of text."""
        return TableNotes(
            units={k: unit for k, leaf in enumerate(self._leaves) if (unit := _unit_of(leaf.type))},
            texts=frozenset(k for k, leaf in enumerate(self._leaves) if is_text(leaf.type)),
        )

    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:
        """Return cells of the first rows; see :class:`.TableLog`."""
        names = self.names
        if any(names.count(names[k]) > 1 for k in columns):
            return []  # refused where they are read
        first = [values[:_HEAD_ROWS] for values in self._first_values(columns)]
        return list(zip(*map(cells_of, first), strict=True))

    def _stored_rows(self, columns: TimedColumns) -> Batches:
        """Yield timestamps and numbers; see :class:`quatprop.readers.tables.table_log.TableLog`."""
        self._refuse_text(columns)
        first = 0
        for group in self._row_groups(columns):
            count = 0
            for batch in self._whole_batches(group):
                if isinstance(batch, int):
                    count += batch
                    continue
                try:
                    rows = batch_rows(batch, self._leaves, columns, first + count)
                except TimestampRangeError:
                    names = listed(self._leaves[k].name for k in columns.stamp.columns)
                    raise UnsupportedLogError(
                        self.path,
                        f"times of column {names} do not fit in int64 ns when they are "
                        f"{columns.stamp.units[0]}; check {Setting('time_unit')}",
                    ) from None
                rows.note(self, columns, first + count)
                if len(rows.t_ns):
                    yield rows.t_ns, rows.numbers
                count += rows.total
            first += count if columns.stamp.series else max(group.rows, count)

    def _whole_batches(self, group: RowGroup) -> Iterator[pa.RecordBatch | int]:
        """Yield the batches of a row group up to damage, which is noted."""
        count = 0
        batches = iter(group.batches)
        while True:
            try:
                batch = next(batches, None)
                if isinstance(batch, pa.RecordBatch):
                    batch.validate()
            except DAMAGE as error:
                rows = max(group.rows - count, 0) or None
                self.losses.note(group.place, f"it is damaged: {plain(error)}", rows)
                return
            if batch is None:
                if count < group.rows:
                    reason = f"it has {count} of the {group.rows} rows that are stated"
                    self.losses.note(group.place, reason, group.rows - count)
                return
            count += batch if isinstance(batch, int) else batch.num_rows
            yield batch

    def _first_values(self, columns: Sequence[int]) -> list[pa.Array]:
        """Return columns of the first rows; empty if they cannot be read."""
        with suppress(*DAMAGE, StopIteration, LogError):
            group = next(self._row_groups(TimedColumns(tuple(columns), Stamp())))
            batch = next(batch for batch in group.batches if isinstance(batch, pa.RecordBatch))
            batch.validate()  # Arrow trusts the declared number of rows
            return [values_of(batch, self._leaves[k]) for k in columns]
        return []

    def _row_groups(self, columns: TimedColumns) -> Iterator[RowGroup]:
        raise NotImplementedError

    def _wanted(self, columns: TimedColumns) -> list[Leaf]:
        """Return the columns to read, each once."""
        return [self._leaves[k] for k in sorted(columns.read)]

    def are_decoded_with(self, columns: Group, others: Group) -> bool:
        """Return whether columns can be read beside others: each holds numbers."""
        leaves, names = [self._leaves[k] for k in columns], self.names
        are_numbers = all(is_number(one.type) and names.count(one.name) == 1 for one in leaves)
        return are_numbers and super().are_decoded_with(columns, others)

    def label_columns(self) -> dict[int, bool]:
        """Return columns that may hold labels; see :class:`.TableLog`."""
        return {
            k: is_number(leaf.type)
            for k, leaf in enumerate(self._leaves)
            if is_whole(leaf.type) or is_text(leaf.type)
        }

    def _refuse_text(self, columns: TimedColumns) -> None:
        declared = self.notes.units
        names = self.names
        for k in (*columns.numbers, *columns.stamp.columns):
            leaf = self._leaves[k]
            if names.count(leaf.name) > 1:
                raise UnsupportedLogError(
                    self.path,
                    f"several columns are named {quoted(leaf.name)}; rename all but one of them",
                )
            is_stamp = k in columns.stamp.columns and k in declared
            if not is_stamp and not is_number(leaf.type):
                held = "lists" if pa.types.is_list(leaf.type) else leaf.type
                held = "text" if is_text(leaf.type) else held
                raise UnsupportedLogError(
                    self.path,
                    f"column {quoted(leaf.name)} holds {held}, not numbers; convert it to numbers",
                )


class BatchRows(NamedTuple):
    """Rows of the selected series with a time.

    `t_ns`: timestamps, shape ``(N,)``, int64, ns
    `numbers`: as stored, shape ``(N, k)``, float64; NaN for missing values
    `total`: number of rows of the series, with and without a time
    `others`: number of rows of other series
    `beyond`: the column of the fraction of a second, if it exceeds one; else None
    `seen`: the watched cells
    """

    t_ns: Int64
    numbers: Float64
    total: int
    others: int
    beyond: int | None = None
    seen: tuple[Shown, ...] = ()

    def note(self, log: TableLog, columns: TimedColumns, first: int) -> None:
        """Note watched cells, and rows skipped or without a time; `first`: number before."""
        if columns.watch is not None:
            columns.watch.see(self.seen)
        log.other_rows += self.others
        if self.beyond is not None:
            log.remark_on_fraction(log.names[self.beyond], f"{Setting('time_col')}")
        if untimed := self.total - len(self.t_ns):
            place = f"rows {first + 1} to {first + self.total}"
            log.losses.note(place, "rows without a time", untimed)


def batch_rows(
    batch: pa.RecordBatch | pa.Table,
    leaves: Sequence[Leaf] | Mapping[int, Leaf],
    columns: TimedColumns,
    first: int,
) -> BatchRows:
    """Return timestamps and numbers of a batch; `first`: number of rows of the series before it."""
    total = batch.num_rows
    if columns.stamp.series:
        batch = _of_series(batch, leaves, columns)
    count = batch.num_rows
    every = (*columns.numbers, *columns.beside)
    numbers = np.empty((count, len(every)))
    for axis, k in enumerate(every):
        values = values_of(batch, leaves[k])
        if pa.types.is_decimal128(values.type):
            values = values.cast(pa.string())  # Arrow's own cast is not exact
        elif is_text(values.type):
            import pyarrow.compute as pc  # slow to import, and seldom needed

            values = pc.utf8_trim_whitespace(values)
        if not pa.types.is_float64(values.type):
            values = values.cast(pa.float64(), safe=False)
        begin = 0
        for chunk in values.chunks if isinstance(values, pa.ChunkedArray) else (values,):
            numbers[begin : begin + len(chunk), axis] = to_numpy(chunk)
            begin += len(chunk)
    seen: tuple[Shown, ...] = ()
    if columns.watch is not None:
        places = first + np.arange(count)
        needed = numbers[:, : len(columns.numbers)]
        shown = columns.watch.shown(needed, places, lambda k: values_of(batch, leaves[k]))
        seen = tuple(shown)
    if not columns.stamp.columns:
        t_ns = row_stamps(first, count, columns.stamp.sample_rate or 1.0)
        return BatchRows(t_ns, numbers, count, total - count, seen=seen)
    times = [values_of(batch, leaves[k]) for k in columns.stamp.columns]
    if any(values.null_count or pa.types.is_floating(values.type) for values in times):
        timed = np.logical_and.reduce([_has_value(values) for values in times])
        times, numbers = [values.filter(to_arrow(timed)) for values in times], numbers[timed]
    parts = [*map(nanoseconds, times, columns.stamp.units)]
    is_beyond = parts[1:] and columns.stamp.units[0] == "s" and (parts[1] >= NS_PER_S).any()
    beyond = columns.stamp.columns[1] if is_beyond else None
    return BatchRows(sum_parts(parts), numbers, count, total - count, beyond, seen)


def _of_series(
    batch: pa.RecordBatch | pa.Table,
    leaves: Sequence[Leaf] | Mapping[int, Leaf],
    columns: TimedColumns,
) -> pa.RecordBatch | pa.Table:
    """Return the rows of the selected series."""
    import pyarrow.compute as pc

    for k, label in columns.stamp.series:
        texts = pc.utf8_trim_whitespace(values_of(batch, leaves[k]).cast(pa.string()))
        batch = batch.filter(pc.equal(texts, label))
    return batch


def _has_value(column: pa.Array | pa.ChunkedArray) -> Bool:
    """Return which values are neither null nor NaN nor infinite, shape ``(N,)``."""
    import pyarrow.compute as pc

    valid = column.is_valid()
    if pa.types.is_floating(column.type):
        valid = pc.and_kleene(valid, pc.is_finite(column))
    values: Bool = to_numpy(valid)
    return values
