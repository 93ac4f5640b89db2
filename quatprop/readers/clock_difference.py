"""The difference of two clocks of a table, or of messages, over the first rows."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S, duration_text
from quatprop.timeline.counts import MANY_REPEATS
from quatprop.timeline.stamps import are_steady, spread

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.base.arrays import Float64, Int64
    from quatprop.readers.tables.model import RowBatch


_QUARTER_NS = 900 * NS_PER_S
_LARGEST_OFFSET_NS = 14 * 3600 * NS_PER_S
_ROUNDING_NS = NS_PER_S
_LEAST_NS, _ROUNDED = 1_000, 1e-3
"""Clocks of one name that differ by less than this, ns or relative to an interval, are the same."""
_FROM_2000_NS = 946_684_800 * NS_PER_S


class Difference(NamedTuple):
    """Difference of another clock from the one used, ns.

    `constant_ns`: median, positive if the other one is ahead
    `largest_ns`: maximum deviation from the median; 0 for a constant
    """

    constant_ns: int
    largest_ns: int

    @property
    def is_zone(self) -> bool:
        """Whether it may be a UTC offset."""
        return not self.largest_ns and self.constant_ns % _QUARTER_NS == 0


def difference(used: Float64, other: Float64, *, of_one_name: bool = False) -> Difference | None:
    """Return the difference between two clocks; None if it is constant and not a UTC offset.

    Differences up to a step of either clock are rounding.

    `of_one_name`: whether a constant difference is returned too
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
    if is_absolute and is_of_zone:
        return Difference(nearest, 0)
    is_apart = of_one_name and abs(constant) > max(_LEAST_NS, _ROUNDED * tolerance)
    return Difference(round(constant), 0) if is_apart else None


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
    if not found.largest_ns and not found.is_zone:
        side = "ahead of" if found.constant_ns > 0 else "behind"
        apart = duration_text(abs(found.constant_ns))
        return f"the times in {other} are {apart} {side} those in {used}, which are used"
    if not found.largest_ns:
        return (
            f"the times in {other} are those in {used}, which are used, at a UTC offset of "
            f"{offset_text(found.constant_ns)}"
        )
    return (
        f"the times in {other} differ from those in {used}, which are used, by up to "
        f"{duration_text(found.largest_ns)} beyond a constant"
    )


# The time of recording is that of the sample and a delay. Where it is steady, the sample's is.


ENOUGH = 20
"""Fewest rows whose times are compared with those of recording."""
_FASTEST = 20
"""A larger ratio is that of another unit, or of a log that was written at once."""
_WIDER, _SCATTER = 2, 0.2
"""Scatter of intervals, relative to that of those of recording and as a share of them, below which
it does not matter."""
_SPEED = 1e-3
"""Clocks of unequal speed differ by this share: quartz has a tenth, a sensor's own ten times."""
_PARTS, _FEWEST_PARTS = 64, 8
"""Parts of the time whose least delays are compared."""
_FILLED = 0.8
"""Smallest share of these parts that have rows."""
_SIGNIFICANT = 4.0
"""Clocks of unequal speed part by so many times as much as these scatter about a line."""


def stamps_and_log_times(batches: Iterable[RowBatch], least: int = 1) -> tuple[Int64, Int64]:
    """Return the timestamps of the first batches, and the times of their recording, ns.

    `least`: fewest rows, if there are as many
    """
    found, count = [(np.empty(0, np.int64),) * 2], 0
    for rows in batches:
        found.append((rows.values[0], rows.log_ns))
        count += len(rows)
        if count >= least:
            break
    stamps, log_ns = map(np.concatenate, zip(*found, strict=True))
    return stamps, log_ns


class Unsteady(NamedTuple):
    """How times contradict those of recording.

    `interval_ns`: median interval of those of recording, ns, if these are steady
    `are_shared`: whether samples share them, as those of a packet
    `speed`: how fast they go, 1 for as fast
    `scatter_ns`: by how much their intervals scatter, ns; 0: not more than those of recording
    """

    interval_ns: int = 0
    are_shared: bool = False
    speed: float = 1.0
    scatter_ns: int = 0


