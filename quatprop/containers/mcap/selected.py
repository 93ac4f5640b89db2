"""Selected messages of an uncompressed chunk, without reading what lies between them.

A camera beside an IMU fills most of a chunk, and the index says where every message begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.containers.byte_ranges import LARGE, ranges_worth_reading
from quatprop.containers.mcap.messages import indexed_offsets, messages_at
from quatprop.containers.mcap.regions import PEEK, UNCOMPRESSED_HEAD, is_uncompressed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.messages import LocatedMessages
    from quatprop.containers.mcap.regions import Region


def selected_messages(
    source: FileSource, region: Region, ids: Sequence[int]
) -> tuple[Buffer, LocatedMessages] | None:
    """Return the messages of selected channels, read one byte range after another.

    Parameters
    ----------
    source
        The file.
    region
        A chunk.
    ids
        The channels.

    Returns
    -------
    tuple or None
        A buffer, and where messages are in it. None where the chunk is better read whole: it is
        compressed, small or mostly selected, or its index and its records do not agree. The
        checksum is that of the whole chunk, so the messages are not checked against it.
    """
    size = region.length - UNCOMPRESSED_HEAD
    if not _may_be_selected(region, ids) or not is_uncompressed(source, region):
        return None
    index_at = region.start + region.length
    index = source.read(index_at, region.index_length)
    selected = indexed_offsets(index, index_at, region, ids)
    indexed = indexed_offsets(index, index_at, region, list(region.holds or ()))
    if selected is None or indexed is None:
        return None
    ranges = ranges_worth_reading(selected, indexed, size)
    if ranges is None:
        return None
    records_at = region.start + UNCOMPRESSED_HEAD
    begins, ends = records_at + ranges.begins, records_at + ranges.ends
    data = source.read_ranges(begins.tolist(), ends.tolist())
    if len(data) < ranges.size:
        return None
    messages = messages_at(data, selected - ranges.moved)
    if messages is None or not messages.are_all_of(ids):
        return None
    return data, messages


def expected_ranges(
    regions: Sequence[Region], ids: Sequence[int], *, uncompressed: bool
) -> tuple[list[int], list[int]]:
    """Return where the reading of the messages of some channels begins: byte ranges of the file.

    Parameters
    ----------
    regions
        Regions with messages of the channels.
    ids
        The channels.
    uncompressed
        Whether chunks are not compressed, so that large ones are read in part: what they hold is
        known from their heads and indexes.

    Returns
    -------
    begins, ends
        The ranges, bytes.
    """
    begins, ends = [], []
    for region in regions:
        if uncompressed and _may_be_selected(region, region.own(ids)):
            begins += [region.start, region.start + region.length]
            ends += [region.start + PEEK, region.end]
        else:
            begins.append(region.start)
            ends.append(max(region.end, region.start + PEEK))
    return begins, ends


def _may_be_selected(region: Region, ids: Sequence[int]) -> bool:
    """Return whether a region is large, and holds other channels."""
    is_large = region.length - UNCOMPRESSED_HEAD >= LARGE
    return is_large and not set(region.holds or ()) <= set(ids)
