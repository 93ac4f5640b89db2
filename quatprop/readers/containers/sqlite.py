"""SQLite databases, opened without changing them; rows from the pages of damaged ones."""

from __future__ import annotations

import os
import struct
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import quote

import apsw
import numpy as np

from quatprop.stores.file_source import FileSource

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.base.errors import Losses


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
    """Return the URI that opens a database without changing it or creating files beside it.

    `journals`: the files of :func:`journal_files`, if they are to be read, too. Without a shared
        memory file (``-shm``), the connection must be set to ``locking_mode=EXCLUSIVE``, so that
        it creates none
    """
    address = f"file:{quote(str(path.absolute()))}?mode=ro"
    if not journals:
        # Otherwise SQLite creates files beside a database in write-ahead mode.
        return f"{address}&immutable=1"
    return address if has_shared_memory(path) else f"{address}&vfs={NO_LOCKS}"


def has_shared_memory(path: Path) -> bool:
    """Return whether there is a shared memory file: a recorder uses or used write-ahead mode."""
    return path.with_name(f"{path.name}-shm").exists()


def open_database(path: Path, journals: Sequence[str] = ()) -> apsw.Connection:
    """Open a database, read-only; parameters as for :func:`read_only`.

    Its schema is read even if it refers to pages beyond the end of the file. No value may be longer
    than the files, and no query may take more steps than their rows could need.
    """
    flags = apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
    database = apsw.Connection(read_only(path, journals), flags=flags)
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


class WalPages(NamedTuple):
    """The pages in a write-ahead log.

    `offsets`: offset in the log of the newest committed content of each page, by page number
    `unfinished`: number of pages of an unfinished or damaged transaction; approximate if the head
        of the log is damaged
    """

    offsets: dict[int, int]
    unfinished: int


def read_wal(source: FileSource) -> WalPages:
    """Return the pages of a write-ahead log that SQLite applies, and the number of others."""
    head = source.read(0, _WAL_HEAD.size).ljust(_WAL_HEAD.size, b"\0")
    magic, _, page_size, _, *salts_and_sums = _WAL_HEAD.unpack(head)
    salts, sums = tuple(salts_and_sums[:2]), tuple(salts_and_sums[2:])
    words = ">u4" if magic & 1 else "<u4"
    first = np.frombuffer(head, np.uint8, _WAL_HEAD.size - 8).view(words)
    if magic & ~1 != _WAL_MAGIC or not page_size or _checksum(first, (0, 0)) != sums:
        return WalPages({}, 1 + max(0, source.size - _WAL_HEAD.size) // _USUAL_PAGE)
    stride = _FRAME_HEAD.size + page_size
    committed: dict[int, int] = {}
    pending: dict[int, int] = {}
    frames = applied = 0
    is_valid = True
    for count, start in enumerate(range(_WAL_HEAD.size, source.size, stride), 1):
        frame = source.read(start, stride)
        number, database_size, *rest = _FRAME_HEAD.unpack(
            frame[: _FRAME_HEAD.size].ljust(24, b"\0")
        )
        # Frames of an earlier use of the log may follow; both their salts differ.
        if len(frame) < stride or rest[0] == salts[0] or rest[1] == salts[1]:
            frames = count
        checked = np.frombuffer(frame[:8] + frame[_FRAME_HEAD.size :], np.uint8)
        is_valid = is_valid and len(frame) == stride and tuple(rest[:2]) == salts
        if is_valid:
            sums = _checksum(checked.view(words), sums)
            is_valid = sums == tuple(rest[2:])
        if is_valid:
            pending[number] = start + _FRAME_HEAD.size
        if is_valid and database_size:
            committed.update(pending)
            pending.clear()
            applied = count
    return WalPages(committed, frames - applied)


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
            losses.note(f"byte {end}", reason)


# Read the rows of a damaged SQLite table from the pages of the file.
#
# Written by hand, since neither SQLite's recovery extension nor its page tables are part of apsw.
#
# Reference: SQLite, "Database File Format", sections 1.5 to 2.1.


_LEAF = 0x0D
_FILE_HEAD = 100
_LEAF_HEAD = 8
_SIZES = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0)
"""Bytes of a value by its serial type, for types below 12."""
_INTEGERS = frozenset({1, 2, 3, 4, 5, 6, 8, 9})
_FIRST_BLOB = 12
_DAMAGE = (IndexError, struct.error, ValueError)


class Cell(NamedTuple):
    """A row of a table with a topic id, a time and a blob.

    `log_ns`: the time
    `group`: the topic id
    `place`: page number times page size, plus the offset of its record in the page
    `local`: bytes of the record on the leaf page; the others are on overflow pages
    `size`: bytes of the record
    `begin`, `end`: offsets of the blob in the record
    """

    log_ns: int
    rowid: int
    group: int
    place: int
    local: int
    size: int
    begin: int
    end: int


