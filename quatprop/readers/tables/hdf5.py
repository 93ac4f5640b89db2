"""HDF5 files: datasets as columns, named by their paths; read by h5py, whole or not at all."""

from __future__ import annotations

import math
import struct
import zlib
from contextlib import suppress
from io import FileIO
from itertools import chain, compress, product
from typing import TYPE_CHECKING, Any

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
from quatprop.stores.compression import MAX_SIZE, decompressed_limit, too_large

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray
    from quatprop.readers.tables.table_log import TimedColumns
    from quatprop.readers.tables.typed_table import RowGroup

_ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError)
"""Exceptions of h5py for damaged files."""

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
        self._absent: dict[str, list[Any]] = {}
        try:
            with _CheckedFile(path) as content, h5py.File(content, "r") as file:
                self._sample_rate = _sample_rate(file)
                file.visititems(self._describe)
                file.visititems_links(self._describe_link)
                self._note_rest(file.userblock_size)
            if all(member in self._refused for member, _ in self._members):
                reason = next(iter(self._refused.values()), "it has no datasets; name a log")
                raise UnsupportedLogError(path, reason)
            # A program that is still writing holds a lock, which readers need not respect.
            self._file = h5py.File(path, "r", locking=False, rdcc_nbytes=_CACHE_BYTES)
        except _ERRORS as error:
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

    def _note_rest(self, begin: int) -> None:
        """Note bytes after the end declared in the file.

        `begin`: offset of its superblock

        References
        ----------
        The HDF Group, "HDF5 File Format Specification", II.A: "Superblock".
        """
        with self.path.open("rb") as file:
            file.seek(begin)
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
            reason = next(_refusals(item, self.path.stat().st_size), "")
            given = _column_names(item, len(columns))
            # Columns of several quantities have no common unit.
            unit = "" if given or item.dtype.names else _unit(item)
            self._absent[path] = _absent_values(item)
        except (HeaderError, TypeError) as error:
            reason = plain(error)
        if reason:
            self._refused[path] = f"its dataset {quoted(path)}: {reason}"
        name = path.replace("/", ".")
        for column, own in zip(columns, given or [""] * len(columns), strict=True):
            inner = own or column.name
            dot = "." if inner and not inner.startswith("[") else ""
            self._add_column(name + dot + inner + unit, path, column)

    def are_of_same_rows(self, columns: Sequence[int]) -> bool:
        """Return whether columns can be read together: none is refused."""
        members = {self._members[k][0] for k in columns}
        return self._refused.keys().isdisjoint(members) and super().are_of_same_rows(columns)

    def _row_groups(self, columns: TimedColumns) -> Iterator[RowGroup]:
        for k in (*columns.stamp.columns, *columns.numbers):
            if reason := self._refused.get(self._members[k][0]):
                raise UnsupportedLogError(self.path, reason)
        yield from super()._row_groups(columns)

    def _batches(self, wanted: list[Wanted], rows: int) -> Iterator[pa.RecordBatch | int]:
        members: dict[str, list[tuple[str, ArrayColumn]]] = {}
        for name, member, column in wanted:
            members.setdefault(member, []).append((name, column))
        try:
            datasets = [
                _StoredRows(self.path, self._file[member], columns, self._absent[member])
                for member, columns in members.items()
            ]
        except _ERRORS as error:
            reason = f"its datasets {listed(members)} are damaged ({plain(error)}); save them again"
            raise DamagedLogError(self.path, reason) from error
        at_once = rows_at_once(max(dataset.step for dataset in datasets))
        for begin in range(0, rows, at_once):
            end = min(begin + at_once, rows)
            arrays = dict(chain.from_iterable(dataset.read(begin, end) for dataset in datasets))
            yield pa.record_batch(list(arrays.values()), list(arrays))


# Structure: what h5py tells, in a file that cannot hang it.


_HEAP, _HEAP_HEAD = b"GCOL", 16


