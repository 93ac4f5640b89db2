"""The layout of a text table, from its beginning: delimiter, header, units, notes, first row."""

from __future__ import annotations

import csv
import operator
import re
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from typing import TYPE_CHECKING

from quatprop.base.errors import UnknownFormatError, UnsupportedLogError
from quatprop.base.provenance import COMMENT
from quatprop.base.text import Setting, listed, quoted
from quatprop.readers.tables.csv_lines import (
    COMMENTS,
    NUMBER,
    RATES,
    LinesAbove,
    end_mark,
    is_data,
    is_name,
    lines_above,
    rows_below,
    without_trailing_cells,
)
from quatprop.readers.tables.model import TableNotes
from quatprop.readers.tables.table_log import OTHER_DATES, RATE_UNITS, TIME_UNITS, parse_name
from quatprop.readers.tables.time_units import (
    DAY_DIGITS,
    DAY_TIME,
    HOUR_TIME,
    SECONDS,
    SECONDS_TEXT,
    TIME_OF_DAY,
    TIME_OF_HOUR,
)
from quatprop.settings.quantities import SCALED_RATE_UNITS

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


# Parse the lines before the rows of a text table: names of columns, units, notes.


_SAMPLE_RATE = re.compile(
    r"(?i)(?:sample|sampling|update|data|output)[ _-]?(?:rate|frequency)\W*(\d+\.?\d*) *(k?)Hz"
)
_STATED_RATE = re.compile(
    r"(?i)\W*(?:samp(?:le|ling)?[ _-]?(?:rate|freq(?:uency)?)|fs)\s*(?:[\[(]?(k?)Hz[\])]?)?"
    r"\s*[:=,;\s]\s*\"?(\d+\.?\d*)[\s,;\"]*"
)
"""A sample rate in a sentence, with its unit; and alone in a line, in Hz by default."""
_STEP = re.compile(r"Delta_X\s+(\d+[.,]?\d*(?:[Ee][+-]?\d+)?)(?:\s+\1)*\s*")
"""The interval of all channels in a file of LabVIEW, s."""
_COLUMNS_OF_VBO = "[column names]"
_POWERS = {0: "s", -3: "ms", -6: "us", -9: "ns"}


def declared_notes(before: list[str], names: list[str], path: Path) -> TableNotes:
    """Return the facts declared by comments and ``key,value`` lines."""
    title = before[0].strip("\ufeff \r\n") if before else ""
    in_text = (rate.groups() for rate in filter(None, map(_SAMPLE_RATE.search, before)))
    alone = (rate.groups()[::-1] for rate in filter(None, map(_STATED_RATE.fullmatch, before)))
    rates = {float(rate) * (1000 if kilo else 1) for rate, kilo in (*in_text, *alone)} - {0.0}
    if title.startswith("LabVIEW"):
        steps = [
            float(step[1].replace(",", ".")) for step in filter(None, map(_STEP.fullmatch, before))
        ]
        rates |= {float(f"{1 / step:.12g}") for step in steps if step}
    # Several different rates are ambiguous.
    sample_rate = rates.pop() if len(rates) == 1 else None
    if "time" in names and any(text.strip() == _COLUMNS_OF_VBO for text in before):
        return TableNotes(units={names.index("time"): DAY_DIGITS}, title=title)
    if title.upper() != "GYROFLOW IMU LOG":
        return TableNotes(sample_rate=sample_rate, title=title)
    keys = dict(text.strip().split(",", 1) for text in before if "," in text)
    try:
        tick = Decimal(keys.get("tscale", "1").strip())
        scale = float(keys.get("gscale", "1"))
    except (InvalidOperation, ValueError) as error:
        raise UnsupportedLogError(path, "its tscale or gscale is not a number") from error
    if not (tick.is_finite() and tick > 0):
        raise UnsupportedLogError(path, f"its tscale {tick} is not a length of time above 0")
    usual = tick.adjusted() in _POWERS and tick == Decimal(1).scaleb(tick.adjusted())
    unit = _POWERS[tick.adjusted()] if usual else f"{tick:f} s"
    units = {names.index("t"): unit} if "t" in names else {}
    mount = _gcsv_mount(keys.get("orientation", "").strip())
    return TableNotes(units=units, rate_scale=scale, title=title, mount=mount)


