"""Checks of timestamps: order, duplicates, gaps, intervals; and the policy for each."""

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import TYPE_CHECKING, Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np

from quatprop.base.errors import TimelineError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.timeline.counts import LISTED_GAPS, OBSERVE, Counts, Event, Policy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.base.arrays import Bool, Float64, Int64, Intp

    Ages = NDArray[np.uint64]
    """Times since the earliest timestamp, ns."""


# Find outliers: samples whose timestamps jump ahead and are contradicted by the next ones.
#
# A jump ahead that lasts is a pause. The next timestamps distinguish the two, so each batch waits
# until :data:`LOOK_AHEAD` samples after it are known.


class Rows(Protocol):
    """Rows that can be selected by a mask: timestamps, or samples with timestamps."""

    def __len__(self) -> int: ...
    def __getitem__(self, chosen: Bool, /) -> Self: ...


Batch = TypeVar("Batch", bound=Rows)

LONGEST_RUN = 32
"""Maximum run of outliers, as in a message of a burst of samples with a wrong timestamp."""

CONFIRMING = 8
"""Number of timestamps that decide whether a run before them is outliers; more for long runs."""

LOOK_AHEAD = 2 * LONGEST_RUN
"""Maximum number of later samples on which the decision about a sample depends."""

FAR = 10
"""An outlier is ahead by more than this many intervals of the neighbouring samples."""


LATEST = np.iinfo(np.uint64).max


def marked(
    batches: Iterable[Batch], stamps_of: Callable[[Batch], Int64]
) -> Iterator[tuple[Batch, Bool, int]]:
    """Yield each non-empty batch, a mask of its outliers, and the jump of the first of them, ns.

    `stamps_of`: returns the timestamps of a batch, shape ``(N,)``, int64 ns
    """
    stream = (batch for batch in batches if len(batch))
    waiting: deque[Batch] = deque()
    behind, done = np.empty(0, np.int64), 0
    while True:
        while sum(map(len, islice(waiting, 1, None))) < LOOK_AHEAD:
            batch = next(stream, None)
            if batch is None:
                break
            waiting.append(batch)
        if not waiting:
            return
        batch = waiting.popleft()
        t_ns = stamps_of(batch)
        after = [stamps_of(later)[:LOOK_AHEAD] for later in waiting]
        ahead = np.concatenate([t_ns[-1:], *after])[: LOOK_AHEAD + 1]
        mask, ahead_ns = np.zeros(len(t_ns), np.bool_), 0
        # In the common case time never steps back, which is tested without a copy.
        if not all(map(_in_order, (behind, t_ns, ahead))) or (len(behind) and behind[-1] > t_ns[0]):
            stamps = np.concatenate([behind, t_ns, ahead[1:]])
            own = slice(len(behind), len(behind) + len(t_ns))
            mask, ahead_ns = _outliers(stamps, own, from_the_first=done == len(behind))
        yield batch, mask, ahead_ns
        done += len(t_ns)
        behind = np.concatenate([behind, t_ns[-LONGEST_RUN - 1 :]])[-LONGEST_RUN - 1 :]


def outliers_in_order(t_ns: Int64, found: Bool) -> Bool:
    """Return which samples of a log are outliers if all are sorted by time.

    Outliers that fit between the others only arrived early, and are valid. A log that was written
    newest first is examined in reverse.

    `t_ns`: all timestamps of the log, ns
    """
    if not found.any():
        return found
    if np.sum(t_ns[1:] < t_ns[:-1]) > np.sum(t_ns[1:] > t_ns[:-1]):
        ((_, mask, _),) = marked([t_ns[::-1]], lambda stamps: stamps)
        found = mask[::-1]
    fits = np.zeros(len(t_ns), np.bool_)
    fits[found] = _fits(t_ns[found], np.sort(t_ns[~found]))
    return found & ~fits