class _CheckedFile(FileIO):
    """A file in which no damaged heap keeps HDF5 busy without end.

    Heaps hold the texts of variable length. HDF5 steps from object to object by their sizes, even
    if one is zero.

    References
    ----------
    The HDF Group, "HDF5 File Format Specification", III.E "Global Heap".
    """

    def readinto(self, buffer: Any) -> int:
        """Read bytes; raise OSError if a heap begins there that its objects do not fill."""
        count = super().readinto(buffer) or 0
        if count < len(buffer):
            raise OSError("the file has become shorter")
        if bytes(buffer[: len(_HEAP)]) == _HEAP:
            at = self.tell() - count
            end = at + int.from_bytes(bytes(buffer[8:_HEAP_HEAD]), "little")
            at += _HEAP_HEAD
            while at + _HEAP_HEAD <= end:
                self.seek(at)
                number, size = struct.unpack(
                    "<H6xQ", self.read(_HEAP_HEAD).ljust(_HEAP_HEAD, b"\0")
                )
                step = _HEAP_HEAD + -(-size // 8) * 8 if number else size
                if not _HEAP_HEAD <= step <= end - at:
                    raise OSError("its texts are damaged")
                at += step
        return count


def _columns(dataset: Any) -> list[ArrayColumn]:
    """Return the columns of a dataset."""
    if dataset.is_virtual:
        # Dataset.shape would open the files that it refers to.
        shape = next((source.vspace.shape for source in dataset.virtual_sources()), None)
    else:
        shape = dataset.shape
    if shape is None or dataset.dtype.hasobject:
        raise HeaderError(f"its type is {dataset.dtype}, not numbers")
    if _has_samples_in_columns(dataset, shape):
        shape = shape[::-1]
    return columns_of(ArrayHeader(dataset.dtype, shape, is_fortran=False))


def _has_samples_in_columns(dataset: Any, shape: tuple[int, ...]) -> bool:
    """Return whether samples are along the second dimension.

    MATLAB writes in column-major order.
    """
    is_of_matlab = len(shape) == 2 and "MATLAB_class" in dataset.attrs  # noqa: PLR2004
    return is_of_matlab != has_signals_in_rows(shape[::-1] if is_of_matlab else shape)


def _refusals(dataset: Any, file_size: int) -> Iterator[str]:
    """Yield why a dataset cannot be read; its data are not accessed.

    `file_size`: size of its file, bytes

    References
    ----------
    CF Metadata Conventions, 8.1 "Packed data".
    """
    import h5py

    if dataset.is_virtual or dataset.external:
        files = {name for name, *_ in dataset.external or ()}
        if dataset.is_virtual:
            files = {source.file_name for source in dataset.virtual_sources()}
        names = listed(sorted(files)) or "that is missing"
        yield f"it refers to data elsewhere, {names}, which is not opened; save its values here"
    layout = dataset.id.get_create_plist()
    filters = [layout.get_filter(k) for k in range(layout.get_nfilters())]
    for code, _, _, name in filters:
        if not h5py.h5z.filter_avail(code):
            yield (
                f"it is compressed with filter {code} ({name.decode(errors='replace')}), which "
                "HDF5 does not have here; set HDF5_PLUGIN_PATH to the folder of its plugin"
            )
    if len({code for code, *_ in filters}) < len(filters):
        yield "it is compressed several times; save it compressed once"
    limit = decompressed_limit(file_size)
    if dataset.chunks and dataset.nbytes > limit:
        yield too_large(limit)
    if (size := _chunk_bytes(dataset)) > MAX_SIZE:
        yield f"its chunks have {size} bytes, over the limit {MAX_SIZE}; save it in smaller ones"
    is_whole = layout.get_layout() == h5py.h5d.CONTIGUOUS
    if is_whole and dataset.size and dataset.id.get_offset() is None:
        yield "it was never written; was the recording closed?"
    for name, neutral in _PLAIN.items():
        if name in dataset.attrs and {*_attribute(dataset, name).tolist()} != {neutral}:
            yield f"its numbers are packed, with {quoted(name)}; save them unpacked"
    for name in _FACTORS if dataset.dtype.kind in "iu" else ():
        factors = _attribute(dataset, name)
        if factors.dtype.kind in "iuf" and (factors != 1).any():
            yield (
                f"its numbers are integers with the attribute {quoted(name)}, and no convention "
                "says how it is applied; save them as floats in their unit, or without the "
                "attribute if they are in it already"
            )


def _chunk_bytes(dataset: Any) -> int:
    """Return the size of a chunk, bytes; 0: no chunks."""
    return math.prod(dataset.chunks) * int(dataset.dtype.itemsize) if dataset.chunks else 0


# Attributes: unit, column names, packing, missing values.


_SAMPLE_RATES = ("sampling_rate", "sample_rate")
_COLUMN_NAMES = ("columns", "column_names", "names")
_UNITS = ("Units", "units", "Unit", "unit")
_PLAIN = {"scale_factor": 1, "add_offset": 0}
_FACTORS = (
    *("scale", "scaling", "gain", "factor", "conversion_factor", "scale_factors", "conversion"),
    *("sensitivity", "lsb", "multiplier"),
)
"""Attributes of integers that are counts of a sensor, if they are numbers; the resolution of NWB
is the smallest difference that has a meaning, in the unit of the numbers."""
_ABSENT = ("_FillValue", "missing_value")


def _absent_values(dataset: Any) -> list[Any]:
    """Return the stored numbers that mean a missing value, as in netCDF."""
    if dataset.dtype.kind not in "iuf":
        return []
    arrays = (_attribute(dataset, name) for name in _ABSENT)
    values = (x for array in arrays if array.dtype == dataset.dtype for x in array.tolist())
    return [x for x in values if np.isfinite(x)]


def _sample_rate(file: Any) -> float | None:
    """Return the sample rate declared by a file, Hz."""
    for name in _SAMPLE_RATES:
        value = _attribute(file, name)
        if value.size == 1 and value.dtype.kind in "iuf" and 0 < value.flat[0] < np.inf:
            return float(value.flat[0])
    return None


def _unit(dataset: Any) -> str:
    """Return the unit declared by a dataset, as the suffix of a column name."""
    for name in _UNITS:
        texts = _texts(dataset, name)
        if len(texts) == 1 and texts[0]:
            return f" [{texts[0]}]"
    return ""


def _column_names(dataset: Any, count: int) -> list[str]:
    """Return the names of the columns of a dataset; empty: no names."""
    for name in _COLUMN_NAMES:
        names = _texts(dataset, name)
        if all(names) and len(set(names)) == len(names) == count > 1:
            return names
    return []


def _attribute(item: Any, name: str) -> AnyArray:
    """Return an attribute of fixed size as one dimension; empty for others."""
    if name in item.attrs and not item.attrs.get_id(name).dtype.hasobject:
        return np.asarray(item.attrs[name]).reshape(-1)
    return np.empty(0)


def _texts(dataset: Any, name: str) -> list[str]:
    """Return the strings of an attribute; empty for other types."""
    import h5py

    if name not in dataset.attrs:
        return []
    try:
        if h5py.check_string_dtype(dataset.attrs.get_id(name).dtype) is None:
            return []
        values = np.asarray(dataset.attrs[name]).reshape(-1).tolist()
    except OSError as error:
        reason = f"its attribute {quoted(name)} cannot be read ({plain(error)}); save it again"
        raise HeaderError(reason) from error
    # Bytes of fixed length, or text of variable length in which h5py marks bytes that are none.
    texts = (
        text if isinstance(text, bytes) else text.encode(errors="surrogateescape")
        for text in values
    )
    return [text.decode(errors="replace").strip() for text in texts]


# Rows: only those that are stored in the file itself, for which memory is bounded.


_CACHE_BYTES = 1 << 24
"""Chunks that span several reads are decompressed once if they are smaller."""

_DEFLATE_RATIO = 1032
"""Maximum compression ratio of deflate."""


class _StoredRows:
    """Columns of a dataset, read by rows.

    `absent`: stored numbers that mean a missing value
    `step`: bytes read per row

    Raises DamagedLogError with the place of rows that cannot be read.
    """

    def __init__(
        self,
        log: Path,
        dataset: Any,
        columns: Sequence[tuple[str, ArrayColumn]],
        absent: Sequence[Any],
    ) -> None:
        self._log, self._dataset, self._absent = log, dataset, absent
        self._columns = columns
        self._axis = int(_has_samples_in_columns(dataset, dataset.shape))
        self._width: tuple[slice[int, int, None], ...] = ()
        self.step = size = dataset.dtype.itemsize
        if dataset.ndim > 1:
            # Only from the first wanted column to the last.
            places = [column.offset // size for _, column in columns]
            first, last = min(places), max(places)
            self._width = (slice(first, last + 1),)
            self.step *= last + 1 - first
            self._columns = [
                (name, column._replace(offset=column.offset - first * size, step=self.step))
                for name, column in columns
            ]
        self._unit = (dataset.chunks or dataset.shape)[self._axis]
        if dataset.chunks:
            self._check_sizes()

    def read(self, begin: int, end: int) -> list[tuple[str, pa.Array]]:
        """Return the name and the values of each column for some rows."""
        try:
            return list(self._read(begin, end))
        except _ERRORS as error:
            inside = range(begin // self._unit * self._unit, end, self._unit)
            for first in inside if len(inside) > 1 else ():
                self.read(max(first, begin), min(first + self._unit, end))  # to find the place
            raise self._damage(begin, end, plain(error)) from error

    def _damage(self, begin: int, end: int, reason: str) -> DamagedLogError:
        return DamagedLogError(
            self._log,
            f"its dataset {quoted(self._dataset.name[1:])}: rows {begin + 1} to {end} cannot be "
            f"read ({reason}); copy the others to a new file, with h5py",
        )

    def _read(self, begin: int, end: int) -> Iterator[tuple[str, pa.Array]]:
        part = (slice(begin, end), *self._width)
        part = part[::-1] if self._axis else part
        values = self._dataset[part]
        self._check_written(part, values)
        data = np.ascontiguousarray(values.T if self._axis else values).reshape(-1).view(np.uint8)
        for name, column in self._columns:
            stored = values_in(data.data, column, end - begin)
            for absent in self._absent:
                stored = pc.if_else(pc.equal(stored, absent), None, stored)
            yield name, stored

    def _check_written(self, part: tuple[slice[int, int, None], ...], values: AnyArray) -> None:
        """Raise OSError if a chunk that may be fill values is not in the file.

        Such chunks were never written, or are not where a damaged index has them; the library
        tells neither. They begin and end with the same value.
        """
        dataset = self._dataset
        if not dataset.chunks:
            return
        places = [
            range(along.start // size * size, along.stop, size)
            for along, size in zip(part, dataset.chunks, strict=True)
        ]
        first, last = [], []
        for line, along in zip(places, part, strict=True):
            first.append([max(place, along.start) - along.start for place in line])
            last.append([min(place + line.step, along.stop) - along.start - 1 for place in line])
        kind = np.dtype((np.void, dataset.dtype.itemsize))
        begin, end = (
            np.ascontiguousarray(values[np.ix_(*corners)]).reshape(-1).view(kind)
            for corners in (first, last)
        )
        for place in compress(product(*places), (begin == end).tolist()):
            try:
                dataset.id.read_direct_chunk(place)
            except _ERRORS as error:
                raise OSError("they were never written") from error

    def _check_sizes(self) -> None:
        """Refuse chunks of other sizes than their own, for which the library has no limit.

        It takes memory for whatever a packed chunk holds, and writes one that is not packed beyond
        its memory.
        """
        dataset, size = self._dataset, _chunk_bytes(self._dataset)
        if dataset.size and not dataset.id.get_num_chunks():
            raise self._damage(0, dataset.shape[self._axis], "they were never written")
        is_packed = dataset.id.get_create_plist().get_nfilters() > 0
        doubtful: list[tuple[int, ...]] = []

        def note(chunk: Any) -> None:
            if chunk.size * _DEFLATE_RATIO > MAX_SIZE if is_packed else chunk.size != size:
                doubtful.append(chunk.chunk_offset)

        dataset.id.chunk_iter(note)
        for place in doubtful:
            if not is_packed or _unpacks_to_more(dataset.id.read_direct_chunk(place)[1], size):
                first = place[self._axis]
                reason = f"their chunk has other than {size} bytes"
                raise self._damage(first, first + self._unit, reason)


def _unpacks_to_more(data: bytes, size: int) -> bool:
    """Return whether a deflate stream holds more than a chunk and the checksum of a filter."""
    with suppress(zlib.error):  # HDF5 will find the same
        return len(zlib.decompressobj().decompress(data, size + 9)) > size + 8
    return False
