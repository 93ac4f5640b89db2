"""HDF5 files: datasets as columns, named by their paths."""

from __future__ import annotations

import math
import struct
import zlib
from contextlib import ExitStack, suppress
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from quatprop.base.errors import DamagedLogError, UnsupportedLogError, UsageError
from quatprop.base.text import listed, plain, quoted
from quatprop.readers.tables.model import TableNotes
from quatprop.readers.tables.numpy_table import (
    ArrayColumn,
    ArrayHeader,
    HeaderError,
    NumpyTable,
    Wanted,
    columns_of,
    following,
    has_signals_in_rows,
    rows_at_once,
    values_in,
)
from quatprop.readers.tables.typed_table import DamageError
from quatprop.stores.compression import MAX_SIZE, decompressed_limit, too_large

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray, Int64
    from quatprop.base.errors import Losses
    from quatprop.readers.tables.table_log import TimedColumns
    from quatprop.readers.tables.typed_table import RowGroup


# Read variable-length strings in HDF5 attributes without the library.
#
# They are in a heap of the file; if it is damaged, the library hangs or crashes.
#
# Reference: The HDF Group, "HDF5 File Format Specification", III.E "Global Heap", IV.A.1 "Object
# Headers", IV.A.2.m "The Attribute Message" and IV.A.2.q "The Object Header Continuation Message".


_MOST_BYTES = 1 << 20
_MOST_BLOCKS = 64
_ATTRIBUTE, _CONTINUATION = 0x0C, 0x10
_IS_SHARED, _HAS_TIMES, _HAS_PHASES, _HAS_ORDER = 2, 0x20, 0x10, 4
_REFERENCE = struct.Struct("<IQI")
_HEAP_OBJECT = struct.Struct("<HHIQ")
_OLD_ATTRIBUTE, _NEW_ATTRIBUTE = 1, 3


def variable_text(file: BinaryIO, base: int, address: int, name: str) -> list[str] | None:
    """Return the strings of an attribute; None if they cannot be read."""
    try:
        for message in _attributes(file, base, address):
            found, data = _name_and_data(message)
            if found == name.encode():
                count = len(data) // _REFERENCE.size
                places = _REFERENCE.iter_unpack(data[: count * _REFERENCE.size])
                texts = [_heap_text(file, base, *place) for place in places]
                return [text.decode(errors="replace") for text in texts]
    except (struct.error, OSError, OverflowError, LookupError):
        return None
    return None


def _at(file: BinaryIO, place: int, size: int) -> bytes:
    file.seek(place)
    return file.read(min(size, _MOST_BYTES))


def _attributes(file: BinaryIO, base: int, address: int) -> Iterator[bytes]:
    """Yield the attribute messages of an object header."""
    head = _at(file, base + address, 64)
    is_new = head.startswith(b"OHDR")
    if is_new:
        flags = head[5]
        begin = 6 + (16 if flags & _HAS_TIMES else 0) + (4 if flags & _HAS_PHASES else 0)
        width = 1 << (flags & 3)
        size = int.from_bytes(head[begin : begin + width], "little")
        begin += width
        message_head = struct.Struct("<BHBxx" if flags & _HAS_ORDER else "<BHB")
    else:
        begin, size = 16, struct.unpack_from("<I", head, 8)[0]
        message_head = struct.Struct("<HHBxxx")
    blocks = [(base + address + begin, size)]
    for block in blocks:
        data = _at(file, *block)
        if is_new and block is not blocks[0]:
            data = data[4:-4]  # between a signature and a checksum
        at = 0
        while at + message_head.size <= len(data):
            kind, length, flags = message_head.unpack_from(data, at)
            at += message_head.size
            content = data[at : at + length]
            at += length
            if kind == _ATTRIBUTE and not flags & _IS_SHARED:
                yield content
            elif kind == _CONTINUATION and len(blocks) < _MOST_BLOCKS:
                offset, size = struct.unpack_from("<QQ", content)
                blocks.append((base + offset, size))


