"""Read the rows of a damaged SQLite table from the pages of the file.

Written by hand, since neither SQLite's recovery extension nor its page tables are part of apsw.

References
----------
SQLite, "Database File Format", sections 1.5 to 2.1.
"""

from __future__ import annotations

import struct
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, NamedTuple

from quatprop.containers.rosbag2.sqlite_files import journal_files, read_wal
from quatprop.stores.file_source import FileSource

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

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
