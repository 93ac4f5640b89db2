"""A file that is opened once, and read at any position from several threads."""

from __future__ import annotations

import os
import stat
import sys
import threading
import weakref
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from quatprop.base.errors import UnreadableLogError, os_reason

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray
    from pyarrow import NativeFile

    Int64 = NDArray[np.int64]


_BINARY, _AT_ONCE = getattr(os, "O_BINARY", 0), getattr(os, "O_NONBLOCK", 0)


class FileSource:
    """A file that several threads may read at once.

    `size`: size when it was opened, bytes; a recorder may still append to it
    `is_remote`: whether reads have a high latency
    """

    is_remote = False

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        try:
            # Opening a pipe without a writer would block.
            self._file = os.open(path, os.O_RDONLY | _BINARY | _AT_ONCE)
        except OSError as error:
            raise UnreadableLogError(path, os_reason(error)) from error
        # Also closes it if the log is garbage collected without being closed.
        self._close = weakref.finalize(self, os.close, self._file)
        status = os.fstat(self._file)
        self.size = status.st_size
        if not stat.S_ISREG(status.st_mode):
            self.close()
            reason = "it is a pipe or a device, not a file; name a file, or - with stdin from it"
            if stat.S_ISDIR(status.st_mode):
                reason = "it is a folder, not a file; name a file"
            raise UnreadableLogError(path, reason)

    def read(self, start: int, length: int) -> bytes:
        """Return the bytes from `start`, fewer than `length` at the end of the file."""
        end = min(start + length, self.size)
        data = b""
        # A damaged length may exceed the file.
        while (place := start + len(data)) < end and (more := self._read(end - place, place)):
            data += more
        return data

    def read_ranges(self, begins: Sequence[int], ends: Sequence[int]) -> bytes:
        """Return the bytes of ranges, joined."""
        places = zip(begins, ends, strict=True)
        return b"".join([self.read(begin, end - begin) for begin, end in places])

    def expect(self, begins: Sequence[int], ends: Sequence[int]) -> None:
        """Announce ranges that will be read next; used by remote files."""

    def as_arrow(self) -> NativeFile:
        """Return the file as an Arrow file."""
        import pyarrow as pa

        return pa.OSFile(str(self.path))

    def _read(self, length: int, start: int) -> bytes:
        if sys.platform != "win32" and hasattr(os, "pread"):
            return os.pread(self._file, length, start)
        # Windows has no pread; all threads share the position.
        with self._lock:
            os.lseek(self._file, start, os.SEEK_SET)
            return os.read(self._file, length)

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._close()
        self._file = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


def source_of(log: Path | FileSource) -> FileSource:
    """Return an open file, opening a path."""
    return log if isinstance(log, FileSource) else FileSource(log)


# Byte ranges with selected messages in a buffer or file, without the bytes between them.


LARGE = 1 << 17
"""Size of a chunk, bytes, below which it is read as a whole."""
REMOTE_LARGE = 5 << 18
"""The same in an object store, where reading in part takes at least three requests."""
GAP = 1 << 14
"""Maximum gap between messages, bytes, that is faster to read than to skip."""
SHARE = 4
"""Selected messages are read separately if they are at most 1/SHARE of a chunk."""


class ByteRanges(NamedTuple):
    """Byte ranges with messages.

    `begins`, `ends`: start and end of each range, shape ``(R,)``, int64
    `moved`: bytes by which each message moves towards the start when ranges are joined, shape
        ``(N,)``, int64
    """

    begins: Int64
    ends: Int64
    moved: Int64

    @property
    def size(self) -> int:
        """Total size of the ranges, bytes."""
        return int((self.ends - self.begins).sum())

    def of(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a copy of the ranges of `data`, joined."""
        places = zip(self.begins.tolist(), self.ends.tolist(), strict=True)
        return np.concatenate([data[begin:end] for begin, end in places])


def ranges_of(starts: Int64, ends: Int64, gap: int) -> ByteRanges:
    """Return the byte ranges with messages.

    `starts`, `ends`: start and end of each message, shape ``(N,)``, N > 0, int64; a message out of
        order starts a new range
    """
    between = starts[1:] - ends[:-1]
    first = np.concatenate([[0], np.flatnonzero((between < 0) | (between > gap)) + 1])
    last = np.concatenate([first[1:], [len(starts)]])
    begins, stops = starts[first], ends[last - 1]
    sizes = stops - begins
    moved = begins - (np.cumsum(sizes) - sizes)
    return ByteRanges(begins, stops, np.repeat(moved, last - first))


def ranges_worth_reading(starts: Int64, ends: Int64, size: int) -> ByteRanges | None:
    """Return the byte ranges of a chunk with the requested parts; None: read the whole chunk.

    `starts`, `ends`: start and end of each part, shape ``(N,)``, int64, ascending
    """
    if not len(starts) or starts[0] < 0 or ends.max() > size or (ends < starts).any():
        return None
    ranges = ranges_of(starts, ends, GAP)
    return ranges if ranges.size * SHARE <= size else None


# A file of which some places cannot be read, as on a worn memory card.


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