def _gcsv_mount(letters: str) -> str:
    """Return an orientation of gcsv as signed axes: a lower-case letter is a reversed axis."""
    if letters == "XYZ" or not re.fullmatch(r"(?i)(?!.*(.).*\1)[xyz]{3}", letters):
        return ""
    return ",".join(("" if letter.isupper() else "-") + letter.lower() for letter in letters)


def header_row(before: list[list[str]], data: list[list[str]]) -> int | None:
    """Return the index of the header row before the first row of numbers, or None.

    It is the row that begins with the same kind of record as the data, else the last one that fits.
    """
    fitting = [
        k
        for k, row in enumerate(before)
        if len(row) >= RATES
        and not _is_mark(row)
        and (not any(map(NUMBER.fullmatch, row)) or (bool(data) and _has_components(row)))
        and (not data or _is_as_wide(row, data[0]))
    ]
    kind = data[0][0].strip() if data else ""
    of_kind = [k for k in fitting if kind and before[k][0].lstrip("#%/ ") == kind]
    return next(reversed(of_kind or fitting), None)


_AXES = re.compile(r"(.*?)\s*\(([xyz],[xyz],[xyz])\)\s*([\[(].*[\])])")
"""A name of a vector, its axes in the order of its columns, and its unit."""


def _has_components(row: list[str]) -> bool:
    """Return whether the only numbers in a header are those of components behind the first, 1, 2.

    As in tables of GoPro's telemetry: the first component has the name of the vector.
    """
    pairs = pairwise(["0", *map(str.strip, row)])
    numbered = [(before, cell) for before, cell in pairs if NUMBER.fullmatch(cell)]
    return len(row) - len(numbered) >= RATES and all(
        cell == "1" if is_name(before) else (before, cell) == ("1", "2")
        for before, cell in numbered
    )


def _with_axes(names: list[str]) -> list[str]:
    """Return names, with those of components whose order the name of the vector states."""
    for k, name in enumerate(names):
        vector = _AXES.fullmatch(name)
        if vector and names[k + 1 : k + 3] == ["1", "2"]:
            axes = (f"{vector[1]}.{axis} {vector[3]}" for axis in vector[2].split(","))
            return [*names[:k], *axes, *_with_axes(names[k + 3 :])]
    return names


def _is_as_wide(header: list[str], row: list[str]) -> bool:
    """Return whether names fit a row, apart from empty cells at the ends of both."""
    names, cells = map(without_trailing_cells, (header, row))
    if len(names) == len(row) + 1 and names[-1].strip() == _COMMENT_NAME:
        return True
    return len(header) == len(row) or len(cells) <= len(names) <= len(row)


def _is_mark(row: list[str]) -> bool:
    """Return whether a row only marks the end of a header, as in files of LabVIEW."""
    return bool(_END_MARK.fullmatch(row[0])) and not any(cell.strip() for cell in row[1:])


def unfit_header(before: list[list[str]], width: int) -> str:
    """Return that the row above those of numbers has as many names as they have no cells.

    It is not known which names have lost their cells, so none is used.
    """
    names = next(filter(None, map(without_trailing_cells, reversed(before))), [])
    if len(names) < RATES or not all(map(is_name, names)):
        return ""
    return f"its header has {len(names)} names and its rows have {width} cells"


def column_names(rows: list[list[str]], header: int, width: int) -> list[str]:
    """Return the names in the header, with the units or group titles in the row above."""
    names = _with_axes(_fitted(rows[header], width))
    if names[0] == _X_OF_LABVIEW:
        return _with_units_of_labview(rows[: header + 1], names)
    row = rows[header - 1] if header else []
    above = _fitted(row, width)
    is_beside = abs(len(row) - len(rows[header])) <= 1
    if not is_beside or not any(above) or any(map(NUMBER.fullmatch, above)):
        return names
    if not any(names[1:]):
        # pandas writes the name of the index below those of columns.
        return [names[0], *column_names(rows, header - 1, width)[1:]]
    # Repeated cells below unique names are units, even if unknown.
    if _are_units(names) or len({*names}) < len({*above}) == width:
        return _with_units(above, names)
    if _are_units(above):
        return _with_units(names, above)
    repeat = len({*names}) < width or len({*above}) < width
    grouped = repeat or "" in names[:-1]
    return _told_apart(rows[: header - 1], _grouped(above, names)) if grouped else names


