"""Rows of a text table: parse whole blocks, and split blocks with rows that do not fit."""

from __future__ import annotations

import io
import os
from abc import ABC, abstractmethod
from contextlib import suppress
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, cast

import numpy as np
import pyarrow as pa

from quatprop.base.errors import UnreadableLogError, UnsupportedLogError, os_reason
from quatprop.base.text import Setting, plain
from quatprop.base.threads import thread_count
from quatprop.readers.tables.exact_times import SPARE_PLACES, TimestampRangeError
from quatprop.readers.tables.typed_table import BatchRows, batch_rows
from quatprop.stores.compression import (
    MAGIC_BYTES,
    UnreadableDataError,
    decompressed_pieces,
    file_compression,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from quatprop.base.arrays import Float64, Int64
    from quatprop.base.errors import Losses
    from quatprop.readers.tables.table_log import Batches, TableLog, TimedColumns
    from quatprop.readers.tables.typed_table import Leaf


_LOSSES_A_BLOCK = 8

WHOLE = -1
"""In place of a number of spare decimals: times are integers, which are parsed faster."""


class RowMisfitError(ValueError):
    """A row that pyarrow cannot safely parse, or would wrongly accept."""


MISFITS = (
    *(pa.ArrowInvalid, pa.ArrowNotImplementedError, UnicodeDecodeError),
    *(TimestampRangeError, RowMisfitError),
)
"""Exceptions for text with a row that does not fit."""


class TextRows(ABC):
    """One reading of a text table; subclasses parse and split the blocks of a format.

    `leaves`: the columns to read, by index
    `task_bytes`: bytes that one thread of pyarrow parses at a time
    """

    task_bytes: int

    def __init__(self, log: TableLog, columns: TimedColumns, leaves: Mapping[int, Leaf]) -> None:
        self.log = log
        self.columns = columns
        self.leaves = leaves
        self.rejected = RejectedRows(log.path, log.losses)
        # Spare places, for times finer than 1 ns, are only used once they are needed.
        self.spares: Sequence[int] = (0, SPARE_PLACES) if columns.stamp.columns else (SPARE_PLACES,)

    @abstractmethod
    def parse(self, block: TextBlock, task_bytes: int, spare: int) -> pa.Table:
        """Return all rows of a block; may raise one of MISFITS.

        `spare`: spare decimals for times, or :data:`WHOLE`
        """

    @abstractmethod
    def of_own_kind(self, table: pa.Table, block: TextBlock) -> pa.Table:
        """Return the rows of a block without those of other kinds; may raise one of MISFITS."""

    @abstractmethod
    def apart(self, block: TextBlock) -> Batches:
        """Yield the rows of a block that fit, and note the others."""

    def batches(self, blocks: Iterable[TextBlock]) -> Batches:
        """Yield timestamps, ns, ``(N,)``, and numbers, ``(N, k)``, of the rows that fit."""
        count = len(self.columns.numbers) + len(self.columns.beside)
        for block in blocks:
            t_ns, numbers = self._fitting(block)
            self.rejected.refuse_if_most()
            if missing := count - numbers.shape[1]:
                numbers = np.pad(numbers, ((0, 0), (0, missing)), constant_values=np.nan)
            if len(t_ns):
                yield t_ns, numbers

    def _fitting(self, block: TextBlock) -> tuple[Int64, Float64]:
        """Return the rows of a block that fit, where they do not without the columns beside."""
        with suppress(*MISFITS):
            return self.whole(block)
        beside, self.columns = self.columns.beside, self.columns._replace(beside=())
        if beside:
            with suppress(*MISFITS):
                return self.whole(block)  # without them from now on
        none = (np.empty(0, np.int64), np.empty((0, len(self.columns.numbers))))
        t_ns, numbers = map(np.concatenate, zip(none, *self.apart(block), strict=True))
        self.columns = self.columns._replace(beside=tuple(k for k in beside if k in self.leaves))
        return t_ns, numbers

    def whole(self, block: TextBlock, task_bytes: int = 0) -> tuple[Int64, Float64]:
        """Return timestamps and numbers of a block in which all rows fit."""
        task_bytes = task_bytes or self.task_bytes
        for spare in self.spares:
            try:
                rows, foreign = self._rows(block, task_bytes, spare)
                break
            except MISFITS:
                if spare == WHOLE:
                    self.spares = self.spares[1:]
                elif spare == SPARE_PLACES:
                    raise
        if spare == SPARE_PLACES:
            self.spares = (spare,)
        rows.note(self.log, self.columns, self.rejected.count)
        self.log.foreign_rows += foreign
        self.rejected.count += rows.total
        return rows.t_ns, rows.numbers

    def _rows(self, block: TextBlock, task_bytes: int, spare: int) -> tuple[BatchRows, int]:
        """Return the rows of a block, and the number of those of other kinds."""
        table = self.parse(block, task_bytes, spare)
        own = self.of_own_kind(table, block)
        rows = batch_rows(own, self.leaves, self.columns, self.rejected.timed)
        return rows, len(table) - len(own)


def use_threads(data: bytes | memoryview, task_bytes: int) -> bool:
    """Return whether a text is large enough for several threads."""
    return len(data) > task_bytes and thread_count() > 1


class RejectedRows:
    """Notes rows of a text table that do not fit as losses; refuses the table if most do not.

    `count`: number of rows read so far, including those that do not fit
    `untimed`: number of those that were no samples, and so took no time at a sample rate
    """

    def __init__(self, path: Path, losses: Losses) -> None:
        self.count = self.untimed = 0
        self._path = path
        self._losses = losses
        self._first = (0, "")
        self._rejected = 0

    @property
    def timed(self) -> int:
        """Number of samples so far, read or not."""
        return self.count - self.untimed

    def note(self, rows: list[tuple[int, str]]) -> None:
        """Note the line numbers and reasons of rejected rows in a block, as one loss if many."""
        if not rows:
            return
        if not self._rejected:
            self._first = rows[0]
        self._rejected += len(rows)
        if len(rows) <= _LOSSES_A_BLOCK:
            for line, reason in rows:
                self._losses.note(f"line {line}", reason, 1)
            return
        reason = f"{len(rows)} of these rows do not fit; the first: {rows[0][1]}"
        self._losses.note(f"lines {rows[0][0]} to {rows[-1][0]}", reason, len(rows))

    def refuse_if_most(self) -> None:
        """Refuse a table if more than half of its rows were rejected."""
        if 2 * self._rejected > self.count:
            line, reason = self._first
            raise UnsupportedLogError(
                self._path,
                f"{self._rejected} of its first {self.count} rows do not fit (line {line}: "
                f"{reason}); check the columns and units, such as {Setting('time_unit')}, or "
                "whether it is one table",
            )


# Read text in blocks of whole records, with constant memory.


BLOCK_BYTES = 1 << 22
"""Size of a block, bytes; larger for a longer record."""

_SMALL_LOG = 1 << 16
_PIECE_BYTES = 1 << 18
"""Bytes read or examined at a time."""
_LONGEST_RECORD = 1 << 26


class TextBlock(NamedTuple):
    """Whole records of a text.

    `line`: line number of the first record
    `data`: the records; valid until the next block is read
    `quoted`: whether it has quotes, within which a line break may be part of a cell
    """

    line: int
    data: memoryview
    quoted: bool


class TextStream:
    """A text that can be read once, and is decompressed while reading.

    `file`: an open binary file, plain or compressed with gzip, zstd, bz2 or lz4
    `may_be_compressed`: whether to look for compression
    `size`: bytes of the file to read; None: unknown
    `damage`: why the text ends early; ``""``: no damage so far
    """

    def __init__(self, file: BinaryIO, *, may_be_compressed: bool = True) -> None:
        self.size: int | None = getattr(file, "size", None)
        self._file: Any = file if hasattr(file, "peek") else io.BufferedReader(cast("Any", file))
        compression = file_compression(self._file.peek(MAGIC_BYTES) if may_be_compressed else b"")
        self._pieces: Iterator[bytes] | None = None
        if compression:
            self._pieces = decompressed_pieces(self._file, compression)
        self._rest = memoryview(b"")
        self.damage = ""
        self.is_compressed = bool(compression)

    def fill(self, buffer: bytearray | memoryview) -> int:
        """Read until `buffer` is full or the text ends; return the number of bytes read."""
        view = memoryview(buffer)
        filled = 0
        while filled < len(view) and (size := self._read_into(view[filled:])):
            filled += size
        return filled

    def _read_into(self, view: memoryview) -> int:
        """Read the next piece, or a part of it; at damage, note it and return 0."""
        try:
            if not self._rest and self._pieces is None:
                return int(self._file.readinto(view[:_PIECE_BYTES]))
            self._rest = self._rest or memoryview(next(self._pieces or iter(()), b""))
        except UnreadableDataError as error:
            self.damage = error.reason
        except OSError as error:
            self.damage = f"it cannot be read further: {plain(error)}"
        size = min(len(self._rest), len(view))
        view[:size] = self._rest[:size]
        self._rest = self._rest[size:]
        return size

    def read(self, size: int) -> bytes:
        """Return the next `size` bytes, fewer at the end."""
        buffer = bytearray(size)
        return bytes(buffer[: self.fill(buffer)])

    def unread(self, data: bytes) -> None:
        """Put back data that was read last."""
        self._rest = memoryview(data + bytes(self._rest))

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class _FileNow(io.FileIO):
    """A file as far as it goes when it is opened, or only `size` bytes: recorders append to it."""

    def __init__(self, path: Path, size: int | None) -> None:
        super().__init__(path)
        self.size = os.fstat(self.fileno()).st_size if size is None else size

    def readinto(self, buffer: Any) -> int | None:
        """Read no further."""
        left = max(0, self.size - self.tell())
        return super().readinto(memoryview(buffer)[:left])


def open_text(path: Path, size: int | None = None) -> TextStream:
    """Open a file as a text; it ends after `size` bytes, or where it ends now."""
    try:
        return TextStream(cast("BinaryIO", _FileNow(path, size)))
    except OSError as error:
        raise UnreadableLogError(path, os_reason(error)) from error


def record_blocks(text: TextStream, line: int, size: int = BLOCK_BYTES) -> Iterator[TextBlock]:
    """Yield a text as blocks that end where a record ends."""
    # Allocating memory takes time, so small logs get a small buffer.
    buffer = bytearray(min(size, _SMALL_LOG))
    filled = text.fill(buffer)
    if filled == len(buffer):
        buffer.extend(bytes(size - filled))
    while True:
        filled += text.fill(memoryview(buffer)[filled:])
        ended = filled < len(buffer)
        cut = filled if ended else record_end(buffer, filled)
        if not cut and filled < _LONGEST_RECORD and not ended:
            buffer = buffer + bytes(len(buffer))
            continue
        cut = cut or filled
        if cut:
            yield TextBlock(line, memoryview(buffer)[:cut], buffer.find(b'"', 0, cut) >= 0)
        if ended:
            return
        line += _count(buffer, "\n", cut)
        buffer[: filled - cut] = buffer[cut:filled]
        filled -= cut


def record_end(buffer: bytes | bytearray, end: int) -> int:
    """Return the end of the last whole record in ``buffer[:end]``; 0 if there is none.

    A line break within quotes does not end a record, unless quotes are unbalanced everywhere: one
    stray quote must not swallow the rest of a log.
    """
    last = cut = buffer.rfind(b"\n", 0, end) + 1
    quotes = _count(buffer, '"', cut) if buffer.find(b'"', 0, cut) >= 0 else 0
    while quotes % 2 and cut:
        before = buffer.rfind(b"\n", 0, cut - 1) + 1
        quotes -= buffer.count(b'"', before, cut)
        cut = before
    return cut or last


def _count(buffer: bytes | bytearray, mark: str, end: int) -> int:
    """Return the count of a character in ``buffer[:end]``, much faster than ``bytes.count``."""
    text = np.frombuffer(buffer, np.uint8, end)
    pieces = (text[begin : begin + _PIECE_BYTES] for begin in range(0, end, _PIECE_BYTES))
    return sum(int(np.count_nonzero(piece == ord(mark))) for piece in pieces)
