"""Messages picked out of a chunk that is not packed, without reading what lies between them.

A camera beside an IMU fills most of a chunk, and the index data tell where everything begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.rosbag1.index import Content
from quatprop.containers.rosbag1.records import OP_CHUNK, MalformedRecordError, index_offsets
from quatprop.containers.spans import LARGE, spans_worth_picking

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

    from numpy.typing import NDArray

    from quatprop.containers.rosbag1.index import Chunk
    from quatprop.containers.rosbag1.records import RecordFile


def picked(file: RecordFile, chunk: Chunk, wanted: AbstractSet[int]) -> Content | None:
    """Return what a chunk has of some connections, read stretch after stretch.

    Parameters
    ----------
    file
        The bag.
    chunk
        One of its chunks.
    wanted
        Numbers of the connections.

    Returns
    -------
    Content or None
        Records, and index entries that point to those of the wanted connections. None where the
        chunk is better read whole: it is packed, small or mostly wanted, or its index data are
        not what the bag says of them.
    """
    if chunk.loose or chunk.counts.keys() <= wanted:
        return None
    try:
        record = file.record(chunk.start)
        size = record.end - record.data
        is_plain = record.op == OP_CHUNK and record.fields.get(b"compression") == b"none"
        if not is_plain or size < LARGE or record.end > chunk.end:
            return None
        entries = index_offsets(file.at(record.end, min(chunk.end - record.end, size)))
    except MalformedRecordError:
        return None
    if {conn: len(found) for conn, found in entries.items()} != chunk.counts:
        return None
    every = _offsets(entries)
    ours = {conn: found for conn, found in entries.items() if conn in wanted}
    begins = _offsets(ours)
    spans = spans_worth_picking(begins, every, size)
    if spans is None:
        return None
    places = zip(spans.begins.tolist(), spans.ends.tolist(), strict=True)
    data = b"".join(file.at(record.data + begin, end - begin) for begin, end in places)
    for conn, found in ours.items():
        moved = found.copy()
        moved["offset"] = found["offset"] - spans.moved[np.searchsorted(begins, found["offset"])]
        ours[conn] = moved
    return Content(np.frombuffer(data, np.uint8), ours)


def _offsets(entries: dict[int, NDArray[np.void]]) -> NDArray[np.int64]:
    """Return where all records begin, ascending."""
    parts = [found["offset"].astype(np.int64) for found in entries.values()]
    return np.sort(np.concatenate([*parts, np.empty(0, np.int64)]))
