"""Parse rows of damaged text one by one.

pyarrow refuses a whole block, and does not tell which rows do not fit.
"""

from __future__ import annotations

import csv
import io
import re
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from quatprop.errors import UnsupportedLogError
from quatprop.tables import timestamps
from quatprop.tables.csv.headers import COMMENTS, CsvLayout
from quatprop.tables.csv.notes import NUMBER, without_trailing_cells
from quatprop.tables.text_rows import RowMisfitError
from quatprop.text import plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from quatprop.tables.base import TimedColumns

_LARGEST = np.iinfo(np.int64).max
_NAME = re.compile(r"[\W_]*[^\W\d_]")
_NOT_A_NUMBER = {
    *("", "nan", "-nan", "+nan", "na", "n/a", "#n/a", "null", "none", "1.#qnan", "1.#ind"),
}


def date_type(layout: CsvLayout, k: int) -> pa.DataType | None:
    """Return the type of a column of dates; None for a column of numbers."""
    return pa.timestamp("ns", layout.dates[k]) if k in layout.dates else None


@dataclass(frozen=True, slots=True)
class RowParser:
    """Parses rows one by one, and finds those that do not fit."""

    path: Path
    layout: CsvLayout
    columns: TimedColumns

    def rows(
        self, data: bytes, line: int
    ) -> Iterator[tuple[int, tuple[int, list[float]] | str | None]]:
        """Yield the line number of each row, and its timestamp and numbers or why it does not fit.

        They are None for a row of another series. Without time columns, the timestamp is invalid.
        """
        for place, cells in self._records(data, line):
            if isinstance(cells, str):
                yield place, cells
            elif self._is_no_row([cell.strip() for cell in cells], place):
                continue
            elif self._is_of_another_series(cells):
                yield place, None
            else:
                try:
                    row = self._row(cells)
                except ValueError as error:
                    yield place, str(error)
                else:
                    yield place, row

    def has_line_breaks_in_cells(self, data: bytes | memoryview) -> bool:
        """Return whether any cell has a line break."""
        text = np.frombuffer(data, np.uint8)
        quotes = np.flatnonzero(text == ord('"'))
        if len(quotes) % 2:
            raise RowMisfitError
        breaks = np.flatnonzero(text == ord("\n"))
        breaks = breaks[np.searchsorted(quotes, breaks) % 2 == 1]
        content = bytes(data) if len(breaks) else b""
        for begin in breaks + 1:
            if self.is_row(content[begin : content.find(b"\n", begin)]):
                raise RowMisfitError
        return len(breaks) > 0

    def is_row(self, line: bytes) -> bool:
        """Return whether a line is a valid row by itself, ignoring quotes."""
        cells = line.split(None if self.layout.delimiter == " " else self.layout.delimiter.encode())
        if len(cells) < len(self.layout.names):
            return False
        if cells[0].count(b'"') % 2 and 0 not in (
            *self.columns.stamp.columns,
            *self.columns.numbers,
        ):
            return False  # the end of a quoted cell with a line break
        texts = [cell.strip(b' \r\n"').decode(errors="replace") for cell in cells]
        try:
            self._row(texts[: len(self.layout.names)])
        except ValueError:
            return False
        return True

    def _reader(self, lines: Iterable[str], *, strict: bool = False) -> Iterator[list[str]]:
        return csv.reader(lines, delimiter=self.layout.delimiter, strict=strict)

    def _records(self, data: bytes, line: int) -> Iterator[tuple[int, list[str] | str]]:
        """Yield the line number of each record, and its cells or what is wrong with its quotes."""
        if self.layout.delimiter == " ":
            data = squeeze_blanks(data)
        lines = io.StringIO(data.decode(errors="replace"), newline="").readlines()
        position = 0

        def following() -> Iterator[str]:
            nonlocal position
            while position < len(lines):
                position += 1
                yield lines[position - 1]

        reader = self._reader(following())
        while position < len(lines):
            begin = position
            if lines[begin].lstrip().startswith(COMMENTS):
                position += 1
                continue
            try:
                cells: list[str] | str = next(reader)
            except csv.Error:
                cells = "it cannot be split into cells"
            if b'"' in data and self._has_open_quote(lines[begin:position]):
                # The following lines are read separately.
                position, cells = begin + 1, "its quote is not closed"
                reader = self._reader(following())
            yield line + begin, cells

    def _has_open_quote(self, lines: list[str]) -> bool:
        """Return whether a record ends within quotes, or has whole rows within quotes."""
        if any(self.is_row(text.encode()) for text in lines[1:]):
            return True
        try:
            deque(self._reader(lines, strict=True), maxlen=0)
        except csv.Error as error:
            return "unexpected end of data" in str(error)
        return False

    def _is_no_row(self, cells: list[str], line: int) -> bool:
        """Return whether it is blank, a comment or a repeated header; refuse a different header."""
        if not any(cells) or cells[0].startswith(COMMENTS):
            return True
        names = self.layout.names
        if not self.layout.header or len(cells) != len(names) or not all(map(_is_name, cells)):
            return False
        if not all(cell in name for cell, name in zip(cells, names, strict=True)):
            raise UnsupportedLogError(
                self.path, f"another table begins at line {line}; split it there into two"
            )
        return True

    def _is_of_another_series(self, cells: list[str]) -> bool:
        return any(
            k < len(cells) and cells[k].strip() != label for k, label in self.columns.stamp.series
        )

    def _row(self, cells: list[str]) -> tuple[int, list[float]]:
        names = self.layout.names
        if len(cells) > len(names):
            # Trailing delimiters give empty cells.
            cells = cells[: max(len(names), len(without_trailing_cells(cells)))]
        if len(cells) != len(names):
            raise ValueError(f"it has {len(cells)} columns instead of {len(names)}")
        row = [self._number(cells[k], names[k]) for k in self.columns.numbers]
        parts = zip(self.columns.stamp.columns, self.columns.stamp.units, strict=True)
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
            raise ValueError(self._misfit(cell, name, "number")) from None

    def _stamp(self, cell: str, unit: str, k: int) -> int:
        name = self.layout.names[k]
        kind = date_type(self.layout, k)
        try:
            if kind is not None:
                return int(pa.scalar(cell.strip()).cast(kind).value)
            return timestamps.from_text(self._pointed(cell), unit)
        except timestamps.TimestampRangeError:
            other = timestamps.likely_unit(self._pointed(cell))
            hint = f", but would in {other}" if other else ""
            raise ValueError(
                f"{plain(cell)} {unit} in column {quoted(name)} does not fit in int64 ns{hint}"
            ) from None
        except ValueError:
            raise ValueError(self._misfit(cell, name, "time")) from None

    def _misfit(self, cell: str, name: str, wanted: str) -> str:
        mark = " with a decimal comma" if self.layout.decimal == "," and "." in cell else ""
        return f"{quoted(cell)} in column {quoted(name)} is not a {wanted}{mark}"

    def _pointed(self, cell: str) -> str:
        """Return a number with a decimal point; refuse 1_000 and non-ASCII digits."""
        # With decimal commas, a point may separate thousands.
        if "_" in cell or not cell.isascii() or (self.layout.decimal == "," and "." in cell):
            raise ValueError
        return cell.replace(",", ".") if self.layout.decimal == "," else cell


def _is_name(cell: str) -> bool:
    """Return whether a cell may be the name of a column, or its unit."""
    is_number = NUMBER.fullmatch(cell) or cell.lower() in _NOT_A_NUMBER
    return not is_number and _NAME.match(cell) is not None


def squeeze_blanks(data: bytes | memoryview) -> bytes:
    """Return rows with each run of blanks replaced by one space."""
    text = bytes(data).replace(b"\t", b" ")
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    text = b"\n" + text
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b"\n ", b"\n").replace(b" \n", b"\n")[1:].rstrip(b" ")
