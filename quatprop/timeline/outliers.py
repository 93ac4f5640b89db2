"""Find outliers: samples whose timestamps jump ahead and are contradicted by the next ones.

A jump ahead that lasts is a pause. The next timestamps distinguish the two, so each batch waits
until :data:`LOOK_AHEAD` samples after it are known.
"""

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import TYPE_CHECKING, Protocol, Self, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from quatprop.arrays import Bool, Int64, Intp

    Ages = NDArray[np.uint64]
    """Times since the earliest timestamp, ns."""


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
