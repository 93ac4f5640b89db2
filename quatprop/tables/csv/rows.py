"""Rows of text to columns of numbers: whole blocks by pyarrow, damaged places row by row.

The second parser is written by hand because pyarrow refuses a block as a whole, and does not say
which of its rows do not fit.
"""

from __future__ import annotations

import csv
import io
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from quatprop.arrow_arrays import to_numpy
from quatprop.tables import timestamps
from quatprop.tables.csv.headers import COMMENTS
from quatprop.text import plain, quoted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from quatprop.tables.base import TimedColumns
    from quatprop.tables.csv.headers import CsvLayout

MISFITS = (pa.ArrowInvalid, timestamps.TimestampRangeError)
"""What :class:`BlockParser` raises for a block in which a row does not fit."""

_TASK_BYTES = 1 << 19  # what one thread of pyarrow parses at a time

_LARGEST = np.iinfo(np.int64).max
_NOT_A_NUMBER = {
    "",
    "nan",
    "-nan",
    "+nan",
    "na",
    "n/a",
    "#n/a",
    "null",
    "none",
    "1.#qnan",
    "1.#ind",
}


class ParsedRows(NamedTuple):
    """Rows of a block or a piece.

    Parameters
    ----------
    t_ns
        Stamps, shape ``(N,)``, int64, ns; None for a table without time.
    numbers
        Numbers as stored, shape ``(N, k)``, float64; NaN where a cell is empty.
    total
        How many rows there were, kept and rejected.
    kept
        Which of them were kept, shape ``(N,)``, int64; None where all were.
    rejected
        Line number and reason of each row that was rejected.
    """

    t_ns: NDArray[np.int64] | None
    numbers: NDArray[np.float64]
    total: int
    kept: NDArray[np.int64] | None = None
    rejected: tuple[tuple[int, str], ...] = ()


class _ColumnParser:
    """What both parsers know: the layout and the columns to read."""

    def __init__(self, layout: CsvLayout, columns: TimedColumns) -> None:
        self.layout = layout
        self.columns = columns

    def _date_type(self, k: int) -> pa.DataType | None:
        if k not in self.layout.dates:
            return None
        return pa.timestamp("ns", self.layout.dates[k])


class BlockParser(_ColumnParser):
    """Reads whole blocks, all rows at once.

    Parameters
    ----------
    layout
        How the table is laid out.
    columns
        Which columns to read.
    """

    def __init__(self, layout: CsvLayout, columns: TimedColumns) -> None:
        super().__init__(layout, columns)
        self._names = [str(k) for k in range(len(layout.names))]
        self._spare = 0

    def parse(
        self, data: bytes | memoryview, *, quoted: bool, task: int = _TASK_BYTES
    ) -> ParsedRows:
        """Return all rows of a block.

        Parameters
        ----------
        data
            Whole records.
        quoted
            Whether there may be line breaks between quotes.
        task
            Bytes that one thread parses at a time; no record may be longer.

        Raises
        ------
        ArrowInvalid
            A row does not have the right number of columns, or a cell is not a number.
        TimestampRangeError
            A stamp does not fit in int64 ns.
        """
        if self.layout.delimiter == " ":
            data = squeeze_blanks(data)
        try:
            return self._parse(data, self._spare, quoted, task)
        except MISFITS:
            if self._spare or not self.columns.time:
                raise
        rows = self._parse(data, timestamps.SPARE_PLACES, quoted, task)
        self._spare = timestamps.SPARE_PLACES  # stamps finer than ns, here and likely further on
        return rows

    def _parse(self, data: bytes | memoryview, spare: int, quoted: bool, task: int) -> ParsedRows:
        if self.columns.time:
            timestamps.refuse_tiny_numbers(data)
        types = {str(k): pa.float64() for k in self.columns.numbers}
        for k, unit in zip(self.columns.time, self.columns.units, strict=True):
            types[str(k)] = self._date_type(k) or timestamps.decimal_type(unit, spare)
        read = partial(
            arrow_csv.read_csv,
            pa.BufferReader(pa.py_buffer(data)),
            read_options=arrow_csv.ReadOptions(
                column_names=self._names,
                block_size=task,
                use_threads=len(data) > task,
            ),
            parse_options=arrow_csv.ParseOptions(
                delimiter=self.layout.delimiter, newlines_in_values=quoted
            ),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types,
                include_columns=list(types),
                decimal_point=self.layout.decimal,
            ),
        )
        # In the main thread pyarrow would take over the handling of Ctrl-C and SIGTERM meanwhile,
        # and a process that is told to end at that moment aborts.
        with ThreadPoolExecutor(1) as thread:
            table = thread.submit(read).result()
        numbers = np.empty((table.num_rows, len(self.columns.numbers)))
        for place, k in enumerate(self.columns.numbers):
            numbers[:, place] = to_numpy(table.column(str(k)))
        return ParsedRows(self._stamps(table), numbers, table.num_rows)

    def _stamps(self, table: pa.Table) -> NDArray[np.int64] | None:
        if not self.columns.time:
            return None
        columns = [table.column(str(k)) for k in self.columns.time]
        if any(column.null_count for column in columns):
            raise pa.ArrowInvalid("a row without a time")
        return timestamps.sum_parts(map(_nanoseconds, columns, self.columns.units))


