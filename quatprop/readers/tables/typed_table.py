"""Base class of tables with typed columns: convert record batches to timestamps and numbers.

Subclasses list the columns of a format and read record batches; times, units, text and damage are
handled here.
"""

from __future__ import annotations

from contextlib import suppress
from decimal import ROUND_HALF_EVEN, Context, Decimal, InvalidOperation, Overflow
from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa

from quatprop.base.arrow_arrays import to_arrow, to_numpy
from quatprop.base.errors import UnsupportedLogError, UsageError
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.base.times import NS_PER_S, regular_stamps
from quatprop.readers.tables.model import Stamp, TableNotes
from quatprop.readers.tables.table_log import TableLog, TimedColumns
from quatprop.readers.tables.turns import runs_in

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.readers.tables.table_log import Batches
    from quatprop.readers.tables.turns import Run


# Columns of values: fields of structs and elements of short lists are separate columns.


_LONGEST_LIST = 16


class Leaf(NamedTuple):
    """A column of values.

    `path`: name of the column, followed by the fields of a struct
    `element`: index in a list; None if it is not a list
    """

    path: tuple[str, ...]
    type: pa.DataType
    element: int | None = None

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
        return [Leaf(path, kind, index) for index in range(length)]
    return [Leaf(path, pa.list_(kind))]


def values_of(batch: pa.RecordBatch | pa.Table, leaf: Leaf) -> pa.Array | pa.ChunkedArray:
    """Return the values of a column; null if a list is too short."""
    column = batch.column(leaf.path[0])
    if leaf.path[1:] or leaf.element is not None:
        import pyarrow.compute as pc  # slow to import, and not needed for CSV
    if leaf.path[1:]:
        column = pc.struct_field(column, list(leaf.path[1:]))
    if leaf.element is not None:
        is_short = pc.less_equal(pc.list_value_length(column), leaf.element)
        column = pc.list_element(pc.if_else(is_short, None, column), leaf.element)
    return column.dictionary_decode() if pa.types.is_dictionary(column.type) else column


def is_number(kind: pa.DataType) -> bool:
    """Return whether values are numbers."""
    return bool(
        pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal128(kind)
    )


def is_text(kind: pa.DataType) -> bool:
    """Return whether values are text."""
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def is_whole(kind: pa.DataType) -> bool:
    """Return whether values are integers."""
    return bool(pa.types.is_integer(kind) or (pa.types.is_decimal128(kind) and kind.scale == 0))


# Convert the times of tables to int64 nanoseconds exactly, never through float64.
#
# Without its point, a decimal number of seconds with 9 places is an integer in ns. A column is
# therefore read as decimal128 with the scale of ns, and the unscaled integers are taken from its
# buffer.


_PIECE_BYTES = 1 << 16
"""Bytes of text examined at a time, so that they stay in the cache."""

