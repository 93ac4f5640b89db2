"""Text tables: CSV and similar formats, from a file or a stream.

Trajectories of TUM RGB-D and KITTI have no header, but known columns.
"""

from __future__ import annotations

import csv
import io
import os
import re
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache, partial, reduce
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from quatprop.base.arrow_arrays import readable
from quatprop.base.errors import (
    DamagedLogError,
    UnknownFormatError,
    UnreadableLogError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.base.provenance import COMMENT, JsonObject, provenance_in
from quatprop.base.text import Remark, quoted
from quatprop.readers.tables.csv_layout import (
    HEAD_BYTES,
    MINUS,
    detect_layout,
    split_cells,
    split_rows,
)
from quatprop.readers.tables.csv_lines import NOT_A_NUMBER, NUMBER, is_data
from quatprop.readers.tables.csv_rows import Misfit, Other, RowParser, date_type
from quatprop.readers.tables.exact_times import (
    decimal_type,
    may_hold,
    refuse_tiny_numbers,
    row_stamps,
)
from quatprop.readers.tables.table_log import TableLog
from quatprop.readers.tables.text_rows import (
    MISFITS,
    WHOLE,
    RowMisfitError,
    TextBlock,
    TextRows,
    TextStream,
    open_text,
    record_blocks,
    record_end,
    use_threads,
)
from quatprop.readers.tables.time_units import TEXTS
from quatprop.readers.tables.typed_table import Leaf

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from quatprop.base.arrays import Float64, Int64
    from quatprop.readers.tables.csv_layout import CsvLayout
    from quatprop.readers.tables.model import TableNotes
    from quatprop.readers.tables.table_log import Batches, TimedColumns


# Parse blocks of text: as a whole, or piece by piece if rows do not fit.


_PIECE_BYTES = 1 << 16
_ENOUGH_ROWS = 100_000
"""Number of rows after which a table is refused if most rows do not fit."""


class CsvRows(TextRows):
    """One reading of a CSV table."""

    task_bytes = 1 << 19

    def __init__(self, log: TableLog, layout: CsvLayout, columns: TimedColumns) -> None:
        leaves = {k: Leaf((str(k),), pa.float64()) for k in columns.read}
        super().__init__(log, columns, leaves)
        self._layout = layout
        self._row_parser = RowParser(log.path, layout, columns)
        times = next(iter(log.head(columns.stamp.columns)), ()) if columns.stamp.columns else ()
        if times and all(f"{time}".strip().isdecimal() for time in times):
            self.spares = (WHOLE, *self.spares)

    def parse(self, block: TextBlock, task_bytes: int, spare: int) -> pa.Table:
        """Return all rows of a block; no record is longer than a task."""
        line_breaks = block.quoted and self._row_parser.has_line_breaks_in_cells(block.data)
        data = self._layout.cleaned(block.data)
        if spare == WHOLE and (may_hold(data, b"x") or may_hold(data, b"X")):
            raise RowMisfitError("it may have hexadecimal numbers, which are no times")
        if spare != WHOLE and self.columns.stamp.columns:
            refuse_tiny_numbers(data)
        types = {str(k): pa.float64() for k in (*self.columns.numbers, *self.columns.beside)}
        for k, unit in zip(self.columns.stamp.columns, self.columns.stamp.units, strict=True):
            is_whole = spare == WHOLE and unit not in TEXTS
            number = pa.int64() if is_whole else decimal_type(unit, max(spare, 0))
            types[str(k)] = date_type(self._layout, k) or number
        labels = (k for k, _ in self.columns.stamp.series)
        # Cells that are only watched may be of any encoding.
        watched = self.columns.read - self.columns.used - {*self.columns.beside}
        types |= {str(k): pa.binary() for k in watched}
        types |= {str(k): pa.string() for k in (*labels, *self.columns.others)}
        read = partial(
            arrow_csv.read_csv,
            readable(data),
            read_options=arrow_csv.ReadOptions(
                column_names=list(map(str, range(len(self._layout.names)))),
                block_size=task_bytes,
                use_threads=use_threads(data, task_bytes),
            ),
            parse_options=arrow_csv.ParseOptions(
                delimiter=self._layout.delimiter, newlines_in_values=line_breaks
            ),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types, include_columns=list(types), decimal_point=self._layout.decimal
            ),
        )
        if threading.current_thread() is threading.main_thread():
            pool = _other_thread(os.getpid())
            try:
                reading = pool.submit(read)
            except BaseException:
                # Interrupted at its start, the thread is unknown to its pool, and would never end.
                pool.shutdown(wait=False)
                _other_thread.cache_clear()
                raise
            table = reading.result()
        else:
            table = read()
        return table

    def of_own_kind(self, table: pa.Table, block: TextBlock) -> pa.Table:  # noqa: ARG002
        """Return the rows with a number to read, or with nothing else."""
        numbers, others = (
            [table.column(str(k)) for k in each]
            for each in (self.columns.numbers, self.columns.others)
        )
        if others and numbers and all(column.null_count for column in numbers):
            import pyarrow.compute as pc  # slow to import, and seldom needed

            known = pa.array([*NOT_A_NUMBER])
            filled = [
                *map(pc.is_valid, numbers),
                *(
                    pc.is_in(pc.utf8_lower(pc.utf8_trim_whitespace(column)), known)
                    for column in others
                ),
            ]
            is_own = reduce(pc.or_, filled[: len(numbers)])
            table = table.filter(pc.or_(is_own, reduce(pc.and_, filled[len(numbers) :])))
        if any(table.column(str(k)).null_count for k in self.columns.stamp.columns):
            raise RowMisfitError("a row without a time")
        return table

    def apart(self, block: TextBlock) -> Batches:
        """Yield rows piece by piece; pieces with a misfit are read row by row."""
        text = io.BytesIO(self._layout.without_headers(bytes(block.data)))
        pieces = TextStream(text, may_be_compressed=False)
        rejected: list[tuple[int, str]] = []
        first = self.rejected.count
        for piece in record_blocks(pieces, block.line, _PIECE_BYTES):
            try:
                yield self.whole(piece, len(piece.data))
            except MISFITS:
                yield self._one_by_one(piece, rejected)
            count = self.rejected.count
            if count - first > _ENOUGH_ROWS and 2 * len(rejected) > count:
                break  # the table will be refused
        self.rejected.note(rejected)

    def _one_by_one(
        self, piece: TextBlock, rejected: list[tuple[int, str]]
    ) -> tuple[Int64, Float64]:
        """Return the rows of a piece that fit, and append the others to `rejected`."""
        first = self.rejected.timed
        stamps: list[int] = []
        numbers: list[list[float]] = []
        kept: list[int] = []
        cells: list[list[str]] = []
        for line, row in self._row_parser.rows(bytes(piece.data), piece.line):
            if isinstance(row, Other):
                self.log.other_rows += row is Other.SERIES
                self.log.foreign_rows += row is Other.KIND
                continue
            if isinstance(row, Misfit):
                rejected.append((line, row.reason))
                self.rejected.untimed += not row.is_sample
            else:
                stamps.append(row.stamp)
                numbers.append(row.numbers)
                kept.append(self.rejected.timed - first)
                cells.append(row.cells)
            self.rejected.count += 1
        rates = np.array(numbers, np.float64).reshape(-1, len(self.columns.numbers))
        if self.columns.watch is not None:
            places = first + np.array(kept, np.intp)
            self.columns.watch.see(
                self.columns.watch.shown(
                    rates, places, lambda k: pa.array([row[k] for row in cells], pa.string())
                )
            )
        t_ns = np.array(stamps, np.int64)
        if not self.columns.stamp.columns:
            rate = self.columns.stamp.sample_rate or 1.0
            t_ns = row_stamps(first, self.rejected.timed - first, rate)[kept]
        return t_ns, rates


