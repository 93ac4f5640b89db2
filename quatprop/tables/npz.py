"""Archives of NumPy arrays, each with one or several columns.

``zipfile`` cannot open an archive without the directory at its end. If it was cut off, the members
are found here by their headers; ``zipfile`` still unpacks them and verifies their checksums.

References
----------
PKWARE, ".ZIP File Format Specification" (APPNOTE.TXT), sections 4.3.7 and 4.5.3.
"""

from __future__ import annotations

import struct
import zipfile
from contextlib import suppress
from typing import TYPE_CHECKING, BinaryIO, cast

import numpy as np

from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.provenance import METADATA_KEY, JsonObject, provenance_in
from quatprop.tables.base import refuse_second_file
from quatprop.tables.npy_format import ArrayColumn, HeaderError, columns_of, read_header
from quatprop.tables.numpy_table import NumpyTable, archive_damage, following
from quatprop.tables.typed_table import DamageError
from quatprop.text import listed, plain, quoted

if TYPE_CHECKING:
    from pathlib import Path


_SIGNATURE = b"PK\x03\x04"
_HEADER = struct.Struct("<4s4xH4xIIIHH")
_IN_EXTRA_FIELD = 0xFFFFFFFF
_ZIP64_SIZES = struct.Struct("<4xQQ")


class CutArchive:
    """An archive without directory; its members are found by their headers."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._members: dict[str, tuple[int, zipfile.ZipInfo]] = {}
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(0)
            while info := _read_header(file):
                begin = file.tell()
                if not info.compress_size:
                    # The size is only written when the archive is complete.
                    info.compress_size = info.file_size = size - begin
                    info.CRC = None  # type: ignore[assignment]  # which means: not checked
                self._members[info.filename] = begin, info
                file.seek(min(begin + info.compress_size, size))

    def namelist(self) -> list[str]:
        """Return the names of the members."""
        return list(self._members)

    def open(self, name: str) -> BinaryIO:
        """Open a member; reading it raises EOFError where it was cut."""
        begin, info = self._members[name]
        file = self._path.open("rb")
        file.seek(begin)
        return cast("BinaryIO", zipfile.ZipExtFile(file, "r", info, close_fileobj=True))

    def close(self) -> None:
        """Do nothing: files are open only while they are read."""


def _read_header(file: BinaryIO) -> zipfile.ZipInfo | None:
    """Read the header of a member; None if it is incomplete."""
    header = file.read(_HEADER.size)
    if len(header) < _HEADER.size:
        return None
    signature, method, crc, packed, unpacked, *lengths = _HEADER.unpack(header)
    name, extra = (file.read(length) for length in lengths)
    if signature != _SIGNATURE:
        return None
    info = zipfile.ZipInfo(name.decode(errors="replace"))
    info.compress_type, info.CRC = method, crc
    info.compress_size, info.file_size = packed, unpacked
    if _IN_EXTRA_FIELD in {packed, unpacked}:
        # NumPy writes no other extra field.
        sizes = _ZIP64_SIZES.unpack_from(extra.ljust(_ZIP64_SIZES.size, b"\0"))
        info.file_size, info.compress_size = sizes
    return info


_MOST_ARRAYS = 4096
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
            if dtype.kind == "U":
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
