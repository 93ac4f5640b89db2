"""Columns of NumPy arrays, read in blocks: single arrays, and the base class of archives."""

from __future__ import annotations

import lzma
import math
import warnings
import zipfile
import zlib
from contextlib import ExitStack, contextmanager, suppress
from io import BufferedIOBase, BytesIO
from itertools import islice
from typing import IO, TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

import numpy as np
import pyarrow as pa
from numpy.lib import format as npy

from quatprop.base.arrow_arrays import to_arrow
from quatprop.base.errors import DamagedLogError, UnsupportedLogError
from quatprop.base.provenance import METADATA_KEY, JsonObject, provenance_in
from quatprop.base.text import listed, plain, quoted
from quatprop.readers.tables.table_log import refuse_second_file
from quatprop.readers.tables.typed_table import BATCH_ROWS, Leaf, RowGroup, TypedTable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.readers.tables.table_log import TimedColumns

    Buffer = bytes | memoryview


# Headers of arrays, and the columns of an array. Nothing is unpickled.


_LONGEST_HEADER = 1 << 15
_WIDEST_ROW = 1 << 20
_MOST_COLUMNS = 4096
_MOST_SIGNALS, _FEWEST_SAMPLES = 20, 100


class HeaderError(ValueError):
    """The header cannot be used, for the reason in the message."""


class ArrayHeader(NamedTuple):
    """The header of an array.

    `is_fortran`: whether it is stored column by column
    """

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    is_fortran: bool


class ArrayColumn(NamedTuple):
    """A column of numbers within an array.

    `name`: ``""`` for a plain array of one dimension
    `start`: position of its first row after the header, bytes
    `step`: distance of rows, bytes
    `offset`: position of the value in a row, bytes
    """

    name: str
    dtype: np.dtype[Any]
    start: int
    step: int
    offset: int
    rows: int


def has_signals_in_rows(shape: tuple[int, ...]) -> bool:
    """Return whether rows of a matrix are signals instead of samples, as is common in MATLAB.

    It then has few rows and many columns.
    """
    return len(shape) == 2 and shape[0] <= _MOST_SIGNALS and shape[1] > _FEWEST_SAMPLES  # noqa: PLR2004


def read_header(stream: IO[bytes] | BufferedIOBase) -> ArrayHeader:
    """Read the header of an array, up to its first number.

    References
    ----------
    NumPy Enhancement Proposal 1, "A Simple File Format for NumPy Arrays".
    """
    magic = stream.read(npy.MAGIC_LEN)
    if not magic.startswith(npy.MAGIC_PREFIX):
        raise HeaderError("it does not begin as a NumPy array; was it copied whole?")
    size = stream.read(2 if magic.endswith(b"\1\0") else 4)
    length = int.from_bytes(size, "little")
    if length > _LONGEST_HEADER:
        raise HeaderError(f"its header claims {length} bytes, which no table needs")
    text = stream.read(length)
    try:
        version = npy.read_magic(BytesIO(magic))
        if version == (3, 0):
            # As version 2, but in UTF-8; there is no public function for it.
            text = text.decode().encode("ascii", "backslashreplace")
            size, version = len(text).to_bytes(4, "little"), (2, 0)
        read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
        with warnings.catch_warnings(action="ignore"):  # of headers that Python 2 wrote
            shape, is_fortran, dtype = read(BytesIO(size + text), len(text))
    except Exception as error:
        # The parsers of Python and NumPy raise all kinds of exceptions.
        raise HeaderError("its header is damaged; was it copied whole?") from error
    if min(shape, default=0) < 0:
        raise HeaderError("its header gives no shape; save it again")
    if dtype.hasobject:
        raise HeaderError(
            "it holds pickled Python objects, which could run code and are not read; "
            "save plain numbers"
        )
    if not 0 < dtype.itemsize <= _WIDEST_ROW:
        raise HeaderError(f"its elements have {dtype.itemsize} bytes, which no table needs")
    return ArrayHeader(dtype, shape, is_fortran)


