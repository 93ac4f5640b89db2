"""Tables of text: CSV and its relatives, from a file or a stream."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from quatprop.errors import UnreadableLogError, UnsupportedLogError, UsageError
from quatprop.provenance import COMMENT, METADATA_KEY, provenance_in
from quatprop.tables.base import TableLog
from quatprop.tables.csv.decimal_time import counted
from quatprop.tables.csv.headers import HEAD_BYTES, sniff
from quatprop.tables.csv.last_line import TAIL_BYTES, is_cut
from quatprop.tables.csv.rows import MISFITS, BlockParser, RowParser, Rows
from quatprop.tables.csv.text_blocks import LineCounter, TextStream, blocks, pieces, record_end
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from quatprop.containers.base import Losses
    from quatprop.tables.base import TableNotes, TimedColumns
    from quatprop.tables.csv.headers import Layout
    from quatprop.tables.csv.text_blocks import Block

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

_PIECE_BYTES = 1 << 16
_LOSSES_A_BLOCK = 8
_ENOUGH_ROWS = 100_000
"""Rows after which a table is refused, of which most do not fit."""
_SHOWN = 12
"""Bytes of a line that are shown."""
_STDIN = Path("-")


class CsvLog(TableLog):
    """A text table.

    Parameters
    ----------
    source
        The file, or an open binary stream such as stdin, which can be read only once. Both may
        be packed with gzip, zstd, bz2 or lz4.

    Raises
    ------
    UnreadableLogError
        The file cannot be read, or is empty.
    UnsupportedLogError
        It is not a text of one table.
    """

    kind = "csv"

    def __init__(self, source: Path | BinaryIO) -> None:
        super().__init__(source if isinstance(source, Path) else _STDIN)
        self.remarks: list[str] = []
        self._file = None if isinstance(source, Path) else source
        self._text: TextStream | None = self._open()
        self._head = self._text.read(HEAD_BYTES)
        if self._file is None:
            self._text.close()
        if not self._head:
            raise UnreadableLogError(self.path, "it is empty; was the recording closed?")
        self._layout = sniff(self._head, self.path)
        if self._layout.header and self._layout.body == HEAD_BYTES == len(self._head):
            raise UnsupportedLogError(
                self.path,
                f"its header is longer than {HEAD_BYTES} bytes; is it a table with a row a sample?",
            )
        self._known_losses: int | None = None

    @property
    def notes(self) -> TableNotes:
        """What the lines before the header say."""
        return self._layout.notes

    def provenance(self) -> dict[str, Any]:
        """Return how the content came about, as the first line may say; empty where it does not.

        Raises
        ------
        DamagedLogError
            What is written there is not what this package writes.
        """
        first, _, _ = self._head.partition(b"\n")
        told = first.startswith(COMMENT)
        return provenance_in({METADATA_KEY: first.removeprefix(COMMENT)} if told else {}, self.path)

    def columns(self) -> list[str]:
        """Return the column names in order; ``"0"``, ``"1"``... for a table without a header."""
        return list(self._layout.names)

    def rows(self, columns: TimedColumns) -> Iterator[tuple[Int64, Float64]]:
        """Yield the chosen columns as stamps in ns and numbers as stored, block after block.

        Rows that do not fit are left out and told in :attr:`losses`.

        Raises
        ------
        UnsupportedLogError
            Most rows do not fit.
        """
        text = self._restarted()
        again = self._open_rows if self._file is None else None
        lines = LineCounter(self._layout.line, again)
        scan = _Scan(self._layout, columns, lines, self.losses)
        tail = b""
        try:
            for block in blocks(text):
                whole, tail = self._without_cut_line(block, tail, text, columns, lines)
                t_ns, numbers = scan.read(whole)
                scan.refuse_mostly_lost(self.path)
                if len(t_ns):
                    yield t_ns, numbers
            if text.damage:
                self.losses.note("end of the file", text.damage)
        finally:
            lines.close()
            if self._file is None:
                text.close()

    def _without_cut_line(
        self,
        block: Block,
        tail: bytes,
        text: TextStream,
        columns: TimedColumns,
        lines: LineCounter,
    ) -> tuple[Block, bytes]:
        """Return a block without a last line that was cut off, and its end for the next."""
        data = block.data
        end = bytes(data[-TAIL_BYTES:])
        if end.endswith(b"\n"):
            return block, end
        whole = bytes(data)
        begin = record_end(whole, len(whole))
        last = whole[begin:]
        wanted = {*columns.time, *columns.numbers}
        before = (tail + whole[max(0, begin - TAIL_BYTES) : begin])[-TAIL_BYTES:]
        cut = bool(text.damage) or is_cut(before, last, self._layout, wanted)
        if cut is None:
            shown = quoted(last[-_SHOWN:].decode(errors="replace"))
            self.remarks.append(
                f"the last line has no line end: if the log was cut off there, its end {shown} "
                "may have lost digits"
            )
        if not cut:
            return block, b""
        line = lines.at(block.offset) + whole.count(b"\n", 0, begin)
        reason = "it has no line end, and its last cell was cut off"
        self.losses.note(f"line {line}", reason, 1)
        return block._replace(data=data[:begin]), b""

    def close(self) -> None:
        """Release what was read; a stream is left to its owner."""
        self._text = None

    def _open(self) -> TextStream:
        try:
            return TextStream(self.path.open("rb") if self._file is None else self._file)
        except OSError as error:
            raise UnreadableLogError(self.path, f"it cannot be read: {error.strerror}") from error

    def _open_rows(self) -> TextStream:
        text = self._open()
        text.read(self._layout.body)
        return text

    def _restarted(self) -> TextStream:
        """Return the text from its first row on, and forget what an earlier reading lost."""
        if self._known_losses is None:
            self._known_losses = len(self.losses)
        self.losses.restart(self._known_losses)
        self.remarks.clear()
        if self._file is None:
            return self._open_rows()
        text, self._text = self._text, None
        if text is None:
            raise UsageError("stdin can be read only once; save it to a file first")
        text.unread(self._head[self._layout.body :])
        return text


class _Scan:
    """One reading of a table: what it has to remember from block to block."""

    def __init__(
        self, layout: Layout, columns: TimedColumns, lines: LineCounter, losses: Losses
    ) -> None:
        self._layout = layout
        self._columns = columns
        self._block_parser = BlockParser(layout, columns)
        self._row_parser = RowParser(layout, columns)
        self._lines = lines
        self._losses = losses
        self._known = len(losses)
        self._count = 0
        self._lost = 0

    def read(self, block: Block) -> tuple[Int64, Float64]:
        """Return stamps and numbers of the rows of a block that fit."""
        try:
            parts = [self._block_parser.parse(block.data, quoted=block.quoted)]
        except MISFITS:
            parts = list(self._damaged(block))
        stamps = [self._stamps(rows) for rows in parts]
        self._lines.passed(block)
        if len(parts) == 1:
            return stamps[0], parts[0].numbers
        return np.concatenate(stamps), np.concatenate([rows.numbers for rows in parts])

    def refuse_mostly_lost(self, path: Path) -> None:
        """Refuse a table of which more rows were lost than read."""
        if 2 * self._lost > self._count:
            first = self._losses[self._known]
            raise UnsupportedLogError(
                path,
                f"{self._lost} of its first {self._count} rows do not fit ({first.place}: "
                f"{first.reason}); check the columns and units, or whether it is one table",
            )

    def _damaged(self, block: Block) -> Iterator[Rows]:
        """Read a block in which something does not fit, piece by piece."""
        line = self._lines.at(block.offset)
        lost: list[tuple[int, str]] = []
        seen = 0
        for piece in pieces(self._layout.without_headers(bytes(block.data)), _PIECE_BYTES):
            try:
                rows = self._block_parser.parse(piece, quoted=b'"' in piece, task=len(piece))
            except MISFITS:
                rows = self._row_parser.parse(piece, line)
                lost += rows.lost
            yield rows
            line += piece.count(b"\n")
            seen += rows.total
            if seen > _ENOUGH_ROWS and 2 * len(lost) > self._count + seen:
                break  # it will be refused: nobody waits for the rest
        self._note(lost)

    def _note(self, lost: list[tuple[int, str]]) -> None:
        self._lost += len(lost)
        if len(lost) <= _LOSSES_A_BLOCK:
            for line, reason in lost:
                self._losses.note(f"line {line}", reason, 1)
        else:
            place = f"lines {lost[0][0]} to {lost[-1][0]}"
            reason = f"of these rows {len(lost)} do not fit; the first: {lost[0][1]}"
            self._losses.note(place, reason, len(lost))

    def _stamps(self, rows: Rows) -> Int64:
        t_ns = rows.t_ns
        if t_ns is None:
            t_ns = counted(self._count, rows.total, self._columns.sample_rate or 1.0)
            t_ns = t_ns if rows.kept is None else t_ns[rows.kept]
        self._count += rows.total
        return t_ns
