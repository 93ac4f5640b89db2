"""Times in text whose digits are no decimal number, as their order shows."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S
from quatprop.readers.tables.exact_times import from_text
from quatprop.readers.tables.time_units import (
    COUNTS,
    DAY_COUNTS,
    DAY_DIGITS,
    TIME_OF_DAY,
    TIME_OF_HOUR,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.base.arrays import Int64
    from quatprop.readers.matching import ColumnMatcher
    from quatprop.readers.tables.model import Group


_COUNT = {
    "s": re.compile(r"(?a)\d{1,10}[.,](0|[1-9]\d{0,8})"),
    TIME_OF_DAY: re.compile(r"(?a)\d{1,2}:\d{1,2}:\d{1,2}[.,](0|[1-9]\d{0,8})"),
}
_UNIT_OF_DIGITS = {3: "ms", 6: "us", 9: "ns"}
_FEWEST_BACK = 2
_RATIO = 10
"""As counts, texts step back at least so many times less often than as decimals."""

_HALF_A_DAY_NS = 43_200 * NS_PER_S

_DIGITS = re.compile(r"(?a)\d{6}(?:[.,]\d+)?")
_UNUSED_NS = 40 * 10**9
"""From 095959 to 100000, and from 095859 to 095900, numbers pass over 40 s at least."""

_MEANINGS = {
    TIME_OF_DAY: "the times in {} have no date, and count from midnight",
    TIME_OF_HOUR: "the times in {} are minutes and seconds, and count from the full hour",
    DAY_DIGITS: "the numbers in {} are hours, minutes and seconds, and count from midnight",
    **{
        text: f"the digits behind the point in {{}} count {unit}, without leading zeros"
        for unit, text in COUNTS.items()
    },
    **{
        text: f"the times in {{}} have no date, and count from midnight; the digits behind the "
        f"point count {unit}, without leading zeros"
        for unit, text in DAY_COUNTS.items()
    },
}


def remark_on_text(matcher: ColumnMatcher, time: Group, unit: str) -> None:
    """Remark on how a time that is text is read."""
    if unit in _MEANINGS:
        matcher.remark("time-of-day", _MEANINGS[unit].format(matcher.names(time)))


def shown_unit(matcher: ColumnMatcher, time: Group, unit: str) -> str:
    """Return the unit that the order of texts shows, else `unit`.

    `unit`: as stated by the header or the user; ``""``: not stated
    """
    is_of_day = unit == TIME_OF_DAY
    cells = [row[0] for row in matcher.first_rows(time)] if is_of_day or unit in {"", "s"} else []
    texts = [cell.strip() for cell in cells if isinstance(cell, str)]
    if counts := _counts(texts, TIME_OF_DAY if is_of_day else "s"):
        return counts
    if is_of_day or not _are_digits_of_day(texts):
        return unit
    if not unit:
        return DAY_DIGITS
    matcher.remark(
        "unit-overruled",
        f"the numbers in {matcher.names(time)} look like hours, minutes and seconds, and are read "
        f"in {unit}, as requested; without {Setting('time_unit')} they are read as times of day",
    )
    return unit


def _counts(texts: Sequence[str], read_as: str) -> str:
    """Return the unit of seconds with a count behind the point, as from ``%d.%d`` in C; or none.

    `read_as`: unit of the texts if there are decimals behind the point
    """
    digits = 0
    for text in texts:
        match = _COUNT[read_as].fullmatch(text)
        if match is None:
            return ""
        digits = max(digits, len(match[1]))
    units = COUNTS if read_as == "s" else DAY_COUNTS
    if (unit := units.get(_UNIT_OF_DIGITS.get(digits, ""))) is None:
        return ""
    as_decimals, as_counts = _steps_back(texts, read_as), _steps_back(texts, unit)
    is_shown = as_decimals >= _FEWEST_BACK and as_counts * _RATIO <= as_decimals
    return unit if is_shown else ""


def _are_digits_of_day(texts: Sequence[str]) -> bool:
    """Return whether numbers are ``hhmmss``: with leading zeros, or no second above 59."""
    if len(texts) <= _FEWEST_BACK or not all(map(_DIGITS.fullmatch, texts)):
        return False
    try:
        as_times = _times(texts, DAY_DIGITS)
    except ValueError:
        return False
    if any(text.startswith("0") for text in texts):
        return True
    # Where a minute ends, numbers jump and times go on as before.
    passed = np.diff(_times(texts, "s")) - np.diff(as_times)
    is_end = passed >= _UNUSED_NS
    steps = np.diff(as_times)
    return bool(is_end.any() and steps[is_end].max() <= 2 * np.quantile(steps, 0.9))


def _steps_back(texts: Sequence[str], unit: str) -> int:
    steps = np.diff(_times(texts, unit))
    is_midnight = (steps < -_HALF_A_DAY_NS) & (unit in DAY_COUNTS.values())
    return int(np.count_nonzero((steps < 0) & ~is_midnight))


def _times(texts: Sequence[str], unit: str) -> Int64:
    """Return times in ns; raise ValueError if one is none."""
    pointed = (text.replace(",", ".") for text in texts)
    return np.array([from_text(text, unit) for text in pointed], np.int64)
