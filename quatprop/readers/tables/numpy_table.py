"""Read columns of NumPy arrays block by block: single arrays, and the base class of archives."""

from __future__ import annotations

import ast
import lzma
import math
import struct
import zipfile
import zlib
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, TypeAlias, cast

import numpy as np
import pyarrow as pa

from quatprop.base.arrow_arrays import to_arrow
from quatprop.base.errors import DamagedLogError, UnsupportedLogError
from quatprop.base.provenance import METADATA_KEY, JsonObject, provenance_in
from quatprop.base.text import listed, plain, quoted
from quatprop.readers.tables.table_log import refuse_second_file
from quatprop.readers.tables.typed_table import BATCH_ROWS, DamageError, Leaf, RowGroup, TypedTable

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.readers.tables.table_log import TimedColumns

    Buffer = bytearray | memoryview


# NumPy's array format: headers, and the columns of an array.
#
# Headers are not read by ``numpy.lib.format``, which has no public function for version 3, trusts
# any size, and has no clear errors for other content. Nothing is unpickled.
#
# Reference: NumPy Enhancement Proposal 1, "A Simple File Format for NumPy Arrays", and its versions
# 2 and 3.


MAGIC = b"\x93NUMPY"
_PREAMBLES = {(1, 0): ("<H", "latin-1"), (2, 0): ("<I", "latin-1"), (3, 0): ("<I", "utf-8")}
"""Version -> format of the header length, and encoding of the header."""

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


def read_header(stream: BinaryIO) -> ArrayHeader:
    """Read the header of an array, up to its first number."""
    magic = stream.read(len(MAGIC) + 2)
    version = tuple(magic[len(MAGIC) :])
    if not magic.startswith(MAGIC) or len(version) != 2:  # noqa: PLR2004  # major and minor
        raise HeaderError("it does not begin as a NumPy array; check that it was copied whole")
    if version not in _PREAMBLES:
        shown = ".".join(map(str, version))
        raise HeaderError(f"it is of version {shown} and 1.0 to 3.0 are read; save it again")
    length_format, encoding = _PREAMBLES[version]
    size = stream.read(struct.calcsize(length_format))
    length = int.from_bytes(size, "little")
    if length > _LONGEST_HEADER:
        raise HeaderError(f"its header claims {length} bytes, which no table needs")
    text = stream.read(length)
    if len(text) < length or not length:
        raise HeaderError("it ends within its header; check that it was copied whole")
    try:
        return _header(ast.literal_eval(text.decode(encoding).strip()))
    except HeaderError:
        raise
    except Exception as error:
        # The parsers of Python and NumPy raise all kinds of exceptions.
        raise HeaderError("its header is damaged; save it again") from error


def _header(facts: dict[str, Any]) -> ArrayHeader:
    descr, shape = facts["descr"], facts["shape"]
    if not isinstance(shape, tuple) or any(type(size) is not int or size < 0 for size in shape):
        raise HeaderError("its header gives no shape; save it again")
    dtype = np.lib.format.descr_to_dtype(descr)
    if dtype.hasobject:
        raise HeaderError(
            "it holds pickled Python objects, which could run code and are not read; "
            "save plain numbers"
        )
    if not 0 < dtype.itemsize <= _WIDEST_ROW:
        raise HeaderError(f"its elements have {dtype.itemsize} bytes, which no table needs")
    return ArrayHeader(dtype, shape, bool(facts["fortran_order"]))


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


# Archives of NumPy arrays, each with one or several columns.
#
# ``zipfile`` cannot open an archive without the directory at its end. If it was cut off, the
# members are found here by their headers; ``zipfile`` still unpacks them and verifies their
# checksums.
#
# Reference: PKWARE, ".ZIP File Format Specification" (APPNOTE.TXT), sections 4.3.7 and 4.5.3.


_SIGNATURE = b"PK\x03\x04"
_HEADER = struct.Struct("<4s2xHHxxxxIIIHH")
_ENCRYPTED, _SIZES_FOLLOW = 1, 8
_IN_EXTRA_FIELD = 0xFFFFFFFF
_ZIP64 = 1
_STEP = 1 << 12


