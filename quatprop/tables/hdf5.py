"""HDF5 files: datasets of columns, by the paths of their groups."""

from __future__ import annotations

import math
from contextlib import ExitStack, nullcontext
from typing import TYPE_CHECKING, Any, BinaryIO, cast

import numpy as np

from quatprop.errors import DamagedLogError, UnsupportedLogError, UsageError
from quatprop.tables.base import TableNotes, refuse_second_file
from quatprop.tables.npy_format import ArrayColumn, ArrayHeader, HeaderError, columns_of
from quatprop.tables.numpy_table import NumpyTable
from quatprop.text import plain, quoted

if TYPE_CHECKING:
    from pathlib import Path

    from quatprop.arrays import AnyArray

_MAGIC = b"\x89HDF\r\n\x1a\n"
_CHUNK_CACHE_BYTES = 1 << 26
_SAMPLE_RATES = ("sampling_rate", "sample_rate")
_COLUMN_NAMES = ("columns", "column_names", "names")
_UNITS = ("Units", "units", "Unit", "unit")
_MOST_UNPACKED = 2000
"""Bytes that a byte of the file may become: deflate stops at 1032."""

_ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError)
"""What h5py raises for damaged files."""


class Hdf5Log(NumpyTable):
    """Datasets of one dimension are columns, those of two have one for each of their columns.

    ``group/gyr`` of shape ``(N, 3)`` becomes ``group.gyr[0]`` to ``group.gyr[2]``, or
    ``group.gyr.x`` where its attribute ``columns`` says so in text of fixed length. The attribute
    ``sampling_rate`` of the file, Hz, counts the rows where there is no time. In files of MATLAB
    (version 7.3) rows and columns are exchanged.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    UsageError
        h5py is not installed.
    DamagedLogError
        Its groups and datasets cannot be listed.
    UnsupportedLogError
        It has no dataset that is a table, or another file was joined to it.
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
        self._refused = ""
        try:
            with ExitStack() as resources:
                # Programs that are still writing keep a lock, which only matters to other writers.
                self._file = resources.enter_context(
                    h5py.File(path, "r", locking=False, rdcc_nbytes=_CHUNK_CACHE_BYTES)
                )
                self._sample_rate = _sample_rate(self._file)
                self._file.visititems(self._describe)
                if (end := _second_file(path)) is not None:
                    refuse_second_file(path, end)
                if not self._leaves:
                    reason = self._refused or "it has no datasets; name a log"
                    raise UnsupportedLogError(path, reason)
                resources.pop_all()
        except _ERRORS as error:
            raise DamagedLogError(
                path,
                f"its groups and datasets are damaged ({plain(error)}); was it closed and copied "
                "whole?",
            ) from error

    @property
    def notes(self) -> TableNotes:
        """The sample rate that the file declares."""
        return TableNotes(sample_rate=self._sample_rate)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _describe(self, path: str, item: Any) -> None:
        """Add the columns of a dataset; those that are no columns are ignored."""
        if not hasattr(item, "shape"):
            return
        try:
            columns = _columns(item, self.path.stat().st_size)
        except HeaderError as error:
            self._refused = self._refused or f"its dataset {quoted(path)}: {error}"
            return
        name = path.replace("/", ".")
        given = _given_names(item, len(columns))
        # One unit is not that of columns of several quantities.
        unit = "" if given or item.dtype.names else _unit(item)
        for column, own in zip(columns, given or [""] * len(columns), strict=True):
            inner = own or column.name
            dot = "." if inner and not inner.startswith("[") else ""
            self._add_column(name + dot + inner + unit, path, column)

    def _open_rows(self, member: str) -> BinaryIO:
        return cast("BinaryIO", nullcontext(_DatasetBytes(self._file[member])))


def _is_of_matlab(dataset: Any) -> bool:
    """Whether MATLAB has written it, column after column."""
    return "MATLAB_class" in dataset.attrs and len(dataset.shape) == 2  # noqa: PLR2004


def _shape(dataset: Any) -> tuple[int, ...]:
    """Return rows and columns."""
    shape: tuple[int, ...] = dataset.shape
    return shape[::-1] if _is_of_matlab(dataset) else shape


class _DatasetBytes:
    """The numbers of a dataset, row after row, as they would stand in a file of NumPy."""

    def __init__(self, dataset: Any) -> None:
        self._dataset = dataset
        self._is_of_matlab = _is_of_matlab(dataset)
        self._step = dataset.dtype.itemsize * math.prod(_shape(dataset)[1:])
        self._next = 0

    def read(self, size: int) -> bytes:
        """Return whole rows, one at least, and fewer of them before a chunk that is damaged.

        Raises
        ------
        EOFError
            It begins here.
        """
        count = max(1, size // self._step)
        while True:
            rows = slice(self._next, self._next + count)
            try:
                taken = self._dataset[:, rows].T if self._is_of_matlab else self._dataset[rows]
            except _ERRORS as error:
                if count == 1:
                    raise EOFError(plain(error)) from error
                count //= 2
                continue
            self._next += len(taken)
            return bytes(taken.tobytes())


def _columns(dataset: Any, file_size: int) -> list[ArrayColumn]:
    """Return the columns of a dataset in a file of some bytes.

    Raises
    ------
    HeaderError
        It is no table of numbers.
    """
    if dataset.shape is None or dataset.dtype.hasobject:
        raise HeaderError(f"its type is {dataset.dtype}, not numbers")
    if dataset.nbytes > _MOST_UNPACKED * file_size:
        raise HeaderError(f"it claims {dataset.nbytes} bytes, which the file cannot hold")
    return columns_of(ArrayHeader(dataset.dtype, _shape(dataset), is_fortran=False))


def _second_file(path: Path) -> int | None:
    """Return where another file begins behind the end that the first one states.

    References
    ----------
    The HDF Group, "HDF5 File Format Specification", II.A: "Superblock".
    """
    with path.open("rb") as file:
        head = file.read(64)
        version = head[len(_MAGIC)]
        at = 28 if version > 1 else 40 + 4 * version
        end = int.from_bytes(head[at : at + 8], "little")
        if not head.startswith(_MAGIC) or end > path.stat().st_size:
            return None
        file.seek(end)
        return end if file.read(len(_MAGIC)) == _MAGIC else None


def _attribute(item: Any, name: str) -> AnyArray:
    """Return an attribute of fixed size; empty where it is another.

    Text of variable length is not asked for: HDF5 crashes or hangs where that is damaged.
    """
    if name in item.attrs and not item.attrs.get_id(name).dtype.hasobject:
        return np.atleast_1d(np.asarray(item.attrs[name]))
    return np.empty(0)


def _sample_rate(file: Any) -> float | None:
    for name in _SAMPLE_RATES:
        value = _attribute(file, name)
        if value.size == 1 and value.dtype.kind in "iuf" and 0 < value.flat[0] < np.inf:
            return float(value.flat[0])
    return None


def _unit(dataset: Any) -> str:
    """Return the unit that an attribute of the dataset declares, as headers of columns have it."""
    for name in _UNITS:
        value = _attribute(dataset, name)
        if value.dtype.kind == "S" and value.size == 1 and value.flat[0].strip():
            return f" [{value.flat[0].decode(errors='replace').strip()}]"
    return ""


def _given_names(dataset: Any, count: int) -> list[str]:
    """Return the names of columns that an attribute of the dataset gives; none without one."""
    for name in _COLUMN_NAMES:
        value = _attribute(dataset, name)
        if value.dtype.kind == "S" and value.shape == (count,):
            names = [text.decode(errors="replace").strip() for text in value.tolist()]
            if all(names) and len(set(names)) == count > 1:
                return names
    return []
