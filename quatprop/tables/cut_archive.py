"""Members of a zip archive whose directory, at its end, was cut off.

Written by hand because ``zipfile`` opens no archive without a directory; it still unpacks the
members and checks their checksums.

References
----------
PKWARE, ".ZIP File Format Specification" (APPNOTE.TXT), sections 4.3.7 and 4.5.3.
"""

from __future__ import annotations

import struct
import zipfile
from typing import TYPE_CHECKING, BinaryIO, cast

if TYPE_CHECKING:
    from pathlib import Path

_SIGNATURE = b"PK\x03\x04"
_HEADER = struct.Struct("<4s2xHHxxxxIIIHH")
_ENCRYPTED, _SIZES_FOLLOW = 1, 8
_IN_EXTRA_FIELD = 0xFFFFFFFF
_ZIP64 = 1
_STEP = 1 << 12


class CutArchive:
    """The members of an archive, found by the headers before them.

    Parameters
    ----------
    path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._members: dict[str, tuple[int, zipfile.ZipInfo]] = {}
        with path.open("rb") as file:
            size = file.seek(0, 2)
            begin = 0
            while begin < size:
                file.seek(begin)
                info = _read_header(file)
                if info is None:
                    break
                begin = file.tell()
                if not info.compress_size:
                    # Its size was to be written when it was complete.
                    info.compress_size = info.file_size = size - begin
                    info.CRC = None  # type: ignore[assignment]  # which means: not checked
                self._members[info.filename] = begin, info
                begin += info.compress_size

    def namelist(self) -> list[str]:
        """Return the names of the members."""
        return list(self._members)

    def open(self, name: str) -> BinaryIO:
        """Open a member; reading it raises EOFError where it was cut."""
        begin, info = self._members[name]
        file = self._path.open("rb")
        file.seek(begin)
        return cast("BinaryIO", _CutMember(file, "r", info, close_fileobj=True))

    def close(self) -> None:
        """Do nothing: files are open only while they are read."""


class _CutMember(zipfile.ZipExtFile):
    """A member that is read in small steps: where it ends early, the last step is lost."""

    def read1(self, n: int | None = -1) -> bytes:
        """Return at most some kilobytes."""
        return super().read1(_STEP if n is None or n < 0 else min(n, _STEP))


def _read_header(file: BinaryIO) -> zipfile.ZipInfo | None:
    """Read the header of a member; None where there is no whole one, or it is encrypted."""
    header = file.read(_HEADER.size)
    if len(header) < _HEADER.size:
        return None
    signature, flags, method, crc, packed, unpacked, *lengths = _HEADER.unpack(header)
    name, extra = (file.read(length) for length in lengths)
    if signature != _SIGNATURE or flags & _ENCRYPTED or len(extra) < lengths[1] or not name:
        return None
    info = zipfile.ZipInfo(name.decode(errors="replace"))
    info.compress_type, info.CRC = method, crc
    info.compress_size, info.file_size = packed, unpacked
    if _IN_EXTRA_FIELD in {packed, unpacked}:
        info.file_size, info.compress_size = _zip64_sizes(extra)
    if flags & _SIZES_FOLLOW:
        info.compress_size = 0
    return info


def _zip64_sizes(extra: bytes) -> tuple[int, int]:
    """Return the sizes of a member, unpacked and packed, out of an extra field; zeros if absent."""
    while len(extra) >= struct.calcsize("<HH"):
        kind, length = struct.unpack_from("<HH", extra)
        if kind == _ZIP64 and length >= struct.calcsize("<QQ"):
            return cast("tuple[int, int]", struct.unpack_from("<QQ", extra, 4))
        extra = extra[4 + length :]
    return 0, 0