PLACES = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Unit -> decimal places with which an unscaled number is in ns."""

SPARE_PLACES = 9
"""Further places for times finer than 1 ns, such as floats printed in full."""

_DIGITS = 38
_FROM_2000_NS, _UNTIL_2100_NS = 946_684_800 * NS_PER_S, 4_102_444_800 * NS_PER_S
_LIMITS = np.iinfo(np.int64)
_EXACT = Context(prec=400, rounding=ROUND_HALF_EVEN)


class TimestampRangeError(ValueError):
    """The time does not fit in int64 ns."""


def decimal_type(unit: str, spare: int = 0) -> pa.DataType:
    """Return the decimal type with unscaled integers in ns / 10**spare.

    pyarrow refuses text with more digits than the precision, but does not check that the number
    fits after rescaling. Precision + scale = 38 ensures that it does.
    """
    scale = PLACES[unit] + spare
    return pa.decimal128(_DIGITS - scale, scale)


def refuse_tiny_numbers(data: bytes | memoryview) -> None:
    """Refuse numbers below 1e-39, which pyarrow must not read as decimals.

    It would read powers of ten beyond the end of a table, and crash for a few thousand places.
    """
    for begin in range(0, len(data), _PIECE_BYTES):
        piece = bytes(data[begin : begin + _PIECE_BYTES + len("-400")]) + b"   "
        text = np.frombuffer(piece, np.uint8)
        for letter in b"eE":
            # Fast exit: few texts have exponents.
            if letter not in piece:
                continue
            marks = np.flatnonzero(text == letter)
            marks = marks[text[marks + 1] == ord("-")] + 1
            first, second, third = (text[marks + k] - np.uint8(ord("0")) for k in (1, 2, 3))
            if np.any((first <= 9) & (second <= 9) & ((third <= 9) | (first >= 4))):  # noqa: PLR2004  # digits
                raise TimestampRangeError("its time is a number below 1e-39")


def nanoseconds(column: pa.ChunkedArray | pa.Array, unit: str) -> Int64:
    """Return a time column without nulls in int64 ns.

    `column`: times, or numbers of any type in `unit`, rounded half to even
    `unit`: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``
    `Returns`: shape ``(N,)``, int64, ns
    """
    if pa.types.is_decimal128(column.type):
        chunks = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
        parts = [_unscaled(_rounded(chunk, PLACES[unit])) for chunk in chunks]
        return np.concatenate([np.empty(0, np.int64), *parts])
    if pa.types.is_floating(column.type):
        return from_floats(to_numpy(column.cast(pa.float64())), unit)
    try:
        integers = to_numpy(column.cast(pa.int64()))
    except pa.ArrowInvalid as error:
        raise TimestampRangeError from error
    factor = 10 ** PLACES[unit]
    largest = _LIMITS.max // factor
    if len(integers) and (integers.max() > largest or integers.min() < -largest):
        raise TimestampRangeError
    stamps: Int64 = integers * factor
    return stamps


def _rounded(chunk: pa.Array, places: int) -> pa.Array:
    """Return decimals rounded to a number of places."""
    if chunk.type.scale == places:
        return chunk
    import pyarrow.compute as pc  # slow to import, and seldom needed

    wide = chunk.view(pa.decimal128(_DIGITS, chunk.type.scale))
    try:
        if chunk.type.scale > places:
            wide = pc.round(wide, ndigits=places, round_mode="half_to_even")
        return wide.cast(pa.decimal128(_DIGITS, places))
    except pa.ArrowInvalid as error:
        raise TimestampRangeError from error


def _unscaled(chunk: pa.Array) -> Int64:
    halves = np.frombuffer(chunk.buffers()[1], np.int64).reshape(-1, 2)
    low, high = halves[chunk.offset : chunk.offset + len(chunk)].T
    if np.any(high != low >> 63):
        raise TimestampRangeError
    stamps: Int64 = low
    return stamps


def from_text(text: str, unit: str) -> int:
    """Return one number in ns, rounded half to even."""
    try:
        scaled = Decimal(text.strip()).scaleb(PLACES[unit], _EXACT)
        whole = scaled.to_integral_value(context=_EXACT)
    except Overflow as error:
        raise TimestampRangeError(text) from error
    except InvalidOperation as error:
        raise ValueError(text) from error
    if not whole.is_finite():
        raise ValueError(text)
    if not _LIMITS.min <= whole <= _LIMITS.max:
        raise TimestampRangeError(text)
    return int(whole)


def likely_unit(text: str) -> str:
    """Return the unit in which a number is a time in this century; ``""``: none."""
    for unit in PLACES:
        try:
            t_ns = from_text(text, unit)
        except ValueError:
            continue
        if _FROM_2000_NS <= t_ns < _UNTIL_2100_NS:
            return unit
    return ""


def from_floats(values: Float64, unit: str) -> Int64:
    """Return finite floats in ns: their exact value, rounded half to even.

    Integer and fractional parts are scaled separately, so that only the result is rounded.
    """
    factor = 10 ** PLACES[unit]
    whole = np.floor(values)
    if np.any(np.abs(values) >= _LIMITS.max // factor):
        raise TimestampRangeError
    fraction = (values - whole) * factor
    nanos = np.rint(fraction)
    # A product at exactly one half may have been rounded to it.
    for row in np.flatnonzero(np.abs(fraction - nanos) == 0.5):  # noqa: PLR2004  # the half
        nanos[row] = round(Fraction(float(values[row] - whole[row])) * factor)
    stamps: Int64 = whole.astype(np.int64) * factor + nanos.astype(np.int64)
    return stamps


def sum_parts(parts: Iterable[Int64]) -> Int64:
    """Return the sum of the parts of a timestamp, each in ns, shape ``(N,)``, int64."""
    first, *others = parts
    for other in others:
        total = first + other
        if np.any((first ^ total) & (other ^ total) < 0):
            raise TimestampRangeError
        first = total
    return first


def row_stamps(first: int, count: int, sample_rate: Fraction | float) -> Int64:
    """Return the timestamps of rows at a constant rate.

    `sample_rate`: Hz; a float is taken as its shortest decimal
    `Returns`: shape ``(count,)``, int64, ns
    """
    try:
        return regular_stamps(first, first + count, Fraction(str(sample_rate)))
    except UsageError as error:
        raise UsageError(f"{error.text}; check {Setting('sample_rate')}") from None


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
            units={
                k: leaf.type.unit
                for k, leaf in enumerate(self._leaves)
                if pa.types.is_timestamp(leaf.type) or pa.types.is_duration(leaf.type)
            },
            texts=frozenset(k for k, leaf in enumerate(self._leaves) if is_text(leaf.type)),
        )

    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:
        """Return cells of the first rows; see :class:`.TableLog`."""
        first = [values[:_HEAD_ROWS] for values in self._first_values(columns)]
        # Python's dates have no nanoseconds.
        times = [pa.types.is_timestamp(values.type) for values in first]
        cells = [
            (values.cast(pa.int64()) if is_time else values).to_pylist()
            for values, is_time in zip(first, times, strict=True)
        ]
        return list(zip(*cells, strict=True))

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
        return [self._leaves[k] for k in sorted(columns.read)]

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
    `labels`: the watched columns, and their labels in all rows of the series
    """

    t_ns: Int64
    numbers: Float64
    total: int
    others: int
    beyond: int | None = None
    labels: tuple[tuple[int, list[Run]], ...] = ()

    def note(self, log: TableLog, columns: TimedColumns, first: int) -> None:
        """Note labels, and rows skipped or without a time; `first`: number of rows before."""
        if columns.watch is not None:
            columns.watch.see(self.labels)
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
    numbers = np.empty((count, len(columns.numbers)))
    for axis, k in enumerate(columns.numbers):
        values = values_of(batch, leaves[k])
        if pa.types.is_decimal128(values.type):
            values = values.cast(pa.string())  # Arrow's own cast is not exact
        elif is_text(values.type):
            import pyarrow.compute as pc  # slow to import, and seldom needed

            values = pc.utf8_trim_whitespace(values)
        is_float64 = pa.types.is_float64(values.type)
        numbers[:, axis] = to_numpy(values if is_float64 else values.cast(pa.float64(), safe=False))
    labels = tuple(_labels(batch, leaves, columns, numbers, first))
    if not columns.stamp.columns:
        t_ns = row_stamps(first, count, columns.stamp.sample_rate or 1.0)
        return BatchRows(t_ns, numbers, count, total - count, labels=labels)
    times = [values_of(batch, leaves[k]) for k in columns.stamp.columns]
    if any(values.null_count or pa.types.is_floating(values.type) for values in times):
        timed = np.logical_and.reduce([_has_value(values) for values in times])
        times, numbers = [values.filter(to_arrow(timed)) for values in times], numbers[timed]
    parts = [*map(nanoseconds, times, columns.stamp.units)]
    is_beyond = parts[1:] and columns.stamp.units[0] == "s" and (parts[1] >= NS_PER_S).any()
    beyond = columns.stamp.columns[1] if is_beyond else None
    return BatchRows(sum_parts(parts), numbers, count, total - count, beyond, labels)


def _labels(
    batch: pa.RecordBatch | pa.Table,
    leaves: Sequence[Leaf] | Mapping[int, Leaf],
    columns: TimedColumns,
    numbers: Float64,
    first: int,
) -> Iterator[tuple[int, list[Run]]]:
    """Yield the watched columns, and their labels in the rows that have all numbers."""
    if columns.watch is None:
        return
    is_whole: Bool = np.logical_not(np.isnan(numbers).any(axis=1))
    for k in columns.watch.columns:
        values = values_of(batch, leaves[k])
        if not is_whole.all():
            values = values.filter(to_arrow(is_whole))
        yield k, runs_in(values, first + np.flatnonzero(is_whole))


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
