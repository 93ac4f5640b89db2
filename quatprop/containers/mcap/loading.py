"""Load the regions of an MCAP file, ahead of their use where they are compressed."""

from __future__ import annotations

from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from quatprop.concurrency.threads import Deferred, prefetch
from quatprop.containers.buffers import Buffers
from quatprop.containers.compression import LARGE
from quatprop.containers.limits import DecompressionBudget
from quatprop.containers.mcap.regions import (
    PEEK,
    Loaded,
    RegionError,
    chunk_head,
    is_uncompressed,
    load,
)
from quatprop.containers.mcap.selected import expected_ranges, selected_messages

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.messages import LocatedMessages
    from quatprop.containers.mcap.regions import Region

    Content: TypeAlias = Loaded | tuple[Buffer, LocatedMessages] | RegionError


TOGETHER = 1 << 21
"""Bytes of regions that are loaded together, in one thread."""

FIRST = 1 << 16
"""Bytes of the first of them, for who reads only the beginning; then twice as many each time."""


def load_regions(
    source: FileSource, regions: Sequence[Region], ids: Sequence[int]
) -> Generator[Content, None, None]:
    """Load regions, one after another.

    Parameters
    ----------
    source
        The file.
    regions
        Where in it.
    ids
        The channels that are wanted.

    Yields
    ------
    Loaded or tuple or RegionError
        The whole region; its selected messages alone, as
        :func:`quatprop.containers.mcap.selected.selected_messages` gives them, where that is
        quicker; or why it cannot be read. Chunks that are decompressed follow each other in one
        buffer while they fit.
    """
    load_one = partial(_load, source, DecompressionBudget(source.size), ids)
    uncompressed = bool(regions) and is_uncompressed(source, regions[0])
    source.expect(*expected_ranges(regions, ids, uncompressed=uncompressed))
    if uncompressed or not regions:
        yield from (load_one(region, None) for region in regions)
        return
    groups = _groups(source, load_one, regions)
    loaded: Generator[list[Content], None, None] = prefetch(_load_group, groups)
    with closing(loaded):
        for contents in loaded:
            yield from contents


class _Group(NamedTuple):
    """What loads some regions that follow each other, in one thread.

    Parameters
    ----------
    calls
        Each loads one region.
    is_large
        Whether it is one large region, which is loaded only when it is its turn.
    """

    calls: list[Callable[[], Content]]
    is_large: bool = False


def _load_group(group: _Group) -> list[Content] | Deferred[list[Content]]:
    def contents() -> list[Content]:
        return [call() for call in group.calls]

    return Deferred(contents) if group.is_large else contents()


def _groups(
    source: FileSource,
    load_one: Callable[[Region, NDArray[np.uint8] | None], Content],
    regions: Sequence[Region],
) -> Iterator[_Group]:
    """Yield regions in groups: handing over each by itself would cost as much as unpacking it.

    Memory is given to them in their order, whichever of them is loaded first.
    """
    buffers = Buffers()
    calls: list[Callable[[], Content]] = []
    size, enough = 0, min(FIRST, TOGETHER)
    for region in regions:
        start = source.read(region.start, PEEK) if region.is_chunk else b""
        head = chunk_head(start, region.length)
        if head is not None and head.size > LARGE:
            yield _Group(calls)
            yield _Group([partial(load_one, region, None)], is_large=True)
            calls, size = [], 0
            continue
        into = buffers.take(head.size) if head and head.compression == "zstd" else None
        calls.append(partial(load_one, region, into))
        size += region.length if head is None else head.size
        if size >= enough:
            yield _Group(calls)
            calls, size, enough = [], 0, min(2 * enough, TOGETHER)
    yield _Group(calls)


def _load(
    source: FileSource,
    budget: DecompressionBudget,
    ids: Sequence[int],
    region: Region,
    into: NDArray[np.uint8] | None,
) -> Content:
    """Return the selected messages of a region or, where that is as quick, all of it."""
    try:
        selected = selected_messages(source, region, region.own(ids))
        return selected or load(source, region, budget, into=into)
    except RegionError as error:
        return error
