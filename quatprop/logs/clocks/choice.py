"""The choice of a clock among the columns of a table."""

from __future__ import annotations

import re
from contextlib import suppress
from itertools import takewhile
from typing import TYPE_CHECKING

from quatprop.errors import UndeclaredError, UsageError
from quatprop.logs.clocks import clocks
from quatprop.logs.clocks.clocks import Clock
from quatprop.logs.vocabulary.sources import GENERIC
from quatprop.tables.base import OTHER_DATES
from quatprop.tables.column_names import TIME_UNITS, whole_key
from quatprop.tables.timestamps import from_text
from quatprop.text import Setting, listed, plain
from quatprop.times import NS_PER_S, duration_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.arrays import Float64
    from quatprop.logs.matching.matcher import ColumnMatcher
    from quatprop.logs.vocabulary.rows import Row
    from quatprop.tables.model import Group

_PARTS_OF_A_SECOND = "|".join(name for unit in ("ms", "us", "ns") for name in TIME_UNITS[unit])


def clocks_of(matcher: ColumnMatcher, row: Row, numbers: Group) -> list[Clock]:
    """Return the columns that may be the time, those that can be read if there are any."""
    keys = [matcher.columns[k].key for k in numbers]
    found: dict[int, Clock] = {}
    for place, pattern in enumerate(_conventional(matcher, row)):
        # The time of recording is the stamp of a convention only where a file has no other.
        rank = clocks.ARRIVAL if found and pattern == row.log_time else clocks.CONVENTION
        for k in matcher.matching(pattern):
            found.setdefault(k, clock_at(matcher, k, rank, row.time_unit, place))
    if matcher.selection.clock is None:
        for k, column in enumerate(matcher.columns):
            named = clocks.named_clock(column.key, keys)
            if k in found or k in numbers or not (named or k in matcher.notes.units):
                continue
            rank, unit, place = named or (clocks.EPOCH, "", len(clocks.CLOCKS))
            if re.fullmatch(row.log_time or "(?!)", column.key):
                rank = clocks.ARRIVAL
            found[k] = clock_at(matcher, k, rank, unit, place)
    # T (K) beside t (s) is a temperature.
    units = {"", *TIME_UNITS}
    every = list(found.values())
    by_unit = [clock for clock in every if {*clock.units} <= {*units, OTHER_DATES}] or every
    return _nearest(matcher, [one for one in by_unit if one.is_readable] or by_unit, keys)


def _conventional(matcher: ColumnMatcher, row: Row) -> tuple[str, ...]:
    """Return the patterns of the time columns of a convention, for the chosen clock."""
    match matcher.selection.clock:
        case None:
            return () if row is GENERIC else row.stamps
        case "header":
            return tuple(pattern for pattern in row.stamps if pattern != row.log_time)
        case "log" if row.log_time:
            return (row.log_time,)
        case clock:
            raise UsageError(
                f"{plain(matcher.path)}: this table has no {clock} time; choose the column with "
                f"{Setting('time_col')}",
            )


def clock_at(matcher: ColumnMatcher, k: int, rank: int, implied_unit: str, place: int) -> Clock:
    """Return a column as a clock, by its unit or, where none is declared, by an implied one."""
    unit = OTHER_DATES if k in matcher.notes.texts else matcher.declared((k,)) or implied_unit
    zoned = matcher.notes.dates.get(k)
    offset = utc_offset_ns(matcher, k)
    if zoned is not None or unit == OTHER_DATES:
        rank = max(rank, clocks.TEXT if zoned or offset else clocks.LOCAL)
    return Clock((k,), rank, place, (unit,), bool(zoned), offset)


def utc_offset_ns(matcher: ColumnMatcher, k: int) -> int:
    """Return the offset of local text from UTC that the header states, ns; else 0."""
    is_local = matcher.notes.dates.get(k) is False
    return clocks.stated_offset_ns(matcher.columns[k].unit) if is_local else 0


def refuse_unknown_beside_arrival(matcher: ColumnMatcher, best: Clock, found: list[Clock]) -> None:
    """Refuse to take the time of arrival where another column may be the sensor's own."""
    if best.rank == clocks.ARRIVAL:
        unknown = {*matcher.matching(rf".*[._]{clocks.TIME}")}
        if unknown := unknown - {k for clock in found for k in clock.columns}:
            raise ambiguous_time(matcher, [*best.columns, *sorted(unknown)])


def _nearest(matcher: ColumnMatcher, found: list[Clock], keys: list[str]) -> list[Clock]:
    """Return clocks without those that, of one kind, are further from what was sampled."""

    def distance(clock: Clock) -> int:
        key = matcher.columns[clock.columns[0]].key
        return -max((_shared(key, name) for name in keys), default=0)

    kinds = {(clock.rank, clock.place) for clock in found}
    nearest = {kind: min(distance(c) for c in found if (c.rank, c.place) == kind) for kind in kinds}
    return [c for c in found if distance(c) == nearest[c.rank, c.place]]


