"""Rows of a text table, one by one: those that fit, and others that are no rows.

pyarrow refuses a whole block, and does not tell which rows do not fit.
"""

from __future__ import annotations

import csv
import io
import re
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa

from quatprop.base.errors import UnsupportedLogError
from quatprop.base.text import plain, quoted
from quatprop.readers.tables.csv_layout import split_line
from quatprop.readers.tables.csv_lines import (
    COMMENTS,
    NOT_A_NUMBER,
    NUMBER,
    is_other_header,
    without_trailing_cells,
)
from quatprop.readers.tables.exact_times import TimestampRangeError, from_text, likely_unit
from quatprop.readers.tables.text_rows import RowMisfitError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from quatprop.readers.tables.csv_layout import CsvLayout
    from quatprop.readers.tables.table_log import TimedColumns


_GROUPED = {
    ".": re.compile(r"\s*[+-]?[1-9]\d{0,2}(?:,\d{3})+\.\d+\s*"),
    ",": re.compile(r"\s*[+-]?[1-9]\d{0,2}(?:\.\d{3})+,\d+\s*"),
}
"""Decimal mark -> numbers whose thousands are told by another mark than their decimals."""
_LONGEST_SHOWN = 80
"""Characters of a comment between rows that are shown."""

_LARGEST = np.iinfo(np.int64).max


def date_type(layout: CsvLayout, k: int) -> pa.DataType | None:
    """Return the type of a column of dates; None for a column of numbers."""
    return pa.timestamp("ns", layout.dates[k]) if k in layout.dates else None


class Misfit(NamedTuple):
    """A line that is no row: the reason, and whether it was a sample, which took its time."""

    reason: str
    is_sample: bool = True


class Sample(NamedTuple):
    """A row that fits; `stamp`: its timestamp, ns."""

    stamp: int
    numbers: list[float]
    cells: list[str]


class Other(Enum):
    """A row that is not of the signal: of another series, or of another kind, without numbers."""

    SERIES = "series"
    KIND = "kind"


@dataclass(frozen=True, slots=True)
class RowParser:
    """Parses rows one by one, and finds those that do not fit."""

    path: Path
    layout: CsvLayout
    columns: TimedColumns

    def rows(self, data: bytes, line: int) -> Iterator[tuple[int, Sample | Misfit | Other]]:
        """Yield the line number of each row, and its timestamp and numbers or what it is instead.

        Without time columns, the timestamp is invalid.
        """
        for place, cells in self._records(data, line):
            if isinstance(cells, str):
                yield place, Misfit(cells)
            elif self._is_no_row([cell.strip() for cell in cells], place):
                continue
            elif self._is_of_another_series(cells):
                yield place, Other.SERIES
            elif self._is_of_another_kind(cells):
                yield place, Other.KIND
            else:
                try:
                    row = self._row(cells)
                except ValueError as error:
                    yield place, Misfit(str(error), is_sample=self._is_sample(cells))
                else:
                    yield place, Sample(*row, cells)

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
        data = bytes(self.layout.cleaned(data))
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
                yield line + begin, split_line(lines[begin], self.layout.delimiter)
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
        if not any(cells) or self.layout.above.is_repeated(cells):
            return True
        names = self.layout.names
        if self.layout.header and is_other_header(cells, names, self.layout.delimiter):
            raise UnsupportedLogError(
                self.path, f"another table begins at line {line}; split it there into two"
            )
        return self.layout.above.is_comment(cells, len(names))

    def _is_of_another_series(self, cells: list[str]) -> bool:
        return any(
            k < len(cells) and cells[k].strip() != label for k, label in self.columns.stamp.series
        )

    def _is_of_another_kind(self, cells: list[str]) -> bool:
        """Return whether a row has no number to read, but others: those of another topic."""
        columns = self.columns
        if len(cells) < len(self.layout.names) or not columns.numbers:
            return False
        is_blank = [cell.strip().lower() in NOT_A_NUMBER for cell in cells]
        if not all(is_blank[k] for k in columns.numbers):
            return False
        if not all(is_blank[k] for k in columns.others):
            return True
        times = columns.stamp.columns
        return bool(times) and all(is_blank[k] for k in times) and not all(is_blank)

    @staticmethod
    def _is_sample(cells: list[str]) -> bool:
        """Return whether a row that does not fit may be a sample, rather than a separator."""
        return len(cells) > 1 and any(map(NUMBER.fullmatch, cells))

    def _row(self, cells: list[str]) -> tuple[int, list[float]]:
        names = self.layout.names
        if len(cells) > len(names):
            # Trailing delimiters give empty cells.
            cells = cells[: max(len(names), len(without_trailing_cells(cells)))]
        if len(cells) != len(names):
            why = f"it has {len(cells)} columns instead of {len(names)}"
            if (text := ",".join(cells).strip()).startswith("#"):
                # What it says may be about the rows behind it.
                why += f": {quoted(text[:_LONGEST_SHOWN])}"
            raise ValueError(why)
        row = [self._number(cells[k], names[k]) for k in self.columns.numbers]
        parts = zip(self.columns.stamp.columns, self.columns.stamp.units, strict=True)
        stamp = sum(self._stamp(cells[k], unit, k) for k, unit in parts)
        if abs(stamp) > _LARGEST:
            raise ValueError(f"its time of {stamp} ns does not fit in int64 ns")
        return stamp, row

    def _number(self, cell: str, name: str) -> float:
        if cell.strip().lower() in NOT_A_NUMBER:
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
            return from_text(self._pointed(cell), unit)
        except TimestampRangeError:
            other = likely_unit(self._pointed(cell))
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
        if _GROUPED[self.layout.decimal].fullmatch(cell):
            cell = cell.replace("," if self.layout.decimal == "." else ".", "")
        # With decimal commas, a point alone may separate thousands.
        if "_" in cell or not cell.isascii() or (self.layout.decimal == "," and "." in cell):
            raise ValueError
        return cell.replace(",", ".") if self.layout.decimal == "," else cell
