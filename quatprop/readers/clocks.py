"""Clocks of tables: which columns may be the time, their priority, and whether they agree.

A row of :data:`CLOCKS` has the names and the rank of a clock. The best clock that is not constant
is used, and compared with the others over the first rows.
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
"""Ranks, best first: timestamp of a known convention, sampling time of the sensor, number since an
epoch, text with a UTC offset, local text, time of arrival or recording."""

_QUARTER_NS = 900 * NS_PER_S
_LARGEST_OFFSET_NS = 14 * 3600 * NS_PER_S
_ROUNDING_NS = NS_PER_S
_FROM_2000_NS = 946_684_800 * NS_PER_S

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

INDEX = r"(?:.*[._])?(?:frame|index|idx|count|samples?|n|no|num|number)"
"""Names of columns that may count samples, or only rows."""


class Clock(NamedTuple):
    """A column that may be the time, or two columns of seconds and their fraction.

    `rank`, `place`: its rank, and its place within the rank
    `units`: unit of each column; ``""``: not declared
    `zoned`: whether its text has UTC offsets
    `offset_ns`: UTC offset of local text declared by the header, ns
    """

    columns: tuple[int, ...]
    rank: int
    place: int
    units: tuple[str, ...]
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


def is_constant(times: Float64 | None) -> bool:
    """Return whether a clock has the same time in all rows, as one that was never set."""
    return times is not None and len(times) > 1 and bool((times == times[0]).all())


class Difference(NamedTuple):
    """Difference of another clock from the one used, ns.

    `constant_ns`: median, positive if the other one is ahead
    `largest_ns`: maximum deviation from the median; 0 for a UTC offset
    """

    constant_ns: int
    largest_ns: int


def difference(used: Float64, other: Float64) -> Difference | None:
    """Return the difference between two clocks; None if it is constant and not a UTC offset.

    Differences up to a step of either clock are rounding.
    """
    apart = other - used
    apart = apart[np.isfinite(apart)]
    if len(apart) < 2:  # noqa: PLR2004  # one says nothing
        return None
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
    """Return a UTC offset as text, such as ``+01:00``."""
    minutes = abs(ns) // NS_PER_S // 60
    return f"{'-' if ns < 0 else '+'}{minutes // 60:02d}:{minutes % 60:02d}"


def difference_text(other: str, used: str, found: Difference) -> str:
    """Return a sentence on the difference of two clocks; the names are already quoted."""
    if not found.largest_ns:
        return (
            f"the times in {other} are those in {used}, which are used, at a UTC offset of "
            f"{offset_text(found.constant_ns)}"
        )
    return (
        f"the times in {other} differ from those in {used}, which are used, by up to "
        f"{duration_text(found.largest_ns)} beyond a constant"
    )
