"""Storage of HDF5 datasets: read only rows that are stored in the file itself.

A dataset can refer to other files, and the library returns zeros for rows that were never written.
"""

from __future__ import annotations

import math
import zlib
from contextlib import suppress
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from quatprop.stores.compression import MAX_SIZE
from quatprop.stores.limits import decompressed_limit, too_large
from quatprop.tables.hdf5_attributes import absent_values
from quatprop.tables.npy_format import HeaderError, has_signals_in_rows
from quatprop.tables.numpy_table import rows_at_once, values_in
from quatprop.text import listed, plain

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.arrays import Int64
    from quatprop.tables.log import Losses
    from quatprop.tables.npy_format import ArrayColumn

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
