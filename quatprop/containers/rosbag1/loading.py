"""Read the messages of a channel in the chunks of a ROS 1 bag, and note what is lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.base import Losses, MessageBlock
from quatprop.containers.byte_ranges import LARGE as LARGE_ENOUGH
from quatprop.containers.chunks import ChunkReader
from quatprop.containers.compression import UnreadableDataError
from quatprop.containers.rosbag1.accounting import record_of
from quatprop.containers.rosbag1.index import BagChunk, ChunkRecords, offsets_of, read_chunk
from quatprop.containers.rosbag1.messages import indexed_messages, only_messages
from quatprop.containers.rosbag1.records import (
    HEAD,
    OP_MESSAGE,
    begin_of_messages,
    surviving_records,
)
from quatprop.containers.rosbag1.selected import selected_messages

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

    from quatprop.containers.rosbag1.records import RecordFile


class BagReader(ChunkReader[BagChunk, ChunkRecords]):
    """Reads the messages of one channel.

    Parameters
    ----------
    file
        The bag.
    losses
        What is lost of it; grows.
    topic, connections
        The channel, and the numbers of its connections.
    """

    def __init__(self, file: RecordFile, losses: Losses, topic: str, connections: set[int]) -> None:
        super().__init__(file.source)
        self.file, self.losses, self.topic, self.connections = file, losses, topic, connections
        self._is_plain: bool | None = None

    def expected(self, chunk: BagChunk) -> list[tuple[int, int]]:
        """Return the bytes of a chunk, or of the head of one that is read in part."""
        head_end = chunk.start + HEAD
        if self.is_mixed(chunk) and chunk.end - chunk.start >= LARGE_ENOUGH:
            if self._is_plain is None:
                record = record_of(self.file, chunk)
                self._is_plain = record is None or record.fields[b"compression"] == b"none"
            if self._is_plain:
                return [(chunk.start, head_end)]
        return [(chunk.start, max(chunk.end, head_end))]

    def size_of(self, chunk: BagChunk) -> int:
        """Return the bytes of the records of a chunk by its head."""
        if chunk.is_unchunked:
            return chunk.end - chunk.start
        record = record_of(self.file, chunk)
        if record is None:
            return 0
        is_plain = record.fields[b"compression"] == b"none"
        return record.end - record.data if is_plain else record.number(b"size")

    def is_mixed(self, chunk: BagChunk) -> bool:
        """Return whether a chunk holds other connections."""
        return not chunk.is_unchunked and not chunk.counts.keys() <= chunk.inside(self.connections)

    def whole(self, chunk: BagChunk) -> ChunkRecords:
        """Return the records of a chunk."""
        if chunk.is_missing:
            return ChunkRecords(damage="a part of it is missing")
        try:
            self.budget.check()
            loaded = read_chunk(self.file, chunk, record_of(self.file, chunk))
        except UnreadableDataError as error:
            return ChunkRecords(damage=str(error))
        self.budget.spend(0 if chunk.is_unchunked else len(loaded.data))
        return loaded

    def selected(self, chunk: BagChunk, whole: ChunkRecords | None = None) -> ChunkRecords | None:
        """Return copies of the wanted messages of a chunk, if they are all that is needed."""
        record = record_of(self.file, chunk)
        inside = chunk.inside(self.connections)
        if record is None or not self._is_indexed(chunk, chunk.counts):
            return None
        return selected_messages(self.file, chunk, record, inside, whole)

    def messages_at(self, content: ChunkRecords, chunk: BagChunk) -> MessageBlock | None:
        """Return the messages that were selected; None where they are others."""
        if content.offsets is None:
            return None
        return indexed_messages(content.data, content.offsets, chunk.inside(self.connections))

    def only_messages(
        self,
        data: NDArray[np.uint8],
        chunk: BagChunk,  # noqa: ARG002  # its numbers are compared by `may_have`
    ) -> tuple[MessageBlock, int] | None:
        """Return the messages of a chunk that holds nothing else behind its definitions."""
        begin = begin_of_messages(data)
        return None if begin is None else only_messages(data, begin)

    def may_have(self, chunk: BagChunk, log_ns: NDArray[np.int64], id_: int) -> bool:
        """Return whether a connection is wanted, and a chunk has so many messages of it."""
        return id_ in chunk.inside(self.connections) and chunk.counts.get(id_) == len(log_ns)

    def messages(self, content: ChunkRecords, chunk: BagChunk) -> MessageBlock | None:
        """Return the messages of one chunk, and note what is lost of them."""
        inside = chunk.inside(self.connections)
        messages, damage = None, ""
        counts = {conn: len(rows) for conn, rows in content.entries.items() if conn in inside}
        expected = {conn: n for conn, n in chunk.counts.items() if conn in inside}
        is_indexed = self._is_indexed(chunk, counts) and counts == expected
        if is_indexed and not content.damage:
            messages = indexed_messages(content.data, offsets_of(content.entries, inside), inside)
        if messages is None:
            messages, damage = _scanned(content, inside)
        missing = sum(chunk.counts.get(conn, 0) for conn in inside) - len(messages)
        if damage or missing > 0:
            reason = damage or "it has fewer messages than it says"
            self.losses.note(chunk.place, reason, missing or None, self.topic)
        return messages

    def _is_indexed(self, chunk: BagChunk, indexed: Collection[int]) -> bool:
        """Return whether an index is sure to have all messages of the wanted connections.

        Without chunk infos, a connection may have messages under the number of another one.
        """
        return chunk.is_proved is not False or chunk.inside(self.connections) <= {*indexed}


def _scanned(content: ChunkRecords, wanted: set[int]) -> tuple[MessageBlock, str]:
    """Locate messages record by record; the string says why there may be more, or is ``""``."""
    records, damage = surviving_records(content.data, content.indexed_offsets)
    rows = [
        (record.data, record.end, record.time(b"time"))
        for record in records
        if record.op == OP_MESSAGE and record.number(b"conn") in wanted
    ]
    starts, ends, log_ns = np.array(rows, np.int64).reshape(-1, 3).T.copy()
    return MessageBlock(content.data, starts, ends, log_ns, log_ns), content.damage or damage
