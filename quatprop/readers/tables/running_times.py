"""Times that depend on the rows before: sums of intervals, and clocks that wrap around."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from quatprop.base.times import NS_PER_S, duration_text
from quatprop.readers.tables.time_units import TIME_OF_DAY, time_scale
from quatprop.timeline.stamps import COUNTERS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.readers.tables.model import Table

    Batches = Iterator[tuple[Int64, Float64]]

Rows = TypeVar("Rows")


DAY_NS = 86_400 * NS_PER_S

_FAR = 10
"""Maximum number of usual intervals at which a counter continues after it has wrapped around."""

_SHARE = 50
"""Nor more than this part of its period: one in ns wraps around every 4.3 s."""


def summed(batches: Batches) -> Batches:
    """Yield rows with the sums of their intervals, the first at 0 ns."""
    total = None
    for intervals, numbers in batches:
        times = np.cumsum(intervals)
        times += -times[0] if total is None else total
        total = int(times[-1])
        yield times, numbers


class Unwrapping:
    """Continues a clock that wraps around.

    `periods_ns`: its possible periods, ns
    `is_certain`: whether it wraps wherever it steps back by most of a period, as a time of day; a
        counter does if it reaches its end, and goes on from 0
    `count`, `period_ns`: how often it wrapped around, and after how long, ns
    """

    def __init__(self, periods_ns: tuple[int, ...], *, is_certain: bool = False) -> None:
        self._periods, self._is_certain = periods_ns, is_certain
        self._last: int | None = None
        self._usual = 0
        self.count = 0
        self.period_ns = 0

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
        for period in (self.period_ns,) if self.count else self._periods:
            down = self._wraps(before, t_ns, period, usual)
            if not (self.count or down.any()):
                continue
            # A row from before that came late, which none can before the first turn.
            up = self._wraps(t_ns, before, period, usual)
            up &= (self.count > 0) | np.logical_or.accumulate(down)
            turns = self.count + np.cumsum(down.astype(np.int64) - up)
            if turns.any():
                self.period_ns, self.count = period, int(turns[-1])
                return t_ns + turns * period
        return t_ns

    def _wraps(self, before: Int64, after: Int64, period: int, usual: int) -> Bool:
        """Return where times go on after the end of a period."""
        if self._is_certain:
            return before - after > period // 2
        near = min(_FAR * usual, period // _SHARE)
        at_end = (before < period) & (before >= period - near)
        return at_end & (after >= 0) & (after < near)


def unwrapped(
    batches: Iterator[tuple[Int64, Rows]], unit: str, table: Table
) -> Iterator[tuple[Int64, Rows]]:
    """Yield rows of a counter of 32 bits, or of times of day, with times that do not wrap around.

    `unit`: unit of the time in the file
    `table`: gets a remark if a counter did
    """
    if unit == TIME_OF_DAY:
        yield from Unwrapping((DAY_NS,), is_certain=True).apply(batches)
        return
    scale = time_scale(unit)
    of_unit = int(scale.step_ns * 10**scale.places * 2**32)
    clock = Unwrapping((*COUNTERS.values(), of_unit))
    yield from clock.apply(batches)
    if clock.count:
        table.remark(
            "counter-wrapped",
            f"the time wrapped around {clock.count} time{'s' * (clock.count > 1)} after "
            f"{duration_text(clock.period_ns)}, as a counter of 32 bits, and is continued",
        )