def against_recorded(used: Float64 | Int64, recorded: Float64 | Int64) -> Unsteady | None:
    """Return how times contradict those of recording; None if they do not.

    That is if these are not steady, too: a delay that varies is usual.
    """
    known = np.isfinite(used) & np.isfinite(recorded) & (used != 0)
    used, recorded = used[known], recorded[known]
    lag = len(used) // 2
    if len(used) < ENOUGH or not (recorded[lag:] > recorded[: len(used) - lag]).all():
        return None
    if not are_steady(recorded):
        return None
    steps = np.diff(used)
    low, middle, high = spread(np.diff(recorded))
    interval_ns = round(middle)
    if np.count_nonzero(steps == 0) >= MANY_REPEATS * len(steps):
        return Unsteady(interval_ns, are_shared=True)
    least, usual, most = spread(steps)
    scatter = most - least
    is_large = scatter > max(_WIDER * (high - low), _SCATTER * max(middle, usual))
    return Unsteady(interval_ns, scatter_ns=round(scatter)) if is_large else None


def unlike_speed(used: Float64 | Int64, recorded: Float64 | Int64) -> Unsteady | None:
    """Return how fast times go relative to those of recording; None if as fast, or not known.

    Messages are recorded late by a delay that varies, never early, so only the least delay in each
    part of the time tells of the clocks. Their speeds differ if these delays lie on a straight
    line, from the first to the last: one that grows and falls back is that of a queue.

    `used`, `recorded`: of all of a log, or of rows all over it, shape ``(N,)``, ns
    """
    known = np.isfinite(used) & np.isfinite(recorded) & (used != 0)
    used, recorded = used[known], recorded[known]
    parts = min(_PARTS, len(used) // 2)
    if parts < _FEWEST_PARTS or (span := float(np.ptp(recorded))) <= 0:
        return None
    since = (recorded - recorded.min()).astype(np.float64)
    delay = (recorded - used).astype(np.float64)
    part = (since * (parts / span)).astype(np.int64).clip(max=parts - 1)
    order = np.lexsort((delay, part))
    least = order[np.flatnonzero(np.diff(part[order], prepend=-1))]
    x, y = since[least], delay[least] - delay[least[0]]
    if len(x) < _FILLED * parts:
        return None  # it stalls
    half = len(x) // 2
    slope = spread((y[half:] - y[: len(y) - half]) / (x[half:] - x[: len(x) - half]))[1]
    by = abs(slope) * float(x[-1] - x[0])
    is_line = by > _SIGNIFICANT * float(np.ptp(y - slope * x))
    is_other = abs(slope) > _SPEED and 1 / _FASTEST < 1.0 - slope < _FASTEST
    return Unsteady(speed=1.0 - slope) if is_line and is_other else None


def unsteady_text(found: Unsteady, used: str, recorded: str) -> str:
    """Return a sentence on times that contradict those of recording, up to the way out.

    `used`, `recorded`: what the two are, such as ``"the header timestamps"``
    """
    if found.speed != 1:
        recorder = "fell further and further behind" if found.speed < 1 else "was behind at first"
        return (
            f"{used} go {found.speed:.4g} times as fast as {recorded}: that is right in a "
            f"simulation, if a log was played at another speed, or if the recorder {recorder}; if "
            "not"
        )
    steady = f"steady, about {duration_text(found.interval_ns)} apart"
    if found.are_shared:
        return (
            f"many samples share {used}, while {recorded} are {steady}; if they are those of "
            "packets"
        )
    return (
        f"the intervals between {used} scatter by {duration_text(found.scatter_ns)}, while "
        f"{recorded} are {steady}; if the samples were taken at a steady rate"
    )
