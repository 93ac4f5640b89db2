"""Times that depend on the rows before: sums of intervals, and clocks that wrap around."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from quatprop.base.times import NS_PER_S, duration_text
from quatprop.readers.tables.time_units import (
    DAY_COUNTS,
    DAY_DIGITS,
    TEXTS,
    TIME_OF_DAY,
    TIME_OF_HOUR,
    time_scale,
)
from quatprop.timeline.stamps import COUNTERS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.readers.tables.model import Table

    Batches = Iterator[tuple[Int64, Float64]]

Rows = TypeVar("Rows")


class Period(NamedTuple):
    """The period of a clock that begins anew.

    `ns`: how long it counts, ns
    `first_ns`: the time at which it begins anew, ns
    `kind`: the clock, as a remark calls it
    """

    ns: int
    first_ns: int
    kind: str

    @property
    def end_ns(self) -> int:
        """The time that it does not reach, ns."""
        return self.first_ns + self.ns


DAY_NS = 86_400 * NS_PER_S
_HALF_DAY, _HOUR_NS = "a clock of 12 hours", 3600 * NS_PER_S

_OF_CLOCKS = (
    *(Period(period, 0, "a counter of 32 bits") for period in COUNTERS.values()),
    Period(2**16 * NS_PER_S // 1000, 0, "a counter of 16 bits"),
    Period(7 * DAY_NS, 0, "the time of a week"),
    Period(DAY_NS, 0, "the time of a day"),
    Period(DAY_NS // 2, 0, _HALF_DAY),
    Period(DAY_NS // 2, _HOUR_NS, _HALF_DAY),
)
"""Clocks that begin anew after the same time, whatever the unit."""

_CERTAIN_NS = {
    **dict.fromkeys((TIME_OF_DAY, DAY_DIGITS, *DAY_COUNTS.values()), DAY_NS),
    TIME_OF_HOUR: _HOUR_NS,
}
"""Periods of text, ns, which are over wherever it steps back by most of one."""

_BITS, _SIGNED = (16, 24, 32), (16, 32)
"""Sizes of counters of the unit of a column, bits, and of those that may have a sign."""

_SHORTEST_UNIT_NS = 1000
"""Shorter units have counters of 32 bits at least."""


def periods_of(unit: str) -> tuple[Period, ...]:
    """Return the periods after which times in a unit may begin anew."""
    if unit in TEXTS:
        return tuple(period for period in _OF_CLOCKS if period.kind == _HALF_DAY)
    scale = time_scale(unit)
    step_ns = scale.step_ns * 10**scale.places
    periods = list(_OF_CLOCKS)
    for bits in _BITS if step_ns >= _SHORTEST_UNIT_NS else _BITS[-1:]:
        kind = f"a counter of {bits} bits"
        firsts = (0, -(2 ** (bits - 1))) if bits in _SIGNED else (0,)
        periods += (Period(int(step_ns * 2**bits), int(step_ns * first), kind) for first in firsts)
    return tuple(periods)


_FAR = 10
"""Maximum number of usual intervals at which a counter continues after it has wrapped around."""

_SHARE = 50
"""Nor more than this part of its period: one in ns wraps around every 4.3 s."""

_FEWEST = 3
"""Fewest usual intervals in a period that is shorter than that allows."""


def summed(batches: Batches) -> Batches:
    """Yield rows with the sums of their intervals, the first at 0 ns."""
    total = None
    for intervals, numbers in batches:
        times = np.cumsum(intervals)
        times += -times[0] if total is None else total
        total = int(times[-1])
        yield times, numbers


class Unwrapping:
    """Continues a clock that begins anew.

    `periods`: its possible periods; it has reached the end of one where it goes on from its begin
    `certain_ns`: period, ns, that is over wherever the clock steps back by most of it; 0: none
    `count`, `period`: how often it began anew, and after which period
    """

    def __init__(self, periods: tuple[Period, ...], certain_ns: int = 0) -> None:
        self._periods = (*periods, *[Period(certain_ns, 0, "")][: certain_ns > 0])
        self._certain_ns = certain_ns
        self._last: int | None = None
        self._usual = 0
        self.count = 0
        self.period = self._periods[0]

    def apply(self, batches: Iterator[tuple[Int64, Rows]]) -> Iterator[tuple[Int64, Rows]]:
        """Yield rows with their times continued."""
        for t_ns, numbers in batches:
            if not len(t_ns):
                continue
            first, last = int(t_ns[0]), int(t_ns[-1])
            latest = first if self._last is None else self._last
            if self.count or first < latest or (t_ns[1:] < t_ns[:-1]).any():
                t_ns = self._continued(np.append(latest, t_ns[:-1]), t_ns)  # noqa: PLW2901
            else:
                self._usual = (last - first) // max(len(t_ns) - 1, 1)
            self._last = last
            yield t_ns, numbers

    def _continued(self, before: Int64, t_ns: Int64) -> Int64:
        rising = t_ns[t_ns > before] - before[t_ns > before]
        usual = max(int(np.median(rising)) if len(rising) else 0, self._usual)
        for period in (self.period,) if self.count else self._periods:
            down = self._wraps(before, t_ns, period, usual)
            if not self.count and (not down.any() or _shows_others(t_ns, period)):
                continue
            # A row from before that came late, which none can before the first turn.
            up = self._wraps(t_ns, before, period, usual)
            up &= (self.count > 0) | np.logical_or.accumulate(down)
            turns = self.count + np.cumsum(down.astype(np.int64) - up)
            if turns.any():
                self.period, self.count = period, int(turns[-1])
                return t_ns + turns * period.ns
        return t_ns

    def _wraps(self, before: Int64, after: Int64, period: Period, usual: int) -> Bool:
        """Return where times go on after the end of a period."""
        if period.ns == self._certain_ns:
            return before - after > period.ns // 2
        near = min(_FAR * usual, period.ns // _SHARE)
        past, left = after - period.first_ns, period.end_ns - before
        is_near = (past >= 0) & (past < near) & (left > 0) & (left <= near)
        if near >= 2 * usual or period.ns < _FEWEST * usual:
            return is_near
        # Of few rows in a period, the next one comes after about the usual interval. Times far off,
        # whose sum may exceed int64, are left out first.
        is_steady = (past >= 0) & (past < 2 * usual) & (left > 0) & (left < 2 * usual)
        is_steady &= np.abs(past + left - usual) <= usual // 2
        return np.asarray(is_near | is_steady)


def _shows_others(t_ns: Int64, period: Period) -> bool:
    """Return whether a clock shows times that it has not in a period, more than one of damage."""
    return bool(np.count_nonzero((t_ns < period.first_ns) | (t_ns >= period.end_ns)) > 1)


def unwrapped(
    batches: Iterator[tuple[Int64, Rows]], unit: str, table: Table
) -> Iterator[tuple[Int64, Rows]]:
    """Yield rows of a clock that begins anew with times that do not.

    `unit`: unit of the time in the file
    `table`: gets a remark if it did, unless it shows times of day or of the hour
    """
    clock = Unwrapping(periods_of(unit), _CERTAIN_NS.get(unit, 0))
    yield from clock.apply(batches)
    if clock.count and clock.period.kind:
        table.remark(
            "counter-wrapped",
            f"the time wrapped around {clock.count} time{'s' * (clock.count > 1)} after "
            f"{duration_text(clock.period.ns)}, as {clock.period.kind}, and is continued",
        )
