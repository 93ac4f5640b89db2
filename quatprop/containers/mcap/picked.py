"""Messages picked out of a chunk that is not compressed, without reading what lies between them.

A camera beside an IMU fills most of a chunk, and the index tells where everything begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.containers.mcap.messages import at_offsets, indexed
from quatprop.containers.mcap.regions import PLAIN_HEAD, is_plain
from quatprop.containers.spans import LARGE, spans_worth_picking

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.messages import Messages
    from quatprop.containers.mcap.regions import Region


def picked(
    source: FileSource, region: Region, ids: Sequence[int]
) -> tuple[Buffer, Messages] | None:
    """Return the messages of some channels, read stretch after stretch.

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
        A buffer and where messages are in it. None where the chunk is better read whole: it is
        compressed, small or mostly wanted, or its index and its records do not agree. The
        checksum of a chunk is of the whole of it, so it is not known to be right.
    """
    size = region.length - PLAIN_HEAD
    if size < LARGE or set(region.holds or ()) <= set(ids) or not is_plain(source, region):
        return None
    index_at = region.start + region.length
    index = source.read(index_at, region.index_length)
    wanted = indexed(index, index_at, region, ids)
    every = indexed(index, index_at, region, list(region.holds or ()))
    if wanted is None or every is None:
        return None
    spans = spans_worth_picking(wanted, every, size)
    if spans is None:
        return None
    records_at = region.start + PLAIN_HEAD
    places = zip(spans.begins.tolist(), spans.ends.tolist(), strict=True)
    data = b"".join(source.read(records_at + begin, end - begin) for begin, end in places)
    if len(data) < spans.size:
        return None
    messages = at_offsets(data, wanted - spans.moved)
    if messages is None or not messages.are_all_of(ids):
        return None
    return data, messages
