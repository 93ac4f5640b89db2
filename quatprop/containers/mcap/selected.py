"""Selected messages of an uncompressed chunk, without reading what lies between them.

A camera beside an IMU fills most of a chunk, and the index says where every message begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.containers.byte_ranges import LARGE, ranges_worth_reading
from quatprop.containers.mcap.messages import indexed_offsets, messages_at
from quatprop.containers.mcap.regions import UNCOMPRESSED_HEAD, is_uncompressed

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
    is_small = size < LARGE or set(region.holds or ()) <= set(ids)
    if is_small or not is_uncompressed(source, region):
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
    places = zip(ranges.begins.tolist(), ranges.ends.tolist(), strict=True)
    data = b"".join(source.read(records_at + begin, end - begin) for begin, end in places)
    if len(data) < ranges.size:
        return None
    messages = messages_at(data, selected - ranges.moved)
    if messages is None or not messages.are_all_of(ids):
        return None
    return data, messages