@lru_cache(maxsize=1)
def _other_thread(_process: int) -> ThreadPoolExecutor:
    """Return a thread of this process, for each forked process a new one.

    In the main thread, pyarrow handles SIGINT and SIGTERM while it reads, and may abort the process
    instead of ending it normally.
    """
    return ThreadPoolExecutor(1)


# Detect whether a last line without a line end was cut off.
#
# A recorder that crashed leaves such a line, but some programs also write line ends only between
# rows. The cells above distinguish the two if all have the same number of decimals, or if there are
# many and all have more than the last one.


TAIL_BYTES = 1 << 16
"""Bytes of the preceding rows that are compared."""

_FEW = 3
"""Minimum number of rows if their cells have the same length."""
_MANY = 100
"""Minimum number of rows if the lengths of cells vary, so that a shorter one is unlikely."""

_NUMBER = re.compile(r"\s*[+-]?(\d*)(?:[.,](\d*))?(?:[eE][+-]?(\d*))?\s*")


class _Digits(NamedTuple):
    """Lengths of the parts of a number; of other text, the total length."""

    whole: int
    decimals: int
    exponent: int


def is_truncated(
    before: bytes, last: bytes, layout: CsvLayout, used: Collection[int]
) -> bool | None:
    """Return whether a last line without a line end was cut off; None if unknown."""
    cells = _cells(last, layout)
    column = len(layout.names) - 1
    if len(cells) != len(layout.names) or column not in used:
        return False
    if layout.end:
        return not last.rstrip().endswith(layout.end.encode())
    if last.count(b'"') % 2:
        return True
    rows = (_cells(line, layout) for line in before.splitlines())
    earlier = [_digits(row[column]) for row in rows if len(row) == len(layout.names)]
    digits = _digits(cells[column])
    if not earlier:
        return None
    if not any(digits):
        return True if all(map(any, earlier)) else None
    return _is_shorter(digits, earlier)


