"""SQLite databases, opened without changing them; the rows of damaged ones."""

from __future__ import annotations

import os
import struct
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import apsw
import numpy as np

from quatprop.stores.file_source import FileSource

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from apsw import SQLiteValue
    from numpy.typing import NDArray

    from quatprop.base.errors import Losses


LEAST_ROWID = -(1 << 63)
_WAL_HEAD = struct.Struct(">8I")
_FRAME_HEAD = struct.Struct(">6I")
_WAL_MAGIC = 0x377F0682
"""The last bit is set if checksums are of big-endian words."""
NO_LOCKS = "win32-none" if os.name == "nt" else "unix-none"
"""SQLite's file system without locks and shared memory."""


_LEAST_LENGTH, _MOST_LENGTH = 1 << 20, 1 << 30
"""Lower and upper bound of the limit on a value's bytes."""
_STEP = 1 << 20
_STEPS_PER_BYTE = 50
"""A row has six bytes at least, and a query takes up to a hundred steps to sort and return it."""
_LEAST_STEPS = 1 << 24
_USUAL_PAGE = 4096
_MOST_REST = 1 << 16
"""Bytes behind a database that are inspected: space that SQLite reserves is zero."""


def journal_files(path: Path) -> list[str]:
    """Return the names of the journal files with changes not yet in the database."""
    return [
        name
        for name in (f"{path.name}-wal", f"{path.name}-journal")
        if (file := path.with_name(name)).is_file() and file.stat().st_size
    ]


def read_only(path: Path, journals: Sequence[str] = ()) -> str:
    """Return the URI that opens a database without changing it or creating files next to it.

    `journals`: the files of :func:`journal_files`, if they are to be read, too. Without a shared
        memory file (``-shm``), the connection must be set to ``locking_mode=EXCLUSIVE``, so that
        it creates none
    """
    address = f"file:{quote(str(path.absolute()))}?mode=ro"
    if not journals:
        # Otherwise SQLite creates files next to a database in write-ahead mode.
        return f"{address}&immutable=1"
    return address if has_shared_memory(path) else f"{address}&vfs={NO_LOCKS}"


def has_shared_memory(path: Path) -> bool:
    """Return whether there is a shared memory file: a recorder uses or used write-ahead mode."""
    return path.with_name(f"{path.name}-shm").exists()


def _page_size(path: Path) -> int:
    """Return the bytes of a page; a power of two."""
    with path.open("rb") as file:
        stated = int.from_bytes(file.read(18)[16:], "big")
    return 1 << 16 if stated == 1 else stated or _USUAL_PAGE


class _WholePages(apsw.VFS):
    """SQLite's file system, for a file whose last page is cut off.

    SQLite would read the rest of that page as zeros.
    """

    def __init__(self, page_size: int) -> None:
        self.name, self._page_size = f"quatprop-{page_size}", page_size
        super().__init__(self.name, "")

    def xOpen(self, name: Any, flags: Any) -> apsw.VFSFile:  # noqa: N802  # SQLite's name
        """Open a file."""
        return _WholePagesFile(name, flags, self._page_size)


class _WholePagesFile(apsw.VFSFile):
    """A file without its last page, if that is cut off."""

    def __init__(self, name: Any, flags: Any, page_size: int) -> None:
        super().__init__("", name, flags)
        self._page_size = page_size

    def xFileSize(self) -> int:  # noqa: N802  # SQLite's name
        """Return the bytes of the whole pages."""
        size = super().xFileSize()
        return size - size % self._page_size


def open_database(path: Path, journals: Sequence[str] = ()) -> apsw.Connection:
    """Open a database, read-only; parameters as for :func:`read_only`.

    Its schema is read even if it refers to pages beyond the end of the file. No value may be longer
    than the files, and no query may take more steps than their rows could need.
    """
    flags = apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
    address = read_only(path, journals)
    if path.stat().st_size % _page_size(path) and not journals:
        vfs = _WholePages(_page_size(path))
        database = apsw.Connection(address, flags=flags, vfs=vfs.name)
    else:
        database = apsw.Connection(address, flags=flags)
    if journals and not has_shared_memory(path):
        database.execute("PRAGMA locking_mode=EXCLUSIVE")
    # SQLite would delete a write-ahead log without intact frames when it closes the database.
    database.config(apsw.SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1)
    database.execute("PRAGMA writable_schema=ON")
    database.config(apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0)
    size = sum(file.stat().st_size for file in (path, *map(path.with_name, journals)))
    database.limit(apsw.SQLITE_LIMIT_LENGTH, min(max(size, _LEAST_LENGTH), _MOST_LENGTH))
    limit_steps(database, size)
    return database


