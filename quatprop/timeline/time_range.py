"""The time range of a log that is used, and the part of the log that must be read for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.text import Remark, Setting
from quatprop.base.times import duration_text, open_range
from quatprop.timeline.stamps import GAP_FACTOR

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Int64
    from quatprop.base.times import Instant
    from quatprop.kinematics.series import AttitudeSeries, GyroSeries
    from quatprop.settings.reading import GyroCorrection

Series = TypeVar("Series", "GyroSeries", "AttitudeSeries")


_NOT_NS = 100_000
"""If the first timestamp is this many times the requested start, the start is not in ns."""

_FEW_NS = 1_000_000
"""A number below this, before the second sample, is meant in seconds."""


class PartOfLog(NamedTuple):
    """The part of a log with a time range, found by the index of the log.

    `first_ns`: begin of the part in log time, included, ns
    `last_ns`: end of the part in log time, included, ns
    `leaves_out`: whether samples are omitted before and after the range
    """

    first_ns: int
    last_ns: int
    leaves_out: tuple[bool, bool]


class PartReader(Protocol):
    """Reads parts of a log by its index."""

    def ends(self) -> Ends | None:
        """Return the first and last timestamp; None if that takes the whole log."""

    def read(
        self, first_ns: int | None, last_ns: int | None
    ) -> tuple[PartOfLog, Iterator[GyroSeries]] | None:
        """Return the part with the timestamps of a range, and its samples.

        None if the whole log has to be read.
        """


class Ends(NamedTuple):
    """The ends of a log, from which relative times count.

    `first_ns`, `last_ns`: first and last timestamp, ns
    `pauses`: timestamps before and after a pause near the first and the last sample, ns, or None
    """

    first_ns: int
    last_ns: int
    pauses: tuple[tuple[int, int] | None, tuple[int, int] | None] = (None, None)


NEAR_END = 32
"""Maximum number of samples between an end of the log and a pause near it."""


class EndsFinder:
    """Finds the ends of a log under a timestamp policy.

    `earliest`: whether the first sample is the earliest, as in a sorted log, instead of the first
        one read
    """

    def __init__(self, *, earliest: bool = False) -> None:
        self._earliest = earliest
        self._head = self._tail = np.empty(0, np.int64)

    def add(self, t_ns: Int64) -> None:
        """Add the next timestamps, without outliers, shape ``(N,)``, int64 ns."""
        some = 2 * NEAR_END
        if self._earliest:
            self._head = np.sort(np.concatenate([self._head, t_ns]))[:some]
        elif len(self._head) < some:
            self._head = np.concatenate([self._head, t_ns[:some]])[:some]
        if not (t_ns[1:] >= t_ns[:-1]).all():
            t_ns = np.sort(t_ns)
        self._tail = np.sort(np.concatenate([self._tail, t_ns[-some:]]))[-some:]

    def ends(self) -> Ends:
        """Return the ends; zeros if there were no samples."""
        if not len(self._head):
            return Ends(0, 0)
        # Samples before the first one are dropped or refused.
        head = np.sort(self._head[self._head >= self._head[0]])
        tail = self._tail
        near = (head[: NEAR_END + 1], head), (tail[-NEAR_END - 1 :], tail)
        first, last = (_longest_pause(*stamps) for stamps in near)
        return Ends(int(head[0]), int(tail[-1]), (first, last))


def _longest_pause(t_ns: Int64, around: Int64) -> tuple[int, int] | None:
    """Return the timestamps before and after the longest interval, if it is a gap."""
    intervals = np.diff(around)
    intervals = np.sort(intervals[intervals > 0])
    if len(t_ns) < 2 or not len(intervals):  # noqa: PLR2004  # ends of an interval
        return None
    longest = int(np.argmax(np.diff(t_ns)))
    before, after = t_ns[longest : longest + 2].tolist()
    is_gap = after - before > GAP_FACTOR * int(intervals[(len(intervals) - 1) // 2])
    return (before, after) if is_gap else None


def absolute_ns(instant: Instant, ends: Ends) -> int:
    """Return an instant as a time of the log's clock, ns."""
    return instant.ns + {"clock": 0, "first": ends.first_ns, "last": ends.last_ns}[instant.origin]


