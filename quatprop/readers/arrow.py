"""Tables of Apache Arrow: Parquet and Feather (Arrow IPC) files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from quatprop.errors import (
    DamagedLogError,
    UnreadableLogError,
    UnsupportedLogError,
    listed,
    plain,
    quoted,
)
from quatprop.provenance import provenance_in
from quatprop.readers import columns as choosing
from quatprop.readers import decimal_time
from quatprop.readers.base import Closing, Loss
from quatprop.readers.chooser import Notes
from quatprop.series import GyroSeries

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.readers.base import TableColumns, TimedColumns
    from quatprop.selection import Selection

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

_BATCH_ROWS = 1 << 16
_DAMAGE = (pa.ArrowException, OSError)
"""ArrowException has what cannot be allocated in it: lengths in a damaged file may be any."""


class _Leaf(NamedTuple):
    """A column that holds values; columns of structs are opened into their fields."""

    path: tuple[str, ...]
    type: pa.DataType

    @property
    def name(self) -> str:
        return ".".join(self.path)


class _Part(NamedTuple):
    """Rows that are read together, and lost together where they are damaged."""

    place: str
    rows: int
    batches: Iterable[pa.RecordBatch]


class _ArrowLog(Closing):
    """What Parquet and Feather have in common: typed, named columns in parts."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses: list[Loss] = []
        self._known_losses: int | None = None
        try:
            self._file = pa.OSFile(str(path))
        except OSError as error:
            raise UnreadableLogError(path, f"it cannot be read: {error.strerror}") from error
        try:
            schema = self._schema()
            self._schema_metadata: Mapping[bytes, bytes] = schema.metadata or {}
            self._leaves = list(_leaves(schema))
        except _DAMAGE as error:
            self._file.close()
            raise DamagedLogError(
                path,
                f"its end or its schema is damaged ({plain(error)}); was it written to the end?",
            ) from error

    def columns(self) -> list[str]:
        """Return the column names in order, fields of structs as ``column.field``."""
        return [leaf.name for leaf in self._leaves]

    @property
    def notes(self) -> Notes:
        """Columns of timestamps carry their own unit."""
        return Notes(
            declared={
                k: leaf.type.unit
                for k, leaf in enumerate(self._leaves)
                if pa.types.is_timestamp(leaf.type) or pa.types.is_duration(leaf.type)
            }
        )

    def provenance(self) -> dict[str, Any]:
        """Return how the content came about, as written beside it; empty where it is not.

        Raises
        ------
        DamagedLogError
            What is written there is not what this package writes.
        """
        return provenance_in(self._metadata(), self.path)

    def choose(self, selection: Selection) -> TableColumns:
        """Return which columns hold time and rates; see :func:`quatprop.readers.columns.choose`."""
        columns = choosing.choose(self.path, self.columns(), selection, self.notes)
        self._refuse_other_than_numbers(columns.timed)
        return columns

    def series(self, columns: TableColumns) -> Iterator[GyroSeries]:
        """Yield the chosen columns as rates in rad/s and stamps in ns, batch after batch.

        Raises
        ------
        UnsupportedLogError
            A column does not hold numbers, or a stamp does not fit in int64 ns.
        """
        for t_ns, rate in self.rows(columns.timed):
            yield GyroSeries(t_ns, choosing.in_rad_s(rate, columns))

    def rows(self, columns: TimedColumns) -> Iterator[tuple[Int64, Float64]]:
        """Yield the chosen columns as stamps in ns and numbers as stored, batch after batch.

        Raises
        ------
        UnsupportedLogError
            A column does not hold numbers, or a stamp does not fit in int64 ns.
        """
        self._refuse_other_than_numbers(columns)
        if self._known_losses is None:
            self._known_losses = len(self.losses)
        del self.losses[self._known_losses :]
        wanted = [self._leaves[k] for k in dict.fromkeys((*columns.time, *columns.numbers))]
        first = 0
        for part in self._parts(wanted):
            read = 0
            batches = iter(part.batches)
            while True:
                try:
                    batch = next(batches, None)
                    if batch is not None:
                        # Arrow believes what a file says about its rows: they may not be there.
                        batch.validate()
                except _DAMAGE as error:
                    rows = max(part.rows - read, 0) or None
                    self.losses.append(Loss(part.place, f"it is damaged: {plain(error)}", rows))
                    break
                if batch is None:
                    break
                t_ns, numbers = self._rows(batch, columns, first + read)
                if len(t_ns):
                    yield t_ns, numbers
                read += batch.num_rows
            first += max(part.rows, read)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _schema(self) -> pa.Schema:
        raise NotImplementedError

    def _metadata(self) -> Mapping[bytes, bytes]:
        return self._schema_metadata

    def _refuse_other_than_numbers(self, columns: TimedColumns) -> None:
        declared = self.notes.declared
        names = self.columns()
        for k in (*columns.numbers, *columns.time):
            leaf = self._leaves[k]
            if names.count(leaf.name) > 1:
                raise UnsupportedLogError(
                    self.path,
                    f"several columns are named {quoted(leaf.name)}; rename all but one of them",
                )
            is_stamp = k in columns.time and k in declared
            if not is_stamp and not _is_number(leaf.type):
                raise UnsupportedLogError(
                    self.path, f"column {quoted(leaf.name)} holds {leaf.type}, not numbers"
                )

    def _parts(self, wanted: list[_Leaf]) -> Iterator[_Part]:
        raise NotImplementedError

    def _rows(
        self, batch: pa.RecordBatch, columns: TimedColumns, first: int
    ) -> tuple[Int64, Float64]:
        numbers = np.empty((batch.num_rows, len(columns.numbers)))
        for axis, k in enumerate(columns.numbers):
            values = _column(batch, self._leaves[k])
            numbers[:, axis] = values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        if not columns.time:
            t_ns = decimal_time.counted(first, batch.num_rows, columns.sample_rate or 1.0)
            return t_ns, numbers
        timed = np.ones(batch.num_rows, np.bool_)
        for k in columns.time:
            timed &= _has_value(_column(batch, self._leaves[k]))
        if not timed.all():
            lost = int(np.count_nonzero(~timed))
            place = f"rows {first + 1} to {first + batch.num_rows}"
            self.losses.append(Loss(place, "rows without a time", lost))
            batch, numbers = batch.filter(pa.array(timed)), numbers[timed]
        return self._stamps(batch, columns), numbers

    def _stamps(self, batch: pa.RecordBatch, columns: TimedColumns) -> Int64:
        units = (columns.time_unit, "ns")
        try:
            return decimal_time.total(
                _nanoseconds(_column(batch, self._leaves[k]), unit)
                for k, unit in zip(columns.time, units, strict=False)
            )
        except decimal_time.StampRangeError:
            names = listed(self._leaves[k].name for k in columns.time)
            raise UnsupportedLogError(
                self.path,
                f"times of column {names} do not fit in int64 ns when they are "
                f"{columns.time_unit}; check --time-unit",
            ) from None


