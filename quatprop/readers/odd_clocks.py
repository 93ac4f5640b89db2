"""Times of tables that are more than numbers in a unit: GPS weeks, ticks, sums of intervals."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import UnsupportedLogError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S, NS_PER_UNIT, duration_text
from quatprop.readers.clocks import named_clock, original
from quatprop.readers.tables.model import Stamp
from quatprop.readers.tables.table_log import (
    INTERVAL,
    MAYBE_INTERVAL,
    TIME_OF_WEEK,
    TIME_UNITS,
    WEEK_NUMBER,
    counting,
    numbers_of,
)
from quatprop.readers.tables.time_units import (
    TEXTS,
    TICKS,
    TIME_OF_DAY,
    WEEKS,
    is_ticks,
    is_time_unit,
    ticks,
    ticks_since,
)
from quatprop.readers.text_clocks import remark_on_text, shown_unit
from quatprop.timeline.counts import FASTEST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.base.arrays import Float64
    from quatprop.readers.matching import ColumnMatcher
    from quatprop.readers.tables.model import Group


_SECONDS_OF_A_WEEK = 604_800

NO_DURATION = r"(?!.*(?:period|delta|diff|step|interval|duration|exposure|latency|delay|dt)).*"
"""Names of columns with a unit of time that may be the time, not a duration."""

TICKING = r"(?!.*(?:exposure|latency|delay|offset)).*(?:time|stamp|tick|clock|clk).*"
"""Names of columns that may be the time, in whatever unit."""

ABSENT = {"", "nan", "none", "null", "<na>"}
"""Texts of cells without a value, in lower case."""

_FEWEST_TIMED = 4
_DAYS = ((25_000, 75_000), (710_000, 770_000))
"""Days since 1899 in Excel, and since the year 0 in MATLAB, of this century."""
_LONGEST_STEP_DAYS = 2e-5

_FASTEST = 9_000
"""Rows a second that are doubted if only the user states the unit: inertial sensors take 8,000."""

_RISING = 2 / 3
"""Largest share of intervals that are longer than the one before."""


def unit_of_time(matcher: ColumnMatcher, stamp: Stamp) -> str:
    """Return the unit of a time in one column, from the user, the header or a convention."""
    time = stamp.columns
    if stamp.units and is_ticks(stamp.units[0]):
        return stamp.units[0]
    chosen, declared = matcher.selection.time_unit, matcher.declared(time)
    is_whole = declared in TEXTS or declared.startswith(f"{chosen} since ")
    if is_whole or (chosen is None and is_time_unit(declared) and declared not in TIME_UNITS):
        unit = shown_unit(matcher, time, declared) if declared == TIME_OF_DAY else declared
    elif (shown := shown_unit(matcher, time, chosen or declared or "".join(stamp.units))) in TEXTS:
        unit = shown
    else:
        unit = matcher.unit("time", time, TIME_UNITS, *stamp.units)
        if not unit and are_days(matcher, time[0]):
            what = f"the unit of the time {matcher.names(time)}, which looks like days, as of"
            way = f"{Setting('time_unit', 's')} after it is made seconds since its first, 86400"
            steady = f"{Setting('sample_rate', 'HZ')} for rows at a steady rate"
            matcher.unknown[-1] = (
                f"{what} Excel or MATLAB,",
                f"{way} times the difference, or {steady}",
            )
        if unit in NS_PER_UNIT and unit != (declared or "".join(stamp.units)):
            _remark_on_fast_rows(matcher, time[0], unit)
    if unit in TEXTS:
        remark_on_text(matcher, time, unit)
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


def refuse_sparse_times(matcher: ColumnMatcher, time: Group, numbers: Group) -> None:
    """Refuse times that most rows lack, as those of packets that only their first row has."""
    absent = sum(not _is_present(cell) for (cell,) in matcher.first_rows(time[:1]))
    if 2 * absent < _FEWEST_TIMED:
        return
    rows = matcher.first_rows((time[0], *numbers))
    timed = [_is_present(cell) for cell, *others in rows if all(map(_is_present, others))]
    timed = timed[timed.index(True) :] if any(timed) else []
    if len(timed) >= _FEWEST_TIMED and 2 * sum(timed) <= len(timed):
        raise UnsupportedLogError(
            matcher.path,
            f"only {sum(timed)} of the first {len(timed)} rows have a time in "
            f"{matcher.names(time[:1])}; write one in every row, name another column with "
            f"{Setting('time_col', 'C')}, or count rows at a steady rate with "
            f"{Setting('sample_rate', 'HZ')}",
        )


def _is_present(cell: object) -> bool:
    return f"{cell}".strip().lower() not in ABSENT


def are_days(matcher: ColumnMatcher, k: int) -> bool:
    """Return whether numbers look like days of Excel or MATLAB since its epoch."""
    found = _first_numbers(matcher, k)
    if len(found) < 2 or not any(low <= found.min() <= found.max() < high for low, high in _DAYS):  # noqa: PLR2004
        return False
    steps = np.abs(np.diff(found))
    return bool((steps > 0).any() and np.median(steps[steps > 0]) < _LONGEST_STEP_DAYS)


def _remark_on_fast_rows(matcher: ColumnMatcher, k: int, unit: str) -> None:
    """Remark on numbers of which a unit that only the user states makes unusually fast rows."""
    steps = np.diff(_first_numbers(matcher, k))
    rising = float(steps[steps > 0].sum()) * NS_PER_UNIT[unit]
    rate = len(steps) * NS_PER_S / rising if rising else 0.0
    if _FASTEST <= rate <= FASTEST:
        matcher.remark(
            "fast-rows",
            f"in {unit}, the times in {matcher.names((k,))} make {rate:,.0f} samples a second, "
            f"more than most loggers record; if they count ticks, use {Setting('time_col')} and "
            f"{Setting('sample_rate')}, their number a second, instead of {Setting('time_unit')}",
        )


def ticks_at(matcher: ColumnMatcher, k: int, rate: Fraction | float) -> Stamp | None:
    """Return the time by whole numbers that count ticks at a rate, Hz; None if it is none."""
    column = original(matcher, k)
    found = _first_numbers(matcher, k)
    has_unit = matcher.selection.time_unit or matcher.declared((k,))
    implied = named_clock(column.key, ())
    steps = np.diff(found)
    rising = steps[steps > 0]
    if has_unit or (implied and implied[1]) or not len(rising) or (found % 1).any():
        return None
    hz = Fraction(str(rate))
    interval = Fraction(float(np.median(rising))) / hz
    matcher.remark(
        "ticks-at-rate",
        f"the numbers in {matcher.names((k,))} are read as ticks, {float(hz):g} a second: one row "
        f"in about {duration_text(round(interval * NS_PER_S))}, {float(1 / interval):.3g} Hz",
    )
    return Stamp((k,), (ticks(hz),))


def rising_numbers(matcher: ColumnMatcher, numbers: Group) -> Group:
    """Return columns, named as times or ticks, whose first numbers rise."""
    named = [k for k in matcher.matching(TICKING) if k not in numbers]
    return tuple(k for k in named if _mostly_rises(_first_numbers(matcher, k)))


def named_as_units(matcher: ColumnMatcher, numbers: Group) -> dict[int, str]:
    """Return columns that have only the name of a unit of time, as `ms`, and rise: their units."""
    return {
        k: unit
        for unit in ("ms", "us", "ns")
        for k in matcher.matching("|".join(TIME_UNITS[unit]))
        if k not in numbers and _rises(_first_numbers(matcher, k))
    }


def _mostly_rises(found: Float64) -> bool:
    """Return whether numbers rise, and fall less often than a counter begins anew."""
    steps = np.diff(found)
    falls, rises = int((steps < 0).sum()), int((steps > 0).sum())
    return rises > 1 and falls <= len(steps) // 3


def gps_time(matcher: ColumnMatcher) -> tuple[Group, tuple[str, ...]] | None:
    """Return the columns of a GPS week and the time of the week, with their units; None: none."""
    weeks, times = map(matcher.matching, (WEEK_NUMBER, TIME_OF_WEEK))
    weeks = [k for k in weeks if k not in times]
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


def may_be_clock(matcher: ColumnMatcher, k: int, keys: Sequence[str] = ()) -> bool:
    """Return whether a column may be a clock, by its name and type or by its unit and values.

    `keys`: keys of the sampled columns
    """
    column = original(matcher, k)
    if re.fullmatch(INTERVAL, column.key) or not re.fullmatch(NO_DURATION, column.key):
        return False
    if k in matcher.notes.dates or named_clock(column.key, keys):
        return True
    has_unit = is_time_unit(matcher.declared((k,)) or column.unit)
    may_be_step = re.fullmatch(MAYBE_INTERVAL, column.key)
    return has_unit and not (may_be_step and not _rises(_first_numbers(matcher, k)))


def _rises(found: Float64) -> bool:
    """Return whether numbers never fall, and are more than two."""
    return bool((np.diff(found) >= 0).all() and len(np.unique(found)) > 2)  # noqa: PLR2004


def remark_on_sum(matcher: ColumnMatcher, time: Group, unlike: str) -> None:
    """Remark on intervals that are summed; `unlike`: what contradicts them, if anything does."""
    matcher.remark(
        "intervals-summed",
        f"the times are the sums of {matcher.names(time)}, each taken as the time since the row "
        f"before; to count rows at a steady rate instead, use {Setting('sample_rate')}"
        + (f"; {unlike}" if unlike else ""),
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
