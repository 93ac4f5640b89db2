"""Chunks of a log, several of which are loaded together and ahead of their use.

Each chunk has memory of its own, as long as what was read of it: nothing stands for records that
are missing.
"""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, TypeVar

from quatprop.concurrency.threads import Deferred, prefetch

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator

Chunk = TypeVar("Chunk")
Content = TypeVar("Content")

GROUP = 1 << 20
"""Bytes in a group: the chunks in it stay in the processor's cache until they are decoded."""

FIRST = 1 << 16
"""Bytes in the first group, for who reads only the beginning; each is twice as large as the one
before, up to :data:`GROUP`."""

MOST_PARTS = 16
"""Chunks in a group of those of which only a part is kept."""

LARGE = 1 << 26
"""Bytes from which a chunk is not loaded ahead of its use."""


def load_ahead(
    sized: Iterable[tuple[Chunk, int | None]], load: Callable[[Chunk], Content]
) -> Generator[tuple[Chunk, Content], None, None]:
    """Load chunks, one after another.

    Parameters
    ----------
    sized
        The chunks, and how large the records of each are; None for one of which only a part is
        kept.
    load
        Loads a chunk. Called in other threads.

    Yields
    ------
    tuple
        Each chunk, and what loading it gave.
    """

    def loaded(chunks: list[Chunk]) -> list[tuple[Chunk, Content]]:
        return [(chunk, load(chunk)) for chunk in chunks]

    def load_group(
        group: tuple[list[Chunk], bool],
    ) -> list[tuple[Chunk, Content]] | Deferred[list[tuple[Chunk, Content]]]:
        chunks, is_large = group
        return Deferred(lambda: loaded(chunks)) if is_large else loaded(chunks)

    with closing(prefetch(load_group, in_groups(sized))) as groups:
        for group in groups:
            yield from group


def in_groups(sized: Iterable[tuple[Chunk, int | None]]) -> Iterator[tuple[list[Chunk], bool]]:
    """Yield chunks in groups: handing over each by itself would cost as much as decompressing it.

    Yields
    ------
    tuple
        Chunks that are loaded in one thread, and whether they are so large that they are loaded
        only when it is their turn.

    Examples
    --------
    >>> [chunks for chunks, _ in in_groups([("a", 5), ("b", 70_000), ("c", None), ("d", 3)])]
    [['a'], ['b'], ['c', 'd']]
    """
    chunks: list[Chunk] = []
    room, limit = 0, min(FIRST, GROUP)
    for chunk, size in sized:
        is_large = size is not None and size > LARGE
        share = max(1, GROUP // MOST_PARTS) if size is None else size
        if chunks and (is_large or room + share > limit):
            yield chunks, False
            chunks, room, limit = [], 0, min(GROUP, 2 * limit)
        if is_large:
            yield [chunk], True
        else:
            chunks.append(chunk)
            room += share
    if chunks:
        yield chunks, False