@contextmanager
def open_pages(path: Path, columns: tuple[int, int, int]) -> Iterator[TablePages]:
    """Open the pages of a database and of the write-ahead log beside it."""
    wal_name = f"{path.name}-wal"
    has_wal = wal_name in journal_files(path)
    wal_file = FileSource(path.with_name(wal_name)) if has_wal else nullcontext()
    with FileSource(path) as source, wal_file as wal:
        yield TablePages(source, columns, read_wal(wal).offsets if wal else {}, wal)


class TablePages:
    """The leaf pages of a table, whether the tables and indexes above them are intact or not.

    `columns`: positions of the columns ``topic_id``, ``timestamp`` and ``data``
    `overlay`: offsets in `wal` of the pages that it has in a newer version, by page number
    `wal`: the write-ahead log; None if there is none
    """

    def __init__(
        self,
        source: FileSource,
        columns: tuple[int, int, int],
        overlay: Mapping[int, int],
        wal: FileSource | None,
    ) -> None:
        self._source, self._columns = source, columns
        self._overlay, self._wal = overlay, wal
        head = source.read(0, _FILE_HEAD)
        size = int.from_bytes(head[16:18], "big")
        self.page_size = 1 << 16 if size == 1 else size
        self._usable = self.page_size - head[20]
        self._count = max([source.size // self.page_size, *self._overlay])

    def cells(self, groups: Collection[object]) -> Iterator[Cell]:
        """Yield the rows of some groups on intact pages, unordered."""
        for number in range(1, self._count + 1):
            page = self._page(number)
            head = _FILE_HEAD if number == 1 else 0
            if len(page) < self._usable or page[head] != _LEAF:
                continue
            (count,) = struct.unpack_from(">H", page, head + 3)
            if head + _LEAF_HEAD + 2 * count > self._usable:
                continue
            for at in struct.unpack_from(f">{count}H", page, head + _LEAF_HEAD):
                try:
                    cell = self._cell(page, at, number)
                except _DAMAGE:
                    continue
                if cell is not None and cell.group in groups:
                    yield cell

    def blob(self, cell: Cell) -> bytes | None:
        """Return the blob of a row; None if an overflow page is missing."""
        number, at = divmod(cell.place, self.page_size)
        local = self._page(number)[at : at + cell.local + 4]
        parts, missing = [local[: cell.local]], cell.size - cell.local
        if missing > self._count * self.page_size:
            return None
        following = int.from_bytes(local[cell.local :], "big") if missing else 0
        while missing > 0:
            page = self._page(following) if 0 < following <= self._count else b""
            part = page[4 : 4 + min(missing, self._usable - 4)]
            if not part:
                return None
            parts.append(part)
            missing -= len(part)
            following = int.from_bytes(page[:4], "big")
        return b"".join(parts)[cell.begin : cell.end]

    def _page(self, number: int) -> bytes:
        source, start = self._source, (number - 1) * self.page_size
        if self._wal is not None and number in self._overlay:
            source, start = self._wal, self._overlay[number]
        try:
            return source.read(start, self.page_size)
        except OSError:
            return b""

    def _cell(self, page: bytes, at: int, number: int) -> Cell | None:
        """Return the row of a cell; None if it is not of this table."""
        size, at = _varint(page, at)
        rowid, at = _varint(page, at)
        local = self._local(size)
        if at + local > self._usable:
            return None
        head_size, position = _varint(page, at)
        begin, values = head_size, []
        stop = at + head_size
        while position < stop:
            kind, position = _varint(page, position)
            length = _SIZES[kind] if kind < _FIRST_BLOB else (kind - _FIRST_BLOB) // 2
            values.append((kind, begin, begin + length))
            begin += length
        if begin != size:
            return None
        group, stamp, data = (values[column] for column in self._columns)
        is_row = {group[0], stamp[0]} <= _INTEGERS and data[0] >= _FIRST_BLOB and not data[0] % 2
        if not is_row or max(group[2], stamp[2]) > local:
            return None
        log_ns, topic = (_integer(page, at, *value) for value in (stamp, group))
        place = number * self.page_size + at
        return Cell(log_ns, rowid, topic, place, local, size, data[1], data[2])

    def _local(self, size: int) -> int:
        """Return the bytes of a record of a size that are on its leaf page."""
        most = self._usable - 35
        if size <= most:
            return size
        least = (self._usable - 12) * 32 // 255 - 23
        local = least + (size - least) % (self._usable - 4)
        return local if local <= most else least


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return a number of 1 to 9 bytes, and the offset behind it."""
    value = 0
    for k in range(8):
        byte = data[at + k]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:  # noqa: PLR2004  # the high bit is set if more bytes follow
            return value, at + k + 1
    value = value << 8 | data[at + 8]
    return value - (1 << 64) if value >> 63 else value, at + 9


def _integer(page: bytes, at: int, kind: int, begin: int, end: int) -> int:
    if kind in {8, 9}:
        return kind - 8
    return int.from_bytes(page[at + begin : at + end], "big", signed=True)