def _with_units_of_labview(rows: list[list[str]], names: list[str]) -> list[str]:
    """Return names with the units in a header of LabVIEW, of a table with one column of X.

    `rows`: the header, up to the row of the names
    """
    facts = {row[0].strip(): row[1:] for row in rows if row}
    if _X_OF_LABVIEW in names[1:]:
        return names
    # Without a header above the names, the last of them tells the program.
    usual = ["Time"] if rows[-1][-1].strip() == _COMMENT_NAME else []
    kinds = {cell.strip() for cell in facts.get("X_Dimension", usual)} - {""}
    has_x = facts.get("X_Columns", [""])[0].strip() != "No"
    unit = "s" if kinds == {"Time"} and has_x else ""
    return _with_units(names, [unit, *_fitted(facts.get("Y_Unit_Label", []), len(names) - 1)])


def _told_apart(above: list[list[str]], names: list[str]) -> list[str]:
    """Return names in which those that repeat have a title from a row further above."""
    for row in reversed(above):
        if len(row) != len(names) or len({*names}) == len(names):
            break
        if not any(map(NUMBER.fullmatch, row)):
            titled = _grouped([cell.strip() for cell in row], names)
            names = [
                title if names.count(name) > 1 else name
                for title, name in zip(titled, names, strict=True)
            ]
    return names


def _are_units(cells: list[str]) -> bool:
    """Return whether cells are units; some, of other sensors, may be unknown."""
    known = [parse_name(f"({_bare(cell)})").unit in _UNITS for cell in cells]
    return sum(known) >= RATES or all(map(operator.or_, known, map(operator.not_, cells)))


def _with_units(names: list[str], units: list[str]) -> list[str]:
    pairs = zip(names, map(_bare, units), strict=True)
    return [f"{name} ({unit})" if unit else name for name, unit in pairs]


def _bare(unit: str) -> str:
    return unit[1:-1] if unit.startswith(("[", "(")) else unit


_X_OF_LABVIEW, _COMMENT_NAME = "X_Value", "Comment"
_END_MARK = re.compile(r"\*{3}\w+\*{3}")
"""The names of the first and of the last column, whose cells are omitted, and the end of headers
in files of LabVIEW."""

_UNITS = {*RATE_UNITS, *SCALED_RATE_UNITS, *TIME_UNITS}


def _fitted(row: list[str], width: int) -> list[str]:
    return [cell.strip() for cell in row[:width]] + [""] * (width - len(row))


def _grouped(groups: list[str], names: list[str]) -> list[str]:
    """Return names with the group titles, each of which is above its first column."""
    full, group = [], ""
    for title, name in zip(groups, names, strict=True):
        group = title or group
        full.append(f"{group}.{name}" if group and name else name or title)
    return full


# Detect the layout of a text table from its beginning: delimiter, header, units, first row.


HEAD_BYTES = 1 << 18
"""Bytes of a table that are examined for its layout."""

