"""Detect whether a last line without a line end was cut off.

A recorder that crashed leaves such a line, but some programs also write line ends only between
rows. The cells above distinguish the two if all have the same number of decimals, or if there are
many and all have more than the last one.
"""

from __future__ import annotations

import csv
import io
import re
from typing import TYPE_CHECKING, NamedTuple

from quatprop.tables.csv.row_parser import squeeze_blanks

if TYPE_CHECKING:
    from collections.abc import Collection

    from quatprop.tables.csv.headers import CsvLayout

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
    if layout.delimiter == " ":
        line = squeeze_blanks(line)
    text = io.StringIO(line.decode(errors="replace"), newline="")
    try:
        return next(csv.reader(text, delimiter=layout.delimiter), [])
    except csv.Error:
        return []


def _digits(cell: str) -> _Digits:
    number = _NUMBER.fullmatch(cell)
    if number is None:
        return _Digits(len(cell.strip()), 0, 0)
    return _Digits(*(len(part or "") for part in number.groups()))