class TimeRange:
    """A stage that keeps the samples of a time range, ends included, and counts the others.

    `settings`: its start and end, None for open ones
    `ends`: the ends of the log, from which relative times count
    `start_ns`, `end_ns`: the range, ns; None: open
    `before`, `after`: number of samples before and after it so far
    """

    def __init__(self, settings: GyroCorrection, ends: Ends | None = None) -> None:
        self._settings, self._ends = settings, ends or Ends(0, 0)
        self.start_ns, self.end_ns = self._absolute()
        self.before = self.after = 0

    @property
    def outside(self) -> tuple[int, int]:
        """The number of samples before and after the range so far."""
        return self.before, self.after

    @property
    def is_open(self) -> bool:
        """Whether neither start nor end is given."""
        return self.start_ns is None and self.end_ns is None

    @property
    def length(self) -> str:
        """The length of the log as text, if the range is relative to its ends; else ``""``."""
        given = [instant for _, instant in self._given()]
        is_relative = given and all(instant.origin != "clock" for instant in given)
        return duration_text(self._ends.last_ns - self._ends.first_ns) if is_relative else ""

    def apply(self, numbered: Iterable[tuple[Series, Int64]]) -> Iterator[tuple[Series, Int64]]:
        """Yield the samples with start <= t <= end, with their indices."""
        if self.is_open:
            yield from numbered
            return
        low, high = open_range(self.start_ns, self.end_ns)
        for number, (batch, rows) in enumerate(numbered):
            if not number:
                self._refuse_seconds(batch.t_ns[:2].tolist())
            inside = (batch.t_ns >= low) & (batch.t_ns <= high)
            self.before += int(np.count_nonzero(batch.t_ns < low))
            self.after += int(np.count_nonzero(batch.t_ns > high))
            if inside.all():
                yield batch, rows
            elif inside.any():
                yield batch[inside], rows[inside]

    def remarks(self, *, part: PartOfLog | None = None) -> Iterator[Remark]:
        """Yield remarks on ends without effect, on pauses, and on a part that was read alone.

        `part`: the part of the log that was read; None: the whole log
        """
        yield from self._idle_remarks(*(self.outside if part is None else part.leaves_out))
        if part is not None:
            yield Remark(
                "part-read",
                "only the part of the log around the time range was read, by its index: what is "
                "damaged or lost elsewhere is not reported, and there is no SHA-256 of the log",
            )
        for name, instant in self._given():
            if instant.origin == "clock":
                continue
            pause = self._ends.pauses[instant.origin == "last"]
            if pause is not None:
                is_last = instant.origin == "last"
                anchor = self._ends.last_ns if is_last else self._ends.first_ns
                yield Remark(
                    "pause-at-end",
                    f"{Setting(name)} counts from the {instant.origin} sample, at {anchor} ns, "
                    f"close to a pause of {duration_text(pause[1] - pause[0])} from {pause[0]} to "
                    f"{pause[1]} ns; if a clock was wrong there, give an absolute time",
                )

    def _given(self) -> list[tuple[str, Instant]]:
        settings = (("start", self._settings.start), ("end", self._settings.end))
        return [(name, instant) for name, instant in settings if instant is not None]

    def _absolute(self) -> tuple[int | None, int | None]:
        """Return the range on the clock of the log, ns; None: open."""
        settings, ends = self._settings, self._ends
        start_ns, end_ns = (
            None if instant is None else absolute_ns(instant, ends)
            for instant in (settings.start, settings.end)
        )
        if settings.start is not None and settings.start.origin == "last":
            start_ns = max(settings.start.ns + ends.last_ns, ends.first_ns)
        if start_ns is not None and end_ns is not None and start_ns > end_ns:
            raise UsageError(
                f"{Setting('start')} is {duration_text(start_ns - end_ns)} after "
                f"{Setting('end')}; swap them, or check units"
            )
        return start_ns, end_ns

    def _idle_remarks(self, before: int, after: int) -> Iterator[Remark]:
        """Yield a remark for each absolute end without effect."""
        sides = {"start": ("before the first", before), "end": ("after the last", after)}
        for name, instant in self._given():
            side, left_out = sides[name]
            if instant.origin == "clock" and not left_out:
                yield Remark(
                    "range-beyond-log",
                    f"{Setting(name)} is {side} sample and excludes nothing; a number without a "
                    "unit is in ns",
                )

    def _refuse_seconds(self, first: list[int]) -> None:
        """Refuse times that cannot be in ns, by the first two timestamps of the log."""
        for name, instant in self._given():
            if instant.origin != "clock" or instant.ns <= 0:
                continue
            if instant.ns < _FEW_NS and instant.ns < first[-1]:
                raise UsageError(
                    f"{Setting(name, str(instant.ns))} is a time of the log's clock in ns, not in "
                    f"seconds; write {instant.ns}s for seconds after the first sample"
                )
            if name == "start" and first[0] // instant.ns >= _NOT_NS:
                raise UsageError(
                    f"{Setting('start')} is at {instant.ns} ns, and the first sample at "
                    f"{first[0]} ns; a number without a unit is in ns: write all digits, a date, "
                    "or a duration from the first sample such as +5s"
                )
