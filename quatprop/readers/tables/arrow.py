"""Tables of Apache Arrow: Parquet and Feather (Arrow IPC) files."""

from __future__ import annotations

import json
import struct
from abc import abstractmethod
from contextlib import suppress
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.compute as pc

from quatprop.base.errors import DamagedLogError, LogError, UnsupportedLogError
from quatprop.base.provenance import METADATA_KEY, JsonObject, provenance_in
from quatprop.base.text import listed, plain
from quatprop.kinematics.column_facts import stated_by
from quatprop.readers.tables.exact_times import TimestampRangeError, nanoseconds
from quatprop.readers.tables.model import Span
from quatprop.readers.tables.running_times import periods_of
from quatprop.readers.tables.table_log import TimedColumns, refuse_second_file
from quatprop.readers.tables.typed_table import (
    BATCH_ROWS,
    DAMAGE,
    DamageError,
    Leaf,
    RowGroup,
    TypedTable,
    element_leaves,
)
from quatprop.stores.compression import checksums_matter
from quatprop.stores.file_source import FileSource, source_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from pyarrow.parquet import FileMetaData

    from quatprop.readers.tables.model import Stamp


# Timestamps of the row groups of a Parquet file, from the statistics in its footer.


UNITS = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}
"""Parquet time unit -> Arrow time unit."""


def stamp_spans(metadata: FileMetaData, leaf: Leaf, time_unit: str) -> list[Span] | None:
    """Return the timestamps of each row group; None without statistics.

    `time_unit`: unit of a column of integers
    """
    paths = [metadata.schema.column(k).path for k in range(metadata.num_columns)]
    if leaf.name not in paths:
        return None
    place, spans = paths.index(leaf.name), []
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        try:
            extremes = _extremes(group.column(place).statistics, leaf.type)
            if extremes is None:
                return None
            first_ns, last_ns = nanoseconds(extremes, time_unit).tolist()
        except (TimestampRangeError, pa.ArrowInvalid, KeyError):
            return None
        spans.append(Span(first_ns, last_ns, group.num_rows))
    # A counter that wraps around is continued only where the whole log is read.
    return None if pa.types.is_integer(leaf.type) and _reaches_back(spans, time_unit) else spans


def _reaches_back(spans: list[Span], unit: str) -> bool:
    """Return whether timestamps of a part are before earlier ones by the period of a counter."""
    last_ns = accumulate((span.last_ns for span in spans), max)
    shortest = min(period.ns for period in periods_of(unit)) * 9 // 10
    return any(
        before - after.first_ns > shortest
        for before, after in zip(last_ns, spans[1:], strict=False)
    )


def _extremes(statistics: Any, kind: pa.DataType) -> pa.Array | None:
    """Return the smallest and the largest value of a column of integers or times, or None."""
    if statistics is None or not statistics.has_min_max:
        return None
    if pa.types.is_integer(kind):
        return pa.array([statistics.min, statistics.max], kind)
    if not pa.types.is_timestamp(kind):
        return None
    unit = UNITS[json.loads(statistics.logical_type.to_json())["timeUnit"]]
    # As numbers: the library's dates have no nanoseconds.
    raw = pa.array([statistics.min_raw, statistics.max_raw], pa.timestamp(unit))
    return raw.cast(pa.timestamp(kind.unit))


_PARQUET_TAIL = 8
_STREAM = b"\xff\xff\xff\xff"
_FEATHER_TAIL, _FEATHER_MAGIC, _END_OF_STREAM = 10, b"ARROW1", 8
_BLOCK = struct.Struct("<qi4xq")
_WINDOW, _LOST_BYTES = 1 << 24, 1 << 16