def _fits(t_ns: Int64, others: Int64) -> Bool:
    """Return which timestamps fill a gap of the others, or continue them at similar intervals."""
    intervals = np.diff(others)
    if not (intervals > 0).any():
        return np.zeros(len(t_ns), np.bool_)
    median = np.median(intervals[intervals > 0])
    after = np.searchsorted(others, t_ns)
    room = np.append(np.append(0, intervals), 0)[after]
    longest = intervals[intervals <= FAR * median].max()
    later = np.sort(t_ns[t_ns > others[-1]])
    # Unsigned, so that no difference overflows.
    steps = np.diff(later, prepend=others[-1]).view(np.uint64)
    is_steady = np.logical_and.accumulate(2 * steps <= max(3 * median, 2 * longest))
    last = later[is_steady][-1] if is_steady.any() else others[-1]
    return np.asarray((2 * room > 3 * median) | ((others[-1] < t_ns) & (t_ns <= last)))


def _in_order(t_ns: Int64) -> bool:
    return bool((t_ns[1:] >= t_ns[:-1]).all())


def _outliers(t_ns: Int64, own: slice, *, from_the_first: bool) -> tuple[Bool, int]:
    """Return which of some timestamps are outliers, and the jump of the first of them, ns.

    `t_ns`: consecutive timestamps, ns
    `from_the_first`: whether they begin with the first of the log, before which there is none
    """
    returns = np.flatnonzero(t_ns[1:] < t_ns[:-1]) + 1
    # Unsigned, so that no difference overflows.
    since = (t_ns - t_ns.min()).view(np.uint64)
    first, last, before = _runs(since, returns, from_the_first=from_the_first)
    change = np.zeros(len(t_ns) + 1, np.int64)
    np.add.at(change, first, 1)
    np.add.at(change, last, -1)
    mask = np.cumsum(change)[own] > 0
    if not mask.any():
        return mask, 0
    begin = own.start + int(mask.argmax())
    run = int(np.argmax((first <= begin) & (begin < last)))
    return mask, int(since[begin] - before[run])


def _runs(since: Ages, returns: Intp, *, from_the_first: bool) -> tuple[Intp, Intp, Ages]:
    """Return begin and end of runs of outliers, and the timestamps before each jump."""
    # The last timestamp not later than most of the next ones: all between are ahead of these.
    place = returns[:, None] + np.arange(CONFIRMING)
    following = np.sort(np.where(place < len(since), since[place % len(since)], LATEST), axis=1)
    middle = (np.minimum(len(since) - returns, CONFIRMING) - 1) // 2
    resumed = np.take_along_axis(following, middle[:, None], axis=1)
    place = returns[:, None] - np.arange(1, LONGEST_RUN + 2)
    is_before = (place >= 0) & (since[np.maximum(place, 0)] <= resumed)
    has_before = is_before.any(axis=1)
    length = np.where(has_before, is_before.argmax(axis=1), returns)
    found = (has_before | (from_the_first & (returns <= LONGEST_RUN))) & (length > 0)
    returns, length, has_before = returns[found], length[found], has_before[found]
    first = returns - length
    before = np.where(has_before, since[first - 1], resumed[found, 0])
    jump = since[first]
    # The next timestamps have returned if they are nearer to the one before than to the jump.
    column = np.arange(LONGEST_RUN + 1)
    place = returns[:, None] + column
    known = (place < len(since)) & (column < np.maximum(length + 1, CONFIRMING)[:, None])
    stamps = since[np.minimum(place, len(since) - 1)]
    late = stamps <= before[:, None]
    nearer = (stamps < jump[:, None]) & (stamps - before[:, None] < jump[:, None] - stamps)
    is_back = known & (late | nearer)
    count = is_back.sum(axis=1)
    span = np.where(is_back & ~late, stamps - before[:, None], 0).max(axis=1)
    is_far = FAR * span.astype(np.float64) < (jump - before).astype(np.float64) * count
    contradicted = (
        is_back[:, 0]
        & (count >= length + ~has_before)
        & (2 * count > known.sum(axis=1))
        & is_far
        & ((span > 0) | (count >= CONFIRMING))
    )
    return first[contradicted], returns[contradicted], before[contradicted]


