"""Byte ranges of a buffer or file that hold selected messages, without what lies between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]


LARGE = 1 << 17
"""Bytes of a chunk below which it is read whole."""
REMOTE_LARGE = 5 << 18
"""The same in an object store, where reading in part takes three requests or more."""
GAP = 1 << 14
"""Bytes between messages that are quicker read than skipped."""
SHARE = 4
"""Selected messages are read by themselves where they are at most 1/SHARE of a chunk."""


class ByteRanges(NamedTuple):
    """Byte ranges that hold messages.

    `begins`, `ends`: where each range begins and ends, shape ``(R,)``, int64
    `moved`: by how many bytes each message moves to the front when the ranges are put side by side,
        shape ``(N,)``, int64
    """

    begins: Int64
    ends: Int64
    moved: Int64

    @property
    def size(self) -> int:
        """Bytes in all ranges."""
        return int((self.ends - self.begins).sum())

    def of(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a copy of the ranges of `data`, side by side."""
        places = zip(self.begins.tolist(), self.ends.tolist(), strict=True)
        return np.concatenate([data[begin:end] for begin, end in places])


def ranges_of(starts: Int64, ends: Int64, gap: int) -> ByteRanges:
    """Return the byte ranges that hold messages.

    `starts`, `ends`: where each message begins and ends, shape ``(N,)``, int64, at least one;
        messages that are not in ascending order begin ranges of their own
    """
    between = starts[1:] - ends[:-1]
    first = np.concatenate([[0], np.flatnonzero((between < 0) | (between > gap)) + 1])
    last = np.concatenate([first[1:], [len(starts)]])
    begins, stops = starts[first], ends[last - 1]
    sizes = stops - begins
    moved = begins - (np.cumsum(sizes) - sizes)
    return ByteRanges(begins, stops, np.repeat(moved, last - first))


def ranges_worth_reading(
    starts: Int64, ends: Int64, size: int, share: int = SHARE
) -> ByteRanges | None:
    """Return the byte ranges of a chunk that hold some of its bytes.

    `starts`, `ends`: where each wanted part begins and ends, shape ``(N,)``, int64, ascending
    """
    if not len(starts) or starts[0] < 0 or ends.max() > size or (ends < starts).any():
        return None
    ranges = ranges_of(starts, ends, GAP)
    return ranges if ranges.size * share <= size else None
