"""Times of tables that are more than numbers in a unit: GPS weeks, ticks, sums of intervals."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Setting
from quatprop.readers.tables.table_log import (
    INTERVAL,
    MAYBE_INTERVAL,
    TIME_OF_WEEK,
    TIME_UNITS,
    WEEK_NUMBER,
    counting,
    numbers_of,
)
from quatprop.readers.tables.time_units import TICKS, TIME_OF_DAY, WEEKS, is_time_unit, ticks_since

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64
    from quatprop.readers.matching import ColumnMatcher
    from quatprop.readers.tables.model import Group, Stamp


_SECONDS_OF_A_WEEK = 604_800

_RISING = 2 / 3
"""Largest share of intervals that are longer than the one before."""


def unit_of_time(matcher: ColumnMatcher, stamp: Stamp) -> str:
    """Return the unit of a time in one column, from the user, the header or a convention."""
    time = stamp.columns
    chosen, declared = matcher.selection.time_unit, matcher.declared(time)
    is_whole = declared == TIME_OF_DAY or declared.startswith(f"{chosen} since ")
    if is_whole or (chosen is None and is_time_unit(declared) and declared not in TIME_UNITS):
        unit = declared
    else:
        unit = matcher.unit("time", time, TIME_UNITS, *stamp.units)
    if unit == TIME_OF_DAY:
        matcher.remark(
            "time-of-day",
            f"the times in {matcher.names(time)} have no date, and count from midnight",
        )
    if unit != TICKS or not len(first := _first_numbers(matcher, time[0])):
        return unit
    unit = ticks_since(float(first[0]))
    if unit != TICKS:
        matcher.remark(
            "ticks-since",
            f"the ticks in {matcher.names(time)} count from the year {int(unit.split()[2][:4])}, "
            "as their size shows, and are read as times since 1970",
        )
    return unit


def gps_time(matcher: ColumnMatcher) -> tuple[Group, tuple[str, ...]] | None:
    """Return the columns of a GPS week and the time of the week, with their units; None: none."""
    weeks, times = map(matcher.matching, (WEEK_NUMBER, TIME_OF_WEEK))
    if len(weeks) != 1 or len(times) != 1:
        return None
    unit = matcher.declared((times[0],))
    if not unit:
        found = _first_numbers(matcher, times[0])
        unit = "ms" if len(found) and found.max() > _SECONDS_OF_A_WEEK else "s"
    if not is_time_unit(unit):
        return None
    time = weeks[0], times[0]
    matcher.remark(
        "gps-time",
        f"the times in {matcher.names(time)} are read as weeks and {unit} of GPS, whose leap "
        "seconds are not taken off: it is ahead of UTC, by 18 s since 2017",
    )
    return time, (WEEKS, unit)


def intervals(matcher: ColumnMatcher, numbers: Group) -> Group:
    """Return the only column of intervals between rows; empty if there is none."""
    for name in (INTERVAL, MAYBE_INTERVAL):
        named = [k for k in matcher.matching(name) if k not in numbers]
        if found := [k for k in named if are_intervals(matcher, k)]:
            return tuple(found) if len(found) == 1 else ()
    return ()


def are_intervals(matcher: ColumnMatcher, k: int) -> bool:
    """Return whether a column has a name of intervals, and values that scatter about one."""
    key = matcher.columns[k].key
    has_unit = is_time_unit(matcher.selection.time_unit or matcher.declared((k,)))
    if not (re.fullmatch(INTERVAL, key) or (has_unit and re.fullmatch(MAYBE_INTERVAL, key))):
        return False
    found = _first_numbers(matcher, k)
    if len(found) < 2:  # noqa: PLR2004
        return True
    # Times rise, and those since a rarer event rise until the next one.
    rises = np.count_nonzero(np.diff(found) > 0)
    return bool((found >= 0).all() and rises <= _RISING * (len(found) - 1) and not _rises(found))


def may_be_time(matcher: ColumnMatcher, k: int) -> bool:
    """Return whether a column, by its name and values, may hold times instead of intervals."""
    key = matcher.columns[k].key
    if re.fullmatch(INTERVAL, key):
        return False
    return not re.fullmatch(MAYBE_INTERVAL, key) or _rises(_first_numbers(matcher, k))


def _rises(found: Float64) -> bool:
    """Return whether numbers never fall, and are more than two."""
    return bool((np.diff(found) >= 0).all() and len(np.unique(found)) > 2)  # noqa: PLR2004


def remark_on_sum(matcher: ColumnMatcher, time: Group) -> None:
    """Remark on intervals that are summed."""
    matcher.remark(
        "intervals-summed",
        f"the times are the sums of {matcher.names(time)}, each taken as the time since the row "
        f"before; to count rows at a steady rate instead, use {Setting('sample_rate')}",
    )


def counts_rows(matcher: ColumnMatcher, k: int) -> bool:
    """Return whether a column without a unit counts samples one by one."""
    found = _first_numbers(matcher, k)
    how = counting(found) if len(found) else None
    is_stated = matcher.selection.time_unit is not None or matcher.declared((k,))
    return not is_stated and how is not None and how.is_by_one


def _first_numbers(matcher: ColumnMatcher, k: int) -> Float64:
    """Return the numbers in the first rows of a column, without gaps."""
    found = numbers_of([cells[0] for cells in matcher.first_rows((k,))])
    return found[np.isfinite(found)]
