"""Read only the part of a log that a time range needs, by the index of the log.

The index of a table contains timestamps: only parts with timestamps in the range are read.

The index of a container contains log times. They differ from timestamps by a delay: the latency of
the recorder or, in a log that was recorded again, the time since. The part that is read is
therefore extended by the delays at both ends of the log and by a margin. It is scanned first: if a
delay in it differs from those at the ends by more than half the margin, or it has no sample in the
range, the whole log is read instead. A sample is missed only if its delay differs from all of these
by more than the margin.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.times import LATEST, NS_PER_S
from quatprop.readers.tables.model import TimeRange
from quatprop.timeline.stamps import LOOK_AHEAD, marked
from quatprop.timeline.time_range import Ends, EndsFinder, PartOfLog

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from quatprop.base.arrays import Int64
    from quatprop.kinematics.series import GyroSeries
    from quatprop.readers.tables.model import RowBatch, Span
    from quatprop.readers.tables.running_times import Period


MARGIN_NS = 60 * NS_PER_S
"""Maximum variation of delays, ns: far more than the latency of buffers and networks."""

SHARE = 4
"""Only parts of up to 1/SHARE of the log are read alone: they are read twice, and damage elsewhere
is not reported."""


class _Zone(NamedTuple):
    """Extremes of the timestamps and of the delays in a part of the log, ns."""

    first_ns: int
    last_ns: int
    least_delay_ns: int
    largest_delay_ns: int


def _ends(head: Iterable[Int64], tail: Iterable[Int64]) -> Ends | None:
    """Return the ends of a log from its first and last timestamps.

    None if they have outliers, or none of them can be read.
    """
    found = []
    for part in (head, tail):  # what is not read between them is no pause
        finder = EndsFinder()
        for t_ns, outliers, _ in marked(part, lambda t_ns: t_ns):
            if outliers.any():
                return None
            finder.add(t_ns)
        found.append(finder.ends())
    if Ends(0, 0) in found:
        return None
    first, last = found
    return Ends(first.first_ns, max(first.last_ns, last.last_ns), (first.pauses[0], last.pauses[1]))


def _latest(spans: Iterable[Span]) -> int:
    return max(span.last_ns for span in spans)


class TableRangeReader(NamedTuple):
    """Reads time ranges of a table with an index of the timestamps in its parts.

    `spans`: the timestamps of the parts, at least one
    `rows`, `batches`: read the samples of some parts
    """

    spans: Sequence[Span]
    rows: Callable[[frozenset[int]], Iterator[RowBatch]]
    batches: Callable[[frozenset[int]], Iterator[GyroSeries]]

    def ends(self) -> Ends | None:
        """Return the first and last timestamp; None if other parts contradict them."""
        rows = np.cumsum([span.rows for span in self.spans])
        head = int(np.searchsorted(rows, LOOK_AHEAD)) + 1
        tail = int(np.searchsorted(rows, rows[-1] - LOOK_AHEAD))
        if head > tail:
            return None
        parts = (range(head), range(tail, len(rows)))
        read = (self.rows(frozenset(part)) for part in parts)
        ends = _ends(*((rows.values[0] for rows in each) for each in read))
        return None if ends is None or _latest(self.spans[:tail]) > ends.last_ns else ends

    def read(
        self, first_ns: int | None, last_ns: int | None
    ) -> tuple[PartOfLog, Iterator[GyroSeries]] | None:
        """Return the parts with timestamps in a range; see :meth:`RangeReader.read`."""
        begin, end = min(span.first_ns for span in self.spans), _latest(self.spans)
        low, high = begin if first_ns is None else first_ns, end if last_ns is None else last_ns
        chosen = {
            number: span
            for number, span in enumerate(self.spans)
            if span.last_ns >= low and span.first_ns <= high
        }
        rows = [sum(span.rows for span in spans) for spans in (chosen.values(), self.spans)]
        if not chosen or SHARE * rows[0] > rows[1]:
            return None
        # An earlier part with later timestamps would affect the timestamp policy in the range.
        before = enumerate(self.spans[: max(chosen)])
        if any(span.last_ns > low for number, span in before if number not in chosen):
            return None
        part = PartOfLog(
            min(span.first_ns for span in chosen.values()),
            _latest(chosen.values()),
            (low > begin, high < end),
        )
        return part, self.batches(frozenset(chosen))


@dataclass
class RangeReader:
    """Reads time ranges of a signal by log times.

    `span`: time of recording, by the index
    `rows`, `batches`: read the samples of a range of log times
    `periods`: the periods after which the clock of the timestamps may begin anew
    """

    span: TimeRange
    rows: Callable[[TimeRange], Iterator[RowBatch]]
    batches: Callable[[TimeRange], Iterator[GyroSeries]]
    periods: tuple[Period, ...] = ()

    def ends(self) -> Ends | None:
        """Return the first and last timestamp; None if that takes the whole log."""
        return None if self._end_zones is None else _ends(*self._end_stamps)

    def read(
        self, first_ns: int | None, last_ns: int | None
    ) -> tuple[PartOfLog, Iterator[GyroSeries]] | None:
        """Return the part of the log with the timestamps of a range, and its samples.

        None if the whole log has to be read.

        `first_ns`, `last_ns`: the range, ends included; None: open
        """
        zones = self._end_zones
        if zones is None:
            return None
        head, tail = zones
        least = min(zone.least_delay_ns for zone in zones)
        largest = max(zone.largest_delay_ns for zone in zones)
        begin = 0 if first_ns is None else first_ns + least - MARGIN_NS
        end = LATEST if last_ns is None else last_ns + largest + MARGIN_NS
        window = TimeRange(max(begin, self.span.first_ns), min(end, self.span.last_ns))
        if window.length_ns < 0 or window.length_ns * SHARE > self.span.length_ns:
            return None
        found = self._zone(window, TimeRange(first_ns or 0, LATEST if last_ns is None else last_ns))
        if (
            found is None
            or found.least_delay_ns < least - MARGIN_NS // 2
            or found.largest_delay_ns > largest + MARGIN_NS // 2
        ):
            return None
        leaves_out = (
            first_ns is not None and first_ns > head.first_ns,
            last_ns is not None and last_ns < tail.last_ns,
        )
        part = PartOfLog(window.first_ns, window.last_ns, leaves_out)
        return part, self.batches(window)

    @cached_property
    def _end_zones(self) -> tuple[_Zone, _Zone] | None:
        """The extremes at the beginning and at the end of the log; None if unusable."""
        first_ns, last_ns = self.span.first_ns, self.span.last_ns
        if self.span.length_ns <= 2 * SHARE * MARGIN_NS:
            return None
        self._end_stamps: tuple[list[Int64], list[Int64]] = ([], [])
        head = self._zone(TimeRange(first_ns, first_ns + MARGIN_NS), note=self._end_stamps[0])
        tail = self._zone(TimeRange(last_ns - MARGIN_NS, last_ns), note=self._end_stamps[1])
        if head is None or tail is None:
            return None
        # A part does not tell how often its counter wrapped around before.
        differ_ns = abs(tail.least_delay_ns - head.least_delay_ns)
        may_wrap = (2 * differ_ns > one.ns for one in self.periods if one.end_ns > head.first_ns)
        return None if any(may_wrap) else (head, tail)

    def _zone(
        self,
        within: TimeRange,
        wanted: TimeRange | None = None,
        note: list[Int64] | None = None,
    ) -> _Zone | None:
        """Return the extremes in a range of log times; None if no timestamp is in `wanted`.

        `note`: list to which the timestamps are appended
        """
        extremes: list[tuple[int, int, int, int]] = []
        is_wanted = wanted is None
        for rows in self.rows(within):
            t_ns, log_ns = rows.values[0], rows.log_ns
            if note is not None:
                note.append(t_ns)
            first, last = int(t_ns.min()), int(t_ns.max())
            if first <= 0 or int(log_ns.min()) <= 0:
                return None  # never set, or relative: delays say nothing, or do not fit 64 bits
            delay = log_ns - t_ns
            extremes.append((first, last, int(delay.min()), int(delay.max())))
            if wanted is not None:
                hits = (t_ns >= wanted.first_ns) & (t_ns <= wanted.last_ns)
                is_wanted = is_wanted or bool(hits.any())
        if not extremes or not is_wanted:
            return None
        first_of, last_of, least_of, largest_of = zip(*extremes, strict=True)
        return _Zone(min(first_of), max(last_of), min(least_of), max(largest_of))
