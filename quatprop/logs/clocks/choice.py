"""Choose a clock among the columns of a table."""

from __future__ import annotations

import re
from contextlib import suppress
from itertools import takewhile
from typing import TYPE_CHECKING

from quatprop.errors import UndeclaredError, UsageError
from quatprop.logs.clocks import clocks
from quatprop.logs.clocks.clocks import Clock
from quatprop.logs.vocabulary.names import POSITION
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
    """Return the columns that may be the time; only readable ones if there are any."""
    keys = [matcher.columns[k].key for k in numbers]
    found: dict[int, Clock] = {}
    for place, pattern in enumerate(_conventional(matcher, row)):
        # The time of recording has the rank of a convention only if there is no other timestamp.
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
    """Return the patterns of a convention for the columns of the selected clock."""
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
    """Return a column as a clock, with its declared or else an implied unit."""
    unit = OTHER_DATES if k in matcher.notes.texts else matcher.declared((k,)) or implied_unit
    zoned = matcher.notes.dates.get(k)
    offset = utc_offset_ns(matcher, k)
    if zoned is not None or unit == OTHER_DATES:
        rank = max(rank, clocks.TEXT if zoned or offset else clocks.LOCAL)
    return Clock((k,), rank, place, (unit,), bool(zoned), offset)


def utc_offset_ns(matcher: ColumnMatcher, k: int) -> int:
    """Return the UTC offset of local text that the header declares, ns; else 0."""
    is_local = matcher.notes.dates.get(k) is False
    return clocks.stated_offset_ns(matcher.columns[k].unit) if is_local else 0


def refuse_unknown_beside_arrival(matcher: ColumnMatcher, best: Clock, found: list[Clock]) -> None:
    """Refuse an arrival time if another column may be the sensor's own time."""
    if best.rank == clocks.ARRIVAL:
        unknown = {*matcher.matching(rf".*[._]{clocks.TIME}")}
        if unknown := unknown - {k for clock in found for k in clock.columns}:
            raise ambiguous_time(matcher, [*best.columns, *sorted(unknown)])


def _nearest(matcher: ColumnMatcher, found: list[Clock], keys: list[str]) -> list[Clock]:
    """Return, of the clocks of each kind, those whose names are most similar to the samples'."""

    def distance(clock: Clock) -> int:
        key = matcher.columns[clock.columns[0]].key
        return -max((_shared(key, name) for name in keys), default=0)

    kinds = {(clock.rank, clock.place) for clock in found}
    nearest = {kind: min(distance(c) for c in found if (c.rank, c.place) == kind) for kind in kinds}
    return [c for c in found if distance(c) == nearest[c.rank, c.place]]


def best_clock(
    matcher: ColumnMatcher, found: list[Clock], unnamed: list[Clock], *, has_rate: bool
) -> Clock | None:
    """Return the best clock that is not constant, and remark on others that differ.

    If all are constant, return the only varying column with a unit of time, or None if the file
    declares a sample rate (`has_rate`).
    """
    found = [_with_fraction(matcher, clock) for clock in sorted(found, key=lambda c: c.priority)]
    fractions = {k for clock in found for k in clock.columns[1:]}
    found = [clock for clock in found if clock.columns[0] not in fractions]
    is_only = len(found) == 1 and not unnamed and not has_rate
    if is_only or not any(clock.is_readable for clock in found):
        return found[0]
    times = _first_times(matcher, [*found, *unnamed])
    moving = [clock for clock in found if not clocks.is_constant(times[clock])]
    if not moving:
        moving = [clock for clock in unnamed if not clocks.is_constant(times[clock])]
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
            if best.priority == other.priority:
                raise ambiguous_time(matcher, [best.columns[0], other.columns[0]])
            continue
        differ = clocks.difference(ours, theirs)
        if differ is None:
            continue
        is_rival = best.rank == other.rank != clocks.CONVENTION
        if differ.largest_ns and (is_rival or best.priority == other.priority):
            apart = duration_text(differ.largest_ns)
            why = f", which differ by up to {apart} beyond a constant"
            raise ambiguous_time(matcher, [best.columns[0], other.columns[0]], why)
        if other.rank == clocks.ARRIVAL and 0 < differ.largest_ns <= NS_PER_S:
            continue  # a delay of the network or the disk
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
    """Return a clock, with the column of the fraction of its seconds if there is one."""
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
    """Return a column, and for whole seconds the column of their fraction, if there is one."""
    match = re.fullmatch(r"(.*[._])?(?:secs?|seconds?)|(.*[._])s", _key_of(matcher, first))
    if not match:
        return (first,)
    fits = re.compile(re.escape(match[1] or match[2] or "") + f"(?:{_PARTS_OF_A_SECOND})").fullmatch
    others = [k for k in range(len(matcher.columns)) if fits(_key_of(matcher, k))]
    return (first, *others[:1])


def _key_of(matcher: ColumnMatcher, k: int) -> str:
    return whole_key(matcher.columns[k].text)


def are_two_clocks(matcher: ColumnMatcher, seconds: int, part: int) -> bool:
    """Return whether seconds have decimals, or a fraction reaches a second: then each is a clock.

    In some ROS messages, nanoseconds slightly exceed a second.
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
    """Return the unit of the second column of a timestamp; by default ns, as in ROS."""
    word = re.split(r"[._]", _key_of(matcher, k))[-1]
    declared = matcher.declared((k,))
    units = (u for u, names in TIME_UNITS.items() if u == declared or word in names)
    return next(units, "ns")


def ambiguous_time(
    matcher: ColumnMatcher, candidates: Sequence[int], why: str = ""
) -> UndeclaredError:
    """Return the error for several possible time columns; `why`: how they differ."""
    candidates = [k for k in candidates if not re.fullmatch(POSITION, _key_of(matcher, k))]
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
    """Return the number of equal words at the start of two names."""
    pairs = zip(*(re.split(r"[._]", name) for name in (a, b)), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
