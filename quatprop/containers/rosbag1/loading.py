"""Read the messages of a channel from the chunks of a ROS 1 bag, and record losses.

Bags have no checksums but redundant counts: chunk infos and the index data behind each chunk state
the number of messages of every connection, and chunks with their index data fill the file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.chunks import ChunkReader
from quatprop.containers.rosbag1.index import (
    BagChunk,
    ChunkRecords,
    index_reader,
    offsets_of,
    read_chunk,
)
from quatprop.containers.rosbag1.messages import indexed_messages
from quatprop.containers.rosbag1.records import (
    HEAD,
    INDEX_ENTRY,
    OP_CHUNK,
    OP_MESSAGE,
    index_data,
    surviving_records,
)
from quatprop.messages.blocks import MessageBlock
from quatprop.stores.byte_ranges import LARGE, ranges_worth_reading
from quatprop.stores.compression import UnreadableDataError

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from quatprop.containers.rosbag1.records import Record, RecordFile
    from quatprop.tables.log import Losses


_INDEX_HEAD = 55
"""Usual bytes of an index data record before its entries."""


class BagReader(ChunkReader[BagChunk, ChunkRecords]):
    """Reads the messages of one channel.

    `topic`, `connections`: the topic of the channel, and the ids of its connections
    """

    def __init__(self, file: RecordFile, losses: Losses, topic: str, connections: set[int]) -> None:
        super().__init__(file.source)
        self.file, self.losses, self.topic, self.connections = file, losses, topic, connections
        self._is_plain: bool | None = None

    def is_mixed(self, chunk: BagChunk) -> bool:
        """Return whether a chunk has other connections."""
        own = chunk.local_ids(self.connections)
        return not chunk.is_unchunked and not chunk.counts.keys() <= own

    def expected(self, chunk: BagChunk, *, is_mixed: bool) -> list[tuple[int, int]]:
        """Return the byte range of a chunk, or of its head if it is read in part."""
        head_end = chunk.start + HEAD
        if is_mixed and chunk.end - chunk.start >= LARGE:
            if self._is_plain is None:
                self._is_plain = _is_plain(record_of(self.file, chunk))
            if self._is_plain:
                return [(chunk.start, head_end)]
        return [(chunk.start, max(chunk.end, head_end))]

    def size_of(self, chunk: BagChunk) -> int:
        """Return the bytes of the records of a chunk by its head; 0 if unknown."""
        if chunk.is_unchunked:
            return chunk.end - chunk.start
        record = record_of(self.file, chunk)
        if record is None:
            return 0
        return record.end - record.data if _is_plain(record) else record.number(b"size")

    def load(self, chunk: BagChunk, *, is_mixed: bool) -> ChunkRecords:
        """Return the records of a chunk, or only the wanted messages of a large one."""
        is_large = chunk.end - chunk.start >= LARGE
        if is_large and is_mixed and self._is_indexed(chunk, chunk.counts):
            selected = self._load_messages(chunk)
            if selected is not None:
                return selected
        return self._load_chunk(chunk)

    def _load_chunk(self, chunk: BagChunk) -> ChunkRecords:
        if chunk.is_missing:
            return ChunkRecords(damage="a part of it is missing")
        try:
            self.budget.check()
            loaded = read_chunk(self.file, chunk, record_of(self.file, chunk))
        except UnreadableDataError as error:
            return ChunkRecords(damage=str(error))
        self.budget.spend(0 if chunk.is_unchunked else len(loaded.data))
        return loaded

    def _load_messages(self, chunk: BagChunk) -> ChunkRecords | None:
        """Return the wanted messages of a chunk; None if it is better read whole.

        That is, if it is compressed or mostly wanted, or its index data and chunk info disagree.
        """
        record = record_of(self.file, chunk)
        if record is None or not _is_plain(record) or record.end > chunk.end:
            return None
        size = record.end - record.data
        entries = ChunkRecords(read_index=index_reader(self.file, chunk, record, size)).entries
        indexed = offsets_of(entries)
        is_double = (indexed[1:] == indexed[:-1]).any()
        if is_double or {conn: len(rows) for conn, rows in entries.items()} != chunk.counts:
            return None
        begins = offsets_of(entries, chunk.local_ids(self.connections))
        nexts = np.append(indexed, size)[np.searchsorted(indexed, begins, "right")]
        ranges = ranges_worth_reading(begins, nexts, size)
        if ranges is None:
            return None
        places = record.data + ranges.begins, record.data + ranges.ends
        data = np.frombuffer(self.file.at_ranges(*(each.tolist() for each in places)), np.uint8)
        return ChunkRecords(data, offsets=begins - ranges.moved)

    def indexed(self, content: ChunkRecords, chunk: BagChunk) -> MessageBlock | None:
        """Return the messages of a chunk by its index data; None if it is not reliable."""
        inside = chunk.local_ids(self.connections)
        if content.offsets is not None:
            return indexed_messages(content.data, content.offsets, inside)
        counts = {conn: len(rows) for conn, rows in content.entries.items() if conn in inside}
        expected = {conn: n for conn, n in chunk.counts.items() if conn in inside}
        if content.damage or not self._is_indexed(chunk, counts) or counts != expected:
            return None
        return indexed_messages(content.data, offsets_of(content.entries, inside), inside)

    def messages(self, content: ChunkRecords, chunk: BagChunk) -> MessageBlock | None:
        """Return the messages of a chunk by its records, and record losses."""
        if content.offsets is not None:
            content = self._load_chunk(chunk)
        inside = chunk.local_ids(self.connections)
        messages, damage = _scanned(content, inside)
        missing = sum(chunk.counts.get(conn, 0) for conn in inside) - len(messages)
        if damage or missing > 0:
            reason = damage or "it has fewer messages than it says"
            self.losses.note(chunk.place, reason, missing or None, self.topic)
        return messages

    def _is_indexed(self, chunk: BagChunk, indexed: Collection[int]) -> bool:
        """Return whether an index is certain to list all messages of the wanted connections.

        Without chunk infos, the index may list messages under the id of another connection.
        """
        return chunk.is_proved is not False or chunk.local_ids(self.connections) <= {*indexed}


def _is_plain(record: Record | None) -> bool:
    return record is None or record.fields[b"compression"] == b"none"


def _scanned(content: ChunkRecords, wanted: set[int]) -> tuple[MessageBlock, str]:
    """Locate messages record by record; return them and the damage, or ``""``."""
    records, damage = surviving_records(content.data, content.indexed_offsets)
    rows = [
        (record.data, record.end, record.time(b"time"))
        for record in records
        if record.op == OP_MESSAGE and record.number(b"conn") in wanted
    ]
    starts, ends, log_ns = np.array(rows, np.int64).reshape(-1, 3).T.copy()
    return MessageBlock(content.data, starts, ends, log_ns, log_ns), content.damage or damage


def accounts_for_all(file: RecordFile, chunks: Sequence[BagChunk]) -> bool:
    """Return whether each of some chunks and its index data end where the next chunk begins."""
    unchecked = [chunk for chunk in chunks if not chunk.is_checked]
    begins = [chunk.start for chunk in unchecked]
    file.source.expect(begins, [begin + HEAD for begin in begins])
    for chunk in unchecked:
        chunk.is_checked = _has_no_gap_behind(file, chunk)
        if not chunk.is_checked:
            return False
    return True


def prove(file: RecordFile, chunks: Sequence[BagChunk]) -> None:
    """Set `is_proved` of chunks: whether their index data agree with their chunk infos."""
    begins = [chunk.start for chunk in chunks]
    file.source.expect(begins, [begin + HEAD for begin in begins])
    ends = [record.end if (record := record_of(file, chunk)) else chunk.end for chunk in chunks]
    file.source.expect(
        ends, [max(pair) for pair in zip((c.end for c in chunks), ends, strict=True)]
    )
    for chunk in chunks:
        chunk.is_proved = _matches_index(file, chunk)


def record_of(file: RecordFile, chunk: BagChunk) -> Record | None:
    """Return the record of a chunk; None if it is missing or incomplete."""
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


def _has_no_gap_behind(file: RecordFile, chunk: BagChunk) -> bool:
    record = record_of(file, chunk)
    if record is None:
        return False
    size = sum(_INDEX_HEAD + INDEX_ENTRY.itemsize * count for count in chunk.counts.values())
    return record.end + size == chunk.end or _matches_index(file, chunk)


def _matches_index(file: RecordFile, chunk: BagChunk) -> bool:
    """Return whether index data fill the space behind a chunk and agree with its chunk info."""
    record = record_of(file, chunk)
    # They are shorter than the messages, unless these are empty.
    if record is None or not 0 <= chunk.end - record.end <= 2 * record.number(b"size"):
        return False
    try:
        data = file.at(record.end, chunk.end - record.end)
    except UnreadableDataError:
        return False
    entries, end = index_data(data)
    return end == len(data) and {conn: len(rows) for conn, rows in entries.items()} == chunk.counts
