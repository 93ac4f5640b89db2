"""Load the regions of an MCAP file."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from quatprop.containers.limits import DecompressionBudget
from quatprop.containers.loading import LARGE, LoadedGroup, load_in_groups
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

    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.redefinitions import DefinitionCheck
    from quatprop.containers.mcap.regions import ChunkHead, Region

    Content: TypeAlias = Loaded | Selected | RegionError
    """The whole of a region; its selected messages alone; or why it cannot be read."""


def load_regions(
    source: FileSource, regions: Sequence[Region], ids: Sequence[int], definitions: DefinitionCheck
) -> Generator[LoadedGroup[Region, Content], None, None]:
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
    return load_in_groups(((region, loader.size(region)) for region in regions), loader.load)


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
        """Return the bytes of the records of a chunk; None for one that is not loaded as usual."""
        head = self.head(region)
        if head is None or not head.size:
            return None
        own = region.own(self.ids)
        if head.size <= LARGE and head.is_uncompressed and may_be_selected(region, own):
            return None
        return head.size

    def load(self, region: Region, into: NDArray[np.uint8] | None) -> Content:
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