def _name_and_data(message: bytes) -> tuple[bytes, bytes]:
    version, _, *sizes = struct.unpack_from("<BBHHH", message)
    begin = 9 if version == _NEW_ATTRIBUTE else 8
    name = message[begin : begin + sizes[0]].rstrip(b"\0")
    step = 8 if version == _OLD_ATTRIBUTE else 1
    return name, message[begin + sum(-(-size // step) * step for size in sizes) :]


def _heap_text(file: BinaryIO, base: int, length: int, heap: int, number: int) -> bytes:
    """Return a string by its length, the address of its heap, and its index in the heap."""
    if not length:
        return b""
    (size,) = struct.unpack_from("<8xQ", _at(file, base + heap, 16))
    data = _at(file, base + heap, size)
    at = 16
    while data.startswith(b"GCOL"):
        found, _, _, size = _HEAP_OBJECT.unpack_from(data, at)
        at += _HEAP_OBJECT.size
        if found == number and length <= size <= len(data) - at:
            return data[at : at + length]
        at += -(-size // 8) * 8
    raise LookupError


# Attributes of HDF5 datasets: unit, column names, packing, missing values.


_SAMPLE_RATES = ("sampling_rate", "sample_rate")
_COLUMN_NAMES = ("columns", "column_names", "names")
_UNITS = ("Units", "units", "Unit", "unit")
_PLAIN = {"scale_factor": 1, "add_offset": 0}
_ABSENT = ("_FillValue", "missing_value")


def packing(dataset: Any) -> str:
    """Return the attribute that packs the stored numbers; ``""``: none.

    References
    ----------
    CF Metadata Conventions, 8.1 "Packed data".
    """
    for name, neutral in _PLAIN.items():
        if name in dataset.attrs and _attribute(dataset, name).tolist() != [neutral]:
            return name
    return ""


def absent_values(dataset: Any) -> list[Any]:
    """Return the stored numbers that mean a missing value, as in netCDF."""
    if dataset.dtype.kind not in "iuf":
        return []
    arrays = (_attribute(dataset, name) for name in _ABSENT)
    values = (x for array in arrays if array.dtype == dataset.dtype for x in array.tolist())
    return [x for x in values if np.isfinite(x)]


def sample_rate(file: Any) -> float | None:
    """Return the sample rate declared by a file, Hz."""
    for name in _SAMPLE_RATES:
        value = _attribute(file, name)
        if value.size == 1 and value.dtype.kind in "iuf" and 0 < value.flat[0] < np.inf:
            return float(value.flat[0])
    return None


def unit_of(dataset: Any, file: BinaryIO) -> str:
    """Return the unit declared by a dataset, as the suffix of a column name."""
    for name in _UNITS:
        texts = _texts(dataset, name, file)
        if len(texts) == 1 and texts[0]:
            return f" [{texts[0]}]"
    return ""


def column_names(dataset: Any, count: int, file: BinaryIO) -> list[str]:
    """Return the names of the columns of a dataset; empty: no names."""
    for name in _COLUMN_NAMES:
        names = _texts(dataset, name, file)
        if all(names) and len(set(names)) == len(names) == count > 1:
            return names
    return []


def _attribute(item: Any, name: str) -> AnyArray:
    """Return an attribute of fixed size as one dimension; empty for others."""
    if name in item.attrs and not item.attrs.get_id(name).dtype.hasobject:
        return np.asarray(item.attrs[name]).reshape(-1)
    return np.empty(0)


def _texts(dataset: Any, name: str, file: BinaryIO) -> list[str]:
    """Return the strings of an attribute; empty for other types."""
    import h5py

    value = _attribute(dataset, name)
    if value.dtype.kind == "S":
        return [text.decode(errors="replace").strip() for text in value.tolist()]
    if value.size or name not in dataset.attrs:
        return []
    if h5py.check_string_dtype(dataset.attrs.get_id(name).dtype) is None:
        return []
    address = h5py.h5o.get_info(dataset.id).addr
    texts = variable_text(file, dataset.file.userblock_size, address, name)
    if texts is None:
        raise HeaderError(f"its attribute {quoted(name)} cannot be read; save it as numpy.bytes_")
    return [text.strip() for text in texts]


# Storage of HDF5 datasets: read only rows that are stored in the file itself.
#
# A dataset can refer to other files, and the library returns zeros for rows that were never
# written.


_CACHE_BYTES = 1 << 26
_DEFLATE_RATIO = 1032
"""Maximum compression ratio of deflate."""
_LEAST_SLOTS, _SLOTS_A_CHUNK = 521, 10

ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError)
"""Exceptions of h5py for damaged files."""


def shape_of(dataset: Any) -> tuple[int, ...] | None:
    """Return the number of rows and columns; None for a dataset without a shape."""
    import h5py

    layout = dataset.id.get_create_plist()
    if layout.get_layout() == h5py.h5d.VIRTUAL:
        # Dataset.shape would open the files that it refers to.
        space = layout.get_virtual_vspace(0) if layout.get_virtual_count() else None
        shape = space and space.get_simple_extent_dims()
    else:
        shape = dataset.shape
    return shape[::-1] if shape and has_samples_in_columns(dataset, shape) else shape


def has_samples_in_columns(dataset: Any, shape: tuple[int, ...]) -> bool:
    """Return whether samples are along the second dimension.

    MATLAB writes in column-major order.
    """
    is_of_matlab = len(shape) == 2 and "MATLAB_class" in dataset.attrs  # noqa: PLR2004
    return is_of_matlab != has_signals_in_rows(shape[::-1] if is_of_matlab else shape)


def refusal(dataset: Any, file_size: int) -> str:
    """Return why a dataset cannot be read; ``""`` if it can.

    The data are not accessed.

    `file_size`: size of its file, bytes
    """
    import h5py

    layout = dataset.id.get_create_plist()
    kind = layout.get_layout()
    files: list[str] = []
    if kind == h5py.h5d.VIRTUAL:
        sources = range(layout.get_virtual_count())
        files = [layout.get_virtual_filename(k) for k in sources]
    elif kind == h5py.h5d.CONTIGUOUS:
        external = range(layout.get_external_count())
        files = [layout.get_external(k)[0].decode(errors="replace") for k in external]
    if files or kind == h5py.h5d.VIRTUAL:
        names = listed(sorted(set(files))) or "that is missing"
        return f"it refers to data elsewhere, {names}, which is not opened; save its values here"
    filters = [layout.get_filter(k) for k in range(layout.get_nfilters())]
    for code, _, _, name in filters:
        if not h5py.h5z.filter_avail(code):
            return (
                f"it is compressed with filter {code} ({name.decode(errors='replace')}), which "
                "HDF5 does not have here; set HDF5_PLUGIN_PATH to the folder of its plugin"
            )
    codes = [code for code, *_ in filters]
    if len(set(codes)) < len(codes):
        return "it is compressed several times; save it compressed once"
    limit = decompressed_limit(file_size)
    if kind == h5py.h5d.CHUNKED and dataset.nbytes > limit:
        return too_large(limit)
    return ""


class StoredRows:
    """Columns of a dataset, read by rows.

    `step`: bytes read per row
    """

    def __init__(self, dataset: Any, columns: Sequence[tuple[str, ArrayColumn]]) -> None:
        import h5py

        self._columns = columns
        self._absent_values = absent_values(dataset)
        self._dataset = dataset
        self._shape: tuple[int, ...] = dataset.shape
        self._axis = int(has_samples_in_columns(dataset, self._shape))
        self._width: slice[int, int, None]  # of several columns
        self.step = size = dataset.dtype.itemsize
        if len(self._shape) > 1:
            # Only from the first wanted column to the last.
            places = [column.offset // size for _, column in columns]
            self._width = slice(min(places), max(places) + 1)
            self.step *= self._width.stop - self._width.start
            first = self._width.start * size
            self._columns = [
                (name, column._replace(offset=column.offset - first, step=self.step))
                for name, column in columns
            ]
        self.why_missing = "they were never written"
        self._chunks_across = 1
        self._places: Int64 = np.empty((0, 1), np.int64)
        self._absent = np.array(dataset.fillvalue, dataset.dtype).tobytes()
        layout = dataset.id.get_create_plist()
        if layout.get_layout() == h5py.h5d.CHUNKED:
            self.unit = dataset.chunks[self._axis]
            self._written = self._written_chunks(layout.get_chunk())
        else:
            self.unit = self._shape[self._axis]
            is_written = layout.get_layout() == h5py.h5d.COMPACT or dataset.id.get_offset()
            self._written = np.arange(1 if is_written else 0)

    def _written_chunks(self, chunk: tuple[int, ...]) -> Int64:
        """Return the row index of each stored chunk, sorted.

        An index is repeated if several chunks cover the columns of a row. The dataset is reopened
        with a cache for all chunks of a row.
        """
        import h5py

        dataset = self._dataset
        first, last = 0, 0
        if len(chunk) > 1:
            width = chunk[1 - self._axis]
            first, last = self._width.start // width, (self._width.stop - 1) // width
        self._chunks_across = last - first + 1
        chunk_bytes = math.prod(chunk) * dataset.dtype.itemsize
        size = chunk_bytes * self._chunks_across
        if size > MAX_SIZE:
            raise HeaderError(f"the chunks of a row have {size} bytes, over the limit {MAX_SIZE}")
        access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
        slots = max(_LEAST_SLOTS, _SLOTS_A_CHUNK * self._chunks_across + 1)
        access.set_chunk_cache(slots, max(size, _CACHE_BYTES), 1.0)
        name = dataset.name.encode()
        self._dataset = h5py.Dataset(h5py.h5d.open(dataset.file.id, name, access))
        places: list[tuple[int, ...]] = []
        large: list[tuple[int, ...]] = []

        def note(info: Any) -> None:
            is_large = dataset.compression == "gzip" and info.size * _DEFLATE_RATIO > MAX_SIZE
            (large if is_large else places).append(info.chunk_offset)

        try:
            self._dataset.id.chunk_iter(note)
            bounded = [place for place in large if self._is_bounded(place, chunk_bytes)]
            if len(bounded) < len(large):
                self.why_missing = f"a chunk of them decompresses to more than {chunk_bytes} bytes"
            places += bounded
        except ERRORS as error:
            self.why_missing = f"the index of their chunks is damaged: {plain(error)}"
        found = np.unique(np.array(places, np.int64).reshape(-1, len(chunk)), axis=0)
        if len(chunk) > 1:
            across = found[:, 1 - self._axis] // width
            found = found[(first <= across) & (across <= last)]
        rows: Int64 = found[:, self._axis] // self.unit
        order = np.argsort(rows, kind="stable")
        self._places = found[order]
        return np.sort(rows)

    def _is_bounded(self, place: tuple[int, ...], size: int) -> bool:
        """Return whether a chunk decompresses to its size at most; HDF5 has no limit."""
        _, data = self._dataset.id.read_direct_chunk(place)
        with suppress(zlib.error):  # HDF5 will find the same
            return len(zlib.decompressobj().decompress(data, size + 1)) <= size
        return True

    def written(self, begin: int, end: int) -> float:
        """Return the share of rows that is stored, from 0 to 1."""
        first, last = begin // self.unit, -(-end // self.unit)
        found = np.searchsorted(self._written, (first, last))
        return float((found[1] - found[0]) / ((last - first) * self._chunks_across))

    def boundaries(self, begin: int, end: int) -> range:
        """Return the chunk boundaries between two rows."""
        return range((begin // self.unit + 1) * self.unit, end, self.unit)

    def read(self, begin: int, end: int) -> Iterator[tuple[str, pa.Array]]:
        """Yield the name and the values of each column for some rows."""
        rows = slice(begin, end)
        if len(self._shape) == 1:
            values = self._dataset[rows]
        elif self._axis:
            values = self._dataset[self._width, rows].T
        else:
            values = self._dataset[rows, self._width]
        data = np.ascontiguousarray(values).reshape(-1).view(np.uint8).data
        self._verify_places(begin, end, data)
        for name, column in self._columns:
            stored = values_in(data, column, end - begin)
            for absent in self._absent_values:
                stored = pc.if_else(pc.equal(stored, absent), None, stored)
            yield name, stored

    def _verify_places(self, begin: int, end: int, data: memoryview) -> None:
        """Raise an error if a chunk that reads as fill values cannot be found in the file.

        In a damaged index, a chunk may be listed but not found, and reads as fill values.
        """
        for unit in range(begin // self.unit, -(-end // self.unit)) if len(self._places) else ():
            at = (max(begin, unit * self.unit) - begin) * self.step
            if data[at : at + len(self._absent)] == self._absent:
                first, last = np.searchsorted(self._written, (unit, unit + 1))
                for place in self._places[first:last].tolist():
                    self._dataset.id.read_direct_chunk(tuple(place))


class _Rows(NamedTuple):
    """A range of rows of a table, with `end` excluded; `lost`: why they cannot be read."""

    begin: int
    end: int
    lost: str = ""
    batch: pa.RecordBatch | None = None


def read_rows(
    datasets: Sequence[StoredRows], rows: int, losses: Losses
) -> Iterator[pa.RecordBatch | int]:
    """Yield the rows of several datasets; an integer is a number of lost rows."""
    step = max(dataset.step for dataset in datasets)
    pieces = (
        piece
        for begin in range(0, rows, rows_at_once(step))
        for piece in _pieces(datasets, begin, min(begin + rows_at_once(step), rows))
    )
    for reason, group in groupby(pieces, lambda piece: piece.lost):
        if not reason:
            yield from (piece.batch for piece in group)
            continue
        lost = list(group)
        count = lost[-1].end - lost[0].begin
        losses.note(f"rows {lost[0].begin + 1} to {lost[-1].end}", reason, count)
        yield count


def _pieces(datasets: Sequence[StoredRows], begin: int, end: int) -> Iterator[_Rows]:
    """Yield rows at once, or chunk by chunk if some of them are lost."""
    missing = min(datasets, key=lambda dataset: dataset.written(begin, end))
    share, lost = missing.written(begin, end), missing.why_missing
    if share == 1:
        try:
            columns = dict(pair for dataset in datasets for pair in dataset.read(begin, end))
            batch = pa.record_batch(list(columns.values()), list(columns))
        except ERRORS as error:
            lost = f"they are damaged: {plain(error)}"
        else:
            yield _Rows(begin, end, batch=batch)
            return
    inside = {place for dataset in datasets for place in dataset.boundaries(begin, end)}
    if not share or not inside:
        yield _Rows(begin, end, lost)
        return
    for piece in pairwise([begin, *sorted(inside), end]):
        yield from _pieces(datasets, *piece)


_MAGIC = b"\x89HDF\r\n\x1a\n"


class Hdf5Log(NumpyTable):
    """An HDF5 file; each dataset of one or two dimensions becomes one or several columns.

    ``group/gyr`` of shape ``(N, 3)`` becomes ``group.gyr[0]`` to ``group.gyr[2]``, or
    ``group.gyr.x`` etc. if its attribute ``columns`` has names. The attribute ``sampling_rate`` of
    the file, Hz, replaces missing times. In MATLAB files (version 7.3) rows and columns are
    exchanged. Nothing outside the file is opened.
    """

    kind = "hdf5"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            import h5py
        except ImportError as error:
            raise UsageError(
                f"{plain(path)}: HDF5 needs h5py, which is not installed; pip install h5py"
            ) from error
        self._refused: dict[str, str] = {}
        try:
            with ExitStack() as resources:
                # A program that is still writing holds a lock, which readers need not respect.
                self._file = resources.enter_context(h5py.File(path, "r", locking=False))
                self._sample_rate = sample_rate(self._file)
                with path.open("rb") as self._bytes:
                    self._file.visititems(self._describe)
                self._file.visititems_links(self._describe_link)
                self._note_rest()
                if all(member in self._refused for member, _ in self._members):
                    reason = next(iter(self._refused.values()), "it has no datasets; name a log")
                    raise UnsupportedLogError(path, reason)
                resources.pop_all()
        except ERRORS as error:
            raise DamagedLogError(
                path,
                f"its groups and datasets are damaged ({plain(error)}); was it closed and copied "
                "whole?",
            ) from error

    @property
    def notes(self) -> TableNotes:
        """The sample rate declared by the file."""
        return TableNotes(sample_rate=self._sample_rate)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _note_rest(self) -> None:
        """Note bytes after the end declared in the file.

        References
        ----------
        The HDF Group, "HDF5 File Format Specification", II.A: "Superblock".
        """
        with self.path.open("rb") as file:
            file.seek(self._file.userblock_size)
            head = file.read(64)
            size = file.seek(0, 2)
        version = head[len(_MAGIC)]
        at = 28 if version > 1 else 40 + 4 * version
        end = int.from_bytes(head[at : at + 8], "little")
        if head.startswith(_MAGIC) and end < size:
            self.losses.note(f"byte {end}", following(size - end, "the file"))

    def _describe_link(self, path: str, link: Any) -> None:
        """Refuse the columns of a link to another file, and remark on it."""
        if hasattr(link, "filename"):
            leads = f"its link {quoted(path)} leads to another file, {quoted(link.filename)}"
            self._refused[path] = f"{leads}, which is not opened; name that file"
            self.remark("external-link", f"{leads}, which is not opened")

    def _describe(self, path: str, item: Any) -> None:
        """Add the columns of a dataset, or note why it has none."""
        import h5py

        if not isinstance(item, h5py.Dataset):
            return
        columns: list[ArrayColumn] = []
        given: list[str] = []
        unit = reason = ""
        try:
            columns = _columns(item)
            reason = refusal(item, self.path.stat().st_size)
            given = column_names(item, len(columns), self._bytes)
            # Columns of several quantities have no common unit.
            unit = "" if given or item.dtype.names else unit_of(item, self._bytes)
            if attribute := packing(item):
                reason = f"its numbers are packed, with {quoted(attribute)}; save them unpacked"
        except HeaderError as error:
            reason = str(error)
        if reason:
            self._refused[path] = f"its dataset {quoted(path)}: {reason}"
        name = path.replace("/", ".")
        for column, own in zip(columns, given or [""] * len(columns), strict=True):
            inner = own or column.name
            dot = "." if inner and not inner.startswith("[") else ""
            self._add_column(name + dot + inner + unit, path, column)

    def _row_groups(self, columns: TimedColumns) -> Iterator[RowGroup]:
        for k in (*columns.stamp.columns, *columns.numbers):
            if reason := self._refused.get(self._members[k][0]):
                raise UnsupportedLogError(self.path, reason)
        yield from super()._row_groups(columns)

    def _batches(self, wanted: list[Wanted], rows: int) -> Iterator[pa.RecordBatch | int]:
        members: dict[str, list[tuple[str, ArrayColumn]]] = {}
        for name, member, column in wanted:
            members.setdefault(member, []).append((name, column))
        datasets = []
        for member, columns in members.items():
            try:
                dataset = StoredRows(self._file[member], columns)
            except HeaderError as error:
                reason = f"its dataset {quoted(member)}: {error}"
                raise UnsupportedLogError(self.path, reason) from error
            except ERRORS as error:
                raise DamageError(plain(error)) from error
            datasets.append(dataset)
        yield from read_rows(datasets, rows, self.losses)


def _columns(dataset: Any) -> list[ArrayColumn]:
    """Return the columns of a dataset."""
    shape = shape_of(dataset)
    if shape is None or dataset.dtype.hasobject:
        raise HeaderError(f"its type is {dataset.dtype}, not numbers")
    return columns_of(ArrayHeader(dataset.dtype, shape, is_fortran=False))
