"""Clocks of tables: which columns may be the time, their priority, and whether they agree.

A row of :data:`CLOCKS` has the names and the rank of a clock. The best clock that is not constant
is used, and compared with the others over the first rows.
"""

from __future__ import annotations

import re
from contextlib import suppress
from functools import reduce
from itertools import takewhile
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import UndeclaredError, UsageError
from quatprop.base.text import Setting, listed, plain
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.readers.clock_difference import (
    Difference,
    Unsteady,
    against_recorded,
    difference,
    difference_text,
    unlike_speed,
    unsteady_text,
)
from quatprop.readers.matching import FIRST_ROWS
from quatprop.readers.tables.exact_times import from_text
from quatprop.readers.tables.table_log import (
    INTERVAL,
    OTHER_DATES,
    TIME_UNITS,
    contradicting_units,
    numbers_of,
    parse_name,
    whole_key,
)
from quatprop.readers.tables.time_units import TEXTS, is_time_unit, time_scale
from quatprop.readers.vocabulary import GENERIC, POSITION

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from quatprop.base.arrays import Float64
    from quatprop.readers.matching import ColumnMatcher
    from quatprop.readers.tables.model import Column, Group
    from quatprop.readers.vocabulary import Row


CONVENTION, SENSOR, EPOCH, TEXT, LOCAL, ARRIVAL = range(6)
"""Ranks, best first: timestamp of a known convention, sampling time of the sensor, number since an
epoch, text with a UTC offset, local text, time of arrival or recording."""

TIME = r"(?:t|ts|time|timestamp|time_?stamp|stamp)"


class ClockName(NamedTuple):
    """Names of a clock.

    `pattern`: regular expression for whole keys of columns. A group ``of`` is the prefix of the
        sampled columns: with another prefix, it is the clock of another sensor
    `rank`: one of the ranks above
    `unit`: the unit implied by the name if none is declared
    """

    pattern: str
    rank: int
    unit: str = ""


CLOCKS = (
    ClockName(
        r"(?:.*[._])?(?:server|host|phone|pc|bag|log|logging|logged|recording|recorded|recv|rx"
        rf"|received?|reception|arrival|arrived|publish|published)_?(?:{TIME}|at)(?:_[a-z]+)?",
        ARRIVAL,
    ),
    ClockName(
        r"(?:.*[._])?(?:device|sensor|samples?|sampling|hardware|hw|mcu|node|boot|tracking)"
        rf"_?{TIME}(?:_(?:boot|sample))?",
        SENSOR,
    ),
    ClockName(rf"{TIME}_(?:boot|sample|device|sensor|since_(?:re)?boot|since_start)", SENSOR),
    ClockName(rf"{TIME}_since_(?:re)?(?:boot|start)_in_ms", SENSOR, "ms"),
    ClockName(rf"(?P<of>.+?)[._]{TIME}(?:_since_(?:re)?boot)?", SENSOR),
    ClockName(rf"(?:epoch?|unix|posix|ros)(?:_?{TIME})?", EPOCH),
    ClockName(rf"(?:{TIME}|time_interval)_since_?1970", EPOCH, "s"),
    *(
        ClockName(word, EPOCH, unit)
        for word, unit in {"millis": "ms", "micros": "us", "nanos": "ns"}.items()
    ),
    ClockName(r"(?:.*\.)?header\.stamp\.secs?", EPOCH),
    ClockName(r"(?:stamp[._])?(?:secs?|seconds)", EPOCH),
    ClockName(rf"(?:{TIME}|tv|epoch|unix|posix)_(?:secs?|seconds)", EPOCH, "s"),
    ClockName(rf"_*{TIME}", EPOCH),
    ClockName(rf"utc_?{TIME}", EPOCH),
    ClockName(rf"(?:{TIME}|seconds|secs?)_?elapsed|elapsed(?:_?{TIME}|_?seconds)?|uptime", EPOCH),
)
"""Names of clocks; the first matching row counts, and earlier rows come first within a rank."""

COUNTER = (
    r"(?:.*[._])?(?:packet|sample|frame|row|message|msg|record)?_?(?:counter|seq|sequence|cnt)"
    r"(?:_?(?:no|num|number|id))?|(?:packet|sample|frame)_?(?:count|no|num|number|index|id)"
)
"""Names of columns that may count samples, including lost ones."""

INDEX = (
    r"(?:.*[._])?(?:frame|index|idx|count|samples?|packet|row|line|n|no|num|number)"
    r"|unnamed:_\d+|level_\d+|"
)
"""Names of columns that may count samples, or only rows; pandas leaves its index without a name."""


class Clock(NamedTuple):
    """A column that may be the time, or two columns of seconds and their fraction.

    `rank`, `place`: its rank, and its place within the rank
    `units`: unit of each column; ``""``: not declared
    `name`: key of its name, without what makes a repeated one unique
    `zoned`: whether its text has UTC offsets
    `offset_ns`: UTC offset of local text declared by the header, ns
    """

    columns: tuple[int, ...]
    rank: int
    place: int
    units: tuple[str, ...]
    name: str = ""
    zoned: bool = False
    offset_ns: int = 0

    @property
    def is_readable(self) -> bool:
        """Whether it can be read: it is not dates of an ambiguous format."""
        return OTHER_DATES not in self.units

    @property
    def priority(self) -> tuple[int, int]:
        """Sort key: lowest for the best clock."""
        return self.rank, self.place