def limit_steps(database: apsw.Connection, size: int) -> None:
    """Interrupt a query that takes more steps than the rows of a file of `size` bytes could need.

    To be called before each query, as the steps of all queries are counted.
    """
    left = iter(range((size * _STEPS_PER_BYTE + _LEAST_STEPS) // _STEP))
    database.set_progress_handler(lambda: next(left, None) is None, _STEP)


def unfinished_pages(source: FileSource) -> int:
    """Return the number of pages of an unfinished or damaged transaction in a write-ahead log.

    It is approximate if the head of the log is damaged.
    """
    head = source.read(0, _WAL_HEAD.size).ljust(_WAL_HEAD.size, b"\0")
    magic, _, page_size, _, *salts_and_sums = _WAL_HEAD.unpack(head)
    salts, sums = tuple(salts_and_sums[:2]), tuple(salts_and_sums[2:])
    words = ">u4" if magic & 1 else "<u4"
    first = np.frombuffer(head, np.uint8, _WAL_HEAD.size - 8).view(words)
    if magic & ~1 != _WAL_MAGIC or not page_size or _checksum(first, (0, 0)) != sums:
        return 1 + max(0, source.size - _WAL_HEAD.size) // _USUAL_PAGE
    stride = _FRAME_HEAD.size + page_size
    frames = applied = 0
    is_valid = True
    for count, start in enumerate(range(_WAL_HEAD.size, source.size, stride), 1):
        frame = source.read(start, stride)
        _, database_size, *rest = _FRAME_HEAD.unpack(frame[: _FRAME_HEAD.size].ljust(24, b"\0"))
        # Frames of an earlier use of the log may follow; both their salts differ.
        if len(frame) < stride or rest[0] == salts[0] or rest[1] == salts[1]:
            frames = count
        checked = np.frombuffer(frame[:8] + frame[_FRAME_HEAD.size :], np.uint8)
        is_valid = is_valid and len(frame) == stride and tuple(rest[:2]) == salts
        if is_valid:
            sums = _checksum(checked.view(words), sums)
            is_valid = sums == tuple(rest[2:])
        if is_valid and database_size:
            applied = count
    return frames - applied


def _checksum(words: NDArray[np.uint32], sums: tuple[int, ...]) -> tuple[int, int]:
    """Return SQLite's checksum of 32-bit words, continued from the previous frame's."""
    first, second = sums
    for even, odd in zip(words[::2].tolist(), words[1::2].tolist(), strict=True):
        first = (first + even + second) & 0xFFFFFFFF
        second = (second + odd + first) & 0xFFFFFFFF
    return first, second


def note_joined_bytes(database: apsw.Connection, path: Path, losses: Losses) -> None:
    """Record bytes behind the last page of a database, which SQLite ignores."""
    # Pragma statements: a view may have the name of a pragma function.
    page_count, page_size = (
        int(str(database.execute(f"PRAGMA {name}").fetchall()[0][0]))
        for name in ("page_count", "page_size")
    )
    end = page_count * page_size
    with FileSource(path) as file:
        rest = file.size - end
        if rest > 0 and any(file.read(end, _MOST_REST)):
            reason = f"{rest} bytes follow the database and are not read; was another joined to it?"
            if rest < page_size:
                reason = f"its last page is cut off; {rest} bytes are not read"
            losses.note(f"byte {end}", reason)


# Read the rows of a damaged table, as far as SQLite can reach them.


_STRIDE = 64
"""Maximum number of row ids that are passed over at a time."""

_ROWS = """
SELECT rowid, timestamp, topic_id, typeof(timestamp) = 'integer' AND typeof(data) = 'blob'
FROM messages NOT INDEXED WHERE rowid >= ? ORDER BY rowid LIMIT ?
"""


class Row(NamedTuple):
    """A row of the messages: log time, ns, row id and topic id; rows sort by time."""

    log_ns: int
    rowid: int
    topic: SQLiteValue


def rows_past_damage(database: apsw.Connection, first: int, most: int) -> Iterator[Row]:
    """Yield the messages on pages that SQLite can read, in order of their row ids.

    `first`: the first row id, if the first page is damaged
    `most`: maximum number of row ids to try behind damage
    """
    begin, left = LEAST_ROWID, most // _STRIDE + _STRIDE
    while True:
        try:
            for rowid, log_ns, topic, is_message in database.execute(_ROWS, (begin, -1)):
                # The pages of a damaged table may be in a circle.
                if not isinstance(rowid, int) or rowid < begin:
                    raise apsw.CorruptError("its row ids are not in order")
                begin = rowid + 1
                if is_message and isinstance(log_ns, int):
                    yield Row(log_ns, rowid, topic)
        except apsw.InterruptError:
            return
        except apsw.Error:
            begin, step = max(begin, first), 1
            while not _is_readable(database, begin + step):
                begin, step, left = begin + step, min(2 * step, _STRIDE), left - 1
                if not left:
                    return
            begin = _end_of_damage(database, begin, begin + step)
            left -= 1
        else:
            return


def _end_of_damage(database: apsw.Connection, low: int, high: int) -> int:
    """Return the first row id from which rows can be read, as they can be from `high` on."""
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if _is_readable(database, middle) else (middle, high)
    return high


def _is_readable(database: apsw.Connection, begin: int) -> bool:
    """Return whether the first row from a row id on, if there is one, can be read."""
    if begin >= -LEAST_ROWID:
        return True
    try:
        database.execute(_ROWS, (begin, 1)).fetchall()
    except apsw.InterruptError:
        return True  # raised again by whoever reads on
    except apsw.Error:
        return False
    return True
