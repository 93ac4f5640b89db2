"""Whether the index of a ROS 1 bag accounts for all of it.

Bags have no checksums, but they say everything twice: chunk infos and the index data behind each
chunk state how many messages every connection has, and chunks with their index data fill the file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.containers.compression import UnreadableDataError
from quatprop.containers.rosbag1.records import HEAD, INDEX_ENTRY, OP_CHUNK, index_data

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.containers.rosbag1.index import BagChunk
    from quatprop.containers.rosbag1.records import Record, RecordFile

_INDEX_HEAD = 55
"""Bytes of an index data record before its entries, as recorders write it."""


def accounts_for_all(file: RecordFile, chunks: Sequence[BagChunk]) -> bool:
    """Return whether each of some chunks and its index data end where the next chunk begins."""
    unchecked = [chunk for chunk in chunks if not chunk.is_checked]
    begins = [chunk.start for chunk in unchecked]
    file.source.expect(begins, [begin + HEAD for begin in begins])
    for chunk in unchecked:
        chunk.is_checked = _fills_its_place(file, chunk)
        if not chunk.is_checked:
            return False
    return True


def prove(file: RecordFile, chunks: Sequence[BagChunk]) -> None:
    """Note of which chunks the index data agree with the chunk infos."""
    begins = [chunk.start for chunk in chunks]
    file.source.expect(begins, [begin + HEAD for begin in begins])
    ends = [record.end if (record := record_of(file, chunk)) else chunk.end for chunk in chunks]
    file.source.expect(
        ends, [max(pair) for pair in zip((c.end for c in chunks), ends, strict=True)]
    )
    for chunk in chunks:
        chunk.is_proved = _is_indexed_alike(file, chunk)


def record_of(file: RecordFile, chunk: BagChunk) -> Record | None:
    """Return the record of a chunk; None where there is none that is whole."""
    if chunk.record is None and not chunk.is_missing:
        try:
            record = file.record(chunk.start)
            record.number(b"size")
            is_chunk = record.op == OP_CHUNK and b"compression" in record.fields
        except UnreadableDataError:
            return None
        if is_chunk and record.end <= file.size:
            chunk.record = record
    return chunk.record


def _fills_its_place(file: RecordFile, chunk: BagChunk) -> bool:
    record = record_of(file, chunk)
    if record is None:
        return False
    size = sum(_INDEX_HEAD + INDEX_ENTRY.itemsize * count for count in chunk.counts.values())
    return record.end + size == chunk.end or _is_indexed_alike(file, chunk)


def _is_indexed_alike(file: RecordFile, chunk: BagChunk) -> bool:
    """Return whether index data fill the place behind a chunk, and state what its info does."""
    record = record_of(file, chunk)
    # They take less than the messages, but for a few that are empty.
    if record is None or not 0 <= chunk.end - record.end <= 2 * record.number(b"size"):
        return False
    try:
        data = file.at(record.end, chunk.end - record.end)
    except UnreadableDataError:
        return False
    entries, end = index_data(data)
    return end == len(data) and {conn: len(rows) for conn, rows in entries.items()} == chunk.counts
