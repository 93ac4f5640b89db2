"""Detect the layout of a text table from its beginning: delimiter, header, units, first row."""

from __future__ import annotations

import csv
import re
from collections import Counter
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING

from quatprop.errors import UnknownFormatError, UnsupportedLogError
from quatprop.provenance import COMMENT
from quatprop.tables.base import OTHER_DATES
from quatprop.tables.csv.notes import NUMBER, RATES, column_names, declared_notes, header_row
from quatprop.text import Setting, listed, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from quatprop.tables.model import TableNotes


HEAD_BYTES = 1 << 18
"""Bytes of a table that are examined for its layout."""

COMMENTS = ("#", "%", "//")
"""Comment marks, which a header may also have."""

_OURS = COMMENT.decode()
_LINES = 200
_LINES_A_CELL = 10
_HEADER_ROWS = 3
_MARKS = tuple(mark.encode() for mark in COMMENTS)
_MARK = b"\xef\xbb\xbf"
_DELIMITERS = ("\t", ";", ",", "|", " ")
_COMMA_NUMBER = re.compile(r"\s*[+-]?\d*,\d+(?:[eE][+-]?\d+)?\s*")
_POINT_NUMBER = re.compile(r"\s*[+-]?\d*\.\d+(?:[eE][+-]?\d+)?\s*")
_THOUSANDS = re.compile(r"\s*[+-]?[1-9]\d{0,2},\d{3}\s*")
_DATE = re.compile(
    r"\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:\.\d+)?(?P<zone>Z|[+-]\d\d(?::?\d\d)?)?\s*"
)
_CHECKSUM = re.compile(rf"{NUMBER.pattern}\*[0-9A-Fa-f]{{2}}", re.IGNORECASE)
_OTHER_DATE = re.compile(r"\s*\d+([/.:-])\d+\1\d+(?:\D.*)?")


@dataclass(frozen=True, slots=True)
class CsvLayout:
    """The layout of a text table.

    `names`: column names in the header; ``"0"``, ``"1"``... without one
    `delimiter`: ``","``, ``";"``, ``"|"``, a tab, or a space for any run of blanks
    `decimal`: ``"."`` or ``","``
    `body`: bytes before the first row
    `line`: line number of the first row, from 1
    `notes`: facts declared before the header
    `header`: the header line without its end; empty without one
    `dates`: column of dates -> ``"UTC"`` if they have a time zone, else None
    """

    names: list[str]
    delimiter: str
    decimal: str
    body: int
    line: int
    notes: TableNotes
    header: bytes = b""
    dates: Mapping[int, str | None] = field(default_factory=dict)

    def without_headers(self, data: bytes) -> bytes:
        """Return rows with repeated headers, as in joined files, replaced by blank lines."""
        if not self.header or self.header not in data:
            return data
        return re.sub(rb"(?m)^%b(?=\r?$)" % re.escape(self.header), b"", data)


