"""A file that is opened once and read at places, from several threads."""

from __future__ import annotations

import os
import stat
import threading
import weakref
from typing import TYPE_CHECKING, Self

from quatprop.errors import UnreadableLogError, os_reason

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pyarrow import NativeFile

_BINARY, _AT_ONCE = getattr(os, "O_BINARY", 0), getattr(os, "O_NONBLOCK", 0)


class FileSource:
    """A file that several threads may read at once.

    `size`: its length when it was opened, bytes; a recorder may still append to it
    `is_remote`: whether it takes long until reading begins
    """

    is_remote = False

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        try:
            # Nobody may ever write to what turns out to be a pipe.
            self._file = os.open(path, os.O_RDONLY | _BINARY | _AT_ONCE)
        except OSError as error:
            raise UnreadableLogError(path, os_reason(error)) from error
        # Also runs when the log that reads from it is no longer used, whoever forgot to close it.
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
        # A damaged place may be beyond what the system takes.
        while (place := start + len(data)) < end and (more := self._read(end - place, place)):
            data += more
        return data

    def read_ranges(self, begins: Sequence[int], ends: Sequence[int]) -> bytes:
        """Return the bytes of some ranges, one after another."""
        places = zip(begins, ends, strict=True)
        return b"".join([self.read(begin, end - begin) for begin, end in places])

    def expect(self, begins: Sequence[int], ends: Sequence[int]) -> None:
        """Announce which ranges will be read next; of use where reading takes long to begin."""

    def as_arrow(self) -> NativeFile:
        """Return the file as Arrow reads it."""
        import pyarrow as pa

        return pa.OSFile(str(self.path))

    def _read(self, length: int, start: int) -> bytes:
        if hasattr(os, "pread"):
            return os.pread(self._file, length, start)
        # Windows has only a place in the file that all threads share.
        with self._lock:
            os.lseek(self._file, start, os.SEEK_SET)
            return os.read(self._file, length)

    def close(self) -> None:
        """Close the file; harmless the second time."""
        self._close()
        self._file = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


def source_of(log: Path | FileSource) -> FileSource:
    """Return a file opened for reading, or the open file that it is already."""
    return log if isinstance(log, FileSource) else FileSource(log)