MINUS = "\u2212".encode()
"""The sign that typesetters and some loggers write for a hyphen."""

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
    r"\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:[.,]\d+)?(?P<zone>Z|[+-]\d\d(?::?\d\d)?)?\s*"
)
_COMMA_DATE = rb"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d),(?=\d)"
_WHOLE, _DECIMALS = re.compile(r"(?a)[+-]?\d+"), re.compile(r"(?a)\d+")
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
    `above`: the lines above the first row
    `end`: the mark at the end of each row, which is no delimiter; ``""``: none
    `has_comma_dates`: whether its dates have decimal commas
    """

    names: list[str]
    delimiter: str
    decimal: str
    body: int
    line: int
    notes: TableNotes
    header: bytes = b""
    dates: Mapping[int, str | None] = field(default_factory=dict)
    above: LinesAbove = field(default_factory=LinesAbove)
    end: str = ""
    has_comma_dates: bool = False

    def cleaned(self, data: bytes | memoryview) -> bytes | memoryview:
        """Return rows without their end marks, and with runs of blanks as one space."""
        if self.end:
            data = re.sub(rb"(?m)[%b \t]+(?=\r?$)" % re.escape(self.end.encode()), b"", data)
        data = self.with_points(data)
        return squeeze_blanks(data) if self.delimiter == " " else data

    def with_points(self, data: bytes | memoryview) -> bytes | memoryview:
        """Return rows with decimal points in dates that have commas, which pyarrow reads."""
        return re.sub(_COMMA_DATE, rb"\1.", bytes(data)) if self.has_comma_dates else data

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
    if end := end_mark(texts):
        texts = [text.rstrip().rstrip(end) for text in texts]
    # The provenance in quatprop's files is a JSON comment with many numbers and commas.
    delimiter, rows, places = _delimiter(["" if text.startswith(_OURS) else text for text in texts])
    places = rows_below(rows, places)
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
    _refuse_halves(rows[:first], data, path)
    _refuse_mixture(data[:-1] or data, rows[header][0] if header is not None else "", width, path)
    names = [str(k) for k in range(width)] if header is None else column_names(rows, header, width)
    body = first if header is None else header + 1
    first_cells = data[0] if data else []
    dates = _dates(first_cells)
    notes = declared_notes(texts[: first if header is None else header], names, path)
    units = {**notes.units, **_other_dates(first_cells), **dict.fromkeys(dates, "ns")}
    return CsvLayout(
        names=names,
        delimiter=delimiter,
        decimal=_decimal(data, delimiter),
        body=sum(map(len, raw[:body])),
        line=b"".join(raw[:body]).count(b"\n") + 1,
        header=b"" if header is None else raw[header].removeprefix(_MARK).rstrip(b"\r\n"),
        notes=notes._replace(
            units=units,
            dates={k: zone is not None for k, zone in dates.items()},
            unfit=unfit_header(rows[:first], width) if data and header is None else "",
        ),
        dates=dates,
        above=lines_above(rows[:first], texts[:first]),
        end=end,
        has_comma_dates=any(re.search(_COMMA_DATE, cell.encode()) for cell in first_cells),
    )


def _records(lines: list[bytes]) -> list[bytes]:
    """Return records: lines, joined if a quote is open at the end and closed soon."""
    records: list[bytes] = []
    if not any(b'"' in line for line in lines):
        return lines
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
    return split_line(text, delimiter)


def split_rows(lines: list[str], delimiter: str) -> list[list[str]]:
    """Return the cells of lines, each a row of its own."""
    # One reader of all is several times as fast; quotes may contain the end of a line.
    if delimiter != " " and not any('"' in line for line in lines):
        texts = [line.strip("\ufeff\r\n") for line in lines]
        with suppress(csv.Error):
            return list(csv.reader(texts, delimiter=delimiter, skipinitialspace=True))
    return [split_cells(line, delimiter) for line in lines]


def split_line(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line without line breaks in cells."""
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return []


def _text(line: bytes) -> str:
    try:
        return line.decode().replace(MINUS.decode(), "-")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def _delimiter(texts: list[str]) -> tuple[str, list[list[str]], list[int]]:
    """Return the delimiter with the most rows of numbers, all cells, and indices of these rows."""

    def fit(split: tuple[str, list[list[str]], list[int]]) -> tuple[int, bool, bool]:
        _, rows, places = split
        widths = set(map(len, rows))
        # The last criterion is for narrow tables, so that an error lists the right columns.
        return len(places), max(widths) >= RATES, len(widths) == 1 < min(widths)

    def split(mark: str) -> tuple[str, list[list[str]], list[int]]:
        rows = split_rows(texts, mark)
        return mark, rows, [k for k, row in enumerate(rows) if is_data(row)]

    text = "".join(texts)
    # Blanks include tabs.
    marks = [mark for mark in _DELIMITERS if mark in text or (mark == " " and "\t" in text)]
    likely = max(marks or _DELIMITERS, key=text.count)
    splits = {likely: split(likely)}
    places = splits[likely][2]
    # No others can have as many rows if more lines are none with them than with the likely one.
    begin = next(iter(places), 0)
    few = texts[begin : begin + len(texts) - len(places) + 1]
    for mark in marks or _DELIMITERS:
        if mark != likely and (
            len(few) <= len(texts) - len(places) or any(map(is_data, split_rows(few, mark)))
        ):
            splits[mark] = split(mark)
    return max((splits[mark] for mark in _DELIMITERS if mark in splits), key=fit)


