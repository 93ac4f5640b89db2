"""Columns that are watched from the first row to the last: other clocks, and numbers of rows."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from quatprop.base.errors import UndeclaredError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S, NS_PER_UNIT, duration_text
from quatprop.readers import clocks
from quatprop.readers.clock_difference import ENOUGH, unlike_speed
from quatprop.readers.odd_clocks import TICKING, may_be_clock
from quatprop.readers.tables.other_clocks import OtherClock, SampledTimes, divergence
from quatprop.readers.tables.row_numbers import NumberedRows
from quatprop.readers.tables.table_log import numbers_of
from quatprop.readers.tables.time_units import is_time_unit, ticks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.base.arrays import Float64, Intp
    from quatprop.readers.clocks import Clock
    from quatprop.readers.matching import ColumnMatcher
    from quatprop.readers.tables.model import Group, Stamp
    from quatprop.readers.tables.row_numbers import Breaks
    from quatprop.readers.tables.turns import WatchedColumn
    from quatprop.readers.vocabulary import Row


NO_COLUMN = "none"
"""The time column of rows that are counted."""

_ONE_BY_ONE = 0.95
"""Share of the first rows from which on a column of any name numbers them, or their packets."""

_MOST_MISSING = 0.1
"""Share of packets that follow a missing one, up to which they are still seen to be regular."""

TICK_RATES = {"sample_time_fine": 10_000}
"""Key of a column without a unit -> its ticks a second, as MT Manager writes it."""

_UNLIKE, _FASTEST = 0.02, 10
"""Clocks contradict each other if they differ by this share, and by no larger factor."""

_FEW, _FEWEST_NUMBERS = 20, 8
"""First rows that are looked at before the others, and fewest numbers in these."""


def columns_next_to_clock(
    matcher: ColumnMatcher, used: Clock, numbers: Group, found: Sequence[Clock]
) -> tuple[WatchedColumn, ...]:
    """Return the other clocks, and the numbers of rows that the used times may contradict.

    `found`: the clocks that were compared over the first rows
    """
    times = _sampled_times(matcher, used)
    if times is None:
        return ()
    numbered = (
        NumberedRows(k, partial(_remark_on_evenly_missed, matcher, k, used.columns), times)
        for k in _row_numbers(matcher, numbers)
        if k not in used.columns
    )
    others = _other_clocks(matcher, used, times, numbers, found)
    return (*others, *numbered)


def columns_at_rate(
    matcher: ColumnMatcher, rate: Fraction | float, numbers: Group, why: str = "if all were there"
) -> tuple[WatchedColumn, ...]:
    """Return the numbers of rows that are counted at a sample rate, Hz; `why`: after "as"."""
    but = f"but rows are counted, as {why}"
    return tuple(
        NumberedRows(k, partial(_remark_on_missed, matcher, k, rate, but=but))
        for k in _row_numbers(matcher, numbers)
    )


def counter_without_gaps(matcher: ColumnMatcher, k: int, given: str) -> NumberedRows:
    """Return a counter of larger steps that is not used, and is refused if it misses some."""
    return NumberedRows(k, partial(_refuse_gaps, matcher, k, given))


def _sampled_times(matcher: ColumnMatcher, clock: Clock) -> SampledTimes | None:
    """Return the used clock for comparison; None if its unit is not known."""
    if clock.units == ("",):
        clock = clock._replace(units=(matcher.selection.time_unit or "",))
    is_text = clock.columns[0] in matcher.notes.dates
    if not (is_text or all(map(is_time_unit, clock.units))):
        return None
    return SampledTimes(clock.columns, partial(clocks.first_times, clock=clock))


def _other_clocks(
    matcher: ColumnMatcher,
    used: Clock,
    times: SampledTimes,
    numbers: Group,
    compared: Sequence[Clock],
) -> list[OtherClock]:
    """Return the other clocks of a table, of whatever rank."""
    keys = [matcher.columns[k].key for k in numbers]
    arrival = {one.columns for one in compared if one.rank == clocks.ARRIVAL}
    found = []
    for k in range(len(matcher.columns)):
        if k in used.columns or k in numbers or not may_be_clock(matcher, k, keys):
            continue
        if not matcher.table.are_of_same_rows((k, *numbers)):
            continue
        rank = clocks.ARRIVAL if (k,) in arrival else clocks.EPOCH
        clock = clocks.clock_at(matcher, k, rank, "", 0)
        has_unit = _has_unit(matcher, clock)
        read = partial(clocks.first_times, clock=clock) if has_unit else _as_they_are
        compare = partial(_compare, matcher, used, clock)
        found.append(OtherClock(times, SampledTimes((k,), read), compare))
    return found


def _as_they_are(cells: Sequence[Sequence[object]]) -> Float64:
    """Return numbers whose unit is not known."""
    return numbers_of(cells[0])


def _has_unit(matcher: ColumnMatcher, clock: Clock) -> bool:
    """Return whether the unit of a clock is known."""
    return clock.columns[0] in matcher.notes.dates or is_time_unit(clock.units[0])


def _compare(
    matcher: ColumnMatcher, used: Clock, other: Clock, times: tuple[Float64, Float64], rows: Intp
) -> None:
    """Remark on a clock that comes apart, or on times that go otherwise than those of arrival."""
    names = matcher.names(other.columns), matcher.names(used.columns)
    if any(one.code == "clocks-differ" and names[0] in one for one in matcher.remarks):
        return
    if (apart := divergence(*times)) is not None:
        first, last = rows[apart.largest : apart.largest + 2] + 1
        by = duration_text(round(float(f"{abs(apart.by / apart.speed):.3g}")))
        how = f"go {by} further than" if apart.by > 0 else f"fall {by} behind"
        unit = "" if _has_unit(matcher, other) else f" and {Setting('time_unit', 's|ms|us|ns')}"
        matcher.table.remark(
            "clocks-part",
            f"the times in {names[0]} {how} those in {names[1]}, which are used, by a jump between "
            f"rows {first} and {last}; to use them, name them with "
            f"{Setting('time_col', matcher.as_option(other.columns[0]))}{unit}",
        )
    elif (
        other.rank == clocks.ARRIVAL
        and _has_unit(matcher, other)
        and (unlike := unlike_speed(*times))
    ):
        said = clocks.sentence_on(matcher, used, other, unlike)
        matcher.table.remark("clocks-differ", said)


def unlike_clocks(
    matcher: ColumnMatcher, row: Row, numbers: Group, stamp: Stamp, unit: str = ""
) -> str:
    """Return how long the first rows take by a clock that contradicts; empty if none does.

    `stamp`: counts rows or samples at its rate, or sums intervals in the `unit`
    """
    if matcher.selection.clock is not None:
        return ""
    ticking = [(k, f"{hz}") for name, hz in TICK_RATES.items() for k in matcher.matching(name)]
    others = [(clock, "") for clock in clocks.clocks_of(matcher, row, numbers)]
    for k, hz in ticking:
        others.append((clocks.clock_at(matcher, k, clocks.SENSOR, ticks(Fraction(hz)), 0), hz))
    for clock, hz in others:
        if clock.rank == clocks.ARRIVAL or {*clock.columns} & {*stamp.columns, *numbers}:
            continue
        cells = [*zip(*matcher.first_rows((*clock.columns, *stamp.columns)), strict=True)]
        if not cells or not _has_unit(matcher, clock):
            continue
        theirs = clocks.first_times(cells[: len(clock.columns)], clock)
        ours = numbers_of(cells[-1]) if stamp.columns else np.arange(len(cells[0]), dtype=float)
        if stamp.sample_rate is not None:
            ours *= NS_PER_S / float(stamp.sample_rate)
        else:
            ours = np.cumsum(ours) * NS_PER_UNIT.get(unit, 0)
        if theirs is not None and (spans := _unlike_spans(ours, theirs)):
            own, other = (duration_text(round(float(f"{span:.4g}"))) for span in spans)
            way = Setting("time_col", matcher.as_option(clock.columns[0]))
            return (
                f"by the times in {matcher.names(clock.columns)}, the first {len(ours)} rows take "
                f"{other}, not {own}; to use these, give {way}"
                + (f" and {Setting('sample_rate', hz)}" if hz else "")
            )
    return ""


def _unlike_spans(ours: Float64, theirs: Float64) -> tuple[float, float] | None:
    """Return how long rows take by two clocks, ns; None if they agree, or one is in no order."""
    if len(ours) < ENOUGH or not (np.diff([ours, theirs]) >= 0).all():
        return None
    own, other = float(ours[-1] - ours[0]), float(theirs[-1] - theirs[0])
    differ = abs(other - own) > max(_UNLIKE, 2 / len(ours)) * own
    # A larger ratio is that of another unit.
    return (own, other) if differ and own / _FASTEST < other < own * _FASTEST else None


# Numbers of rows.


def _row_numbers(matcher: ColumnMatcher, numbers: Group) -> list[int]:
    """Return the columns that may number the rows: by their names, or counting one by one."""
    named = [k for k in matcher.matching(f"{clocks.INDEX}|{clocks.COUNTER}") if k not in numbers]
    known = {*numbers, *named, *matcher.matching(TICKING)}
    others = [
        k
        for k, is_number in matcher.table.label_columns().items()
        if is_number and k not in known and not matcher.declared((k,))
        if not may_be_clock(matcher, k)
    ]
    cells = zip(*matcher.first_rows(others), strict=True) if others else ()
    found = [*named, *(k for k, each in zip(others, cells, strict=False) if _count_on(each))]
    return [k for k in found if matcher.table.are_of_same_rows((k, *numbers))]


def _count_on(cells: Sequence[object]) -> bool:
    """Return whether the numbers of a column of any name go on one by one, or packet by packet."""
    for first in (cells[:_FEW], cells):
        steps = np.diff(numbers_of(first))
        if len(steps) and np.mean((steps == 0) | (steps == 1)) < _ONE_BY_ONE:
            return False
        if len({*cells}) < _FEWEST_NUMBERS:
            return False
    return True


def undeclared_counter(matcher: ColumnMatcher, k: int, counts: str, given: str) -> UndeclaredError:
    """Return the error for a counter of larger steps that misses some."""
    use = Setting("time_col", matcher.as_option(k))
    return UndeclaredError(
        matcher.path,
        f"whether {counts} counts samples",
        (f"{use} and {given} if it does, or {Setting('time_col', NO_COLUMN)} and "
            f"{given} to count rows"),
    )  # fmt: skip


def _refuse_gaps(matcher: ColumnMatcher, k: int, given: str, breaks: Breaks) -> NoReturn:
    """Refuse a counter of larger steps that misses some behind the first rows."""
    counts = f"the counter {matcher.names((k,))}, which usually steps by {breaks.step}, but"
    raise undeclared_counter(matcher, k, f"{counts} {breaks},", given)


def _remark_on_evenly_missed(matcher: ColumnMatcher, k: int, time: Group, breaks: Breaks) -> None:
    """Remark on numbers that are passed over, though the times go on evenly."""
    if breaks.missed.times:
        rate = float(f"{NS_PER_S / breaks.interval_ns:.6g}")
        evenly = f"though the times in {matcher.names(time)} go on evenly"
        _remark_on_missed(matcher, k, rate, breaks, evenly)


def _remark_on_missed(
    matcher: ColumnMatcher,
    k: int,
    rate: Fraction | float,
    breaks: Breaks,
    but: str,
) -> None:
    """Remark on numbers of rows that do not go on; `but`: what the times do."""
    packets, by_packet = "", ""
    if breaks.rows > 1:
        packets = f", which is the same in {breaks.rows} rows,"
        # Where packets are missing so often, what is left shows no steady clock.
        by_packet = "" if breaks.share > _MOST_MISSING else f" and {Setting('regular_time')}"
    given = Setting("sample_rate", f"{float(rate) * breaks.step / breaks.rows:g}")
    use = f"give {Setting('time_col', matcher.as_option(k))} and {given}{by_packet}"
    way = f"if it counts samples, {use}" if breaks.uneven.times else f"to count by it, {use}"
    if breaks.stepped_back.times:
        way = "if another recording begins where it steps back, write that to its own log"
    matcher.table.remark(
        "index-gaps",
        f"{matcher.names((k,))}{packets} {breaks}, {but}; {way}",
    )
