"""Load the chunks of a ROS 1 bag, and locate the messages of some connections in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers import byte_ranges
from quatprop.containers.base import Loss, MessageBlock
from quatprop.containers.coalesce import join_blocks
from quatprop.containers.compression import CompressionError
from quatprop.containers.limits import DecompressionBudget
from quatprop.containers.loading import LARGE, load_in_groups
from quatprop.containers.rosbag1.index import ChunkRecords, read_chunk
from quatprop.containers.rosbag1.messages import indexed_messages, only_messages
from quatprop.containers.rosbag1.records import (
    OP_CHUNK,
    OP_MESSAGE,
    MalformedRecordError,
    begin_of_messages,
    surviving_records,
)
from quatprop.containers.rosbag1.selected import expected_ranges, selected_messages

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from numpy.typing import NDArray

    from quatprop.containers.loading import LoadedGroup
    from quatprop.containers.rosbag1.index import BagChunk
    from quatprop.containers.rosbag1.records import RecordFile

    Content = tuple[ChunkRecords, MessageBlock | None]
    """The records of a chunk, and those messages that were selected before it was read whole."""


class ChunkLoader:
    """Loads chunks and locates messages in them.

    Parameters
    ----------
    file
        The bag.
    chunks
        The chunks, in the order in which they are wanted.
    connections
        Numbers of the connections whose messages are wanted.
    """

    def __init__(self, file: RecordFile, chunks: Sequence[BagChunk], connections: set[int]) -> None:
        self.file, self.chunks, self.connections = file, chunks, connections
        self.budget = DecompressionBudget(file.size)

    def groups(self) -> Generator[LoadedGroup[BagChunk, Content], None, None]:
        """Load the chunks, several together and ahead of their use."""
        compressed = bool(self.chunks) and self._is_compressed(self.chunks[0])
        expected = expected_ranges(self.chunks, self.connections, compressed=compressed)
        self.file.source.expect(*expected)
        return load_in_groups(((chunk, self._size(chunk)) for chunk in self.chunks), self._load)

    def block(
        self, loaded: LoadedGroup[BagChunk, Content]
    ) -> tuple[MessageBlock | None, list[Loss]]:
        """Return the messages of loaded chunks, and what is lost of them."""
        group = loaded.group
        data = loaded.contents[0][0].data if group.buffer is None else group.buffer
        everything = _only_messages(data, loaded, self.connections)
        if everything is not None:
            return everything, []
        blocks, begins, losses = [], [], []
        for (content, selected), chunk, begin in zip(
            loaded.contents, group.chunks, group.begins, strict=True
        ):
            inside = chunk.inside(self.connections)
            messages, damage = selected, ""
            if messages is None and not content.damage:
                messages = _indexed(content.data, content.entries, chunk, inside)
            if messages is None:
                messages, damage = _scanned(content, inside)
            expected = sum(chunk.counts.get(conn, 0) for conn in inside)
            missing = expected - len(messages)
            if damage or missing > 0:
                reason = damage or "it has fewer messages than it says"
                losses.append(Loss(chunk.place, reason, missing or None))
            if len(messages):
                blocks.append(messages)
                begins.append(begin)
        return (join_blocks(data, blocks, begins) if blocks else None), losses

    def _is_compressed(self, chunk: BagChunk) -> bool:
        try:
            return self.file.record(chunk.start).fields.get(b"compression", b"none") != b"none"
        except MalformedRecordError:
            return False

    def _size(self, chunk: BagChunk) -> int | None:
        """Return the bytes of the records of a chunk; None for one that is not loaded as usual."""
        try:
            record = None if chunk.is_unchunked else self.file.record(chunk.start)
            if record is None or record.op != OP_CHUNK or record.end > self.file.size:
                return None
            if record.fields.get(b"compression") != b"none":
                return record.number(b"size") or None
        except MalformedRecordError:
            return None
        size = record.end - record.data
        is_mixed = not chunk.counts.keys() <= chunk.inside(self.connections)
        return None if is_mixed and byte_ranges.LARGE <= size <= LARGE else size or None

    def _load(self, chunk: BagChunk, into: NDArray[np.uint8] | None) -> Content:
        """Read the selected messages of a chunk or, where that is as quick, all of it."""
        inside = chunk.inside(self.connections)
        part = selected_messages(self.file, chunk, inside) if into is None else None
        if part is not None and (selected := _indexed(*part, chunk, inside)) is not None:
            return ChunkRecords(part[0]), selected
        try:
            self.budget.check()
            loaded = read_chunk(self.file, chunk, into)
            self.budget.spend(0 if chunk.is_unchunked else len(loaded.data))
        except (MalformedRecordError, CompressionError) as error:
            loaded = ChunkRecords(np.empty(0, np.uint8), damage=str(error))
        return loaded, None


def _only_messages(
    data: NDArray[np.uint8], loaded: LoadedGroup[BagChunk, Content], wanted: set[int]
) -> MessageBlock | None:
    """Return the messages of chunks that hold nothing else, which is quick; else None."""
    if any(content.damage or selected is not None for content, selected in loaded.contents):
        return None
    begin = begin_of_messages(data)
    messages = None if begin is None else only_messages(data, begin)
    if begin is None or messages is None:
        return None
    block, conn = messages
    chunks, begins = loaded.group.chunks, loaded.group.begins
    for chunk, end in zip(chunks, [*begins[1:], len(data)], strict=True):
        count, rest = divmod(end - begin, block.stride)
        if rest or conn not in chunk.inside(wanted) or chunk.counts.get(conn) != count:
            return None
        begin = end
    return block


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
    block = join_blocks(data, parts, [0] * len(parts))
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