def named_clock(key: str, keys: Iterable[str]) -> tuple[int, str, int] | None:
    """Return rank, implied unit and place of a column, by its key; None if it is not a clock."""
    for place, row in enumerate(CLOCKS):
        match = re.fullmatch(row.pattern, key)
        if match and all(
            any(name.startswith(of) for name in keys) for of in match.groupdict().values()
        ):
            return row.rank, row.unit, place
    return None


def stated_offset_ns(unit: str) -> int:
    """Return the UTC offset, ns, that a header has in place of a unit; else 0."""
    match = re.fullmatch(r"(?:utc|gmt)?([+-]?)(\d\d?):?([0-5]\d)", unit)
    if not match:
        return 0
    minutes = int(match[2]) * 60 + int(match[3])
    return (-1 if match[1] == "-" else 1) * minutes * 60 * NS_PER_S


def first_times(cells: Sequence[Sequence[object]], clock: Clock) -> Float64 | None:
    """Return the times of the first rows, ns, as floats for comparison.

    NaN for rows without a time; None if no row has a readable one.
    """
    if not all(map(is_time_unit, clock.units)):
        return None
    parts = [_numbers(column, unit) for column, unit in zip(cells, clock.units, strict=True)]
    times = reduce(np.add, parts)
    if np.isnan(times).all():
        times = _dates(cells[0], zoned=clock.zoned)
    return None if np.isnan(times).all() else times - clock.offset_ns


def _numbers(cells: Sequence[object], unit: str) -> Float64:
    """Return times in ns, as floats; NaN for cells that are none."""
    if unit not in TEXTS:
        scale = time_scale(unit)
        factor = float(10**scale.places * scale.step_ns)
        return numbers_of(cells) * factor + scale.epoch_ns
    times = np.full(len(cells), np.nan)
    for k, cell in enumerate(cells):
        with suppress(ValueError):
            times[k] = from_text(f"{cell}", unit)
    return times


def _dates(cells: Sequence[object], *, zoned: bool) -> Float64:
    import pyarrow as pa

    times = np.full(len(cells), np.nan)
    for k, cell in enumerate(cells):
        try:
            date = pa.scalar(f"{cell}".strip()).cast(pa.timestamp("ns", "UTC" if zoned else None))
        except pa.ArrowInvalid:
            continue
        times[k] = date.value
    return times


def is_constant(times: Float64 | None) -> bool:
    """Return whether a clock has the same time in all rows, as one that was never set."""
    return times is not None and len(times) > 1 and bool((times == times[0]).all())


# Choose a clock among the columns of a table.


_PARTS_OF_A_SECOND = "|".join(name for unit in ("ms", "us", "ns") for name in TIME_UNITS[unit])


def clocks_of(matcher: ColumnMatcher, row: Row, numbers: Group) -> list[Clock]:
    """Return the columns that may be the time; only readable ones if there are any."""
    keys = [matcher.columns[k].key for k in numbers]
    found: dict[int, Clock] = {}
    for place, pattern in enumerate(_conventional(matcher, row)):
        # The time of recording has the rank of a convention only if there is no other timestamp.
        rank = ARRIVAL if found and pattern == row.log_time else CONVENTION
        for k in matcher.matching(pattern):
            found.setdefault(k, clock_at(matcher, k, rank, row.time_unit, place))
    if matcher.selection.clock is None:
        for k in range(len(matcher.columns)):
            column = original(matcher, k)
            named = named_clock(column.key, keys)
            is_clock = named or k in matcher.notes.units
            if k in found or k in numbers or not is_clock or re.fullmatch(INTERVAL, column.key):
                continue
            rank, unit, place = named or (EPOCH, "", len(CLOCKS))
            if re.fullmatch(row.log_time or "(?!)", column.key):
                rank = ARRIVAL
            found[k] = clock_at(matcher, k, rank, unit or column.unit, place)
    # T (K) next to t (s) is a temperature.
    every = list(found.values())
    known = (clock for clock in every if all(map(_may_be_unit, clock.units)))
    by_unit = [*known] or every
    similar = _nearest(matcher, [one for one in by_unit if one.is_readable] or by_unit, keys)
    return nearest_first(similar, numbers, len(matcher.columns))


def original(matcher: ColumnMatcher, k: int) -> Column:
    """Return a column, without the number that makes its name unique if the name is repeated."""
    column = matcher.columns[k]
    name = re.sub(r"(?:\.|_|_duplicated_)\d+$", "", column.text.strip())
    if name == column.text.strip() or all(name != one.text.strip() for one in matcher.columns):
        return column
    return parse_name(name)


def _may_be_unit(unit: str) -> bool:
    units = contradicting_units(unit) or (unit,)
    return unit in {"", OTHER_DATES} or any(map(is_time_unit, units))


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
    if zoned is not None or unit == OTHER_DATES or unit in TEXTS:
        rank = max(rank, TEXT if zoned or offset else LOCAL)
    return Clock((k,), rank, place, (unit,), original(matcher, k).key, bool(zoned), offset)