def columns_of(header: ArrayHeader) -> list[ArrayColumn]:
    """Return the columns of an array, at least one.

    An array of records has one for each field, with nested fields as ``field.part`` and elements of
    fields that are arrays as ``field[0]``. A plain array of two dimensions has ``[0]``, ``[1]``...
    if there are several. A matrix with signals in rows is transposed.
    """
    dtype, shape, is_fortran = header
    if has_signals_in_rows(shape):
        shape, is_fortran = shape[::-1], not is_fortran
    if len(shape) == 1:
        rows, fields, step = shape[0], _fields(dtype), dtype.itemsize
    elif len(shape) == 2 and not dtype.names:  # noqa: PLR2004  # rows and columns
        rows, width = shape
        # In column-major order, each column is contiguous.
        step = dtype.itemsize * (1 if is_fortran else width)
        names = (f"[{k}]" if width > 1 else "" for k in range(width))
        fields = ((name, dtype, k * dtype.itemsize) for k, name in enumerate(names))
    else:
        raise HeaderError(
            f"its array of shape {shape} is not a table; save one row per sample, in two "
            "dimensions or as records"
        )
    placed = list(islice(fields, _MOST_COLUMNS + 1))
    if not 0 < len(placed) <= _MOST_COLUMNS or step > _WIDEST_ROW:
        raise HeaderError(f"its rows have {step} bytes, which no table needs")
    by_column = len(shape) == 2 and is_fortran  # noqa: PLR2004  # rows and columns
    return [
        ArrayColumn(name, kind, *((place * rows, step, 0) if by_column else (0, step, place)), rows)
        for name, kind, place in placed
    ]


