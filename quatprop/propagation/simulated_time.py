"""Rates of a simulation whose timestamps are not in simulated time.

Nothing is changed here; the finding is one sentence.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import LogError, UsageError
from quatprop.base.text import Remark, quoted
from quatprop.base.times import NS_PER_S
from quatprop.readers.matching import first_batch
from quatprop.readers.row_stamps import stamp_at

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.base.arrays import Int64
    from quatprop.readers.signal import RateSignal
    from quatprop.readers.tables.model import Log, RowBatch, Table


CLOCK = "rosgraph_msgs/msg/Clock"
"""Type of the messages that tell the nodes of a simulation its time."""

LEAST_S = 1.0
"""Shortest time over which two clocks are compared, s."""

SPEED, DELAY_S = 0.02, 0.1
"""Clocks of equal speed agree within this share, and this time, s, by delays of messages."""

MOST_ROWS = 20_000
"""Rows of a clock that are compared."""


def simulation_remarks(log: Log, source: RateSignal) -> list[Remark]:
    """Return a remark if simulated time goes otherwise than header timestamps of the rates."""
    if source.clock != "header":
        return []
    clocks = [table for table in log.tables() if table.is_typed and table.type == CLOCK]
    if len(clocks) != 1:
        return []
    used = times = (np.empty(0, np.int64),) * 2
    with suppress(LogError, UsageError):
        times = _first_times(clocks[0])
        used = _paired(source.rows(at_first=True))
    first = max(each[1][0] if len(each[1]) else np.iinfo(np.int64).max for each in (used, times))
    last = min(each[1][-1] if len(each[1]) else 0 for each in (used, times))
    if last - first < LEAST_S * NS_PER_S:
        return []
    by_header, by_clock = (_lapse(each, first, last) for each in (used, times))
    speed = by_clock / by_header if by_header > 0 else 1.0
    if abs(speed - 1) <= SPEED + DELAY_S * NS_PER_S / by_header:
        return []
    return [
        Remark(
            "not-simulated-time",
            f"the time of the simulation, on topic {quoted(clocks[0].name)}, goes {speed:.3g} "
            f"times as fast as the header timestamps of topic {quoted(source.name)}, which are "
            "used: if the rates are those of the simulation, the attitudes are wrong, and only "
            "stamps in its time give right ones: record them with use_sim_time",
        )
    ]


def _first_times(table: Table) -> tuple[Int64, Int64]:
    """Return the first times of a topic of clocks, and those of recording, ns."""
    stamp = stamp_at(table, "clock")
    return _paired(first_batch(table, [stamp]).read([stamp], ()) if stamp else ())


def _paired(batches: Iterable[RowBatch]) -> tuple[Int64, Int64]:
    """Return times, and those of recording, ns, in order of the latter."""
    found, count = [(np.empty(0, np.int64),) * 2], 0
    for rows in batches:
        found.append((rows.values[0], rows.log_ns))
        count += len(rows)
        if count >= MOST_ROWS:
            break
    times, log_ns = map(np.concatenate, zip(*found, strict=True))
    order = np.argsort(log_ns, kind="stable")
    return times[order], log_ns[order]


def _lapse(pairs: tuple[Int64, Int64], first: int, last: int) -> float:
    """Return how much time passed on a clock between two times of recording, ns."""
    times, log_ns = pairs
    ends = np.interp([0.0, float(last - first)], log_ns - first, times - times[0])
    return float(ends[1] - ends[0])
