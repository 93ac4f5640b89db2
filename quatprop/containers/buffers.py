"""Memory for the records of chunks that is used again once nobody refers to it any more.

Chunks that follow one another are loaded into one buffer, so that their messages can be decoded
together. Fresh memory for each would cost as much as decompressing it: the system clears every
page.
"""

from __future__ import annotations

import weakref
from collections import deque
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    Bytes = NDArray[np.uint8]

Item = TypeVar("Item")

BUFFER = 1 << 21
"""Bytes in a buffer: the chunks in it stay in the processor's cache until they are decoded."""

FIRST = 1 << 16
"""Bytes in the first buffer, for who reads only the beginning; each is twice as large as the one
before, up to :data:`BUFFER`."""


class Buffers:
    """Buffers whose memory is used again when no array refers to them."""

    def __init__(self) -> None:
        self._free: deque[memoryview] = deque()

    def take(self, size: int) -> Bytes:
        """Return uninitialised memory of so many bytes."""
        memory = np.empty(0, np.uint8).data
        while self._free and len(memory) < size:
            memory = self._free.popleft()
        if not size <= len(memory) <= max(2 * size, BUFFER):
            # Not cleared, as a bytearray would be: pages that are not used cost nothing.
            memory = np.empty(max(size, min(2 * size, BUFFER)), np.uint8).data
        buffer = np.frombuffer(memory, np.uint8)
        weakref.finalize(buffer, self._free.append, memory).atexit = False
        return buffer[:size]


@dataclass(frozen=True, slots=True)
class Group(Generic[Item]):
    """Chunks that are loaded together, in one thread.

    Parameters
    ----------
    items
        The chunks.
    buffer
        Memory for their records, one after another; None for one that needs memory of its own.
    begins
        Where in it those of each begin.
    """

    items: list[Item]
    buffer: Bytes | None
    begins: list[int]

    def parts(self) -> Iterator[tuple[Item, Bytes | None]]:
        """Yield each chunk with the memory for its records."""
        if self.buffer is None:
            yield from ((item, None) for item in self.items)
            return
        ends = [*self.begins[1:], len(self.buffer)]
        for item, begin, end in zip(self.items, self.begins, ends, strict=True):
            yield item, self.buffer[begin:end]


def in_groups(sized: Iterable[tuple[Item, int | None]]) -> Iterator[Group[Item]]:
    """Yield chunks in groups: handing over each by itself would cost as much as decompressing it.

    Parameters
    ----------
    sized
        Chunks with the bytes of their records, None for one that needs memory of its own. Memory
        is given to them in their order, whichever of them is loaded first.

    Examples
    --------
    >>> [group.items for group in in_groups([("a", 5), ("b", 7), ("c", None), ("d", 3)])]
    [['a', 'b'], ['c'], ['d']]
    """
    buffers = Buffers()
    items: list[Item] = []
    sizes: list[int] = []
    limit = min(FIRST, BUFFER)

    def group() -> Group[Item]:
        return Group(items, buffers.take(sum(sizes)), list(accumulate(sizes, initial=0))[:-1])

    for item, size in sized:
        if items and (size is None or sum(sizes) + size > limit):
            yield group()
            items, sizes, limit = [], [], min(BUFFER, 2 * limit)
        if size is None:
            yield Group([item], None, [0])
        else:
            items.append(item)
            sizes.append(size)
    if items:
        yield group()
