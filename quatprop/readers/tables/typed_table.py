"""Base class of tables with typed columns: convert record batches to timestamps and numbers.

Subclasses list the columns of a format and read record batches; times, units, text and damage are
handled here.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa

from quatprop.errors import UnsupportedLogError
from quatprop.series.arrow_arrays import to_arrow, to_numpy
from quatprop.tables import timestamps
from quatprop.tables.base import TableLog, TimedColumns
from quatprop.tables.leaves import Leaf, is_number, is_text, is_whole, values_of
from quatprop.tables.model import Stamp, TableNotes
from quatprop.text import Setting, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from quatprop.arrays import Bool, Float64, Int64
    from quatprop.tables.base import Batches


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
    """Typed, named columns in row groups; see :class:`quatprop.tables.base.TableLog`."""

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
            units={
                k: leaf.type.unit
                for k, leaf in enumerate(self._leaves)
                if pa.types.is_timestamp(leaf.type) or pa.types.is_duration(leaf.type)
            },
            texts=frozenset(k for k, leaf in enumerate(self._leaves) if is_text(leaf.type)),
        )

    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:
        """Return cells of the first rows; see :class:`quatprop.tables.base.TableLog`."""
        first = [values[:_HEAD_ROWS] for values in self._first_values(columns)]
        # Python's dates have no nanoseconds.
        times = [pa.types.is_timestamp(values.type) for values in first]
        cells = [
            (values.cast(pa.int64()) if is_time else values).to_pylist()
            for values, is_time in zip(first, times, strict=True)
        ]
        return list(zip(*cells, strict=True))

    def _stored_rows(self, columns: TimedColumns) -> Batches:
        """Yield timestamps and numbers; see :class:`quatprop.tables.base.TableLog`."""
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
                except timestamps.TimestampRangeError:
                    names = listed(self._leaves[k].name for k in columns.stamp.columns)
                    raise UnsupportedLogError(
                        self.path,
                        f"times of column {names} do not fit in int64 ns when they are "
                        f"{columns.stamp.units[0]}; check {Setting('time_unit')}",
                    ) from None
                rows.note(self, first + count)
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
                    # Arrow trusts the declared number of rows.
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
        with suppress(*DAMAGE, StopIteration, UnsupportedLogError):
            group = next(self._row_groups(TimedColumns(tuple(columns), Stamp())))
            batch = next(batch for batch in group.batches if isinstance(batch, pa.RecordBatch))
            return [values_of(batch, self._leaves[k]) for k in columns]
        return []

    def _row_groups(self, columns: TimedColumns) -> Iterator[RowGroup]:
        raise NotImplementedError

    def _wanted(self, columns: TimedColumns) -> list[Leaf]:
        """Return the columns to read, each once."""
        return [self._leaves[k] for k in sorted(columns.used)]

    def label_columns(self) -> dict[int, bool]:
        """Return columns that may hold labels; see :class:`quatprop.tables.base.TableLog`."""
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
    """

    t_ns: Int64
    numbers: Float64
    total: int
    others: int

    def note(self, log: TableLog, first: int) -> None:
        """Note skipped rows and rows without a time; `first`: number of rows before the batch."""
        log.other_rows += self.others
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
    numbers = np.empty((count, len(columns.numbers)))
    for axis, k in enumerate(columns.numbers):
        values = values_of(batch, leaves[k])
        if pa.types.is_decimal128(values.type):
            values = values.cast(pa.string())  # Arrow's own cast is not exact
        is_float64 = pa.types.is_float64(values.type)
        numbers[:, axis] = to_numpy(values if is_float64 else values.cast(pa.float64(), safe=False))
    if not columns.stamp.columns:
        t_ns = timestamps.row_stamps(first, count, columns.stamp.sample_rate or 1.0)
        return BatchRows(t_ns, numbers, count, total - count)
    times = [values_of(batch, leaves[k]) for k in columns.stamp.columns]
    if any(values.null_count or pa.types.is_floating(values.type) for values in times):
        timed = np.logical_and.reduce([_has_value(values) for values in times])
        times, numbers = [values.filter(to_arrow(timed)) for values in times], numbers[timed]
    t_ns = timestamps.sum_parts(map(timestamps.nanoseconds, times, columns.stamp.units))
    return BatchRows(t_ns, numbers, count, total - count)


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