def utc_offset_ns(matcher: ColumnMatcher, k: int) -> int:
    """Return the UTC offset of local text that the header declares, ns; else 0."""
    is_local = matcher.notes.dates.get(k) is False
    return stated_offset_ns(matcher.columns[k].unit) if is_local else 0


def refuse_unknown_with_arrival(matcher: ColumnMatcher, best: Clock, found: list[Clock]) -> None:
    """Refuse an arrival time if another column may be the sensor's own time."""
    if best.rank == ARRIVAL:
        unknown = {*matcher.matching(rf".*[._]{TIME}")}
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


def nearest_first(found: list[Clock], numbers: Group, count: int) -> list[Clock]:
    """Return clocks, of each name the one that stands nearest to the numbers first.

    Of two as near it is the one before them, unless the clocks of the table stand after.

    `count`: number of columns
    """
    of_name: dict[tuple[int, int, str], list[Clock]] = {}
    for clock in found:
        of_name.setdefault((*clock.priority, clock.name), []).append(clock)
    ordered = []
    for clocks in of_name.values():
        columns = [clock.columns[0] for clock in clocks]
        are_after = min(columns) > 0 and max(columns) == count - 1

        def distance(clock: Clock, *, are_after: bool = are_after) -> tuple[int, bool]:
            k = clock.columns[0]
            away = min((abs(k - number) for number in numbers), default=k)
            return away, (k > max(numbers, default=k)) != are_after

        ordered += sorted(clocks, key=distance)
    return ordered


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
    moving = [clock for clock in found if not is_constant(times[clock])]
    if not moving:
        moving = [clock for clock in unnamed if not is_constant(times[clock])]
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
        of_one_name = (*best.priority, best.name) == (*other.priority, other.name)
        differ = difference(ours, theirs, of_one_name=of_one_name)
        is_rival = best.rank == other.rank != CONVENTION or best.priority == other.priority
        # Of one name, the one next to the numbers is theirs.
        if differ is not None and differ.largest_ns and not of_one_name and is_rival:
            apart = duration_text(differ.largest_ns)
            why = f", which differ by up to {apart} beyond a constant"
            raise ambiguous_time(matcher, [best.columns[0], other.columns[0]], why)
        if said := _beyond_delay(ours, theirs, differ, other):
            matcher.remark("clocks-differ", sentence_on(matcher, best, other, said))
    return best


def _beyond_delay(
    ours: Float64, theirs: Float64, differ: Difference | None, other: Clock
) -> Difference | Unsteady | None:
    """Return how another clock differs; of that of arrival a delay is no difference."""
    if other.rank != ARRIVAL or (differ and not 0 < differ.largest_ns <= NS_PER_S):
        return differ
    unsteady = against_recorded(ours, theirs)
    # Within an interval, times scatter if they are rounded.
    if unsteady and (differ or unsteady.are_shared):
        return unsteady
    # A longer table is compared once it is read.
    return unlike_speed(ours, theirs) if len(ours) < FIRST_ROWS else None


def sentence_on(
    matcher: ColumnMatcher, used: Clock, other: Clock, found: Difference | Unsteady
) -> str:
    """Return a sentence on the difference of two clocks."""
    names = _told_apart(matcher, other), _told_apart(matcher, used)
    way = Setting("time_col", matcher.as_option(other.columns[0]))
    if isinstance(found, Unsteady):
        text = unsteady_text(found, *(f"the times in {name}" for name in reversed(names)))
        return f"{text}, use {way}"
    return f"{difference_text(*names, found)}; to use them, name them with {way}"


def _told_apart(matcher: ColumnMatcher, clock: Clock) -> str:
    """Return the name of a clock, quoted; with its number if others have this name."""
    texts = [column.text.strip() for column in matcher.columns]
    name = matcher.names(clock.columns)
    k = clock.columns[0]
    return name if texts.count(texts[k]) == 1 else f"{name} (column {k})"


def _first_times(matcher: ColumnMatcher, found: list[Clock]) -> dict[Clock, Float64 | None]:
    columns = [k for clock in found for k in clock.columns]
    rows = matcher.first_rows(columns)
    cells = dict(zip(columns, zip(*rows, strict=True), strict=True)) if rows else {}
    return {
        clock: first_times([cells[k] for k in clock.columns], clock) if rows else None
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
        if not is_time_unit(matcher.declared((candidates[0],))):
            ticks = f"{way} and {Setting('sample_rate', 'HZ')} if it counts ticks"
            way = f"{way} and {Setting('time_unit', '|'.join(TIME_UNITS))}, {ticks}"
    steady = f"or {Setting('sample_rate', 'HZ')} for rows at a steady rate"
    return UndeclaredError(matcher.path, what, (f"{way}, {steady}"))


def _shared(a: str, b: str) -> int:
    """Return the number of equal words at the start of two names."""
    pairs = zip(*(re.split(r"[._]", name) for name in (a, b)), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