class ParquetLog(_ArrowLog):
    """A Parquet file.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    UnreadableLogError
        The file cannot be read.
    DamagedLogError
        It has no whole footer, and so no schema.
    """

    kind = "parquet"

    def _schema(self) -> pa.Schema:
        from pyarrow.parquet import ParquetFile

        self._parquet = ParquetFile(self._file)
        return self._parquet.schema_arrow

    def _metadata(self) -> Mapping[bytes, bytes]:
        return self._parquet.metadata.metadata or {}

    def _parts(self, wanted: list[_Leaf]) -> Iterator[_Part]:
        names = [leaf.name for leaf in wanted]
        for group in range(self._parquet.num_row_groups):
            rows = self._parquet.metadata.row_group(group).num_rows
            batches = self._parquet.iter_batches(_BATCH_ROWS, [group], names)
            yield _Part(f"row group {group}", rows, batches)


class FeatherLog(_ArrowLog):
    """A Feather file: Arrow's IPC file format.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    UnreadableLogError
        The file cannot be read.
    UnsupportedLogError
        It is of Feather's first version.
    DamagedLogError
        Its schema cannot be read.
    """

    kind = "feather"

    def _schema(self) -> pa.Schema:
        if self._file.read(4) == b"FEA1":
            self._file.close()
            raise UnsupportedLogError(
                self.path, "it is of Feather version 1; save it again as version 2 or as Parquet"
            )
        try:
            return pa.ipc.open_file(self._file).schema
        except pa.ArrowInvalid:
            # Without its footer the file is still a stream of batches.
            return self._stream().schema

    def _stream(self) -> Any:
        self._file.seek(len(b"ARROW1\0\0"))
        return pa.ipc.open_stream(self._file)

    def _parts(self, wanted: list[_Leaf]) -> Iterator[_Part]:
        try:
            file = pa.ipc.open_file(self._file)
        except pa.ArrowInvalid:
            yield _Part("end of the file", 0, self._stream())
            return
        fields = sorted({file.schema.get_field_index(leaf.path[0]) for leaf in wanted})
        file = pa.ipc.open_file(self._file, options=pa.ipc.IpcReadOptions(included_fields=fields))
        for number in range(file.num_record_batches):
            yield _Part(f"record batch {number}", 0, map(file.get_batch, [number]))


def _leaves(fields: Iterable[pa.Field], above: tuple[str, ...] = ()) -> Iterator[_Leaf]:
    for field in fields:
        path = (*above, field.name)
        if pa.types.is_struct(field.type):
            yield from _leaves(field.type.fields, path)
        else:
            yield _Leaf(path, field.type)


def _column(batch: pa.RecordBatch, leaf: _Leaf) -> pa.Array:
    column = batch.column(leaf.path[0])
    return pc.struct_field(column, list(leaf.path[1:])) if leaf.path[1:] else column


def _is_number(kind: pa.DataType) -> bool:
    return bool(
        pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal128(kind)
    )


def _has_value(column: pa.Array) -> NDArray[np.bool_]:
    """Return which values are neither null nor NaN nor infinite, shape ``(N,)``."""
    valid = column.is_valid()
    if pa.types.is_floating(column.type):
        valid = pc.and_(valid, pc.fill_null(pc.is_finite(column), False))
    values: NDArray[np.bool_] = valid.to_numpy(zero_copy_only=False)
    return values


def _nanoseconds(column: pa.Array, unit: str) -> NDArray[np.int64]:
    """Return a time column without nulls as int64 nanoseconds, shape ``(N,)``."""
    if pa.types.is_decimal128(column.type):
        return decimal_time.from_decimals(column, unit)
    if pa.types.is_floating(column.type):
        return decimal_time.from_floats(column.cast(pa.float64()).to_numpy(), unit)
    try:
        integers = column.cast(pa.int64())
    except pa.ArrowInvalid as error:
        raise decimal_time.StampRangeError from error
    return decimal_time.from_integers(integers.to_numpy(), unit)
