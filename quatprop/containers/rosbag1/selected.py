"""Selected messages of an uncompressed chunk, without reading what lies between them.

A camera beside an IMU fills most of a chunk, and the index data say where every message begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.byte_ranges import LARGE, ranges_worth_reading
from quatprop.containers.rosbag1.records import HEAD, OP_CHUNK, MalformedRecordError, index_offsets

if TYPE_CHECKING:
    from collections.abc import Sequence
    from collections.abc import Set as AbstractSet

    from numpy.typing import NDArray

    from quatprop.containers.rosbag1.index import BagChunk
    from quatprop.containers.rosbag1.records import RecordFile

    IndexEntries = dict[int, NDArray[np.void]]


def selected_messages(
    file: RecordFile, chunk: BagChunk, connections: AbstractSet[int]
) -> tuple[NDArray[np.uint8], IndexEntries] | None:
    """Return the messages of selected connections, read one byte range after another.

    Parameters
    ----------
    file
        The bag.
    chunk
        One of its chunks.
    connections
        Numbers of the connections.

    Returns
    -------
    tuple or None
        Records, and the index entries of the selected connections. None where the chunk is better
        read whole: it is compressed, small or mostly selected, or its index data is not what the
        bag says.
    """
    if chunk.is_unchunked or chunk.counts.keys() <= connections:
        return None
    try:
        record = file.record(chunk.start)
        size = record.end - record.data
        is_uncompressed = record.op == OP_CHUNK and record.fields.get(b"compression") == b"none"
        if not is_uncompressed or size < LARGE or record.end > chunk.end:
            return None
        entries = index_offsets(file.at(record.end, min(chunk.end - record.end, size)))
    except MalformedRecordError:
        return None
    if {conn: len(rows) for conn, rows in entries.items()} != chunk.counts:
        return None
    indexed = _offsets(entries)
    selected = {conn: rows for conn, rows in entries.items() if conn in connections}
    begins = _offsets(selected)
    nexts = np.append(indexed, size)[np.searchsorted(indexed, begins, "right")]
    ranges = ranges_worth_reading(begins, nexts, size)
    if ranges is None:
        return None
    places = record.data + ranges.begins, record.data + ranges.ends
    data = file.at_ranges(*(each.tolist() for each in places))
    for conn, rows in selected.items():
        moved = rows.copy()
        moved["offset"] = rows["offset"] - ranges.moved[np.searchsorted(begins, rows["offset"])]
        selected[conn] = moved
    return np.frombuffer(data, np.uint8), selected


def expected_ranges(
    chunks: Sequence[BagChunk], connections: AbstractSet[int], *, compressed: bool
) -> tuple[list[int], list[int]]:
    """Return where the reading of the messages of some connections begins: byte ranges of the file.

    Parameters
    ----------
    chunks
        Chunks with messages of the connections.
    connections
        Numbers of the connections.
    compressed
        Whether chunks are compressed, and so read whole.

    Returns
    -------
    begins, ends
        The ranges, bytes.
    """
    ends = []
    for chunk in chunks:
        is_large = chunk.end - chunk.start >= LARGE
        is_all = chunk.counts.keys() <= chunk.inside(connections)
        in_part = is_large and not compressed and not is_all
        ends.append(chunk.start + HEAD if in_part else max(chunk.end, chunk.start + HEAD))
    return [chunk.start for chunk in chunks], ends


def _offsets(entries: dict[int, NDArray[np.void]]) -> NDArray[np.int64]:
    """Return where all records begin, ascending."""
    parts = [rows["offset"].astype(np.int64) for rows in entries.values()]
    return np.sort(np.concatenate([*parts, np.empty(0, np.int64)]))
