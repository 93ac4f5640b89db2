"""Chunks of a log, several of which are loaded together and ahead of their use.

Chunks that follow one another are loaded into one buffer, so that their messages can be located
and decoded together. The memory of buffers is used again once nobody refers to it any more: fresh
memory for each would cost as much as decompressing it, since the system clears every page.
"""

from __future__ import annotations

import weakref
from collections import deque
from contextlib import closing
from itertools import accumulate
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import numpy as np

from quatprop.concurrency.threads import Deferred, prefetch

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator

    from numpy.typing import NDArray

    Bytes = NDArray[np.uint8]

Chunk = TypeVar("Chunk")
Content = TypeVar("Content")

BUFFER = 1 << 22
"""Bytes in a buffer: the chunks in it stay in the processor's cache until they are decoded."""

FIRST = 1 << 16
"""Bytes in the first buffer, for who reads only the beginning; each is twice as large as the one
before, up to :data:`BUFFER`."""

MOST_PARTS = 16
"""Chunks in a group of those of which only a part is kept."""

LARGE = 1 << 26
"""Bytes from which a chunk is not loaded ahead of its use."""


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


class ChunkGroup(NamedTuple, Generic[Chunk]):
    """Chunks that are loaded together, in one thread.

    Parameters
    ----------
    chunks
        The chunks.
    sizes
        Bytes of the records of each.
    buffer
        Memory for their records, one after another; None where each has memory of its own.
    is_large
        Whether it is loaded only when it is its turn.
    """

    chunks: list[Chunk]
    sizes: list[int]
    buffer: Bytes | None
    is_large: bool = False

    @property
    def begins(self) -> list[int]:
        """Where in the buffer the records of each chunk begin."""
        return list(accumulate(self.sizes[:-1], initial=0))

    def parts(self) -> Iterator[tuple[Chunk, Bytes | None]]:
        """Yield each chunk with the memory for its records."""
        for chunk, begin, size in zip(self.chunks, self.begins, self.sizes, strict=True):
            yield chunk, None if self.buffer is None else self.buffer[begin : begin + size]


LoadedGroup = tuple[ChunkGroup[Chunk], list[Content]]
"""Chunks that were loaded together, and what loading each of them gave."""


def load_in_groups(
    sized: Iterable[tuple[Chunk, int | None]],
    load: Callable[[Chunk, Bytes | None], Content],
) -> Generator[LoadedGroup[Chunk, Content], None, None]:
    """Load chunks, one after another.

    Parameters
    ----------
    sized
        The chunks, and how large the records of each are; None for one of which only a part is
        kept, in memory of its own.
    load
        Loads a chunk into the memory that is given to it. Called in other threads.

    Yields
    ------
    tuple
        Chunks that follow each other, and what loading each of them gave.
    """

    def loaded(group: ChunkGroup[Chunk]) -> LoadedGroup[Chunk, Content]:
        return group, [load(*part) for part in group.parts()]

    def load_group(
        group: ChunkGroup[Chunk],
    ) -> LoadedGroup[Chunk, Content] | Deferred[LoadedGroup[Chunk, Content]]:
        return Deferred(lambda: loaded(group)) if group.is_large else loaded(group)

    with closing(prefetch(load_group, in_groups(sized))) as groups:
        yield from groups


def in_groups(sized: Iterable[tuple[Chunk, int | None]]) -> Iterator[ChunkGroup[Chunk]]:
    """Yield chunks in groups: handing over each by itself would cost as much as decompressing it.

    Memory is given to them in their order, whichever of them is loaded first.

    Examples
    --------
    >>> [group.chunks for group in in_groups([("a", 5), ("b", 7), ("c", None), ("d", 3)])]
    [['a', 'b'], ['c'], ['d']]
    """
    buffers = Buffers()
    chunks: list[Chunk] = []
    sizes: list[int] = []
    share = room = 0
    limit = min(FIRST, BUFFER)
    in_buffer = True

    def group() -> ChunkGroup[Chunk]:
        return ChunkGroup(chunks, sizes, buffers.take(sum(sizes)) if in_buffer else None)

    for chunk, size in sized:
        is_large = size is not None and size > LARGE
        share = max(1, BUFFER // MOST_PARTS) if size is None else size
        if chunks and (is_large or in_buffer != (size is not None) or room + share > limit):
            yield group()
            chunks, sizes, room, limit = [], [], 0, min(BUFFER, 2 * limit)
        if is_large:
            yield ChunkGroup([chunk], [share], None, is_large=True)
        else:
            in_buffer = size is not None
            chunks.append(chunk)
            sizes.append(size or 0)
            room += share
    if chunks:
        yield group()
