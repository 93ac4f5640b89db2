"""Read the messages of a channel in the chunks of a ROS 1 bag, and note what is lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.base import MessageBlock
from quatprop.containers.byte_ranges import LARGE as LARGE_ENOUGH
from quatprop.containers.chunks import ChunkReader
from quatprop.containers.coalesce import join_blocks
from quatprop.containers.compression import CompressionError
from quatprop.containers.limits import DecompressionBudget
from quatprop.containers.loading import LARGE, Buffers
from quatprop.containers.rosbag1.index import BagChunk, ChunkRecords, read_chunk
from quatprop.containers.rosbag1.messages import indexed_messages, only_messages
from quatprop.containers.rosbag1.records import (
    HEAD,
    OP_CHUNK,
    OP_MESSAGE,
    MalformedRecordError,
    begin_of_messages,
    surviving_records,
)
from quatprop.containers.rosbag1.selected import selected_messages

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from quatprop.containers.base import Losses
    from quatprop.containers.rosbag1.records import Record, RecordFile


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
        self._budget = DecompressionBudget(file.size)
        self._buffers = Buffers()
        self._records: dict[int, Record | None] = {}
        self._is_plain: bool | None = None

    def expected(self, chunk: BagChunk) -> list[tuple[int, int]]:
        """Return the bytes of a chunk, or of the head of one that is read in part."""
        head_end = chunk.start + HEAD
        if self._is_mixed(chunk) and chunk.end - chunk.start >= LARGE_ENOUGH:
            if self._is_plain is None:
                record = self._record(chunk)
                self._is_plain = record is None or record.fields[b"compression"] == b"none"
            if self._is_plain:
                return [(chunk.start, head_end)]
        return [(chunk.start, max(chunk.end, head_end))]

    def size(self, chunk: BagChunk) -> int | None:
        """Return the bytes of the records of a chunk; None for one that is not loaded as usual."""
        record = self._records[chunk.start] = self._record(chunk)
        if chunk.is_unchunked:
            return chunk.end - chunk.start
        if record is None:
            return None
        size = _size_of(record)
        return None if self._is_mixed(chunk) and size <= LARGE else size or None

    def load(self, chunk: BagChunk, into: NDArray[np.uint8] | None) -> ChunkRecords:
        """Return the selected messages of a chunk, or all of it."""
        record = self._records.pop(chunk.start)
        inside = chunk.inside(self.connections)
        selects = into is None and self._is_mixed(chunk) and record is not None
        if selects and record is not None:
            selection = selected_messages(self.file, chunk, record, inside)
            if selection is not None:
                return selection
            if 0 < (size := _size_of(record)) <= LARGE:
                into = self._buffers.take(size)
        loaded = self._whole(chunk, record, into)
        if selects and record is not None and not loaded.damage:
            return selected_messages(self.file, chunk, record, inside, loaded) or loaded
        return loaded

    def _whole(
        self, chunk: BagChunk, record: Record | None = None, into: NDArray[np.uint8] | None = None
    ) -> ChunkRecords:
        try:
            self._budget.check()
            loaded = read_chunk(self.file, chunk, into, record)
        except (MalformedRecordError, CompressionError) as error:
            return ChunkRecords(damage=str(error))
        self._budget.spend(0 if chunk.is_unchunked else len(loaded.data))
        return loaded

    def only_messages(
        self,
        data: NDArray[np.uint8],
        first: BagChunk,  # noqa: ARG002  # the numbers are compared with each chunk's
    ) -> tuple[MessageBlock, int] | None:
        """Return the messages of chunks that hold nothing else behind the first definitions."""
        begin = begin_of_messages(data)
        return None if begin is None else only_messages(data, begin)

    def may_have(self, chunk: BagChunk, count: int, id_: int) -> bool:
        """Return whether a connection is wanted, and a chunk has so many messages of it."""
        return id_ in chunk.inside(self.connections) and chunk.counts.get(id_) == count

    def messages(self, content: ChunkRecords, chunk: BagChunk) -> MessageBlock | None:
        """Return the messages of one chunk, and note what is lost of them."""
        inside = chunk.inside(self.connections)
        messages, damage = None, ""
        if not content.damage:
            messages = _indexed(content.data, content.entries, chunk, inside)
        if messages is None and content.is_selection:
            content = self._whole(chunk)
        if messages is None:
            messages, damage = _scanned(content, inside)
        missing = sum(chunk.counts.get(conn, 0) for conn in inside) - len(messages)
        if damage or missing > 0:
            reason = damage or "it has fewer messages than it says"
            self.losses.note(chunk.place, reason, missing or None, self.topic)
        return messages

    def _is_mixed(self, chunk: BagChunk) -> bool:
        return not chunk.is_unchunked and not chunk.counts.keys() <= chunk.inside(self.connections)

    def _record(self, chunk: BagChunk) -> Record | None:
        """Return the record of a chunk; None where there is none that is whole."""
        try:
            record = None if chunk.is_unchunked else self.file.record(chunk.start)
            if record is None or record.op != OP_CHUNK or record.end > self.file.size:
                return None
            record.number(b"size")
        except MalformedRecordError:
            return None
        return record if b"compression" in record.fields else None


def _size_of(record: Record) -> int:
    """Return the bytes of the records of a chunk."""
    is_plain = record.fields[b"compression"] == b"none"
    return record.end - record.data if is_plain else record.number(b"size")


def _indexed(
    data: NDArray[np.uint8],
    indexed: dict[int, NDArray[np.void]],
    chunk: BagChunk,
    wanted: set[int],
) -> MessageBlock | None:
    """Locate messages by the index data; None if it disagrees with the records."""
    parts = []
    for conn in wanted & chunk.counts.keys():
        entries = indexed.get(conn)
        if entries is None or len(entries) != chunk.counts[conn]:
            return None
        offsets = entries["offset"].astype(np.int64)
        # Index data is in order of time; records of equal time are in order of writing.
        if not (offsets[1:] > offsets[:-1]).all():
            offsets.sort()
        part = indexed_messages(data, offsets, conn)
        if part is None:
            return None
        parts.append(part)
    if len(parts) == 1:
        return parts[0]
    block = join_blocks(data, [(part, 0) for part in parts])
    return block.at(np.argsort(block.starts))


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
