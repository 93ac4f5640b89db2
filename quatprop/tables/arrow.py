"""Tables of Apache Arrow: Parquet and Feather (Arrow IPC) files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pyarrow as pa

from quatprop.errors import DamagedLogError, UnreadableLogError, UnsupportedLogError
from quatprop.provenance import JsonObject, provenance_in
from quatprop.tables.typed_table import BATCH_ROWS, DAMAGE, Leaf, RowGroup, TypedTable
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from quatprop.tables.base import TimedColumns


class _ArrowLog(TypedTable):
    """What Parquet and Feather have in common: a schema, with metadata."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            self._file = pa.OSFile(str(path))
        except OSError as error:
            raise UnreadableLogError(path, f"it cannot be read: {error.strerror}") from error
        try:
            schema = self._schema()
            self._schema_metadata: Mapping[bytes, bytes] = schema.metadata or {}
            self._leaves = list(_leaves(schema))
        except DAMAGE as error:
            self._file.close()
            raise DamagedLogError(
                path,
                f"its end or its schema is damaged ({plain(error)}), so its rows cannot be "
                "found; was it written to the end?",
            ) from error

    def provenance(self) -> JsonObject:
        """Return how the content came about, as the metadata of the file say it."""
        return provenance_in(self._metadata(), self.path)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _schema(self) -> pa.Schema:
        raise NotImplementedError

    def _metadata(self) -> Mapping[bytes, bytes]:
        return self._schema_metadata


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

    def _row_groups(self, columns: TimedColumns) -> Iterator[RowGroup]:
        names = [leaf.name for leaf in self._wanted(columns)]
        for group in range(self._parquet.num_row_groups):
            rows = self._parquet.metadata.row_group(group).num_rows
            batches = self._parquet.iter_batches(BATCH_ROWS, [group], names)
            yield RowGroup(f"row group {group}", rows, batches)


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

    def _row_groups(self, columns: TimedColumns) -> Iterator[RowGroup]:
        try:
            file = pa.ipc.open_file(self._file)
        except pa.ArrowInvalid:
            yield RowGroup("end of the file", 0, self._stream())
            return
        names = {leaf.path[0] for leaf in self._wanted(columns)}
        fields = sorted(map(file.schema.get_field_index, names))
        file = pa.ipc.open_file(self._file, options=pa.ipc.IpcReadOptions(included_fields=fields))
        for number in range(file.num_record_batches):
            yield RowGroup(f"record batch {number}", 0, map(file.get_batch, [number]))


def _leaves(fields: Iterable[pa.Field], above: tuple[str, ...] = ()) -> Iterator[Leaf]:
    for field in fields:
        path = (*above, field.name)
        if pa.types.is_struct(field.type):
            yield from _leaves(field.type.fields, path)
        else:
            is_dictionary = pa.types.is_dictionary(field.type)
            yield Leaf(path, field.type.value_type if is_dictionary else field.type)
