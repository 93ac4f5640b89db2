"""The time of rows in a file: a clock, a counter of samples, or a sample rate."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.logs.clocks import clocks
from quatprop.logs.clocks.choice import (
    ambiguous_time,
    are_two_clocks,
    best_clock,
    clock_at,
    clocks_of,
    fraction_unit,
    refuse_unknown_beside_arrival,
    utc_offset_ns,
    with_fraction,
)
from quatprop.logs.clocks.series import SeriesChoice
from quatprop.tables.base import OTHER_DATES, numbers_of
from quatprop.tables.column_names import TIME_UNITS
from quatprop.tables.counters import counting
from quatprop.tables.model import Stamp
from quatprop.text import Setting, plain

if TYPE_CHECKING:
    from fractions import Fraction

    from quatprop.logs.matching.find import Found
    from quatprop.logs.matching.matcher import ColumnMatcher
    from quatprop.logs.vocabulary.rows import Row
    from quatprop.tables.counters import Counting
    from quatprop.tables.model import Group

_INSTANT = r"(?!.*(?:period|delta|diff|step|interval|duration|exposure|latency|delay|dt)).*"
"""Names of columns with a unit of time that may be the time, not a duration."""

_NO_COLUMN = "none"


def time_in_file(matcher: ColumnMatcher, found: Found, marks: Group, row: Row) -> Stamp:
    """Return the timestamp of a quantity in a file; see `choose_time` in `stamps`."""
    numbers = (*found.sets[0], *marks)
    stamp = _source(matcher, row, numbers)
    time, steady = stamp.columns, stamp.sample_rate
    series = SeriesChoice(matcher, numbers, time).chosen()
    if both := set(numbers) & set(time):
        raise UsageError(
            f"{plain(matcher.path)}: {matcher.names(both)} cannot be both the time and one of "
            f"{Setting(matcher.setting)}; name other columns, or the time with "
            f"{Setting('time_col')}",
        )
    if _holds_text(matcher, time):
        raise _unreadable_dates(matcher, time)
    if time and steady is None and _needs_rate(matcher, time[0]):
        raise UndeclaredError(
            matcher.path,
            f"the rate of the counter {matcher.names(time)}",
            Setting("sample_rate", "HZ"),
        )
    units = ("ns",) * len(time)
    if time[1:]:
        units = ("s", fraction_unit(matcher, time[1]))
    elif time and steady is None:
        units = (matcher.unit("time", time, TIME_UNITS, *stamp.units),)
    matcher.refuse_undeclared()
    rate = "" if steady is None else f"{float(steady):g} Hz"
    clock = " at ".join(filter(None, (matcher.spelled(time), rate)))
    offset_ns = sum(utc_offset_ns(matcher, k) for k in time)
    return Stamp(time, units, clock, steady, offset_ns, series)


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
    return UnsupportedLogError(
        matcher.path,
        f"{matcher.names(are)} {'hold' if are[1:] else 'holds'} {OTHER_DATES}; write them as "
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
    found = clocks_of(matcher, row, numbers)
    by_unit = [k for k in matcher.matching(_INSTANT) if matcher.columns[k].unit in TIME_UNITS]
    if len(by_unit) == 1 and not any(clock.is_readable for clock in found):
        return Stamp(tuple(by_unit))
    steady = matcher.notes.sample_rate
    counter = _counter(matcher, numbers) if steady is not None else ()
    others = sorted({*by_unit} - {k for clock in found for k in clock.columns})
    unnamed = [clock_at(matcher, k, clocks.EPOCH, "", 0) for k in others]
    best = found and best_clock(matcher, found, unnamed, has_rate=steady is not None)
    if best:
        refuse_unknown_beside_arrival(matcher, best, found)
        # A numeric clock takes precedence over a declared rate.
        if best.rank < clocks.TEXT or not (counter or (steady and not best.is_readable)):
            return Stamp(best.columns, best.units[:1])
    if steady is not None:
        return _at_rate(matcher, numbers, counter, steady)
    likely = (rf".*[._](?:{clocks.TIME})", r".*(?:time|stamp|sec|clock|date).*", ".*")
    no_time = {*numbers, *matcher.matching(clocks.COUNTER)}
    candidates = ([k for k in matcher.matching(name) if k not in no_time] for name in likely)
    raise ambiguous_time(matcher, by_unit or next(filter(None, candidates), []))


# What the user names.


def _named_time(matcher: ColumnMatcher, name: str, row: Row) -> Stamp:
    """Return the time column that the user named, with the fraction of its seconds."""
    parts = name.split(",")
    if len(parts) == 2 and not matcher.has(name):  # noqa: PLR2004
        time: Group = tuple(matcher.position(part, "time_col") for part in parts)
    else:
        first = matcher.position(name, "time_col")
        time = with_fraction(matcher, first)
        if time[1:] and are_two_clocks(matcher, *time):
            time = (first,)
    k = time[0]
    if any(k in matcher.matching(pattern) for pattern in row.stamps):
        return Stamp(time, (row.time_unit,))
    return Stamp(time, (clocks.named_clock(matcher.columns[k].key, ()) or ("", "", ""))[1:2])


# Counted samples.


def _counted(
    matcher: ColumnMatcher, name: str | None, rate: Fraction | float, numbers: Group, row: Row
) -> Stamp:
    """Return the time by a counter, named or the only one, or by counting rows."""
    given = Setting("sample_rate", f"{float(rate):g}")
    if name is None:
        counter = _counter(matcher, numbers)
        if counter:
            matcher.remark(
                "counter-used",
                f"{given} is the rate of the counter {matcher.names(counter)}, which also counts "
                f"lost samples; to count rows, give {Setting('time_col', _NO_COLUMN)} too"
            )  # fmt: skip
        stamp = _at_rate(matcher, numbers, counter, rate)
        if unused := clocks_of(matcher, row, ()):
            names = matcher.names(min(unused, key=lambda clock: clock.priority).columns)
            what = "the samples" if counter else "the rows"
            matcher.remark(
                "stamps-unused", f"{given} counts {what}; the timestamps in {names} are not used"
            )
        return stamp
    if name == _NO_COLUMN and not matcher.has(name):
        return Stamp(sample_rate=rate)
    k = matcher.position(name, "time_col")
    if re.fullmatch(f"{clocks.COUNTER}|{clocks.INDEX}", matcher.columns[k].key) is None:
        raise UsageError(
            f"{Setting('time_col')} and {Setting('sample_rate')} contradict each other; give one"
        )
    return Stamp((k,), sample_rate=rate)


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
    """Return the time of samples at a rate, and remark on unused counters."""
    stamp = Stamp(counter, sample_rate=rate)
    if counter:
        return stamp
    given = Setting("sample_rate", f"{float(rate):g}")
    for k, how in _countings(matcher, clocks.COUNTER, numbers).items():
        use = Setting("time_col", matcher.as_option(k))
        counts = f"the counter {matcher.names((k,))}, which usually steps by {how.step},"
        if how.has_gaps:
            raise UndeclaredError(
                matcher.path,
                f"whether {counts} counts samples",
                (f"{use} and {given} if it does, or {Setting('time_col', _NO_COLUMN)} and "
                     f"{given} to count rows"),
            )  # fmt: skip
        matcher.remark("counter-unused", f"{counts} is not used; to use it, give {use} and {given}")
        return stamp
    for k, how in _countings(matcher, clocks.INDEX, numbers).items():
        if how.has_gaps:
            use = Setting("time_col", matcher.as_option(k))
            matcher.remark(
                "index-gaps",
                f"{matcher.names((k,))} passes over numbers, as if samples were lost, but rows "
                f"are counted; to count by it, give {use} and {given}"
            )  # fmt: skip
            break
    return stamp
