"""Lines of a text table that are no rows: headers, comments, separators, what ends a row."""

from __future__ import annotations

import re
from collections import Counter
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

from quatprop.readers.tables.table_log import parse_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

NUMBER = re.compile(
    r"\s*[+-]?(?:(?:\d+(?:\.\d*|,\d+)?|[.,]\d+)(?:e[+-]?\d+)?|nan|inf(?:inity)?)\s*", re.IGNORECASE
)
"""A number in a cell, with either decimal mark."""

NOT_A_NUMBER = {
    *("", "nan", "-nan", "+nan", "na", "n/a", "#n/a", "null", "none", "1.#qnan", "1.#ind"),
}
"""Cells of a number that is not known, in lower case."""

RATES = 3
"""Minimum number of numbers in a row of rates."""

COMMENTS = ("#", "%", "//")
"""Comment marks, which a header may also have."""

_STATED = 12
"""Maximum number of rows of numbers that a program states above a header."""

_NAME = re.compile(r"[\W_]*[^\W\d_]")
# Excel's errors in any language, such as #N/A, #VALUE!, #WERT!; #### is a cell that is too narrow.
_EXCEL_ERROR = re.compile(r"##+|#[^\W\d_][\w/]*[!?]?")


def is_data(row: Iterable[str]) -> bool:
    """Return whether a row has enough numbers for rates."""
    return len([*islice(filter(NUMBER.fullmatch, row), RATES)]) == RATES


def is_name(cell: str) -> bool:
    """Return whether a cell may be the name of a column, or its unit."""
    is_number = NUMBER.fullmatch(cell) or cell.lower() in NOT_A_NUMBER
    return not is_number and _NAME.match(cell) is not None


def without_trailing_cells(row: list[str]) -> list[str]:
    """Return cells without the empty ones of trailing delimiters."""
    count = len(row)
    while count and not row[count - 1].strip():
        count -= 1
    return row[:count]


def _texts(row: Iterable[str]) -> list[str]:
    """Return cells without blanks, a comment mark, and the empty ones of trailing delimiters."""
    cells = without_trailing_cells([cell.strip("\ufeff \t\r\n") for cell in row])
    if cells and cells[0].startswith(COMMENTS):
        cells[0] = cells[0].lstrip("".join(COMMENTS)).lstrip()
        del cells[: not cells[0]]
    return cells


class LinesAbove(NamedTuple):
    """The lines above the first row, to tell a line between rows from a row.

    `lines`: their cells, of all that are not only numbers
    `marks`: the comment marks with which some of them begin
    """

    lines: frozenset[tuple[str, ...]] = frozenset()
    marks: tuple[str, ...] = ()

    def is_repeated(self, cells: list[str]) -> bool:
        """Return whether a line between rows is one of them, as in joined files."""
        return tuple(_texts(cells)) in self.lines

    def is_comment(self, cells: list[str], width: int) -> bool:
        """Return whether a line between rows has their comment mark, unless it is Excel's."""
        if not cells[0].startswith(self.marks):
            return False
        is_error = _EXCEL_ERROR.fullmatch(cells[0]) and cells[0] == cells[0].upper()
        return not (is_error and len(cells) == width)


def lines_above(rows: Sequence[list[str]], texts: Sequence[str]) -> LinesAbove:
    """Return what is known of the lines above the first row.

    `rows`: their cells
    `texts`: their text
    """
    begins = [text.lstrip("\ufeff \t") for text in texts]
    return LinesAbove(
        frozenset(tuple(_texts(row)) for row in rows if not all(map(NUMBER.fullmatch, row))),
        tuple(mark for mark in COMMENTS if any(begin.startswith(mark) for begin in begins)),
    )


def is_other_header(cells: list[str], names: Sequence[str], delimiter: str) -> bool:
    """Return whether a line between rows is a header of other columns.

    It has as many names as there are columns, or some of the names; so have comments, in which a
    sentence may have as many words.

    `names`: the columns of the table
    """
    texts = _texts(cells)
    if len(texts) < RATES or not all(map(is_name, texts)):
        return False
    is_sentence = delimiter == " " and cells[0].startswith(COMMENTS)
    if len(texts) == len(without_trailing_cells([*names])) and not is_sentence:
        return True
    known, found = ({parse_name(name).key for name in each} for each in (names, texts))
    return bool(known & found)


def rows_below(rows: list[list[str]], places: list[int]) -> list[int]:
    """Return the rows of numbers without those above the header, which a program states there.

    They are of another kind than the rows below: of another width, or with text for numbers.

    `places`: indices of all rows of numbers
    """
    if not places or len(places) == len(rows) - places[0]:
        return places  # no other lines between them
    kinds = {k: _kind(rows[k]) for k in places}
    usual, _ = Counter(kinds.values()).most_common(1)[0]
    first = next(k for k in places if kinds[k] == usual)
    stated = [k for k in places if k < first]
    below = rows[stated[-1] + 1 : first] if stated else []
    if len(stated) <= _STATED and any(_is_header_of(row, usual) for row in below):
        return [k for k in places if k >= first]
    return places


def _kind(row: list[str]) -> tuple[bool, ...]:
    """Return which cells hold text, without those of trailing delimiters."""
    cells = without_trailing_cells(row)
    return tuple(bool(cell.strip()) and NUMBER.fullmatch(cell) is None for cell in cells)


def _is_header_of(row: list[str], kind: tuple[bool, ...]) -> bool:
    texts = without_trailing_cells(row)
    return len(texts) >= max(RATES, len(kind) - 1) and not any(map(NUMBER.fullmatch, texts))


_ENDS = ";|,"


def end_mark(texts: Sequence[str]) -> str:
    """Return the mark that ends most lines and is nowhere else, so no delimiter; ``""``: none."""
    lines = [line for text in texts if (line := text.rstrip())]
    last = {line[-1] for line in lines[-3:]}  # of healthy rows, a digit
    for mark in filter(last.__contains__, _ENDS):
        ended = sum(line.endswith(mark) for line in lines)
        if 2 * ended > len(lines) and sum(line.count(mark) for line in lines) == ended:
            return mark
    return ""