def _fields(
    dtype: np.dtype[Any], name: str = "", place: int = 0
) -> Iterator[tuple[str, np.dtype[Any], int]]:
    """Yield name, type and offset of every number in a record."""
    if dtype.names is not None and dtype.fields is not None:
        for field in dtype.names:
            inner, offset = dtype.fields[field][:2]
            yield from _fields(inner, f"{name}.{field}" if name else field, place + offset)
    elif dtype.subdtype is not None:
        base, shape = dtype.subdtype
        for k in range(math.prod(shape)):
            yield from _fields(base, f"{name}[{k}]", place + k * base.itemsize)
    else:
        yield name, dtype, place


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

    def are_of_same_rows(self, columns: Sequence[int]) -> bool:
        """Return whether columns can be read together: they have as many rows."""
        return len({self._members[k][1].rows for k in columns}) == 1

    def _open_rows(self, member: str) -> BufferedIOBase:
        """Open an array at its first number."""
        raise NotImplementedError

    def _row_groups(self, columns: TimedColumns) -> Iterator[RowGroup]:
        wanted = [
            (leaf.name, *self._members[k])
            for k, leaf in enumerate(self._leaves)
            if k in columns.read
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
        at_once = rows_at_once(max(column.step for *_, column in wanted))
        at_once = max(1, min(rows, at_once))
        with ExitStack() as stack:
            streams, buffers = {}, {}
            for (member, start), columns in arrays.items():
                stream = stack.enter_context(self._open_rows(member))
                buffer = memoryview(bytearray(at_once * columns[0][1].step))
                streams[member, start], buffers[member, start] = stream, buffer
                for begin in range(0, start, len(buffer)):
                    self._read(member, stream, buffer[: start - begin])
            for begin in range(0, rows, at_once):
                count = min(at_once, rows - begin)
                values: dict[str, pa.Array] = {}
                for (member, start), columns in arrays.items():
                    data = buffers[member, start][: count * columns[0][1].step]
                    self._read(member, streams[member, start], data)
                    values |= {name: values_in(data, column, count) for name, column in columns}
                yield pa.record_batch(list(values.values()), list(values))
            # The last stream of a member of an archive is the nearest to its checksum.
            last = {member: stream for (member, _), stream in streams.items()}
            for member, stream in last.items():
                with self._refused_if_damaged(member):
                    while isinstance(stream, zipfile.ZipExtFile) and stream.read(_PIECE_BYTES):
                        pass

    def _read(self, member: str, stream: BufferedIOBase, buffer: memoryview) -> None:
        """Fill a buffer with the next bytes of an array."""
        with self._refused_if_damaged(member):
            if stream.readinto(buffer) < len(buffer):
                raise EOFError("it ends before its last row")

    @contextmanager
    def _refused_if_damaged(self, member: str) -> Iterator[None]:
        """Convert exceptions for damaged archives."""
        try:
            yield
        except _ARCHIVE_ERRORS as error:
            name = f" {quoted(member.removesuffix(_SUFFIX))}" if member else ""
            reason = plain(error) or type(error).__name__
            raise DamagedLogError(
                self.path, f"its array{name} is damaged ({reason}); save it again"
            ) from error


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
        claimed = math.prod(header.shape) * header.dtype.itemsize
        if begin + claimed > size:
            reason = f"it has {size - begin} of the {claimed} bytes that its array claims"
            raise DamagedLogError(path, f"{reason}; was it copied whole?")
        if begin + claimed < size:
            self.losses.note("end of the file", following(size - begin - claimed, "its array"))

    def _open_rows(self, member: str) -> BufferedIOBase:  # noqa: ARG002  # the only one
        stream = self.path.open("rb")
        read_header(stream)
        return stream


# Archives of NumPy arrays, each with one or several columns.


_MOST_ARRAYS = 4096
_LONGEST_PROVENANCE = 1 << 24
_END_SIZE = 22
_LONGEST_END = (1 << 16) + _END_SIZE
_SUFFIX = ".npy"


class NpzLog(NumpyTable):
    """An archive of arrays, each with one or several columns."""

    kind = "npz"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            self._archive = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
            reason = f"its directory is damaged ({plain(error)}); was it written to the end?"
            raise DamagedLogError(path, reason) from error
        try:
            self._look_for_second_file()
            self._describe()
        except BaseException:
            self._archive.close()
            raise

    def provenance(self) -> JsonObject:
        """Return the provenance in the string ``quatprop``."""
        key = METADATA_KEY.decode()
        member = key + _SUFFIX
        if member not in self._archive.namelist():
            return {}
        text = ""
        is_unusable = suppress(*_ARCHIVE_ERRORS, ValueError, IndexError)
        with is_unusable, self._archive.open(member) as stream:
            dtype = read_header(stream).dtype
            if dtype.kind == "U" and dtype.itemsize <= _LONGEST_PROVENANCE:
                data = stream.read(dtype.itemsize)
                text = str(np.frombuffer(data, dtype)[0])
        return provenance_in(text, self.path)

    def close(self) -> None:
        """Close the file."""
        self._archive.close()

    def _look_for_second_file(self) -> None:
        """Refuse an archive after other bytes, and note bytes after it."""
        begin = min((info.header_offset for info in self._archive.infolist()), default=0)
        if begin:
            refuse_second_file(self.path, begin)
        with self.path.open("rb") as file:
            size = file.seek(0, 2)
            first = file.seek(max(0, size - _LONGEST_END))
            at = file.read().rfind(b"PK\5\6")
        end = first + at + _END_SIZE + len(self._archive.comment)
        if at >= 0 and end < size:
            self.losses.note(f"byte {end}", following(size - end, "the archive"))

    def _other_content(self) -> str:
        """Return a description of an archive without NumPy arrays."""
        names = self._archive.namelist()
        if not names:
            return "it is a ZIP archive of nothing; was it written to the end?"
        if "xl/workbook.xml" in names or "content.xml" in names:
            return "it is a workbook of a spreadsheet; save its table as CSV"
        return f"it is a ZIP archive of {listed(names)}; unpack it, and name a log of them"

    def _open_rows(self, member: str) -> BufferedIOBase:
        with self._refused_if_damaged(member):
            stream = cast("BufferedIOBase", self._archive.open(member))
            read_header(stream)
        return stream

    def _describe(self) -> None:
        """Find the columns; other arrays are ignored."""
        members = [name for name in self._archive.namelist() if name.endswith(_SUFFIX)]
        if len(members) > _MOST_ARRAYS:
            raise UnsupportedLogError(
                self.path, f"it has {len(members)} arrays; save the arrays of one recording"
            )
        arrays: dict[str, list[ArrayColumn]] = {}
        refused = ""
        for member in members:
            name = quoted(member.removesuffix(_SUFFIX))
            try:
                with self._refused_if_damaged(member), self._archive.open(member) as stream:
                    arrays[member] = columns_of(read_header(stream))
            except HeaderError as error:
                refused = refused or f"its array {name}: {error}"
        for member, columns in arrays.items():
            name = member.removesuffix(_SUFFIX)
            for column in columns:
                if not column.name or column.name.startswith("["):
                    self._add_column(name + column.name, member, column)
                else:
                    self._add_column(column.name if len(arrays) == 1 else f"{name}.{column.name}",
                               member, column)  # fmt: skip
        if not self._leaves:
            raise UnsupportedLogError(self.path, refused or self._other_content())
