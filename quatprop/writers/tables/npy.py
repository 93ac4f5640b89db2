"""Tables as NumPy files: one structured array in ``.npy``, one array a column in ``.npz``.

A ``.npy`` file has no room for provenance; in ``.npz`` it is the string ``quatprop``, as JSON.
"""

from __future__ import annotations

import shutil
import zipfile
from typing import TYPE_CHECKING

import numpy as np

from quatprop.writers.atomic import Output, refuse_streams, reported, scratch
from quatprop.writers.base import Table, words_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path
    from typing import Any, BinaryIO

    from numpy.typing import NDArray

PROVENANCE = "quatprop"
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The time that members of an archive carry: the earliest there is, so that bytes repeat."""


class NpyTable(Table):
    """Write columns as one structured array with a field a column.

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
        self._output = Output(target)
        with reported(target):
            self._write_head()

    def write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows."""
        rows = np.empty(len(t_ns), self._dtype)
        for name, column in zip(self._dtype.fields or (), (t_ns, *columns), strict=True):
            rows[name] = column
        with reported(self._output.target):
            self._output.stream.write(rows.data)
        self._count += len(rows)

    def commit(self, provenance: Mapping[str, Any]) -> None:  # noqa: ARG002  # no room for it
        """Finish the file and put it in its place."""
        with reported(self._output.target):
            self._output.stream.seek(0)
            self._write_head()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._output.discard()

    def _write_head(self) -> None:
        """Write the head, which is as long for any number of rows."""
        np.lib.format.write_array_header_1_0(self._output.stream, _header(self._dtype, self._count))


class NpzTable(Table):
    """Write columns as an archive of arrays; until the commit each waits in its own file.

    Parameters
    ----------
    target
        A path.
    names
        Names of the float64 columns that follow ``t_ns``.
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        self._output = Output(target)
        self._count = 0
        self._columns = {name: scratch(target) for name in ("t_ns", *names)}

    def write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows."""
        with reported(self._output.target):
            for body, column in zip(self._columns.values(), (t_ns, *columns), strict=True):
                body.write(np.ascontiguousarray(column).data)
        self._count += len(t_ns)

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the file, with its provenance, and put it in its place."""
        words = np.array(words_of(provenance))
        with reported(self._output.target), zipfile.ZipFile(self._output.stream, "w") as archive:
            for name, body in self._columns.items():
                with _member(archive, name) as member:
                    dtype = np.dtype("<i8" if name == "t_ns" else "<f8")
                    np.lib.format.write_array_header_1_0(member, _header(dtype, self._count))
                    body.seek(0)
                    shutil.copyfileobj(body, member, 1 << 20)
            with _member(archive, PROVENANCE) as member:
                np.lib.format.write_array(member, words, allow_pickle=False)
        self._close()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._close()
        self._output.discard()

    def _close(self) -> None:
        for body in self._columns.values():
            body.close()


def _header(dtype: np.dtype[Any], count: int) -> dict[str, Any]:
    return {
        "descr": np.lib.format.dtype_to_descr(dtype),
        "fortran_order": False,
        "shape": (count,),
    }


def _member(archive: zipfile.ZipFile, name: str) -> BinaryIO:
    """Open a member of an archive for writing, of any size."""
    return archive.open(zipfile.ZipInfo(f"{name}.npy", _EPOCH), "w", force_zip64=True)  # type: ignore[return-value]  # an IO[bytes]