GAP_FACTOR = 10
"""Intervals longer than this many median intervals count as gaps by default."""

LONGEST_NS = int(np.iinfo(np.int64).max)
"""The longest interval in 64 bits, ns."""

MEDIAN_WINDOW = 65_536
"""Number of first intervals whose median is taken: exact, in constant memory."""


def gap_limit_ns(t_ns: Int64) -> int:
    """Return the interval above which there is a gap between timestamps, in any order, ns."""
    steps = np.diff(np.sort(t_ns[:MEDIAN_WINDOW]))
    steps = steps[steps > 0]
    return GAP_FACTOR * int(np.median(steps)) if len(steps) else 0


_FAR = 10
"""Maximum number of intervals at which a counter continues after it has wrapped around."""

COUNTERS = {"ns": 2**32, "us": 2**32 * 1_000, "ms": 2**32 * 1_000_000}
"""Period of a 32-bit counter, ns, by its unit."""


class Examined(NamedTuple, Generic[Batch]):
    """A batch, and the irregularities of its timestamps.

    `rows`: indices of its samples among those that were read, shape ``(N,)``
    `outliers`, `back`: masks of outliers, and of timestamps earlier than a previous one
    """

    batch: Batch
    rows: Int64
    outliers: Bool
    back: Bool


def _are_reversed(t_ns: Int64) -> bool:
    """Return whether samples, more than two, are in reverse order of time."""
    steps = np.diff(t_ns)
    return bool(len(steps) > 1 and (steps <= 0).all() and np.count_nonzero(steps) > 1)