class _ArrowLog(TypedTable):
    """Base class of Parquet and Feather: a schema with metadata."""

    def __init__(self, log: Path | FileSource) -> None:
        self._source = source_of(log)
        path = self._source.path
        super().__init__(path)
        self._file = self._source.as_arrow()
        try:
            self._arrow_schema = self._schema()
            self._leaves = list(_leaves(self._arrow_schema, self._first_lists))
        except DAMAGE as error:
            size = self._file.size()
            self.close()
            raise DamagedLogError(path, self._unreadable(size, plain(error))) from error
        second = None
        with suppress(struct.error, *DAMAGE):
            second = self._second_file()
        if second is not None:
            self.close()
            refuse_second_file(path, second)

    def provenance(self) -> JsonObject:
        """Return the provenance in the metadata of the file."""
        schema = self._arrow_schema
        stored = provenance_in((schema.metadata or {}).get(METADATA_KEY), self.path)
        return stored or self._of_fields(schema)

    def _of_fields(self, schema: pa.Schema) -> JsonObject:
        """Return what columns say of themselves, where the metadata of the file got lost."""
        said = stated_by((field.name, field.metadata or {}) for field in schema)
        for name, values in said.items():
            if len(values) > 1:
                several = listed(sorted(values))
                reason = f"by their metadata, its columns differ in {name}: {several}"
                raise LogError(self.path, f"{reason}; write the columns of one attitude to a file")
        known = {name: min(values) for name, values in said.items()}
        axes = known.pop("sigma_axes", "body")
        return {"convention": known, "uncertainty": {"columns_axes": axes}} if said else {}

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        self._source.close()

    @abstractmethod
    def _schema(self) -> pa.Schema:
        """Open the file, and return its schema."""

    def _first_lists(self, path: tuple[str, ...]) -> pa.Array:
        """Return a column of lists in the first rows; empty if they cannot be read."""
        self._leaves = [Leaf(path, pa.null())]
        return next(iter(self._first_values((0,))), pa.array([]))

    def _unreadable(self, size: int, reason: str) -> str:
        """Return why a file of a size cannot be read at all."""
        return (
            f"its schema is damaged ({reason}), so none of its {size} bytes can be read; "
            "was it written to the end?"
        )

    @abstractmethod
    def _second_file(self) -> int | None:
        """Return the position of another file joined to the first, or None."""

    def _joined_at(self, magic: bytes, end: int) -> int | None:
        """Return the position before `end` where one file ends with `magic` and another begins."""
        for begin in range(1, end, _WINDOW):
            size = min(_WINDOW, end - begin) + 2 * len(magic) - 1
            at = self._file.read_at(size, begin).find(magic + magic)
            if at >= 0:
                return int(begin + at) + len(magic)
        return None


class ParquetLog(_ArrowLog):
    """A Parquet file."""

    kind = "parquet"

    def _schema(self) -> pa.Schema:
        from pyarrow.parquet import ParquetFile

        # Remote files are prefetched in large requests, because of their latency.
        self._parquet = ParquetFile(
            self._file,
            pre_buffer=self._source.is_remote,
            page_checksum_verification=checksums_matter(),
        )
        # The schema's own metadata lack what was added when the file was closed.
        return self._parquet.schema_arrow.with_metadata(self._parquet.metadata.metadata)

    def _unreadable(self, size: int, reason: str) -> str:
        return (
            f"its end is damaged or missing ({reason}), and only there does a Parquet file say "
            f"what its columns are, so none of its {size} bytes can be read; was it closed?"
        )

    def _second_file(self) -> int | None:
        metadata = self._parquet.metadata
        if not metadata.num_row_groups:
            return None
        last = metadata.row_group(metadata.num_row_groups - 1)
        columns = [last.column(k) for k in range(last.num_columns)]
        pages_end = max(
            min(filter(None, (c.dictionary_page_offset, c.data_page_offset)), default=0)
            + c.total_compressed_size
            for c in columns
        )
        # Offsets count from the start of the last file, so they are too small by the size of what
        # precedes it. Page indexes and Bloom filters also lie in between.
        footer = self._file.size() - metadata.serialized_size - _PARQUET_TAIL
        end = footer - pages_end
        # With lost bytes, the second file begins later.
        return self._joined_at(b"PAR1", end + _LOST_BYTES if end > 0 else 0)

    def row_count(self) -> int | None:
        """Return the number of rows in the footer."""
        return int(self._parquet.metadata.num_rows)

    def _row_groups(self, columns: TimedColumns) -> Iterator[RowGroup]:
        names = list({leaf.column: None for leaf in self._wanted(columns)})
        for group in range(self._parquet.num_row_groups):
            rows = self._parquet.metadata.row_group(group).num_rows
            batches: Iterable[pa.RecordBatch | int] = (rows,)
            if columns.parts is None or group in columns.parts:
                batches = self._parquet.iter_batches(BATCH_ROWS, [group], names)
            yield RowGroup(f"row group {group}", rows, batches)

    def spans(self, stamp: Stamp) -> list[Span] | None:
        """Return the timestamps of each row group, by the statistics of the time column."""
        if len(stamp.columns) != 1 or stamp.sample_rate is not None:
            return None
        if stamp.utc_offset_ns or stamp.series or stamp.is_summed:
            return None
        leaf = self._leaves[stamp.columns[0]]
        return stamp_spans(self._parquet.metadata, leaf, stamp.units[0])