def _is_shorter(number: _Digits, earlier: list[_Digits]) -> bool | None:
    """Return whether a number is shorter than those before it; None if unknown."""
    exponents = [digits.exponent for digits in earlier if digits.exponent]
    if number.exponent and exponents and number.exponent < min(exponents):
        return True
    # Integer digits are only compared if there are no decimals.
    has_decimals = any(digits.decimals for digits in earlier)
    lengths = [digits.decimals if has_decimals else digits.whole for digits in earlier]
    length = number.decimals if has_decimals else number.whole
    uniform = len(set(lengths)) == 1 and len({digits.exponent for digits in earlier}) == 1
    if length < min(lengths) and len(earlier) >= (_FEW if uniform else _MANY):
        return True
    if uniform and len(earlier) >= _FEW and number.exponent == earlier[0].exponent:
        return False
    return None


def _cells(line: bytes, layout: CsvLayout) -> list[str]:
    text = io.StringIO(bytes(layout.cleaned(line)).decode(errors="replace"), newline="")
    try:
        return next(csv.reader(text, delimiter=layout.delimiter), [])
    except csv.Error:
        return []


def _digits(cell: str) -> _Digits:
    number = _NUMBER.fullmatch(cell)
    if number is None:
        return _Digits(len(cell.strip()), 0, 0)
    return _Digits(*(len(part or "") for part in number.groups()))


_SHOWN = 12
"""Bytes of a line shown in a remark."""
_HEAD_ROWS = 1000
"""About as many rows are looked at before the file is read; later ones are watched meanwhile."""
_FIRST_ROWS = 100
"""Number of rows with numbers that show which columns are of other topics."""
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
        self.damage = self._text.damage
        if not self._head:
            if self.damage:
                raise DamagedLogError(self.path, f"{self.damage}, and nothing of it can be read")
            raise UnreadableLogError(self.path, "it is empty; was the recording closed?")
        try:
            self._layout = detect_layout(self._head, self.path)
        except UnknownFormatError as error:
            if self.damage:
                raise DamagedLogError(self.path, f"{self.damage}, and {error.reason}") from error
            raise
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
        """Return cells of the first rows; see :class:`.TableLog`."""
        rows = self._whole_rows()
        return list(zip(*([row[k] for row in rows] for k in columns), strict=True))

    def _whole_rows(self) -> list[list[str]]:
        """Return the cells of the first rows that fit the header."""
        if self._first_rows is not None:
            return self._first_rows
        whole = self._head
        if len(whole) == HEAD_BYTES:
            whole = whole.rpartition(b"\n")[0]
        text = bytes(self._layout.with_points(_with_hyphens(whole[self._layout.body :])))
        lines, width = text.decode(errors="replace").splitlines(), len(self._layout.names)
        found: list[list[str]] = []
        for begin in range(0, len(lines), _HEAD_ROWS):
            rows = split_rows(lines[begin : begin + _HEAD_ROWS], self._layout.delimiter)
            found += [row for row in rows if len(row) == width and is_data(row)]
            if len(found) >= _HEAD_ROWS:
                break
        self._first_rows = found
        return self._first_rows

    def label_columns(self) -> dict[int, bool]:
        """Return columns that may hold labels; see :class:`.TableLog`."""
        first = next(iter(self._whole_rows()), [])
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
        """Yield timestamps and numbers; see :class:`quatprop.readers.tables.table_log.TableLog`."""
        text = self._restart()
        columns = columns._replace(others=self._columns_of_other_kinds(columns))
        rows = CsvRows(self, self._layout, columns)
        try:
            yield from rows.batches(self._whole_blocks(text, columns))
            if text.damage:
                self.losses.note("end of the file", text.damage)
        finally:
            if self._stream is None:
                text.close()

    def _columns_of_other_kinds(self, columns: TimedColumns) -> tuple[int, ...]:
        """Return the columns that are empty in most of the first rows with numbers to read.

        A row that has a cell there and no numbers is of another topic, of a logger that writes
        several into one table.
        """
        mark, width = self._layout.delimiter.encode(), len(self._layout.names)
        blanks = (2 * mark, mark + b"\n", mark + b"\r", b"nan", b"NaN")
        if not any(blank in self._head for blank in blanks):
            return ()
        rows: list[list[bool]] = []
        for line in BytesIO(self._head[self._layout.body :]):
            cells = split_cells(line.decode(errors="replace"), self._layout.delimiter)
            is_blank = [cell.strip().lower() in NOT_A_NUMBER for cell in cells]
            if len(cells) == width and not all(is_blank[k] for k in columns.numbers):
                rows.append(is_blank)
                if len(rows) == _FIRST_ROWS:
                    break
        empty = (k for k in range(width) if k not in columns.used)
        return tuple(k for k in empty if 2 * sum(row[k] for row in rows) > len(rows))

    def _whole_blocks(self, text: TextStream, columns: TimedColumns) -> Iterator[TextBlock]:
        """Yield the rows of a text without a truncated last line."""
        tail, has_minus = b"", MINUS in self._head
        for block in record_blocks(text, self._layout.line):
            whole = self._without_truncated_line(block, tail, text, columns)
            tail = bytes(block.data[-TAIL_BYTES:])
            if has_minus:
                whole = whole._replace(data=memoryview(_with_hyphens(bytes(whole.data))))
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


def _with_hyphens(data: bytes) -> bytes:
    return data.replace(MINUS, b"-")


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