class CutArchive:
    """An archive without directory; its members are found by their headers."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._members: dict[str, tuple[int, zipfile.ZipInfo]] = {}
        with path.open("rb") as file:
            size = file.seek(0, 2)
            begin = 0
            while begin < size:
                file.seek(begin)
                info = _read_header(file)
                if info is None:
                    break
                begin = file.tell()
                if not info.compress_size:
                    # The size is only written when the archive is complete.
                    info.compress_size = info.file_size = size - begin
                    info.CRC = None  # type: ignore[assignment]  # which means: not checked
                self._members[info.filename] = begin, info
                begin += info.compress_size

    def namelist(self) -> list[str]:
        """Return the names of the members."""
        return list(self._members)

    def open(self, name: str) -> BinaryIO:
        """Open a member; reading it raises EOFError where it was cut."""
        begin, info = self._members[name]
        file = self._path.open("rb")
        file.seek(begin)
        return cast("BinaryIO", _CutMember(file, "r", info, close_fileobj=True))

    def close(self) -> None:
        """Do nothing: files are open only while they are read."""


class _CutMember(zipfile.ZipExtFile):
    """A member that is read in small steps: if it ends early, only the last step is lost."""

    def read1(self, n: int | None = -1) -> bytes:
        """Return at most :data:`_STEP` bytes."""
        return super().read1(_STEP if n is None or n < 0 else min(n, _STEP))


def _read_header(file: BinaryIO) -> zipfile.ZipInfo | None:
    """Read the header of a member; None if it is incomplete or the member is encrypted."""
    header = file.read(_HEADER.size)
    if len(header) < _HEADER.size:
        return None
    signature, flags, method, crc, packed, unpacked, *lengths = _HEADER.unpack(header)
    name, extra = (file.read(length) for length in lengths)
    if signature != _SIGNATURE or flags & _ENCRYPTED or len(extra) < lengths[1] or not name:
        return None
    info = zipfile.ZipInfo(name.decode(errors="replace"))
    info.compress_type, info.CRC = method, crc
    info.compress_size, info.file_size = packed, unpacked
    if _IN_EXTRA_FIELD in {packed, unpacked}:
        info.file_size, info.compress_size = _zip64_sizes(extra)
    if flags & _SIZES_FOLLOW:
        info.compress_size = 0
    return info


def _zip64_sizes(extra: bytes) -> tuple[int, int]:
    """Return the unpacked and packed size of a member in an extra field; zeros if absent."""
    while len(extra) >= struct.calcsize("<HH"):
        kind, length = struct.unpack_from("<HH", extra)
        if kind == _ZIP64 and length >= struct.calcsize("<QQ"):
            return cast("tuple[int, int]", struct.unpack_from("<QQ", extra, 4))
        extra = extra[4 + length :]
    return 0, 0


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
        self._archive: zipfile.ZipFile | CutArchive
        try:
            self._archive = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
            self._archive = CutArchive(path)
            if not any(name.endswith(_SUFFIX) for name in self._archive.namelist()):
                raise DamagedLogError(
                    path, f"its directory is damaged ({plain(error)}); was it written to the end?"
                ) from error
            self.losses.note(
                "end of the file", "its directory is damaged: more arrays may be missing"
            )
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
        is_unusable = suppress(DamageError, ValueError, IndexError)
        with is_unusable, archive_damage(), self._open_array(member) as stream:
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
        if not isinstance(self._archive, zipfile.ZipFile):
            return
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

    def _open_array(self, member: str) -> BinaryIO:
        return cast("BinaryIO", self._archive.open(member))

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
                with archive_damage(), self._open_array(member) as stream:
                    arrays[member] = columns_of(read_header(stream))
            except HeaderError as error:
                refused = refused or f"its array {name}: {error}"
            except DamageError as error:
                if isinstance(self._archive, CutArchive):
                    self.losses.note(f"array {name}", f"it is damaged: {error}")
                    continue
                # Its columns are unknown, and may be the requested ones.
                raise DamagedLogError(
                    self.path, f"its array {name} is damaged ({error}); save it again"
                ) from error
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
