"""A file that is opened once, and read at any position from several threads."""

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
        if hasattr(os, "pread"):
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
