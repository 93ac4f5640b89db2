"""The stretches of a buffer or file that hold certain messages, apart from all between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]


LARGE = 1 << 17
"""Bytes of a chunk below which it is read whole."""
GAP = 1 << 14
"""Bytes between messages that are sooner read than skipped."""
SHARE = 4
"""What is picked out of a chunk is at most this part of it."""


@dataclass(frozen=True, slots=True)
class Spans:
    """Stretches that hold messages.

    Parameters
    ----------
    begins, ends
        Where each stretch begins and ends, shape ``(S,)``, int64.
    moved
        How far each message comes to the front when the stretches are put side by side, shape
        ``(N,)``, int64.
    """

    begins: Int64
    ends: Int64
    moved: Int64

    @property
    def size(self) -> int:
        """Bytes in all stretches."""
        return int((self.ends - self.begins).sum())

    def of(self, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a copy of the stretches of `data`, side by side."""
        places = zip(self.begins.tolist(), self.ends.tolist(), strict=True)
        return np.concatenate([data[begin:end] for begin, end in places])


def spans_of(starts: Int64, ends: Int64, gap: int) -> Spans:
    """Return the stretches that hold messages.

    Parameters
    ----------
    starts, ends
        Where each message begins and ends, shape ``(N,)``, int64, at least one; messages that do
        not follow each other are in stretches of their own.
    gap
        Bytes between two messages that are taken along rather than begin another stretch.

    Examples
    --------
    >>> spans = spans_of(np.array([10, 20, 90]), np.array([18, 28, 95]), gap=4)
    >>> spans.begins.tolist(), spans.ends.tolist(), spans.moved.tolist()
    ([10, 90], [28, 95], [10, 10, 72])
    """
    between = starts[1:] - ends[:-1]
    first = np.concatenate([[0], np.flatnonzero((between < 0) | (between > gap)) + 1])
    last = np.concatenate([first[1:], [len(starts)]])
    begins, stops = starts[first], ends[last - 1]
    sizes = stops - begins
    moved = begins - (np.cumsum(sizes) - sizes)
    return Spans(begins, stops, np.repeat(moved, last - first))


def spans_worth_picking(wanted: Int64, every: Int64, size: int) -> Spans | None:
    """Return the stretches of a chunk that hold the wanted records.

    Parameters
    ----------
    wanted
        Where the wanted records begin, shape ``(N,)``, int64, ascending.
    every
        Where all records begin that the index knows, shape ``(M,)``, int64, ascending.
    size
        Bytes of all records.

    Returns
    -------
    Spans or None
        None where reading the chunk whole is as quick, or the index points out of it.
    """
    if not len(wanted):
        return None
    ends = np.append(every, size)[np.searchsorted(every, wanted, "right")]
    if wanted[0] < 0 or wanted[-1] >= size or ends[-1] > size:
        return None
    spans = spans_of(wanted, ends, GAP)
    return spans if spans.size * SHARE <= size else None