class StampChecks:
    """Checks timestamps batch by batch, and counts irregularities.

    `chosen_by`: the setting that chooses timestamps: ``"clock"``, or of a table ``"time_col"``
    `steadier`: returns the way to choose timestamps that are steady; ``""``: none is known
    """

    def __init__(
        self,
        path: Path | str,
        policy: Policy = OBSERVE,
        chosen_by: str = "clock",
        steadier: Callable[[], str] = str,
    ) -> None:
        self.path = path
        self._steadier = steadier
        self.chosen_by = chosen_by
        self.policy = policy
        self.counts = Counts(gap_limit_ns=policy.max_gap_ns)
        self.read = 0
        self._latest: int | None = None
        self._begin_ns = 0
        self._is_anew = False
        self._last_two = np.empty(0, np.int64)

    def observe(self, batches: Iterable[Int64]) -> Iterator[Int64]:
        """Yield timestamps unchanged, and count them.

        `batches`: timestamps in the order of the log, each shape ``(N,)``, int64 ns
        """
        checked = (t_ns for t_ns, *_ in self.examined(batches, lambda t_ns: t_ns))
        for t_ns in self.with_gap_limit(checked, lambda t_ns: t_ns):
            self.intervals(t_ns)
            yield t_ns

    def examined(
        self, batches: Iterable[Batch], stamps_of: Callable[[Batch], Int64]
    ) -> Iterator[Examined[Batch]]:
        """Yield non-empty batches with masks of outliers and steps back.

        `stamps_of`: returns the timestamps of a batch, shape ``(N,)``, int64 ns
        """
        for batch, outliers, ahead_ns in marked(batches, stamps_of):
            t_ns = stamps_of(batch)
            rows = np.arange(self.read, self.read + len(t_ns))
            self.read += len(t_ns)
            self.counts.samples_read += len(t_ns)
            back = self._backward(t_ns, rows, outliers)
            if ahead_ns:
                if not self.counts.outliers.count:
                    ahead = duration_text(ahead_ns)
                    self.counts.outliers.cause = f", {ahead} ahead of those around it"
                self.counts.outliers.add(np.flatnonzero(outliers), t_ns, rows)
            if self.policy.on_backwards == "error" and (ahead_ns or back.any()):
                if self.read == len(t_ns) and _are_reversed(t_ns):
                    raise TimelineError(
                        self.path,
                        "the samples are in reverse order of time; choose "
                        f"{Setting('on_backwards', 'sort')}",
                    )
                self._refuse()
            yield Examined(batch, rows, outliers, back)

    def count_again(self, t_ns: Int64, outliers: Bool) -> None:
        """Recount outliers and steps back of a whole log, with a corrected mask of outliers."""
        counts, rows = self.counts, np.arange(len(t_ns))
        counts.outliers, counts.backwards = Event(), Event()
        counts.outliers.add(np.flatnonzero(outliers), t_ns, rows)
        kept = t_ns[~outliers]
        back = np.flatnonzero(kept < np.maximum.accumulate(kept))
        counts.backwards.add(back, kept, rows[~outliers])

    def _backward(self, t_ns: Int64, rows: Int64, outliers: Bool) -> Bool:
        """Return which timestamps are earlier than a previous one that is not an outlier."""
        found = np.zeros(len(t_ns), np.bool_)
        if outliers.any():
            t_ns, rows = t_ns[~outliers], rows[~outliers]
        if not len(t_ns):
            return found
        if self._latest is None:
            self._latest = self._begin_ns = int(t_ns[0])
        latest = self._latest
        before, self._last_two = self._last_two, np.append(self._last_two, t_ns[-2:])[-2:]
        if t_ns[0] >= latest and (t_ns[1:] >= t_ns[:-1]).all():
            self._latest = int(t_ns[-1])
            return found
        reached = np.maximum.accumulate(np.maximum(t_ns, latest))
        # For inspection, a timestamp earlier than its neighbour is backwards; a policy that drops
        # samples must drop all until the clock has caught up again.
        if self.policy.on_backwards == "keep":
            back = np.diff(t_ns, prepend=latest) < 0
            self._latest = int(t_ns[-1])
        else:
            back = t_ns < reached
            self._latest = int(reached[-1])
        where = np.flatnonzero(back)
        if len(where) and not self.counts.backwards.count:
            first = int(where[0])
            self._before_ns = int(reached[first])
            self._step_ns = self._before_ns - int(t_ns[first])
            self._is_anew = _begins_anew(self._before_ns, t_ns[first:][:CONFIRMING])
            stamps, first = np.append(before, t_ns), len(before) + first
            self.counts.backwards.cause = _cause_of_step(stamps, first)
            if not self._is_anew and _is_set_back(stamps, first, self._begin_ns):
                self.counts.backwards.cause = _SET_BACK
        self.counts.backwards.add(where, t_ns, rows)
        found[~outliers] = back
        return found

    def _refuse(self) -> None:
        """Raise an error for the first outlier or step back."""
        outliers, back = self.counts.outliers, self.counts.backwards
        another = f"another {Setting(self.chosen_by)}"
        remedies = f"choose {Setting('on_backwards', 'drop|sort')}, or {another}"
        firsts = [e.first_index for e in (outliers, back) if e.first_index is not None]
        if outliers.first_index == min(firsts):
            raise TimelineError(
                self.path,
                f"the timestamp of sample {outliers.first_index} (t = {outliers.first_ns} ns) is "
                f"an outlier{outliers.cause}; {remedies}",
            )
        if back.cause == _SET_BACK:
            # Sorting would mix what follows with what was before, and dropping would take its time.
            by_label = ""
            if self.chosen_by == "time_col":
                series = Setting("series", "C=VALUE")
                by_label = f", {series} if rows of several sensors follow one another"
            remedies = (
                f"choose {self._steadier() or another}{by_label}, or cut the log there and read "
                f"its parts in order with {Setting('in_sequence')}"
            )
        elif back.cause:
            # Dropping or sorting samples after a wrap-around would damage the data.
            remedies = f"log a wider counter, or choose {self._steadier() or another}"
            if self.chosen_by == "time_col":
                column, rate = Setting("time_col", "COLUMN"), Setting("sample_rate", "HZ")
                remedies = (
                    "log a wider counter, or add 2^32 to the column after each such step, or "
                    f"choose {another}; if a column counts samples, use {column} and {rate}"
                )
        elif self.chosen_by == "time_col":
            sorts = Setting("on_backwards", "drop|sort")
            remedies = (
                f"choose {sorts}, {Setting('series', 'C=VALUE')} if rows of several sensors follow "
                f"one another, or {another}"
            )
            if self._is_anew:
                remedies = (
                    "if the clock begins anew there, as after a restart, cut the file there and "
                    f"read its parts in order with {Setting('in_sequence')}; otherwise {remedies}"
                )
        elif self._is_anew:
            # Sorting would mix the two runs; dropping keeps what begins after the end of the first.
            first_run = f"{Setting('on_backwards', 'drop')} {Setting('end', f'{self._before_ns}')}"
            remedies = (
                "the clock begins anew there: if a simulation was reset, cut the log there and "
                f"propagate each of its two runs by itself, the first also by {first_run}; if only "
                f"the clock was, choose {self._steadier() or another}, or read the parts in order "
                f"with {Setting('in_sequence')}"
            )
        elif steadier := self._steadier():
            remedies = f"choose {steadier}, or {Setting('on_backwards', 'drop|sort')}"
        raise TimelineError(
            self.path,
            f"time steps back by {duration_text(self._step_ns)} at sample {back.first_index} "
            f"(t = {back.first_ns} ns){back.cause}; {remedies}",
        )

    def with_gap_limit(
        self, batches: Iterable[Batch], stamps_of: Callable[[Batch], Int64]
    ) -> Iterator[Batch]:
        """Yield batches; the first ones only when the median interval is known."""
        window: list[Batch] = []
        stream = iter(batches)
        for batch in stream:
            window.append(batch)
            if sum(map(len, window)) > MEDIAN_WINDOW:
                break
        if not window:
            return
        intervals = np.diff(np.concatenate([*map(stamps_of, window)])[: MEDIAN_WINDOW + 1])
        positive = intervals[intervals > 0]
        if len(positive):
            self.counts.median_dt_ns = int(np.median(positive))
            if self.counts.gap_limit_ns is None:
                self.counts.gap_limit_ns = GAP_FACTOR * self.counts.median_dt_ns
        yield from window
        yield from stream

    def intervals(self, t_ns: Int64) -> Int64:
        """Count the timestamps as used and return the intervals that end at them.

        `t_ns`: the next timestamps, shape ``(N,)``, at least one, int64 ns
        `Returns`: shape ``(N,)``, int64 ns; ``(N - 1,)`` for the first batch
        """
        counts = self.counts
        first_ns = int(t_ns[0]) if counts.first_ns is None else counts.first_ns
        if int(t_ns[-1]) - first_ns > LONGEST_NS:
            raise TimelineError(
                self.path,
                f"its timestamps span more than 292 years, up to {t_ns[-1]} ns; check "
                f"{Setting('time_unit')}, the time column or {Setting('clock')}",
            )
        counts.first_ns = first_ns
        before = t_ns[:0] if counts.last_ns is None else np.int64(counts.last_ns)
        intervals = np.diff(t_ns, prepend=before)
        if len(intervals):
            self._count_intervals(intervals, t_ns[-len(intervals) :])
        counts.last_ns = int(t_ns[-1])
        counts.samples_used += len(t_ns)
        return intervals

    def _count_intervals(self, intervals: Int64, ends: Int64) -> None:
        """Count duplicates and gaps among intervals that end at the timestamps `ends`."""
        counts = self.counts
        shortest, longest = int(intervals.min()), int(intervals.max())
        counts.min_dt_ns = min(shortest, shortest if counts.min_dt_ns is None else counts.min_dt_ns)
        is_longest = counts.max_dt_ns is None or longest > counts.max_dt_ns
        counts.max_dt_ns = longest if is_longest else counts.max_dt_ns
        start = max(counts.samples_used, 1)
        if shortest <= 0:
            counts.duplicates.add(np.flatnonzero(intervals == 0), ends, start)
        limit = counts.gap_limit_ns
        if limit is None or longest <= limit:
            return
        where = np.flatnonzero(intervals > limit)
        counts.gaps.add(where, ends, start)
        after = ends[where[: LISTED_GAPS - len(counts.gap_list)]]
        before = after - intervals[where[: len(after)]]
        if is_longest:
            end = int(ends[intervals.argmax()])
            counts.longest_gap = end - longest, end
        counts.gap_list += zip(before.tolist(), after.tolist(), strict=True)
        if self.policy.on_gap == "error":
            raise TimelineError(
                self.path,
                f"a gap ends at sample {counts.gaps.first_index} (t = {counts.gaps.first_ns} ns), "
                f"longer than {duration_text(limit)}; choose "
                f"{Setting('on_gap', 'hold|zero|split')} or a longer {Setting('max_gap')}",
            )


