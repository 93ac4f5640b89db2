"""Tables as NumPy files: one structured array in ``.npy``, one array for each column in ``.npz``.

A ``.npy`` file has no place for provenance; in ``.npz`` it is the string ``quatprop``, as JSON.
"""

from __future__ import annotations

import shutil
import zipfile
from typing import TYPE_CHECKING

import numpy as np

from quatprop.writers.atomic import OutputFile, output_errors, scratch_file
from quatprop.writers.base import TableWriter, provenance_json
from quatprop.writers.targets import refuse_streams

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path
    from typing import Any, BinaryIO

    from numpy.typing import NDArray

PROVENANCE = "quatprop"
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The time of an archive's members: the earliest that ZIP has, so that bytes are reproducible."""


class NpyTable(TableWriter):
    """Write columns as one structured array with a field for each column.

    Parameters
    ----------
    target
        A path; the number of rows stands at its beginning, so it cannot be a pipe.
    names
        Names of the float64 columns that follow ``t_ns``.
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        self._dtype = np.dtype([("t_ns", "<i8"), *((name, "<f8") for name in names)])
        self._count = 0
        refuse_streams(target, "a NumPy file")
        self._output = OutputFile(target)
        with output_errors(target):
            self._write_header()

    def write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows."""
        rows = np.empty(len(t_ns), self._dtype)
        for name, column in zip(self._dtype.fields or (), (t_ns, *columns), strict=True):
            rows[name] = column
        with output_errors(self._output.target):
            self._output.stream.write(rows.data)
        self._count += len(rows)

    def finish(self, provenance: Mapping[str, object]) -> None:  # noqa: ARG002  # no place for it
        """Write the file to its end."""
        with output_errors(self._output.target):
            self._output.stream.seek(0)
            self._write_header()
        self._output.finish()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._output.discard()

    def _write_header(self) -> None:
        """Write the header, which has the same length for any number of rows."""
        np.lib.format.write_array_header_1_0(self._output.stream, _header(self._dtype, self._count))


class NpzTable(TableWriter):
    """Write columns as an archive of arrays; each is kept in a temporary file until the commit.

    Parameters
    ----------
    target
        A path.
    names
        Names of the float64 columns that follow ``t_ns``.
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        self._output = OutputFile(target)
        self._count = 0
        self._columns = {name: scratch_file(target) for name in ("t_ns", *names)}

    def write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows."""
        with output_errors(self._output.target):
            for body, column in zip(self._columns.values(), (t_ns, *columns), strict=True):
                body.write(np.ascontiguousarray(column).data)
        self._count += len(t_ns)

    def finish(self, provenance: Mapping[str, object]) -> None:
        """Finish the file, with its provenance."""
        provenance_array = np.array(provenance_json(provenance))
        with (
            output_errors(self._output.target),
            zipfile.ZipFile(self._output.stream, "w") as archive,
        ):
            for name, body in self._columns.items():
                with _member(archive, name) as member:
                    dtype = np.dtype("<i8" if name == "t_ns" else "<f8")
                    np.lib.format.write_array_header_1_0(member, _header(dtype, self._count))
                    body.seek(0)
                    shutil.copyfileobj(body, member, 1 << 20)
            with _member(archive, PROVENANCE) as member:
                np.lib.format.write_array(member, provenance_array, allow_pickle=False)
        self._close()
        self._output.finish()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._close()
        self._output.discard()

    def _close(self) -> None:
        for body in self._columns.values():
            body.close()


def _header(dtype: np.dtype[Any], count: int) -> dict[str, object]:
    return {
        "descr": np.lib.format.dtype_to_descr(dtype),
        "fortran_order": False,
        "shape": (count,),
    }


def _member(archive: zipfile.ZipFile, name: str) -> BinaryIO:
    """Open a member of an archive for writing, of any size."""
    return archive.open(zipfile.ZipInfo(f"{name}.npy", _EPOCH), "w", force_zip64=True)  # type: ignore[return-value]  # an IO[bytes]