def detect_layout(head: bytes, path: Path) -> CsvLayout:
    """Return the layout of the table that begins with `head`."""
    is_utf16 = head.startswith((b"\xff\xfe", b"\xfe\xff"))
    head = head.rstrip(b"\0")
    if not head or is_utf16 or b"\0" in head.partition(b"\n")[0]:
        what = "it is UTF-16 text" if is_utf16 else "it holds NUL bytes, as no text does"
        raise UnsupportedLogError(
            path, f"{what}; if it is a table, save it again as a CSV in UTF-8"
        )
    raw = _records(head.splitlines(keepends=True)[:_LINES])
    texts = [_text(line) for line in raw]
    _refuse_opensim(texts, path)
    # The provenance in quatprop's files is a JSON comment with many numbers and commas.
    delimiter, rows, places = _delimiter(["" if text.startswith(_OURS) else text for text in texts])
    first = next(iter(places), len(rows))
    data = [rows[k] for k in places]
    width = len(data[0]) if data else max(map(len, rows), default=0)
    header = header_row(rows[:first], data)
    if not data and len(rows) > _HEADER_ROWS and not _is_table(rows, header):
        raise UnknownFormatError(
            path,
            f"none of its first {len(rows)} lines is a row of {RATES} numbers or more; is it a "
            "table with one row per sample?",
        )
    _refuse_turns(rows, places, path)
    _refuse_checksums(data, path)
    _refuse_mixture(data[:-1] or data, rows[header][0] if header is not None else "", width, path)
    names = [str(k) for k in range(width)] if header is None else column_names(rows, header, width)
    body = first if header is None else header + 1
    dates = _dates(data[0]) if data else {}
    others = [k for k, cell in enumerate(data[0] if data else ()) if _OTHER_DATE.fullmatch(cell)]
    notes = declared_notes(texts[: first if header is None else header], names, path)
    units = {**notes.units, **dict.fromkeys(others, OTHER_DATES), **dict.fromkeys(dates, "ns")}
    return CsvLayout(
        names=names,
        delimiter=delimiter,
        decimal=_decimal(data, delimiter),
        body=sum(map(len, raw[:body])),
        line=b"".join(raw[:body]).count(b"\n") + 1,
        header=b"" if header is None else raw[header].removeprefix(_MARK).rstrip(b"\r\n"),
        notes=notes._replace(units=units, dates={k: zone is not None for k, zone in dates.items()}),
        dates=dates,
    )


def _records(lines: list[bytes]) -> list[bytes]:
    """Return records: lines, joined if a quote is open at the end and closed soon."""
    records: list[bytes] = []
    while lines:
        count = 1
        if lines[0].count(b'"') % 2 and not lines[0].lstrip().startswith(_MARKS):
            count += next((k for k, line in enumerate(lines[1:_LINES_A_CELL], 1)
                           if line.count(b'"') % 2), 0)  # fmt: skip
        records.append(b"".join(lines[:count]))
        lines = lines[count:]
    return records


def split_cells(text: str, delimiter: str) -> list[str]:
    """Return the cells of one line."""
    text = text.strip("\ufeff\r\n")
    if delimiter == " ":
        # A space may follow a comment mark: "# timestamp tx ty tz".
        for mark in COMMENTS:
            text = text.removeprefix(mark)
        cells = text.split()
        if '"' not in text:
            return cells
        text = " ".join(cells)
    try:
        return next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return []


def _text(line: bytes) -> str:
    try:
        return line.decode()
    except UnicodeDecodeError:
        return line.decode("latin-1")


def is_data(row: list[str]) -> bool:
    """Return whether a row has enough numbers for rates."""
    return len([*islice(filter(NUMBER.fullmatch, row), RATES)]) == RATES


def _delimiter(texts: list[str]) -> tuple[str, list[list[str]], list[int]]:
    """Return the delimiter with the most rows of numbers, all cells, and indices of these rows."""

    def fit(split: tuple[str, list[list[str]], list[int]]) -> tuple[int, bool, bool]:
        _, rows, places = split
        widths = set(map(len, rows))
        # The last criterion is for narrow tables, so that an error lists the right columns.
        return len(places), max(widths) >= RATES, len(widths) == 1 < min(widths)

    text = "".join(texts)
    # Blanks include tabs.
    marks = [mark for mark in _DELIMITERS if mark in text or (mark == " " and "\t" in text)]
    splits = ((mark, [split_cells(line, mark) for line in texts]) for mark in marks or _DELIMITERS)
    return max(
        ((mark, rows, [k for k, row in enumerate(rows) if is_data(row)]) for mark, rows in splits),
        key=fit,
    )


def _decimal(data: list[list[str]], delimiter: str) -> str:
    """Return the decimal mark; in quoted cells, a comma may separate thousands instead."""
    cells = [cell for row in data for cell in row]
    with_comma = [cell for cell in cells if _COMMA_NUMBER.fullmatch(cell)]
    if delimiter == "," and (
        any(map(_POINT_NUMBER.fullmatch, cells)) or all(map(_THOUSANDS.fullmatch, with_comma))
    ):
        return "."
    return "," if with_comma else "."


