"""Selected messages of an uncompressed chunk, without reading what lies between them.

A camera beside an IMU fills most of a chunk, and the index data say where every message begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.byte_ranges import LARGE, SHARE, ranges_worth_reading
from quatprop.containers.rosbag1.index import BagChunk, ChunkRecords, index_reader, offsets_of

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

    from quatprop.containers.rosbag1.records import Record, RecordFile


def selected_messages(
    file: RecordFile,
    chunk: BagChunk,
    record: Record,
    connections: AbstractSet[int],
    whole: ChunkRecords | None = None,
) -> ChunkRecords | None:
    """Return copies of the messages of selected connections, and of little else.

    Parameters
    ----------
    file
        The bag.
    chunk
        One of its chunks.
    record
        Its record.
    connections
        Numbers of the connections.
    whole
        All records; None to read only those that are selected, one byte range after another.

    Returns
    -------
    ChunkRecords or None
        None where the chunk is better read whole: it is compressed, small or mostly selected, or
        its index data is not what the bag says.
    """
    if whole is None:
        size = record.end - record.data
        is_uncompressed = record.fields[b"compression"] == b"none"
        if not is_uncompressed or size < LARGE or record.end > chunk.end:
            return None
    else:
        size = len(whole.data)
    entries = (whole or ChunkRecords(read_index=index_reader(file, chunk, record, size))).entries
    if {conn: len(rows) for conn, rows in entries.items()} != chunk.counts:
        return None
    indexed = offsets_of(entries)
    if (indexed[1:] == indexed[:-1]).any():
        return None
    begins = offsets_of(entries, connections)
    nexts = np.append(indexed, size)[np.searchsorted(indexed, begins, "right")]
    ranges = ranges_worth_reading(begins, nexts, size, SHARE if whole is None else 1)
    if ranges is None:
        return None
    if whole is None:
        places = record.data + ranges.begins, record.data + ranges.ends
        data = np.frombuffer(file.at_ranges(*(each.tolist() for each in places)), np.uint8)
    else:
        data = ranges.of(whole.data)
    return ChunkRecords(data, offsets=begins - ranges.moved)