class RowParser(_ColumnParser):
    """Reads rows one by one, and says which do not fit.

    Parameters
    ----------
    layout
        How the table is laid out.
    columns
        Which columns to read.
    """

    def parse(self, data: bytes, line: int) -> ParsedRows:
        """Return the rows that fit.

        Parameters
        ----------
        data
            Whole records.
        line
            Number of the first line.
        """
        stamps: list[int] = []
        numbers: list[list[float]] = []
        kept: list[int] = []
        rejected: list[tuple[int, str]] = []
        count = 0
        for place, cells in self._records(data, line):
            if self._is_no_row(cells):
                continue
            try:
                stamp, row = self._row(cells)
            except ValueError as error:
                rejected.append((place, str(error)))
            else:
                stamps.append(stamp)
                numbers.append(row)
                kept.append(count)
            count += 1
        return ParsedRows(
            np.array(stamps, np.int64) if self.columns.time else None,
            np.array(numbers, np.float64).reshape(-1, len(self.columns.numbers)),
            count,
            np.array(kept, np.int64),
            tuple(rejected),
        )

    def _records(self, data: bytes, line: int) -> list[tuple[int, list[str]]]:
        if self.layout.delimiter == " ":
            data = squeeze_blanks(data)
        text = io.StringIO(data.decode(errors="replace"), newline="")
        reader = csv.reader(text, delimiter=self.layout.delimiter)
        records = []
        while True:
            place = line + reader.line_num
            try:
                records.append((place, next(reader)))
            except csv.Error:
                records.append((place, ["?"]))
            except StopIteration:
                return records

    def _is_no_row(self, cells: list[str]) -> bool:
        """Whether it is a blank line, a comment or a repeated header."""
        shown = [cell.strip() for cell in cells]
        return (
            not any(shown)
            or shown[0].startswith(COMMENTS)
            or shown == [name.strip() for name in self.layout.names]
        )

    def _row(self, cells: list[str]) -> tuple[int, list[float]]:
        names = self.layout.names
        if len(cells) != len(names):
            raise ValueError(f"it has {len(cells)} columns instead of {len(names)}")
        row = [self._number(cells[k], names[k]) for k in self.columns.numbers]
        parts = zip(self.columns.time, self.columns.units, strict=True)
        stamp = sum(self._stamp(cells[k], unit, k) for k, unit in parts)
        if abs(stamp) > _LARGEST:
            raise ValueError(f"its time of {stamp} ns does not fit in int64 ns")
        return stamp, row

    def _number(self, cell: str, name: str) -> float:
        if cell.strip().lower() in _NOT_A_NUMBER:
            return np.nan
        try:
            return float(self._pointed(cell))
        except ValueError:
            raise ValueError(f"{quoted(cell)} in column {quoted(name)} is not a number") from None

    def _stamp(self, cell: str, unit: str, k: int) -> int:
        name = self.layout.names[k]
        date_type = self._date_type(k)
        try:
            if date_type is not None:
                return int(pa.scalar(cell.strip()).cast(date_type).value)
            return timestamps.from_text(self._pointed(cell), unit)
        except timestamps.TimestampRangeError:
            raise ValueError(
                f"{plain(cell)} {unit} in column {quoted(name)} does not fit in int64 ns"
            ) from None
        except ValueError:
            raise ValueError(f"{quoted(cell)} in column {quoted(name)} is not a time") from None

    def _pointed(self, cell: str) -> str:
        return cell.replace(",", ".") if self.layout.decimal == "," else cell


def _nanoseconds(column: pa.ChunkedArray, unit: str) -> NDArray[np.int64]:
    if pa.types.is_timestamp(column.type):
        return to_numpy(column.cast(pa.int64()))
    return timestamps.from_decimals(column, unit)


def squeeze_blanks(data: bytes | memoryview) -> bytes:
    """Return rows whose cells are separated by runs of blanks with one space for each run."""
    text = b"\n" + bytes(data).replace(b"\r", b"").replace(b"\t", b" ")
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b"\n ", b"\n").replace(b" \n", b"\n")[1:].rstrip(b" ")