class FeatherLog(_ArrowLog):
    """A Feather file: Arrow's IPC file format; or Arrow's IPC stream format."""

    kind = "feather"

    def _schema(self) -> pa.Schema:
        head = self._file.read(len(_FEATHER_MAGIC))
        self._is_stream = head.startswith(_STREAM)
        if head.startswith(b"FEA1"):
            self.close()
            raise UnsupportedLogError(
                self.path, "it is of Feather version 1; save it again as version 2 or as Parquet"
            )
        try:
            return pa.ipc.open_file(self._file).schema
        except pa.ArrowInvalid:
            # Without its footer the file is still a stream of batches.
            return self._stream().schema

    def _second_file(self) -> int | None:
        tail = self._file.size() - _FEATHER_TAIL
        length, magic = struct.unpack("<I6s", self._file.read_at(_FEATHER_TAIL, tail))
        footer = tail - length
        # Checked first, since Arrow allocates the length of a read.
        if magic != _FEATHER_MAGIC or footer < 0:
            return None
        batches_end = _batches_end(self._file.read_at(length, footer))
        # Only the end-of-stream mark follows the last batch.
        end = footer if footer - batches_end > _END_OF_STREAM else 0
        return self._joined_at(_FEATHER_MAGIC, end)

    def row_count(self) -> int | None:
        """Return an estimate by the first of several record batches, which usually are as long."""
        with suppress(*DAMAGE):
            options = pa.ipc.IpcReadOptions(included_fields=[0])
            file = pa.ipc.open_file(self._file, options=options)
            if file.num_record_batches > 1:
                return int(file.num_record_batches * file.get_batch(0).num_rows)
        return None

    def _streamed(self) -> Iterator[pa.RecordBatch]:
        """Yield the batches of a stream, or of a file without footer, whose end is unknown."""
        yield from self._stream()
        if not self._is_stream:
            raise DamageError("its footer is damaged or missing, so more batches may have followed")

    def _stream(self) -> Any:
        self._file.seek(0 if self._is_stream else len(b"ARROW1\0\0"))
        return pa.ipc.open_stream(self._file)

    def _row_groups(self, columns: TimedColumns) -> Iterator[RowGroup]:
        try:
            file = pa.ipc.open_file(self._file)
        except pa.ArrowInvalid:
            yield RowGroup("end of the file", 0, self._streamed())
            return
        names = {leaf.path[0] for leaf in self._wanted(columns)}
        fields = sorted(map(file.schema.get_field_index, names))
        file = pa.ipc.open_file(self._file, options=pa.ipc.IpcReadOptions(included_fields=fields))
        for number in range(file.num_record_batches):
            yield RowGroup(f"record batch {number}", 0, map(file.get_batch, [number]))


def _batches_end(footer: bytes) -> int:
    """Return the end of the last batch of an Arrow IPC file, by its footer.

    pyarrow does not return the positions of batches.

    References
    ----------
    Apache Arrow, "File.fbs" (tables ``Footer`` and ``Block``); FlatBuffers, "Internals".
    """
    (root,) = struct.unpack_from("<I", footer)
    table = root - struct.unpack_from("<i", footer, root)[0]
    (table_size,) = struct.unpack_from("<H", footer, table)
    ends: list[int] = []
    for slot in (8, 10):  # dictionaries and record batches
        (at,) = struct.unpack_from("<H", footer, table + slot) if slot < table_size else (0,)
        if at:
            vector = root + at + struct.unpack_from("<I", footer, root + at)[0]
            (count,) = struct.unpack_from("<I", footer, vector)
            blocks = footer[vector + 4 : vector + 4 + _BLOCK.size * count]
            ends += map(sum, _BLOCK.iter_unpack(blocks))
    return max(ends, default=0)


def _leaves(
    fields: Iterable[pa.Field],
    first_lists: Callable[[tuple[str, ...]], pa.Array],
    above: tuple[str, ...] = (),
) -> Iterator[Leaf]:
    """Yield the columns of fields; `first_lists`: returns the first lists of a column."""
    for field in fields:
        path = (*above, field.name)
        if pa.types.is_struct(field.type):
            yield from _leaves(field.type.fields, first_lists, path)
        elif pa.types.is_fixed_size_list(field.type):
            yield from element_leaves(path, field.type.value_type, field.type.list_size)
        elif pa.types.is_list(field.type) or pa.types.is_large_list(field.type):
            lengths = pc.list_value_length(first_lists(path)).drop_null()
            yield from element_leaves(
                path, field.type.value_type, lengths[0].as_py() if len(lengths) else 0
            )
        else:
            is_dictionary = pa.types.is_dictionary(field.type)
            yield Leaf(path, field.type.value_type if is_dictionary else field.type)