_LATEST_ANEW_NS = 60 * NS_PER_S
"""A clock that begins anew may have run so long when samples are taken, ns."""


def _begins_anew(before_ns: int, t_ns: Int64) -> bool:
    """Return whether a clock begins anew near 0, and does not return to what it showed before.

    `t_ns`: timestamps from the step back on, ns, shape ``(N,)``
    """
    first_ns = int(t_ns[0])
    is_early = 0 <= first_ns <= min(before_ns // 2, _LATEST_ANEW_NS)
    return is_early and len(t_ns) > 1 and bool((np.diff(t_ns) >= 0).all() and t_ns[1] < before_ns)


_SET_BACK = " as if the clock had been set back"
_FEWEST_AFTER, _USUAL = 3, 2.5
"""Fewest samples before a clock that was set back has caught up, and the longest interval there,
in usual ones: packets of so many samples that came late are followed by a longer one."""


def _is_set_back(t_ns: Int64, first: int, begin_ns: int) -> bool:
    """Return whether time steps back once, and goes on from there past the time before.

    Rows that came late are followed by a jump ahead, to those after them. Those of another sensor
    step back again, or begin when the log does.

    `t_ns`: timestamps around the first step back, ns, which is that to `t_ns[first]`
    `begin_ns`: the first timestamp of the log, ns
    """
    steps = np.diff(t_ns)
    after, before_ns = t_ns[first:], t_ns[first - 1]
    again = int(np.count_nonzero(after < before_ns))
    if np.count_nonzero(steps < 0) > 1 or again < _FEWEST_AFTER or not (steps > 0).any():
        return False
    usual = float(np.median(steps[steps > 0]))
    goes_on = again == len(after) or after[again] - after[again - 1] <= _USUAL * usual
    return bool(goes_on and after[0] - begin_ns > usual)


def are_steady(t_ns: Int64 | Float64) -> bool:
    """Return whether most intervals between timestamps are similar."""
    if len(t_ns) <= CONFIRMING:
        return False
    steps = np.diff(t_ns)
    low, middle, high = spread(steps)
    return bool(0 < middle <= 2 * low and high <= 2 * middle) and not are_in_bursts(steps)


def spread(values: Int64 | Float64) -> tuple[float, float, float]:
    """Return the values below which a tenth, half and nine tenths are.

    Functions of NumPy for that import its masked arrays.
    """
    ordered, last = np.sort(values), len(values) - 1
    low, middle, high = (float(ordered[round(share * last)]) for share in (0.1, 0.5, 0.9))
    return low, middle, high


_PAUSES = 2
"""Longest intervals that are left out of a mean, as those of pauses."""


def are_in_bursts(steps: Int64 | Float64) -> bool:
    """Return whether a few long intervals hold most of the time, as between bursts of samples."""
    usual = np.sort(steps)[:-_PAUSES]
    return bool(usual.sum() > 2 * np.median(usual) * len(usual))


def _cause_of_step(t_ns: Int64, first: int) -> str:
    """Return the likely cause of a step back in time, if the timestamps (ns) show one."""
    if first < 2:  # noqa: PLR2004  # two timestamps before it are needed
        return ""
    before, middle, after = t_ns[first - 2 : first + 1].tolist()
    for unit, period in COUNTERS.items():
        if 0 < period - (middle - after) <= min(_FAR * (middle - before), period // 1000):
            return f" as if a counter of 32 bits in {unit} had wrapped around"
    return ""
