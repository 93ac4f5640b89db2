"""A file of which some places cannot be read, as on a worn memory card."""

from __future__ import annotations

from quatprop.stores.file_source import FileSource

SECTOR = 4096
"""Bytes that are given up around a place that cannot be read."""

MAX_SECTORS = 4096
"""Maximum number of these before the error is raised: the whole device may be gone."""


class ZeroFilledSource(FileSource):
    """Another source, with zeros where the operating system cannot read it.

    It is for searches only: samples are read from `original`, so that none is made of zeros.
    """

    def __init__(self, original: FileSource) -> None:
        self.original = original
        self.path, self.size = original.path, original.size
        self._unreadable: dict[int, int] = {}

    def read(self, start: int, length: int) -> bytes:
        """Return the bytes from `start`, fewer than `length` at the end of the file."""
        try:
            return self.original.read(start, length)
        except OSError:
            end = min(start + length, self.size)
            if length > SECTOR:
                places = range(start, end, SECTOR)
                return b"".join([self.read(at, min(SECTOR, end - at)) for at in places])
            if len(self._unreadable) >= MAX_SECTORS:
                raise
            self._unreadable[start] = end
            return bytes(end - start)

    def first_unreadable(self, begin: int, end: int) -> int | None:
        """Return the offset of the first byte in a range that could not be read so far, or None."""
        places = self._unreadable.items()
        return min((max(at, begin) for at, to in places if at < end and begin < to), default=None)
