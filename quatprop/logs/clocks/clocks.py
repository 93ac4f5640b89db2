"""Clocks of tables: which columns may be the time, how good each is, and whether they agree.

A clock is a row of :data:`CLOCKS`: the names of its columns and its rank. The best clock that moves
is taken; what another one says is compared with it over the first rows.
"""

from __future__ import annotations

import re
from functools import reduce
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.tables.base import OTHER_DATES, numbers_of
from quatprop.times import NS_PER_S, NS_PER_UNIT, duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from quatprop.arrays import Float64

CONVENTION, SENSOR, EPOCH, TEXT, LOCAL, ARRIVAL = range(6)
"""Ranks: the stamp of a known convention; the sensor's sampling time; a number since some epoch;
text with its offset from UTC; local text; when something arrived or was written down."""

_QUARTER_NS = 900 * NS_PER_S
_LARGEST_OFFSET_NS = 14 * 3600 * NS_PER_S
_ROUNDING_NS = NS_PER_S
_FROM_2000_NS = 946_684_800 * NS_PER_S

TIME = r"(?:t|ts|time|timestamp|time_?stamp|stamp)"


class ClockName(NamedTuple):
    """How sources name a clock.

    `pattern`: regular expression for whole keys of columns. A group ``of`` is the beginning of the
        name of what was sampled: of other sensors, the clock is not that of the rates
    `rank`: one of the ranks above
    `unit`: the unit that the name implies where nothing declares one
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
"""Names of clocks; the first row that fits counts, and comes first among those of its rank."""

COUNTER = (
    r"(?:.*[._])?(?:packet|sample|frame|row|message|msg|record)?_?(?:counter|seq|sequence|cnt)"
    r"(?:_?(?:no|num|number|id))?|(?:packet|sample|frame)_?(?:count|no|num|number|index|id)"
)
"""Names of what may count the samples of a sensor, also those that were lost."""

INDEX = r"(?:.*[._])?(?:frame|index|idx|count|samples?|n|no|num|number)"
"""Names of what may count samples, or only rows that were written."""


class Clock(NamedTuple):
    """A column that may be the time, or those of its seconds and their fraction.

    `rank`, `place`: how good it is, and which of those of its rank
    `units`: the unit of each column; ``""`` where nothing declares it
    `zoned`: whether its text has offsets from UTC
    `offset_ns`: the offset of local text that the header states, ns
    """

    columns: tuple[int, ...]
    rank: int
    place: int
    units: tuple[str, ...]
    zoned: bool = False
    offset_ns: int = 0

    @property
    def is_readable(self) -> bool:
        """Whether it is not one of dates that can be read in several ways."""
        return OTHER_DATES not in self.units

    @property
    def goodness(self) -> tuple[int, int]:
        """What is lowest of the best clock."""
        return self.rank, self.place


def named_clock(key: str, keys: Iterable[str]) -> tuple[int, str, int] | None:
    """Return rank, implied unit and place of a column by its key; None if it is no clock."""
    for place, row in enumerate(CLOCKS):
        match = re.fullmatch(row.pattern, key)
        if match and all(
            any(name.startswith(of) for name in keys) for of in match.groupdict().values()
        ):
            return row.rank, row.unit, place
    return None


def stated_offset_ns(unit: str) -> int:
    """Return the offset of local time from UTC that stands in the place of a unit, ns."""
    match = re.fullmatch(r"(?:utc|gmt)?([+-]?)(\d\d?):?([0-5]\d)", unit)
    if not match:
        return 0
    minutes = int(match[2]) * 60 + int(match[3])
    return (-1 if match[1] == "-" else 1) * minutes * 60 * NS_PER_S


def first_times(cells: Sequence[Sequence[object]], clock: Clock) -> Float64 | None:
    """Return the times of the first rows, ns; NaN where there is none, None if they are unknown.

    Floats are enough to compare them.
    """
    if not all(unit in NS_PER_UNIT for unit in clock.units):
        return None
    parts = [
        numbers_of(column) * NS_PER_UNIT[unit]
        for column, unit in zip(cells, clock.units, strict=True)
    ]
    times = reduce(np.add, parts)
    if np.isnan(times).all():
        times = _dates(cells[0], zoned=clock.zoned)
    return None if np.isnan(times).all() else times - clock.offset_ns


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


def stands_still(times: Float64 | None) -> bool:
    """Return whether a clock has the same time in all rows: it was never set."""
    return times is not None and len(times) > 1 and bool((times == times[0]).all())


class Difference(NamedTuple):
    """How another clock differs from the one that is used, ns.

    `constant_ns`: by how much it is ahead, usually
    `largest_ns`: how far it is off that at most
    """

    constant_ns: int
    largest_ns: int


def difference(used: Float64, other: Float64) -> Difference | None:
    """Return how a clock differs from another one; None where they are the same but for a constant.

    Clocks of whole seconds may be off by one, and all by a sampling interval.
    """
    apart = other - used
    apart = apart[np.isfinite(apart)]
    if len(apart) < 2:  # noqa: PLR2004  # one says nothing
        return None
    # A clock that is ahead by a constant and rounds down is ahead by the largest difference.
    constant = float(np.median(apart))
    largest = float(np.abs(apart - constant).max())
    tolerance = max(_usual_step(used, np.median), _usual_step(other, np.min))
    nearest = round(constant / _QUARTER_NS) * _QUARTER_NS
    if largest > tolerance:
        return Difference(round(constant), round(largest))
    is_absolute = min(np.nanmin(used), np.nanmin(other)) > _FROM_2000_NS
    is_of_zone = 0 < abs(nearest) <= _LARGEST_OFFSET_NS and abs(constant - nearest) <= _ROUNDING_NS
    return Difference(nearest, 0) if is_absolute and is_of_zone else None


def _usual_step(times: Float64, which: object) -> float:
    steps = np.diff(times[np.isfinite(times)])
    steps = steps[steps > 0]
    return float(which(steps)) if len(steps) else 0.0  # type: ignore[operator]


def offset_text(ns: int) -> str:
    """Return an offset from UTC as dates have it."""
    minutes = abs(ns) // NS_PER_S // 60
    return f"{'-' if ns < 0 else '+'}{minutes // 60:02d}:{minutes % 60:02d}"


def difference_text(other: str, used: str, found: Difference) -> str:
    """Return a sentence on two clocks, whose names are quoted already."""
    if not found.largest_ns:
        return (
            f"the times in {other} are those in {used}, which are used, at a UTC offset of "
            f"{offset_text(found.constant_ns)}"
        )
    return (
        f"the times in {other} differ from those in {used}, which are used, by up to "
        f"{duration_text(found.largest_ns)} beyond a constant"
    )
