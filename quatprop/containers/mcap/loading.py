"""Load the regions of an MCAP file, several together and ahead of their use."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from quatprop.concurrency.threads import Deferred, prefetch
from quatprop.containers.buffers import in_groups
from quatprop.containers.compression import LARGE
from quatprop.containers.limits import DecompressionBudget
from quatprop.containers.mcap.regions import Loaded, RegionError, head_of, load
from quatprop.containers.mcap.selected import (
    Selected,
    expected_ranges,
    may_be_selected,
    selected_messages,
)

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.buffers import Group
    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.redefinitions import DefinitionCheck
    from quatprop.containers.mcap.regions import ChunkHead, Region

    Content: TypeAlias = Loaded | Selected | RegionError


class LoadedGroup(NamedTuple):
    """Regions that were loaded together.

    Parameters
    ----------
    group
        The regions, and the buffer that holds their records if they have one.
    contents
        The whole of each region; its selected messages alone, where that is quicker; or why it
        cannot be read.
    """

    group: Group[Region]
    contents: list[Content]

    @property
    def data(self) -> Buffer:
        """The records of all regions, one after another."""
        if self.group.buffer is not None:
            return self.group.buffer.data
        (content,) = self.contents
        return b"" if isinstance(content, RegionError) else content.data


def load_regions(
    source: FileSource, regions: Sequence[Region], ids: Sequence[int], definitions: DefinitionCheck
) -> Generator[LoadedGroup, None, None]:
    """Load regions, one after another.

    Parameters
    ----------
    source
        The file.
    regions
        Where in it.
    ids
        The channels that are wanted.
    definitions
        Says whether messages may be selected beside the definitions that a chunk begins with.

    Yields
    ------
    LoadedGroup
        Regions that follow each other.
    """
    loader = _Loader(source, ids, definitions)
    first = loader.head(regions[0]) if regions else None
    is_uncompressed = first is not None and first.is_uncompressed
    source.expect(*expected_ranges(regions, ids, uncompressed=is_uncompressed))
    groups = in_groups((region, loader.size(region)) for region in regions)
    with closing(prefetch(loader.load, groups)) as loaded:
        yield from loaded


class _Loader:
    def __init__(
        self, source: FileSource, ids: Sequence[int], definitions: DefinitionCheck
    ) -> None:
        self.source, self.ids, self.definitions = source, ids, definitions
        self.budget = DecompressionBudget(source.size)

    def head(self, region: Region) -> ChunkHead | None:
        try:
            return head_of(self.source, region)
        except OSError:
            return None  # noted when the chunk is loaded

    def size(self, region: Region) -> int | None:
        """Return the bytes of the records of a chunk that is loaded into a buffer with others."""
        head = self.head(region)
        if head is None or head.size > LARGE:
            return None
        if head.is_uncompressed and may_be_selected(region, region.own(self.ids)):
            return None
        return head.size or None

    def load(self, group: Group[Region]) -> LoadedGroup | Deferred[LoadedGroup]:
        def loaded() -> LoadedGroup:
            return LoadedGroup(group, [self._load(*part) for part in group.parts()])

        head = self.head(group.items[0]) if group.buffer is None else None
        return Deferred(loaded) if head and head.size > LARGE else loaded()

    def _load(self, region: Region, into: NDArray[np.uint8] | None) -> Content:
        """Return the selected messages of a region or, where that is as quick, all of it."""
        own = region.own(self.ids)
        try:
            if into is None and (selected := selected_messages(self.source, region, own)):
                self.definitions.check_leading(selected.data, region, own)
                return selected
        except (RegionError, OSError):
            pass  # it is read whole, and then compared with its checksum
        try:
            return load(self.source, region, self.budget, into=into)
        except RegionError as error:
            return error
