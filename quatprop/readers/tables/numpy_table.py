"""Read columns of NumPy arrays block by block: single arrays, and the base class of archives."""

from __future__ import annotations

import lzma
import math
import zipfile
import zlib
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias

import numpy as np
import pyarrow as pa

from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.series.arrow_arrays import to_arrow
from quatprop.tables.leaves import Leaf
from quatprop.tables.npy_format import ArrayColumn, HeaderError, columns_of, read_header
from quatprop.tables.typed_table import BATCH_ROWS, DamageError, RowGroup, TypedTable
from quatprop.text import listed, plain

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.tables.base import TimedColumns

    Buffer = bytearray | memoryview

Wanted: TypeAlias = tuple[str, str, ArrayColumn]
"""A column to read: its name, the name of its array, and its position in the array."""

_PIECE_BYTES = 1 << 18
_BLOCK_BYTES = 1 << 24
_ARCHIVE_ERRORS = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, RuntimeError, NotImplementedError),
)
"""Exceptions for archives that are damaged, encrypted, or of unsupported compression."""


class NumpyTable(TypedTable):
    """A file of one array, or an archive of several."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._members: list[tuple[str, ArrayColumn]] = []

    def _add_column(self, name: str, member: str, column: ArrayColumn) -> None:
        self._leaves.append(Leaf((name,), _arrow_type(column.dtype)))
        self._members.append((member, column))

    def _open_array(self, member: str) -> BinaryIO:  # noqa: ARG002  # the only one
        """Open an array at its beginning."""
        return self.path.open("rb")

    def _open_rows(self, member: str) -> BinaryIO:
        """Open an array at its first number."""
        stream = self._open_array(member)
        read_header(stream)
        return stream

    def _row_groups(self, columns: TimedColumns) -> Iterator[RowGroup]:
        wanted = [
            (leaf.name, *self._members[k])
            for k, leaf in enumerate(self._leaves)
            if k in columns.used
        ]
        counts = {column.rows for *_, column in wanted}
        if len(counts) > 1:
            names = listed(name for name, *_ in wanted)
            raise UnsupportedLogError(
                self.path,
                f"its arrays {names} have {listed(sorted(counts))} rows, so they are not one "
                "table; choose others",
            )
        rows = counts.pop()
        yield RowGroup("the end of its array", rows, self._batches(wanted, rows))

    def _batches(self, wanted: list[Wanted], rows: int) -> Iterator[pa.RecordBatch | int]:
        arrays: dict[tuple[str, int], list[tuple[str, ArrayColumn]]] = {}
        for name, member, column in wanted:
            arrays.setdefault((member, column.start), []).append((name, column))
        step = max(column.step for *_, column in wanted)
        at_once = rows_at_once(step)
        with ExitStack() as stack, archive_damage():
            streams = []
            for (member, start), columns in arrays.items():
                stream = stack.enter_context(self._open_rows(member))
                _skip(stream, start)
                streams.append((stream, columns))
            for done in range(0, rows, at_once):
                count = min(at_once, rows - done)
                blocks = [
                    (columns, *_read_bytes(stream, count * columns[0][1].step))
                    for stream, columns in streams
                ]
                # If an array ends early, the rows that all arrays have are still valid.
                whole = min(len(data) // columns[0][1].step for columns, data, _ in blocks)
                if whole:
                    values = {
                        name: values_in(data, column, whole)
                        for columns, data, _ in blocks
                        for name, column in columns
                    }
                    yield pa.record_batch(list(values.values()), list(values))
                if whole < count:
                    why = "".join(f" ({damage})" for *_, damage in blocks if damage)
                    raise DamageError(f"it has {done + whole} of the {rows} rows it claims{why}")
            for stream, _ in streams:
                # The checksum of a member is verified at its end.
                stream.read(1)


def following(count: int, what: str) -> str:
    """Return the reason of a loss for bytes after the end of a file."""
    return f"{count} bytes follow {what} and are not read; was another joined to it?"


def rows_at_once(size: int) -> int:
    """Return the number of rows read at once, for rows of `size` bytes."""
    return max(1, min(BATCH_ROWS, _BLOCK_BYTES // size))


def _arrow_type(dtype: np.dtype[Any]) -> pa.DataType:
    """Return the Arrow type of a column; binary if it is not numbers, times or text."""
    if dtype.kind == "S":
        return pa.string()
    try:
        return pa.from_numpy_dtype(dtype.newbyteorder("="))
    except (pa.ArrowException, TypeError):
        return pa.binary()


@contextmanager
def archive_damage() -> Iterator[None]:
    """Convert exceptions for damaged archives to DamageError."""
    try:
        yield
    except _ARCHIVE_ERRORS as error:
        raise DamageError(plain(error) or type(error).__name__) from error


def _skip(stream: BinaryIO, count: int) -> None:
    while count > 0 and (data := stream.read(min(count, _PIECE_BYTES))):
        count -= len(data)


def _read_bytes(stream: BinaryIO, size: int) -> tuple[bytearray, str]:
    """Return the next bytes of an array, and why they are fewer than requested, or ``""``."""
    data = bytearray()
    # At a cut, read1 returns the bytes before it, and read discards them.
    read = getattr(stream, "read1", stream.read)
    try:
        # In pieces, to return those before damage.
        while len(data) < size and (piece := read(min(size - len(data), _PIECE_BYTES))):
            data += piece
    except _ARCHIVE_ERRORS as error:
        return data, plain(error) or type(error).__name__
    return data, ""


def values_in(data: Buffer, column: ArrayColumn, rows: int) -> pa.Array:
    """Return a column from the bytes of rows, in native byte order."""
    stored: np.ndarray[Any, Any] = np.ndarray(
        (rows,), column.dtype, data, column.offset, (column.step,)
    )
    native = stored.astype(column.dtype.newbyteorder("="))
    if native.dtype.kind == "S":
        native = np.char.decode(native, "latin-1")
    # Only Arrow converts missing dates to null.
    return pa.array(native) if native.dtype.kind in "mMU" else to_arrow(native)


class NpyLog(NumpyTable):
    """A file of one array."""

    kind = "npy"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with path.open("rb") as stream:
            try:
                header = read_header(stream)
                columns = columns_of(header)
            except HeaderError as error:
                raise DamagedLogError(path, str(error)) from error
            begin, size = stream.tell(), stream.seek(0, 2)
        for column in columns:
            # Columns without names get numbers, as in text.
            name = column.name if header.dtype.names else (column.name or "[0]")[1:-1]
            self._add_column(name, "", column)
        beyond = size - begin - math.prod(header.shape) * header.dtype.itemsize
        if beyond > 0:
            self.losses.note("end of the file", following(beyond, "its array"))
