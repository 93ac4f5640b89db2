"""Byte ranges with selected messages in a buffer or file, without the bytes between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]


LARGE = 1 << 17
"""Size of a chunk, bytes, below which it is read as a whole."""
REMOTE_LARGE = 5 << 18
"""The same in an object store, where reading in part takes at least three requests."""
GAP = 1 << 14
"""Maximum gap between messages, bytes, that is faster to read than to skip."""
SHARE = 4
"""Selected messages are read separately if they are at most 1/SHARE of a chunk."""


class ByteRanges(NamedTuple):
    """Byte ranges with messages.

    `begins`, `ends`: start and end of each range, shape ``(R,)``, int64
    `moved`: bytes by which each message moves towards the start when ranges are joined, shape
        ``(N,)``, int64
    """

    begins: Int64
    ends: Int64
    moved: Int64

    @property
    def size(self) -> int:
        """Total size of the ranges, bytes."""
        return int((self.ends - self.begins).sum())

    def of(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a copy of the ranges of `data`, joined."""
        places = zip(self.begins.tolist(), self.ends.tolist(), strict=True)
        return np.concatenate([data[begin:end] for begin, end in places])


def ranges_of(starts: Int64, ends: Int64, gap: int) -> ByteRanges:
    """Return the byte ranges with messages.

    `starts`, `ends`: start and end of each message, shape ``(N,)``, N > 0, int64; a message out of
        order starts a new range
    """
    between = starts[1:] - ends[:-1]
    first = np.concatenate([[0], np.flatnonzero((between < 0) | (between > gap)) + 1])
    last = np.concatenate([first[1:], [len(starts)]])
    begins, stops = starts[first], ends[last - 1]
    sizes = stops - begins
    moved = begins - (np.cumsum(sizes) - sizes)
    return ByteRanges(begins, stops, np.repeat(moved, last - first))


def ranges_worth_reading(starts: Int64, ends: Int64, size: int) -> ByteRanges | None:
    """Return the byte ranges of a chunk with the requested parts; None: read the whole chunk.

    `starts`, `ends`: start and end of each part, shape ``(N,)``, int64, ascending
    """
    if not len(starts) or starts[0] < 0 or ends.max() > size or (ends < starts).any():
        return None
    ranges = ranges_of(starts, ends, GAP)
    return ranges if ranges.size * SHARE <= size else None
