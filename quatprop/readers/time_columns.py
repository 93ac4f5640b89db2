"""The time of rows in a file: a clock, a counter of samples, or a sample rate."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.base.text import Setting, plain
from quatprop.readers import clocks
from quatprop.readers.clocks import (
    ambiguous_time,
    are_two_clocks,
    best_clock,
    clock_at,
    clocks_of,
    fraction_unit,
    refuse_unknown_with_arrival,
    utc_offset_ns,
    with_fraction,
)
from quatprop.readers.odd_clocks import (
    are_intervals,
    counts_rows,
    gps_time,
    intervals,
    may_be_clock,
    named_as_units,
    refuse_sparse_times,
    remark_on_sum,
    rising_numbers,
    ticks_at,
    unit_of_time,
)
from quatprop.readers.series_choice import SeriesChoice
from quatprop.readers.tables.model import Stamp
from quatprop.readers.tables.table_log import OTHER_DATES, counting, numbers_of
from quatprop.readers.tables.time_units import is_time_unit
from quatprop.readers.watched_columns import (
    NO_COLUMN,
    columns_at_rate,
    columns_next_to_clock,
    counter_without_gaps,
    undeclared_counter,
    unlike_clocks,
)

if TYPE_CHECKING:
    from fractions import Fraction

    from quatprop.readers.clocks import Clock
    from quatprop.readers.matching import ColumnMatcher, Found
    from quatprop.readers.tables.model import Group
    from quatprop.readers.tables.table_log import Counting
    from quatprop.readers.vocabulary import Row


_SAME_RATE = 0.02
"""Largest difference of a measured rate from a stated one, as a share of it."""


def time_in_file(matcher: ColumnMatcher, found: Found, marks: Group, row: Row) -> Stamp:
    """Return the timestamp of a quantity in a file; see `choose_time` in `stamps`."""
    numbers = (*found.sets[0], *marks)
    stamp = _source(matcher, row, numbers)
    time, steady = stamp.columns, stamp.sample_rate
    choice = SeriesChoice(matcher, numbers, time)
    series = choice.chosen()
    if both := set(numbers) & set(time):
        raise UsageError(
            f"{plain(matcher.path)}: {matcher.names(both)} cannot be both the time and one of "
            f"{Setting(matcher.setting)}; name other columns, or the time with "
            f"{Setting('time_col')}",
        )
    if _holds_text(matcher, time):
        raise _unreadable_dates(matcher, time)
    if time and steady is None:
        refuse_sparse_times(matcher, time, numbers)
    if time and steady is None and _needs_rate(matcher, time[0]):
        raise UndeclaredError(
            matcher.path,
            f"the rate of the counter {matcher.names(time)}",
            Setting("sample_rate", "HZ"),
        )
    units = ("ns",) * len(time)
    if time[1:]:
        units = stamp.units if stamp.units[1:] else ("s", fraction_unit(matcher, time[1]))
    elif time and steady is None:
        units = (unit_of_time(matcher, stamp),)
    if stamp.is_summed:
        remark_on_sum(matcher, time, unlike_clocks(matcher, row, numbers, stamp, units[0]))
    elif steady is not None:
        _remark_on_unlike(matcher, stamp, numbers, row)
    matcher.refuse_undeclared()
    rate = "" if steady is None else f"{float(steady):g} Hz"
    clock = " at ".join(filter(None, (matcher.spelled(time), rate)))
    offset_ns = sum(utc_offset_ns(matcher, k) for k in time)
    watched = (*choice.watched(series), *stamp.watched)
    return Stamp(time, units, clock, steady, offset_ns, series, watched, stamp.is_summed)


def _holds_text(matcher: ColumnMatcher, time: Group) -> bool:
    """Return whether a time is unreadable text, such as dates with names of months."""
    if any(matcher.notes.units.get(k) == OTHER_DATES for k in time):
        return True
    if not time or matcher.declared(time[:1]) or matcher.selection.time_unit is not None:
        return False
    cells = [row[0] for row in matcher.first_rows(time[:1])]
    return bool(cells) and bool(np.isnan(numbers_of(cells)).all())


def _needs_rate(matcher: ColumnMatcher, k: int) -> bool:
    """Return whether a column counts samples, so a sample rate is needed."""
    is_counter = re.fullmatch(clocks.COUNTER, matcher.columns[k].key) is not None
    return is_counter and not (matcher.selection.time_unit or matcher.declared((k,)))


def _unreadable_dates(matcher: ColumnMatcher, time: Group) -> UnsupportedLogError:
    """Return the error for a time that is text, perhaps in two columns."""
    dates = sorted(k for k, unit in matcher.notes.units.items() if unit == OTHER_DATES)
    are = dates if matcher.selection.time_col is None and {*time} <= {*dates} else time
    what = (
        OTHER_DATES
        if {*are} <= {*dates}
        else "text that is neither a number nor a date of ISO 8601"
    )
    return UnsupportedLogError(
        matcher.path,
        f"{matcher.names(are)} {'hold' if are[1:] else 'holds'} {what}; write the times as "
        f"2023-11-14T22:13:20.5{' in one column' if are[1:] else ''}, name another column "
        f"with {Setting('time_col', 'C')}, or count rows at a steady rate with "
        f"{Setting('sample_rate', 'HZ')}",
    )


def _source(matcher: ColumnMatcher, row: Row, numbers: Group) -> Stamp:
    """Return the time columns with their implied units, or a counter or sample rate."""
    name, sample_rate = matcher.selection.time_col, matcher.selection.sample_rate
    if sample_rate is not None:
        if not (math.isfinite(sample_rate) and sample_rate > 0):
            raise UsageError(f"{Setting('sample_rate')} {sample_rate} is not a rate above 0 Hz")
        return _counted(matcher, name, sample_rate, numbers, row)
    if name is not None:
        return _named_time(matcher, name, row)
    return _recognised(matcher, row, numbers)


def _recognised(matcher: ColumnMatcher, row: Row, numbers: Group) -> Stamp:
    """Return the time columns that are recognised by name, unit or content."""
    found = clocks_of(matcher, row, numbers)
    every = range(len(matcher.columns))
    with_unit = [k for k in every if is_time_unit(clocks.original(matcher, k).unit)]
    by_unit = [k for k in with_unit if may_be_clock(matcher, k)]
    if not any(clock.is_readable for clock in found):
        if by_gps := gps_time(matcher):
            return Stamp(*by_gps)
        units = dict.fromkeys(by_unit, "") or named_as_units(matcher, numbers)
        if len(units) == 1:
            return Stamp(tuple(units), tuple(units.values()))
        if len({clocks.original(matcher, k).key for k in by_unit}) == 1:
            found = _of_one_name(matcher, by_unit, numbers)
    steady = matcher.notes.sample_rate
    counter = _counter(matcher, numbers) if steady is not None else ()
    others = sorted({*by_unit} - {k for clock in found for k in clock.columns})
    unnamed = [clock_at(matcher, k, clocks.EPOCH, "", 0) for k in others]
    best = found and best_clock(matcher, found, unnamed, has_rate=steady is not None)
    if best:
        refuse_unknown_with_arrival(matcher, best, found)
        if steady is not None and best.units == ("",) and counts_rows(matcher, best.columns[0]):
            return _counted_by_clock(matcher, best.columns, steady)
        # A numeric clock takes precedence over a declared rate.
        if best.rank < clocks.TEXT or not (counter or (steady and not best.is_readable)):
            watched = columns_next_to_clock(matcher, best, numbers, found)
            return Stamp(best.columns, best.units[:1], watched=watched)
    if steady is not None:
        return _at_rate(matcher, numbers, counter, steady)
    if summed := intervals(matcher, numbers):
        return Stamp(summed, is_summed=True)
    likely = (rf".*[._](?:{clocks.TIME})", r".*(?:time|stamp|sec|clock|date).*", ".*")
    no_time = {*numbers, *matcher.matching(clocks.COUNTER)}
    candidates = ([k for k in matcher.matching(name) if k not in no_time] for name in likely)
    raise ambiguous_time(matcher, by_unit or next(filter(None, candidates), []))


def _of_one_name(matcher: ColumnMatcher, columns: list[int], numbers: Group) -> list[Clock]:
    """Return clocks that only their unit shows, with one name and numbers behind it."""
    units = [clocks.original(matcher, k).unit for k in columns]
    pairs = zip(columns, units, strict=True)
    found = [clocks.clock_at(matcher, k, clocks.EPOCH, unit, 0) for k, unit in pairs]
    return clocks.nearest_first(found, numbers, len(matcher.columns))


def _counted_by_clock(matcher: ColumnMatcher, time: Group, rate: float) -> Stamp:
    """Return the time by whole numbers in a column named as a clock, at a stated rate."""
    matcher.remark(
        "counter-at-rate",
        f"the whole numbers in {matcher.names(time)} count samples, at the {rate:g} Hz that the "
        "file states",
    )
    return Stamp(time, sample_rate=rate)


# Columns that the user names.


def _named_time(matcher: ColumnMatcher, name: str, row: Row) -> Stamp:
    """Return the time column that the user named, with the fraction of its seconds."""
    parts = name.split(",")
    if len(parts) == 2 and not matcher.has(name):  # noqa: PLR2004
        time: Group = tuple(matcher.position(part, "time_col") for part in parts)
        if all(re.fullmatch(clocks.INDEX, matcher.columns[k].key) for k in time):
            raise UsageError(
                f"{plain(matcher.path)}: {matcher.names(time)} count samples, and are no seconds "
                f"and a fraction of them; count rows with {Setting('sample_rate', 'HZ')}"
            )
    else:
        first = matcher.position(name, "time_col")
        time = with_fraction(matcher, first)
        if time[1:] and are_two_clocks(matcher, *time):
            time = (first,)
    k = time[0]
    if not time[1:] and are_intervals(matcher, k):
        return Stamp(time, ("",), is_summed=True)
    by_gps = gps_time(matcher) if time[1:] else None
    if by_gps is not None and by_gps[0] == time:
        return Stamp(*by_gps)
    if any(k in matcher.matching(pattern) for pattern in row.stamps):
        return Stamp(time, (row.time_unit,))
    column = clocks.original(matcher, k)
    _, implied, _ = clocks.named_clock(column.key, ()) or (0, "", 0)
    return Stamp(time, (implied or column.unit,))


# Counted samples.


def _counted(
    matcher: ColumnMatcher, name: str | None, rate: Fraction | float, numbers: Group, row: Row
) -> Stamp:
    """Return the time by a counter, named or the only one, or by counting rows."""
    given = Setting("sample_rate", f"{float(rate):g}")
    stated = matcher.notes.sample_rate
    if stated is not None and abs(stated - rate) > _SAME_RATE * rate and name in {None, NO_COLUMN}:
        matcher.remark(
            "other-rate",
            f"{given} is used, although the file states {stated:g} Hz; to use that, leave it out",
        )
    if name is None:
        counter = _counter(matcher, numbers)
        if counter:
            matcher.remark(
                "counter-used",
                f"{given} is the rate of the counter {matcher.names(counter)}, which also counts "
                f"lost samples; to count rows, give {Setting('time_col', NO_COLUMN)} too"
            )  # fmt: skip
        stamp = _at_rate(matcher, numbers, counter, rate)
        _remark_on_unused(matcher, stamp, numbers, row)
        return stamp
    if name == NO_COLUMN and not matcher.has(name):
        watched = columns_at_rate(matcher, rate, numbers, "requested")
        return Stamp(sample_rate=rate, watched=watched)
    k = matcher.position(name, "time_col")
    if re.fullmatch(f"{clocks.COUNTER}|{clocks.INDEX}", matcher.columns[k].key):
        return Stamp((k,), sample_rate=rate)
    by_ticks = ticks_at(matcher, k, rate)
    if by_ticks is None:
        raise UsageError(
            f"{plain(matcher.path)}: {matcher.names((k,))} does not count samples or ticks, so "
            f"that {Setting('time_col')} and {Setting('sample_rate')} contradict each other; give "
            "one"
        )
    return by_ticks


def _remark_on_unused(matcher: ColumnMatcher, stamp: Stamp, numbers: Group, row: Row) -> None:
    """Name the timestamps next to rows or samples that are counted."""
    given = Setting("sample_rate", f"{float(stamp.sample_rate or 0):g}")
    what = "the samples" if stamp.columns else "the rows"
    if unused := clocks_of(matcher, row, ()):
        names = matcher.names(min(unused, key=lambda clock: clock.priority).columns)
        said = f"the timestamps in {names} are not used"
    elif ticking := rising_numbers(matcher, (*numbers, *stamp.columns)):
        said = f"the numbers in {matcher.names(ticking[:1])} are not used"
        if not matcher.declared(ticking[:1]):
            as_ticks = Setting("time_col", matcher.as_option(ticking[0]))
            said += f"; if they are ticks at this rate, give {as_ticks} too"
    else:
        return
    if unlike := unlike_clocks(matcher, row, numbers, stamp):
        said += f": {unlike}"
    matcher.remark("stamps-unused", f"{given} counts {what}; {said}")


def _remark_on_unlike(matcher: ColumnMatcher, stamp: Stamp, numbers: Group, row: Row) -> None:
    """Name a clock that contradicts the rate at which rows or samples are counted."""
    if any(remark.code == "stamps-unused" for remark in matcher.remarks):
        return
    if unlike := unlike_clocks(matcher, row, numbers, stamp):
        what = "samples" if stamp.columns else "rows"
        rate = f"{float(stamp.sample_rate or 0):g} Hz"
        matcher.remark("stamps-unused", f"the {what} are counted at {rate}, but {unlike}")


def _counter(matcher: ColumnMatcher, numbers: Group) -> Group:
    """Return the first column that counts samples, or nothing."""
    counters = _countings(matcher, clocks.COUNTER, numbers)
    return tuple(k for k, counting in counters.items() if counting.is_by_one)[:1]


def _countings(matcher: ColumnMatcher, pattern: str, numbers: Group) -> dict[int, Counting]:
    """Return the columns of some names that count, and how."""
    columns = [k for k in matcher.matching(pattern) if k not in numbers]
    cells = zip(*matcher.first_rows(columns), strict=True) if columns else ()
    found = zip(columns, map(counting, map(numbers_of, cells)), strict=False)
    return {k: how for k, how in found if how is not None}


def _at_rate(
    matcher: ColumnMatcher, numbers: Group, counter: Group, rate: Fraction | float
) -> Stamp:
    """Return the time of samples at a rate; numbers of rows that are not used are watched."""
    stamp = Stamp(counter, sample_rate=rate)
    if counter:
        return stamp
    given = Setting("sample_rate", f"{float(rate):g}")
    for k, how in _countings(matcher, clocks.COUNTER, numbers).items():
        use = Setting("time_col", matcher.as_option(k))
        counts = f"the counter {matcher.names((k,))}, which usually steps by {how.step},"
        if how.has_gaps:
            raise undeclared_counter(matcher, k, counts, given)
        matcher.remark("counter-unused", f"{counts} is not used; to use it, give {use} and {given}")
        return stamp._replace(watched=(counter_without_gaps(matcher, k, given),))
    return stamp._replace(watched=columns_at_rate(matcher, rate, numbers))
