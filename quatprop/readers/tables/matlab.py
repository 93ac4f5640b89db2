"""MATLAB files before version 7.3: variables and fields of structs are columns.

Newer ones are HDF5. Compressed variables are decompressed here, since scipy trusts any size; scipy
then decodes each variable separately, so that only damaged ones are lost.

References
----------
The MathWorks, "MAT-File Format": "Level 5 MAT-Files".
"""

from __future__ import annotations

import struct
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.base.errors import DamagedLogError, UnsupportedLogError, UsageError
from quatprop.base.text import plain, quoted
from quatprop.readers.tables.numpy_table import (
    ArrayHeader,
    HeaderError,
    NumpyTable,
    columns_of,
    following,
)
from quatprop.stores.compression import (
    DecompressionBudget,
    UnreadableDataError,
    decompressed_pieces,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.base.arrays import AnyArray

_MAGIC = b"MATLAB 5.0"
_HEADER_BYTES, _TAG_BYTES = 128, 8
_COMPRESSED, _MATRIX = 15, 14
_TYPES = {*range(1, 8), 9, *range(12, 19)}
"""Known data types; for others, scipy reads beyond the end of a table."""
_DEEPEST = 8
_OBJECT = (
    "it is an object, which only MATLAB reads; save a table by table2struct(t,'ToScalar',true)"
)


class MatlabLog(NumpyTable):
    """A MATLAB file; vectors and matrices are columns, those in structs as ``struct.field``."""

    kind = "matlab"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            from scipy.io import loadmat, whosmat
        except ImportError as error:
            raise UsageError(
                f"{plain(path)}: files of MATLAB before version 7.3 need scipy, which is not "
                "installed; pip install scipy, or save it again with '-v7.3'"
            ) from error
        self._arrays: dict[str, AnyArray] = {}
        self._refused = ""
        found = 0
        for place, element in self._elements():
            try:
                variables = loadmat(BytesIO(element))
                # Later than version 4, an element is one variable; whosmat fails on objects.
                is_old = 0 in element[:4]
                names = [name for name, *_ in whosmat(BytesIO(element))] if is_old else []
            except MemoryError:
                raise
            except Exception as error:  # noqa: BLE001  # what scipy raises for damage is its choice
                self.losses.note(place, f"a variable is damaged: {plain(error)}")
                continue
            if len(set(names)) < len(names):
                raise UnsupportedLogError(
                    path, "several of its variables have one name; was another file joined to it?"
                )
            found += 1
            for name, value in variables.items():
                if _is_object(value):
                    self._describe(value["s0"].item().decode(errors="replace"), value)
                elif not name.startswith("__"):
                    self._describe(name, value)
        if not found:
            damage = self.losses[0].reason if self.losses else "it has no variables"
            raise DamagedLogError(path, f"{damage}; was it written to the end?")
        if not self._leaves:
            reason = self._refused or "none of its variables has more than one value"
            raise UnsupportedLogError(path, reason)

    def _elements(self) -> Iterator[tuple[str, bytes]]:
        """Yield the position of each variable, and the bytes of a file with only this variable."""
        with self.path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(0)
            header = file.read(_HEADER_BYTES)
            if 0 in header[:4]:
                yield "byte 0", header + file.read()  # of version 4, which is not compressed
                return
            budget = DecompressionBudget(size)
            order = "<" if header.endswith(b"IM") else ">"
            while tag := file.read(_TAG_BYTES):
                place = f"byte {file.tell() - len(tag)}"
                kind, length = struct.unpack(order + "II", tag.ljust(_TAG_BYTES, b"\0"))
                if _MAGIC.startswith(tag):
                    rest = size - file.tell() + len(tag)
                    self.losses.note(place, following(rest, "the file"))
                    return
                data = file.read(min(length, size))
                if len(tag) < _TAG_BYTES or len(data) < length:
                    self.losses.note(place, "the file ends within a variable")
                    return
                try:
                    element = (
                        self._decompressed(data, budget) if kind == _COMPRESSED else tag + data
                    )
                except UnreadableDataError as error:
                    self.losses.note(place, f"a variable is damaged: {error.reason}")
                    continue
                try:
                    is_known = _has_known_types(memoryview(element), order)
                except RecursionError:  # nested thousands of times, as no table is
                    is_known = False
                if is_known:
                    yield place, header + element
                else:
                    self.losses.note(
                        place, "a variable is damaged: the type of its data is unknown"
                    )

    def _decompressed(self, data: bytes, budget: DecompressionBudget) -> bytes:
        element = bytearray()
        for piece in decompressed_pieces(BytesIO(data), "zlib"):
            element += piece
            budget.spend(len(piece))
            try:
                budget.check()
            except UnreadableDataError as error:
                raise UnsupportedLogError(self.path, error.reason) from error
        return bytes(element)

    def _describe(self, name: str, value: Any, depth: int = 0) -> None:
        """Add the columns of a variable, or note why it has none."""
        if _is_object(value):
            self._refuse(name, _OBJECT)
        elif not isinstance(value, np.ndarray):
            self._refuse(name, "it is sparse; save it as a full matrix")
        elif value.dtype.names and value.size == 1 and depth < _DEEPEST:
            for field in value.dtype.names:
                self._describe(f"{name}.{field}", value.flat[0][field], depth + 1)
        elif value.dtype.hasobject:
            what = "an array of structs" if value.dtype.names else "a cell array"
            self._refuse(name, f"it is {what}; save its numbers as vectors")
        elif value.size > 1:
            # A row vector is read as a column.
            array = value.reshape(-1) if value.shape[0] == 1 and value.ndim == 2 else value  # noqa: PLR2004
            try:
                columns = columns_of(ArrayHeader(array.dtype, array.shape, is_fortran=False))
            except HeaderError as error:
                self._refuse(name, str(error))
                return
            self._arrays[name] = array
            for column in columns:
                self._add_column(name + column.name, name, column)

    def _refuse(self, name: str, reason: str) -> None:
        self._refused = self._refused or f"its variable {quoted(name)}: {reason}"

    def _open_rows(self, member: str) -> BytesIO:
        return BytesIO(np.ascontiguousarray(self._arrays[member]).tobytes())


def _is_object(value: object) -> bool:
    """Return whether a variable is an object of a class, such as a table or a string."""
    return type(value).__name__ == "MatlabOpaque"


def _has_known_types(data: memoryview, order: str) -> bool:
    """Return whether all elements, including those in matrices, have known types."""
    at = 0
    while at + _TAG_BYTES <= len(data):
        kind, length = struct.unpack_from(order + "II", data, at)
        small = kind >> 16
        if (kind & 0xFFFF if small else kind) not in _TYPES:
            return False
        at += _TAG_BYTES
        if small:  # up to four bytes are in the tag
            continue
        if kind == _MATRIX and not _has_known_types(data[at : at + length], order):
            return False
        at += length + -length % _TAG_BYTES
    return True
