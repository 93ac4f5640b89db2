"""Tables as NumPy files: a structured array in ``.npy``, an array per column in ``.npz``.

A ``.npy`` file cannot store provenance; in ``.npz`` it is the string ``quatprop``, as JSON.
"""

from __future__ import annotations

import shutil
import zipfile
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from quatprop.kinematics.time_series import IN_CACHE, blocks
from quatprop.writers.atomic import OutputFile, scratch_file
from quatprop.writers.base import TableWriter, provenance_json
from quatprop.writers.targets import refuse_streams

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray

PROVENANCE = "quatprop"
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The time of an archive's members: fixed, at ZIP's earliest, so that bytes are reproducible."""


class NpyTable(TableWriter):
    """A table as a structured array with a field per column.

    `target`: a path; not a pipe, since the file begins with the number of rows
    `names`: names of the float64 columns that follow ``t_ns``
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        self._dtype = np.dtype([("t_ns", "<i8"), *((name, "<f8") for name in names)])
        self._count = 0
        refuse_streams(target, "a NumPy file")
        super().__init__(OutputFile(target))
        with self._opening():
            self._write_header()

    def _write(self, t_ns: AnyArray, columns: Sequence[AnyArray]) -> None:
        for part in blocks(len(t_ns), IN_CACHE):
            rows = np.empty(len(t_ns[part]), self._dtype)
            for name, column in zip(self._dtype.fields or (), (t_ns, *columns), strict=True):
                rows[name] = column[part]
            self._output.stream.write(rows.data)
        self._count += len(t_ns)

    def _finish(self, provenance: Mapping[str, object]) -> None:  # noqa: ARG002  # cannot be stored
        self._output.stream.seek(0)
        self._write_header()

    def _write_header(self) -> None:
        """Write the header, which has the same length for any number of rows."""
        np.lib.format.write_array_header_1_0(self._output.stream, _header(self._dtype, self._count))


class NpzTable(TableWriter):
    """A table as an archive of arrays; each is kept in a temporary file until the commit.

    `names`: names of the float64 columns that follow ``t_ns``
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        super().__init__(OutputFile(target))
        self._count = 0
        self._columns = {name: scratch_file(target) for name in ("t_ns", *names)}

    def _write(self, t_ns: AnyArray, columns: Sequence[AnyArray]) -> None:
        for body, column in zip(self._columns.values(), (t_ns, *columns), strict=True):
            body.write(np.ascontiguousarray(column).data)
        self._count += len(t_ns)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        provenance_array = np.array(provenance_json(provenance))
        with zipfile.ZipFile(self._output.stream, "w") as archive:
            for name, body in self._columns.items():
                with _member(archive, name) as member:
                    dtype = np.dtype("<i8" if name == "t_ns" else "<f8")
                    np.lib.format.write_array_header_1_0(member, _header(dtype, self._count))
                    body.seek(0)
                    shutil.copyfileobj(body, member, 1 << 20)
            with _member(archive, PROVENANCE) as member:
                np.lib.format.write_array(member, provenance_array, allow_pickle=False)

    def abort(self) -> None:
        """Discard uncommitted output."""
        for body in self._columns.values():
            body.close()
        super().abort()


def _header(dtype: np.dtype[Any], count: int) -> dict[str, object]:
    return {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": (count,)}


def _member(archive: zipfile.ZipFile, name: str) -> BinaryIO:
    """Open a member of any size for writing."""
    return archive.open(zipfile.ZipInfo(f"{name}.npy", _EPOCH), "w", force_zip64=True)  # type: ignore[return-value]  # an IO[bytes]
