"""Text tables: CSV and similar formats, from a file or a stream.

Trajectories of TUM RGB-D and KITTI have no header, but known columns.
"""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from quatprop.errors import DamagedLogError, UnreadableLogError, UnsupportedLogError, UsageError
from quatprop.provenance import COMMENT, JsonObject, provenance_in
from quatprop.tables.base import TableLog
from quatprop.tables.csv.headers import HEAD_BYTES, detect_layout, is_data, split_cells
from quatprop.tables.csv.notes import NUMBER
from quatprop.tables.csv.reading import CsvRows
from quatprop.tables.csv.row_parser import RowParser
from quatprop.tables.csv.truncation import TAIL_BYTES, is_truncated
from quatprop.tables.text_stream import TextStream, open_text, record_blocks, record_end
from quatprop.text import Remark, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.tables.base import Batches, TimedColumns
    from quatprop.tables.model import TableNotes
    from quatprop.tables.text_stream import TextBlock


_SHOWN = 12
"""Bytes of a line shown in a remark."""
_STDIN = Path("-")


class CsvLog(TableLog):
    """A text table.

    `source`: a file, or an open binary stream such as stdin, which can be read only once. Either
        may be compressed with gzip, zstd, bz2 or lz4
    """

    kind = "csv"

    def __init__(self, source: Path | BinaryIO) -> None:
        super().__init__(source if isinstance(source, Path) else _STDIN)
        self.remarks: list[Remark] = []
        self._stream = None if isinstance(source, Path) else source
        self._text = open_text(source) if isinstance(source, Path) else TextStream(source)
        self._was_read = False
        self._first_rows: list[list[str]] | None = None
        self._head = self._text.read(HEAD_BYTES)
        if self._stream is None:
            self._text.close()
        if not self._head:
            if damage := self._text.damage:
                raise DamagedLogError(self.path, f"{damage}, and nothing of it can be read")
            raise UnreadableLogError(self.path, "it is empty; was the recording closed?")
        self._layout = detect_layout(self._head, self.path)
        if self._layout.header and self._layout.body == HEAD_BYTES == len(self._head):
            raise UnsupportedLogError(
                self.path,
                f"its header is longer than {HEAD_BYTES} bytes; is it a table with one row per "
                "sample?",
            )

    @property
    def notes(self) -> TableNotes:
        """Facts declared before the header."""
        return self._layout.notes

    def provenance(self) -> JsonObject:
        """Return the provenance in the first line."""
        first, _, _ = self._head.partition(b"\n")
        if not first.startswith(COMMENT):
            return {}
        return provenance_in(first.removeprefix(COMMENT), self.path)

    @property
    def names(self) -> list[str]:
        """Column names in order; ``"0"``, ``"1"``... without a header."""
        return list(self._layout.names)

    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:
        """Return cells of the first rows; see :class:`quatprop.tables.base.TableLog`."""
        if self._first_rows is None:
            self._first_rows = list(self._whole_rows())
        return [tuple(row[k] for k in columns) for row in self._first_rows]

    def _whole_rows(self) -> Iterator[list[str]]:
        """Yield the cells of the first rows that fit the header."""
        whole = self._head
        if len(whole) == HEAD_BYTES:
            whole = whole.rpartition(b"\n")[0]
        lines = whole[self._layout.body :].decode(errors="replace").splitlines()
        rows = (split_cells(line, self._layout.delimiter) for line in lines)
        width = len(self._layout.names)
        return (row for row in rows if len(row) == width and is_data(row))

    def label_columns(self) -> dict[int, bool]:
        """Return columns that may hold labels; see :class:`quatprop.tables.base.TableLog`."""
        first = next(self._whole_rows(), [])
        dates = self._layout.notes.units
        return {
            k: cell.strip().isdecimal()
            for k, cell in enumerate(first)
            if k not in dates and (cell.strip().isdecimal() or not NUMBER.fullmatch(cell))
        }

    def row_count(self) -> int | None:
        """Return an estimate from the sizes of the file and its first rows; None if compressed."""
        head = self._head[self._layout.body :]
        rows = head.count(b"\n")
        if self._stream is not None or not rows or self._text.is_compressed:
            return None
        return max(rows, round((self._text.size or 0) / len(head) * rows))

    def _stored_rows(self, columns: TimedColumns) -> Batches:
        """Yield timestamps and numbers; see :class:`quatprop.tables.base.TableLog`."""
        text = self._restart()
        rows = CsvRows(self, self._layout, columns)
        try:
            yield from rows.batches(self._whole_blocks(text, columns))
            if text.damage:
                self.losses.note("end of the file", text.damage)
        finally:
            if self._stream is None:
                text.close()

    def _whole_blocks(self, text: TextStream, columns: TimedColumns) -> Iterator[TextBlock]:
        """Yield the rows of a text without a truncated last line."""
        tail = b""
        for block in record_blocks(text, self._layout.line):
            whole = self._without_truncated_line(block, tail, text, columns)
            tail = bytes(block.data[-TAIL_BYTES:])
            if len(whole.data):
                yield whole

    def _without_truncated_line(
        self, block: TextBlock, tail: bytes, text: TextStream, columns: TimedColumns
    ) -> TextBlock:
        """Return a block without a truncated last line."""
        if bytes(block.data[-1:]) in {b"\n", b"\r"}:
            return block
        data = bytes(block.data).rstrip(b"\0")
        is_padded = len(data) < len(block.data)
        if is_padded:
            # A file system may leave zeros at the end of a file after a power failure.
            self.losses.note("end of the file", "it is filled with zero bytes")
            block = block._replace(data=block.data[: len(data)])
            if data[-1:] in {b"", b"\n"}:
                return block
        begin = record_end(data, len(data))  # cells may have line breaks
        if data.count(b'"', begin) % 2 and data.count(b'"') % 2 == 0:
            begin = 0  # the only record
        if any(
            map(RowParser(self.path, self._layout, columns).is_row, data[begin:].split(b"\n")[1:])
        ):
            begin = data.rfind(b"\n") + 1  # a stray quote, not a cell with line breaks
        last = data[begin:]
        before = (tail + data[max(0, begin - TAIL_BYTES) : begin])[-TAIL_BYTES:]
        used = columns.used
        damaged = is_padded or bool(text.damage)
        truncated = damaged or is_truncated(before, last, self._layout, used)
        if truncated is None:
            shown = quoted(last[-_SHOWN:].decode(errors="replace"))
            self.remark(
                "no-line-end",
                f"the last line has no line end: if the log was cut off there, its end {shown} "
                "may have lost digits",
            )
        if not truncated:
            return block
        line = block.line + data.count(b"\n", 0, begin)
        self.losses.note(f"line {line}", "it has no line end, and its last cell was cut off", 1)
        return block._replace(data=block.data[:begin])

    def _restart(self) -> TextStream:
        """Return the text from its first row on, and remove the remarks of an earlier reading."""
        self.remarks.clear()
        if self._stream is None:
            if len(self._head) < HEAD_BYTES and not self._text.damage:  # that was all of it
                return TextStream(BytesIO(self._head[self._layout.body :]), may_be_compressed=False)
            rows = open_text(self.path, self._text.size)
            rows.read(self._layout.body)
            return rows
        if self._was_read:
            raise UsageError("stdin can be read only once; save it to a file first")
        self._was_read = True
        self._text.unread(self._head[self._layout.body :])
        return self._text


class TumLog(CsvLog):
    """A trajectory of eight columns: time in seconds, position, quaternion."""

    kind = "tum"
    expected: tuple[str, ...] = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")

    def __init__(self, source: Path | BinaryIO) -> None:
        super().__init__(source)
        if self._layout.header:
            return
        if len(self._layout.names) != len(self.expected):
            raise UnsupportedLogError(
                self.path,
                f"it has {len(self._layout.names)} columns, and a {self.kind.upper()} trajectory "
                f"has {len(self.expected)}: {' '.join(self.expected)}",
            )
        self._layout = replace(self._layout, names=list(self.expected))


class KittiLog(TumLog):
    """A trajectory of twelve columns: the matrix (R | t) row by row, without times."""

    kind = "kitti"
    expected = (
        *("r11", "r12", "r13", "tx"),
        *("r21", "r22", "r23", "ty"),
        *("r31", "r32", "r33", "tz"),
    )
