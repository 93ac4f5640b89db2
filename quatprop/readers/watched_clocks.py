"""Clocks of a table beside the used one, which are watched from the first row to the last."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from quatprop.base.text import Setting
from quatprop.base.times import duration_text
from quatprop.readers import clocks
from quatprop.readers.odd_clocks import may_be_clock
from quatprop.readers.tables.side_clocks import SampledTimes, SideClock
from quatprop.readers.tables.table_log import numbers_of
from quatprop.readers.tables.time_units import is_time_unit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.base.arrays import Float64
    from quatprop.readers.clocks import Clock
    from quatprop.readers.matching import ColumnMatcher
    from quatprop.readers.tables.model import Group
    from quatprop.readers.tables.side_clocks import Parting


def sampled_times(matcher: ColumnMatcher, clock: Clock) -> SampledTimes | None:
    """Return the used clock for comparison; None if its unit is not known."""
    if clock.units == ("",):
        clock = clock._replace(units=(matcher.selection.time_unit or "",))
    is_text = clock.columns[0] in matcher.notes.dates
    if not (is_text or all(map(is_time_unit, clock.units))):
        return None
    return SampledTimes(clock.columns, partial(clocks.first_times, clock=clock))


def clocks_beside(
    matcher: ColumnMatcher, used: Clock, times: SampledTimes, numbers: Group
) -> list[SideClock]:
    """Return the other clocks of a table, of whatever rank."""
    keys = [matcher.columns[k].key for k in numbers]
    found = []
    for k in range(len(matcher.columns)):
        if k in used.columns or k in numbers or not may_be_clock(matcher, k, keys):
            continue
        if not matcher.table.are_of_same_rows((k, *numbers)):
            continue
        clock = clocks.clock_at(matcher, k, clocks.EPOCH, "", 0)
        has_unit = _has_unit(matcher, clock)
        read = partial(clocks.first_times, clock=clock) if has_unit else _as_they_are
        report = partial(_remark, matcher, used, clock)
        found.append(SideClock(times, SampledTimes((k,), read), report))
    return found


def _as_they_are(cells: Sequence[Sequence[object]]) -> Float64:
    """Return numbers whose unit is not known."""
    return numbers_of(cells[0])


def _has_unit(matcher: ColumnMatcher, clock: Clock) -> bool:
    """Return whether the unit of a clock is known."""
    return clock.columns[0] in matcher.notes.dates or is_time_unit(clock.units[0])


def _remark(
    matcher: ColumnMatcher, used: Clock, other: Clock, parted: Parting, rows: tuple[int, int]
) -> None:
    ours, theirs = matcher.names(used.columns), matcher.names(other.columns)
    if any(remark.code == "clocks-differ" and theirs in remark for remark in matcher.remarks):
        return
    by = duration_text(round(float(f"{abs(parted.by / parted.speed):.3g}")))
    how = f"go {by} further than" if parted.by > 0 else f"fall {by} behind"
    unit = "" if _has_unit(matcher, other) else f" and {Setting('time_unit', 's|ms|us|ns')}"
    matcher.table.remark(
        "clocks-part",
        f"the times in {theirs} {how} those in {ours}, which are used, by a jump between rows "
        f"{rows[0]} and {rows[1]}; to use them, name them with "
        f"{Setting('time_col', matcher.as_option(other.columns[0]))}{unit}",
    )