def best_clock(
    matcher: ColumnMatcher, found: list[Clock], unnamed: list[Clock], *, has_rate: bool
) -> Clock | None:
    """Return the best clock that moves, and note what another one says.

    If none does, it is the only other column that moves in a unit of time, or None where the file
    `has_rate`, a sample rate.
    """
    found = [_with_fraction(matcher, clock) for clock in sorted(found, key=lambda c: c.goodness)]
    fractions = {k for clock in found for k in clock.columns[1:]}
    found = [clock for clock in found if clock.columns[0] not in fractions]
    is_only = len(found) == 1 and not unnamed and not has_rate
    if is_only or not any(clock.is_readable for clock in found):
        return found[0]
    times = _first_times(matcher, [*found, *unnamed])
    moving = [clock for clock in found if not clocks.stands_still(times[clock])]
    if not moving:
        moving = [clock for clock in unnamed if not clocks.stands_still(times[clock])]
        if len(moving) != 1:
            moving = [] if has_rate else found
    is_found = moving and moving[0] in found
    if stopped := found[: found.index(moving[0])] if is_found else found:
        names = matcher.names([k for clock in stopped for k in clock.columns])
        instead = "the sample rate is"
        if moving:
            instead = f"those in {matcher.names(moving[0].columns)} are"
        matcher.remark("clock-stands", f"the times in {names} are all the same; {instead} used")
    if not moving:
        return None
    best, *others = moving
    for other in others:
        ours, theirs = times[best], times[other]
        if ours is None or theirs is None:
            if best.goodness == other.goodness:
                raise ambiguous_time(matcher, [best.columns[0], other.columns[0]])
            continue
        differ = clocks.difference(ours, theirs)
        if differ is None:
            continue
        is_rival = best.rank == other.rank != clocks.CONVENTION
        if differ.largest_ns and (is_rival or best.goodness == other.goodness):
            apart = duration_text(differ.largest_ns)
            why = f", which differ by up to {apart} beyond a constant"
            raise ambiguous_time(matcher, [best.columns[0], other.columns[0]], why)
        if other.rank == clocks.ARRIVAL and 0 < differ.largest_ns <= NS_PER_S:
            continue  # what takes as long as the network or the disk does
        both = matcher.names(other.columns), matcher.names(best.columns)
        way = Setting("time_col", matcher.as_option(other.columns[0]))
        sentence = clocks.difference_text(*both, differ)
        matcher.remark("clocks-differ", f"{sentence}; to use them, name them with {way}")
    return best


def _first_times(matcher: ColumnMatcher, found: list[Clock]) -> dict[Clock, Float64 | None]:
    columns = [k for clock in found for k in clock.columns]
    rows = matcher.first_rows(columns)
    cells = dict(zip(columns, zip(*rows, strict=True), strict=True)) if rows else {}
    return {
        clock: clocks.first_times([cells[k] for k in clock.columns], clock) if rows else None
        for clock in found
    }


# Seconds and their fraction.


def _with_fraction(matcher: ColumnMatcher, clock: Clock) -> Clock:
    """Return a clock of seconds with the column of their fractions, if there is one."""
    first, *fraction = with_fraction(matcher, clock.columns[0])
    if not fraction:
        return clock
    if are_two_clocks(matcher, first, *fraction):
        if matcher.declared((first,)) and matcher.declared(tuple(fraction)):
            return clock
        raise ambiguous_time(matcher, (first, *fraction))
    units = ("s", fraction_unit(matcher, *fraction))
    return clock._replace(columns=(first, *fraction), units=units)


def with_fraction(matcher: ColumnMatcher, first: int) -> Group:
    """Return a column, and if it is of whole seconds that of their fractions, if there is one."""
    match = re.fullmatch(r"(.*[._])?(?:secs?|seconds?)|(.*[._])s", _key_of(matcher, first))
    if not match:
        return (first,)
    fits = re.compile(re.escape(match[1] or match[2] or "") + f"(?:{_PARTS_OF_A_SECOND})").fullmatch
    others = [k for k in range(len(matcher.columns)) if fits(_key_of(matcher, k))]
    return (first, *others[:1])


def _key_of(matcher: ColumnMatcher, k: int) -> str:
    return whole_key(matcher.columns[k].text)


def are_two_clocks(matcher: ColumnMatcher, seconds: int, part: int) -> bool:
    """Return whether one is a whole stamp by itself: seconds with decimals, or parts for 1 s.

    In odd messages of ROS the nanoseconds go on a little beyond a second.
    """
    unit = fraction_unit(matcher, part)
    limit = (2 if unit == "ns" else 1) * NS_PER_S
    for cells in matcher.table.head((seconds, part)):
        with suppress(ValueError):
            whole, fraction = from_text(f"{cells[0]}", "s"), from_text(f"{cells[1]}", unit)
            if whole % NS_PER_S or fraction >= limit:
                return True
    return False


def fraction_unit(matcher: ColumnMatcher, k: int) -> str:
    """Return the unit of the second column of a stamp; ns, as in ROS, if nothing says it."""
    word = re.split(r"[._]", _key_of(matcher, k))[-1]
    declared = matcher.declared((k,))
    units = (u for u, names in TIME_UNITS.items() if u == declared or word in names)
    return next(units, "ns")


def ambiguous_time(
    matcher: ColumnMatcher, candidates: Sequence[int], why: str = ""
) -> UndeclaredError:
    """Return the error for columns that all may be the time, and why none of them is taken."""
    names = listed(matcher.columns[k].text for k in candidates)
    what, way = f"the time column (one of {names}{why})", f"{Setting('time_col', 'C')}"
    if not candidates:
        what = "the time column"
    elif len(candidates) == 1:
        column = matcher.as_option(candidates[0])
        what, way = f"whether {names} is the time", f"{Setting('time_col', column)}"
        if matcher.declared((candidates[0],)) not in TIME_UNITS:
            way = f"{way} and {Setting('time_unit', '|'.join(TIME_UNITS))}"
    steady = f"or {Setting('sample_rate', 'HZ')} for rows at a steady rate"
    return UndeclaredError(matcher.path, what, (f"{way}, {steady}"))


def _shared(a: str, b: str) -> int:
    """Return how many words of two names are the same from the beginning."""
    pairs = zip(*(re.split(r"[._]", name) for name in (a, b)), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
