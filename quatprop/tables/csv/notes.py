"""Parse the lines before the rows of a text table: names of columns, units, notes."""

from __future__ import annotations

import operator
import re
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING

from quatprop.errors import UnsupportedLogError
from quatprop.settings.quantities import SCALED_RATE_UNITS
from quatprop.tables.column_names import RATE_UNITS, TIME_UNITS, parse_name
from quatprop.tables.model import TableNotes

if TYPE_CHECKING:
    from pathlib import Path

NUMBER = re.compile(
    r"\s*[+-]?(?:(?:\d+(?:\.\d*|,\d+)?|[.,]\d+)(?:e[+-]?\d+)?|nan|inf(?:inity)?)\s*", re.IGNORECASE
)
"""A number in a cell, with either decimal mark."""

RATES = 3
"""Minimum number of numbers in a row of rates."""

_SAMPLE_RATE = re.compile(
    r"(?i)(?:sample|sampling|update|data|output)[ _-]?(?:rate|frequency)\W*([\d.]+) *(k?)Hz"
)
_POWERS = {0: "s", -3: "ms", -6: "us", -9: "ns"}


def declared_notes(before: list[str], names: list[str], path: Path) -> TableNotes:
    """Return the facts declared by comments and ``key,value`` lines."""
    title = before[0].strip("\ufeff \r\n") if before else ""
    rates = {
        float(rate[1]) * (1000 if rate[2] else 1)
        for rate in filter(None, map(_SAMPLE_RATE.search, before))
    }
    # Several different rates are ambiguous.
    sample_rate = rates.pop() if len(rates) == 1 else None
    if title.upper() != "GYROFLOW IMU LOG":
        return TableNotes(sample_rate=sample_rate, title=title)
    keys = dict(text.strip().split(",", 1) for text in before if "," in text)
    try:
        tick = Decimal(keys.get("tscale", "1").strip())
        scale = float(keys.get("gscale", "1"))
    except (InvalidOperation, ValueError) as error:
        raise UnsupportedLogError(path, "its tscale or gscale is not a number") from error
    if tick.adjusted() not in _POWERS or tick != Decimal(1).scaleb(tick.adjusted()):
        raise UnsupportedLogError(
            path, f"its tscale {tick} is not 1, 0.001, 0.000001 or 0.000000001 s; convert its times"
        )
    units = {names.index("t"): _POWERS[tick.adjusted()]} if "t" in names else {}
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
        and not any(map(NUMBER.fullmatch, row))
        and (not data or _is_as_wide(row, data[0]))
    ]
    kind = data[0][0].strip() if data else ""
    of_kind = [k for k in fitting if kind and before[k][0].lstrip("#%/ ") == kind]
    return next(reversed(of_kind or fitting), None)


def _is_as_wide(header: list[str], row: list[str]) -> bool:
    """Return whether names fit a row, apart from empty cells at the ends of both."""
    names, cells = map(without_trailing_cells, (header, row))
    return len(header) == len(row) or len(cells) <= len(names) <= len(row)


def without_trailing_cells(row: list[str]) -> list[str]:
    """Return cells without the empty ones of trailing delimiters."""
    count = len(row)
    while count and not row[count - 1].strip():
        count -= 1
    return row[:count]


def column_names(rows: list[list[str]], header: int, width: int) -> list[str]:
    """Return the names in the header, with the units or group titles in the row above."""
    names = _fitted(rows[header], width)
    above = rows[header - 1] if header else []
    if abs(len(above) - len(rows[header])) > 1:
        return names
    above = _fitted(above, width)
    if not any(above) or any(map(NUMBER.fullmatch, above)):
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
    return _grouped(above, names) if repeat or "" in names[:-1] else names


def _are_units(cells: list[str]) -> bool:
    """Return whether cells are units; some, of other sensors, may be unknown."""
    known = [parse_name(f"({_bare(cell)})").unit in _UNITS for cell in cells]
    return sum(known) >= RATES or all(map(operator.or_, known, map(operator.not_, cells)))


def _with_units(names: list[str], units: list[str]) -> list[str]:
    pairs = zip(names, map(_bare, units), strict=True)
    return [f"{name} ({unit})" if unit else name for name, unit in pairs]


def _bare(unit: str) -> str:
    return unit[1:-1] if unit.startswith(("[", "(")) else unit


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