def _dates(row: list[str]) -> dict[int, str | None]:
    matches = ((k, _DATE.fullmatch(cell)) for k, cell in enumerate(row))
    return {k: "UTC" if match["zone"] else None for k, match in matches if match}


def _refuse_opensim(texts: list[str], path: Path) -> None:
    """Refuse OpenSim tables, which have a whole quaternion w,x,y,z in one cell."""
    if "DataType=Quaternion" in map(str.strip, texts):
        columns = f"{Setting('quat_cols', '1,2,3,4')} {Setting('from_layout', 'wxyz')}"
        time = f"{Setting('time_col', '0')} {Setting('time_unit', 's')}"
        way_out = (
            f"sed '1,/^time/d' FILE | tr , '\\t', and read the first sensor with {columns} {time}"
        )
        reason = "it is an OpenSim table, with a quaternion in a cell; write one number a cell with"
        raise UnsupportedLogError(path, f"{reason} {way_out}")


def _refuse_turns(rows: list[list[str]], data: list[int], path: Path) -> None:
    """Refuse times on separate lines, each of which would count as a lost row.

    `data`: indices of the rows of numbers
    """
    if len(data) <= 2 or len(rows) - data[0] < 2 * len(data) - 1:  # noqa: PLR2004
        return
    between = [row for k, row in enumerate(rows) if k > data[0] and k not in {*data}]
    others = [row for row in between if any(map(str.strip, row))]
    if len(others) >= len(data) - 1 and all(map(_is_time, others)):
        in_pairs = data[0] == 1 and _is_time(rows[0])
        how = ", such as with paste -d, - -" if in_pairs else ""
        reason = f"times such as {quoted(' '.join(others[0]))} are on lines of their own between"
        raise UnsupportedLogError(
            path, f"{reason} its rows; write each on the line of its row{how}"
        )


def _is_time(row: list[str]) -> bool:
    text = " ".join(row)
    return any(pattern.fullmatch(text) for pattern in (_DATE, _OTHER_DATE, NUMBER))


def _refuse_checksums(data: list[list[str]], path: Path) -> None:
    """Refuse rows with an NMEA 0183 checksum after the last number."""
    last = [row[-1].strip() for row in data]
    if last and all(_CHECKSUM.fullmatch(cell) for cell in last):
        raise UnsupportedLogError(
            path,
            f"its rows end in NMEA checksums, such as {quoted(last[0][-3:])}; remove them, for "
            "example with sed -E 's/\\*[0-9A-Fa-f]{2}//'",
        )


def _refuse_mixture(data: list[list[str]], title: str, width: int, path: Path) -> None:
    """Refuse rows of several kinds: most differ in width from the first, or they begin with a kind.

    `title`: name of the first column; ``""`` without a header
    """
    widths = Counter(map(len, data))
    kinds = sorted({row[0].strip() for row in data})
    have_kinds = len(kinds) > 1 and all(map(str.isidentifier, kinds))
    if have_kinds and (len(widths) > 1 or title.startswith(COMMENTS) or title in kinds):
        reason = f"its rows begin with {listed(kinds)}"
    elif data and widths[width] * 2 < len(data):
        reason = f"its rows have {', '.join(map(str, sorted(widths)))} columns"
    else:
        return
    raise UnsupportedLogError(
        path,
        f"{reason}, so it holds several kinds of records; write each kind to its own file",
    )


def _is_table(rows: list[list[str]], header: int | None) -> bool:
    """Return whether rows without numbers may be a table: a narrow one, or one with a header."""
    if header is None:
        return {len(row) for row in rows if row} == {2}
    return any(len(row) == len(rows[header]) for row in rows[header + 1 :])
