"""HDF5 files: datasets as columns, named by their paths."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from quatprop.errors import DamagedLogError, UnsupportedLogError, UsageError
from quatprop.tables.hdf5_attributes import column_names, packing, sample_rate, unit_of
from quatprop.tables.hdf5_storage import ERRORS, StoredRows, read_rows, refusal, shape_of
from quatprop.tables.model import TableNotes
from quatprop.tables.npy_format import ArrayColumn, ArrayHeader, HeaderError, columns_of
from quatprop.tables.numpy_table import NumpyTable, Wanted, following
from quatprop.tables.typed_table import DamageError
from quatprop.text import plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import pyarrow as pa

    from quatprop.tables.base import TimedColumns
    from quatprop.tables.typed_table import RowGroup

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
