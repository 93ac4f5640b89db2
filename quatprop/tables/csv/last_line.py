"""Whether the last line of a text is whole, where no line end says so.

A recorder that died leaves a line without its end, and so do people and programs that put line
ends between rows only. The cells before tell the two apart where they all have as many decimals,
or where there are many of them and all have more.
"""

from __future__ import annotations

import csv
import io
import re
from typing import TYPE_CHECKING, NamedTuple

from quatprop.tables.csv.rows import squeezed

if TYPE_CHECKING:
    from collections.abc import Collection

    from quatprop.tables.csv.headers import Layout

TAIL_BYTES = 1 << 16
"""How much of the rows before is compared."""

_FEW = 3
"""Rows that show how long cells are, where all are equally long."""
_MANY = 100
"""Rows that show how long cells are, where they differ: as many come before one that is shorter
than all of them by chance."""

_NUMBER = re.compile(r"\s*[+-]?(\d*)(?:[.,](\d*))?(?:[eE][+-]?(\d*))?\s*")


class _Digits(NamedTuple):
    """How long the parts of a number are; of anything else, how long it is."""

    whole: int
    decimals: int
    exponent: int


def is_cut(before: bytes, last: bytes, layout: Layout, wanted: Collection[int]) -> bool | None:
    """Tell whether a last line without line end has lost some of what it should have.

    Parameters
    ----------
    before
        Rows that come before it, whole lines.
    last
        The line.
    layout
        How the table is laid out.
    wanted
        Positions of the columns that are read.

    Returns
    -------
    bool or None
        None where nobody can tell. A line with too few cells is not told here, nor one whose
        last cell is not wanted.
    """
    cells = _cells(last, layout)
    column = len(layout.names) - 1
    if len(cells) != len(layout.names) or column not in wanted:
        return False
    if last.count(b'"') % 2:
        return True
    rows = (_cells(line, layout) for line in before.splitlines())
    others = [_digits(row[column]) for row in rows if len(row) == len(layout.names)]
    mine = _digits(cells[column])
    if not others:
        return None
    if not any(mine):
        return True if all(map(any, others)) else None
    return _is_shorter(mine, others)


def _is_shorter(mine: _Digits, others: list[_Digits]) -> bool | None:
    """Compare the length of a number with that of those before it."""
    exponents = [one.exponent for one in others if one.exponent]
    if mine.exponent and exponents and mine.exponent < min(exponents):
        return True
    # The digits before the point are no measure where there are others behind them.
    has_decimals = any(one.decimals for one in others)
    lengths = [one.decimals if has_decimals else one.whole for one in others]
    length = mine.decimals if has_decimals else mine.whole
    alike = len(set(lengths)) == 1 and len({one.exponent for one in others}) == 1
    if length < min(lengths) and len(others) >= (_FEW if alike else _MANY):
        return True
    if alike and len(others) >= _FEW and mine.exponent == others[0].exponent:
        return False
    return None


def _cells(line: bytes, layout: Layout) -> list[str]:
    if layout.delimiter == " ":
        line = squeezed(line)
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