def _decimal(data: list[list[str]], delimiter: str) -> str:
    """Return the decimal mark; in quoted cells, a comma may separate thousands instead."""
    cells = [cell for row in data for cell in row]
    with_comma = [cell for cell in cells if "," in cell and _COMMA_NUMBER.fullmatch(cell)]
    if not with_comma:
        return "."
    is_point = delimiter == "," and (
        any(map(_POINT_NUMBER.fullmatch, cells)) or all(map(_THOUSANDS.fullmatch, with_comma))
    )
    return "." if is_point else ","


def _dates(row: list[str]) -> dict[int, str | None]:
    matches = ((k, _DATE.fullmatch(cell)) for k, cell in enumerate(row))
    return {k: "UTC" if match["zone"] else None for k, match in matches if match}


def _other_dates(row: list[str]) -> dict[int, str]:
    """Return the units of times that are other text, and of dates in other formats."""
    units = {}
    for k, cell in enumerate(row):
        if _OTHER_DATE.fullmatch(cell):
            units[k] = TIME_OF_DAY if re.fullmatch(DAY_TIME, cell, re.ASCII) else OTHER_DATES
        elif re.fullmatch(HOUR_TIME, cell, re.ASCII):
            units[k] = TIME_OF_HOUR
        elif re.fullmatch(SECONDS_TEXT, cell, re.ASCII):
            units[k] = SECONDS
    return units


def _refuse_opensim(texts: list[str], path: Path) -> None:
    """Refuse OpenSim tables, which have a whole quaternion w,x,y,z in one cell."""
    if "DataType=Quaternion" in map(str.strip, texts):
        columns = f"{Setting('quat_cols', '1,2,3,4')} {Setting('from_layout', 'wxyz')}"
        time = f"{Setting('time_col', '0')} {Setting('time_unit', 's')}"
        remedy = (
            f"sed '1,/^time/d' FILE | tr , '\\t', and read the first sensor with {columns} {time}"
        )
        reason = "it is an OpenSim table, with a quaternion in a cell; write one number a cell with"
        raise UnsupportedLogError(path, f"{reason} {remedy}")


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


def _refuse_halves(before: list[list[str]], data: list[list[str]], path: Path) -> None:
    """Refuse rows of numbers with decimal commas, which also separate them."""
    names = next(filter(None, map(without_trailing_cells, reversed(before))), [])
    if not names or any(len(row) != 2 * len(names) for row in data):
        return
    whole, decimals = ([cell.strip() for row in data for cell in row[k::2]] for k in (0, 1))
    are_halves = all(map(_WHOLE.fullmatch, whole)) and all(map(_DECIMALS.fullmatch, decimals))
    # No number begins with zeros, but decimals do.
    if are_halves and any(len(cell) > 1 and cell[0] == "0" for cell in decimals):
        raise UnsupportedLogError(
            path,
            f"its header has {len(names)} names and its rows have {len(data[0])} cells, each "
            f"second of them the decimals of the one before, as in {','.join(data[0][:2])}: commas "
            "separate the numbers, too; export it with another separator, or decimal points",
        )


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


def squeeze_blanks(data: bytes | memoryview) -> bytes:
    """Return rows with each run of blanks replaced by one space."""
    text = bytes(data).replace(b"\t", b" ")
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    text = b"\n" + text
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b"\n ", b"\n").replace(b" \n", b"\n")[1:].rstrip(b" ")
