"""Selected messages of an uncompressed chunk, without reading what lies between them.

A camera beside an IMU fills most of a chunk, and the index says where every message begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.containers.byte_ranges import LARGE, ranges_worth_reading
from quatprop.containers.mcap.messages import indexed_offsets, messages_at
from quatprop.containers.mcap.regions import PEEK, RECORD, head_of, index_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.messages import LocatedMessages
    from quatprop.containers.mcap.regions import Region


class Selected(NamedTuple):
    """Messages that were read without the rest of their chunk.

    Parameters
    ----------
    data
        The beginning of the chunk up to its first message, its selected messages, and the heads of
        the others.
    messages
        Where the selected messages are.
    """

    data: Buffer
    messages: LocatedMessages


def selected_messages(source: FileSource, region: Region, ids: Sequence[int]) -> Selected | None:
    """Return the messages of selected channels, read one byte range after another.

    The heads of the other messages are read too: their lengths show that no definition is hidden
    between them.

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
    Selected or None
        None where the chunk is better read whole: it is compressed, small or mostly selected, or
        its index and its records do not agree. The checksum is that of the whole chunk, so the
        messages are not checked against it.
    """
    chunk = head_of(source, region) if may_be_selected(region, ids) else None
    if chunk is None or not chunk.is_uncompressed:
        return None
    index = index_of(source, region)
    selected = indexed_offsets(index, region, ids)
    indexed = indexed_offsets(index, region, list(region.holds or ()))
    if selected is None or indexed is None or not len(selected):
        return None
    begins = np.concatenate([[0], indexed])
    nexts = np.append(indexed, chunk.size)
    is_whole = np.isin(begins, selected)
    is_whole[0] = True
    ends = np.where(is_whole, nexts, np.minimum(begins + RECORD.size, nexts))
    ranges = ranges_worth_reading(begins, ends, chunk.size)
    if ranges is None:
        return None
    records_at = region.start + chunk.begin
    places = records_at + ranges.begins, records_at + ranges.ends
    data = source.read_ranges(*(place.tolist() for place in places))
    if len(data) < ranges.size or (nexts[1:] - begins[1:] < RECORD.size).any():
        return None
    moved = (begins - ranges.moved)[1:]
    # A stride of 1 byte lets records begin anywhere.
    lengths = np.ndarray((len(data) - RECORD.size + 1,), "<u8", data, offset=1, strides=(1,))
    if (lengths[moved] != nexts[1:] - begins[1:] - RECORD.size).any():
        return None
    messages = messages_at(data, moved[is_whole[1:]])
    return Selected(data, messages) if messages and messages.are_all_of(ids) else None


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
        if uncompressed and may_be_selected(region, region.own(ids)):
            begins += [region.start, region.start + region.length]
            ends += [region.start + PEEK, region.end]
        else:
            begins.append(region.start)
            ends.append(max(region.end, region.start + PEEK))
    return begins, ends


def may_be_selected(region: Region, ids: Sequence[int]) -> bool:
    """Return whether a region is large, and holds other channels."""
    is_large = region.is_chunk and region.length >= LARGE
    return is_large and region.holds is not None and not set(region.holds) <= set(ids)
