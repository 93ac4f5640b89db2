"""The chunks of a ROS 1 bag, from its index or, if it has none, by walking its records.

A bag that was not closed (``.bag.active``, or cut off) has no index. Its records are walked from
the beginning: counts and times are in the index data that follows each chunk, and the connections
are in the chunks themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.rosbag1.records import (
    OP_CHUNK,
    OP_CHUNK_INFO,
    OP_CONNECTION,
    Record,
    RecordFile,
    data_fields,
    index_data,
)
from quatprop.stores.compression import UnreadableDataError, decompress, decompress_prefix
from quatprop.tables.log import Losses

if TYPE_CHECKING:
    from collections.abc import Callable, Container
    from collections.abc import Set as AbstractSet

    from numpy.typing import NDArray

MAGIC = b"#ROSBAG V2.0\n"

_NUMBERS = 1 << 32
"""Numbers that the connections of a bag can have."""

MAX_INDEX = 1 << 24
"""Bytes of an index that are read at once."""


@dataclass(slots=True)
class BagChunk:
    """A chunk, or a run of messages outside any chunk.

    `start`: where its record begins
    `end`: where its index data ends at the latest
    `first_ns`: log time of its earliest message
    `counts`: number of messages of each connection
    `is_unchunked`: whether it is a run of messages outside any chunk
    `id_offset`: what is added to the numbers of its connections: bags that were put one behind
        another have numbers of their own, each counted from 0
    `last_ns`: log time of its latest message; None if it is unknown
    `is_checked`: whether it ends where the next chunk begins, or whatever is between them was read
    `is_missing`: whether `counts` are what is missing of a chunk whose rest was found elsewhere
    `is_proved`: whether `counts` are certain, so that it holds no other connection; None if that
        was not looked at yet
    """

    start: int
    end: int
    first_ns: int = 0
    counts: dict[int, int] = field(default_factory=dict)
    is_unchunked: bool = False
    id_offset: int = 0
    last_ns: int | None = None
    record: Record | None = None
    is_checked: bool = False
    is_missing: bool = False
    is_proved: bool | None = None

    @property
    def place(self) -> str:
        """Where it is, for a sentence."""
        return f"{'messages' if self.is_unchunked else 'chunk'} at byte {self.start}"

    def local_ids(self, connections: AbstractSet[int]) -> set[int]:
        """Return the numbers that some connections of the file have inside the chunk."""
        return {conn - self.id_offset for conn in connections}


@dataclass(frozen=True, eq=False)
class ChunkRecords:
    """What was loaded of a chunk.

    `data`: its decompressed records, as far as they could be read, shape ``(B,)``
    `damage`: why they end early, or ``""``
    `read_index`: reads the index data that follow the chunk
    `offsets`: where the wanted messages begin in `data`, which has little else; None if it is
        whole
    """

    data: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, np.uint8))
    damage: str = ""
    read_index: Callable[[], bytes] = bytes
    offsets: NDArray[np.int64] | None = None

    @cached_property
    def entries(self) -> dict[int, NDArray[np.void]]:
        """Index entries of each connection."""
        try:
            return index_data(self.read_index())[0]
        except UnreadableDataError:
            return {}

    @property
    def indexed_offsets(self) -> NDArray[np.int64]:
        """Where messages begin by the index data, shape ``(N,)``, int64, ascending."""
        return np.unique(offsets_of(self.entries))


def offsets_of(
    entries: dict[int, NDArray[np.void]], connections: Container[int] | None = None
) -> NDArray[np.int64]:
    """Return where the messages of some connections begin, or of all, ascending."""
    parts = [
        rows["offset"].astype(np.int64)
        for conn, rows in entries.items()
        if connections is None or conn in connections
    ]
    return np.sort(np.concatenate([*parts, np.empty(0, np.int64)]), kind="stable")


@dataclass(slots=True)
class BagIndex:
    """The connections and chunks of a bag.

    `connections`: header and data fields of the connection records, by number
    `id_offset`: what is added to the numbers of connections in the current bag of joined ones
    `origin`: where the current bag begins, from which its own index counts
    `infos`: what chunk infos say that were met among the records
    """

    connections: dict[int, dict[bytes, bytes]] = field(default_factory=dict)
    chunks: list[BagChunk] = field(default_factory=list)
    losses: Losses = field(default_factory=Losses)
    end: int = 0
    id_offset: int = 0
    origin: int = 0
    infos: list[BagChunk] = field(default_factory=list)

    def begin_bag(self, origin: int) -> None:
        """Begin another bag that follows in the same file; no number keeps its meaning."""
        self.id_offset += _NUMBERS
        self.origin = origin

    def add_connection(self, record: Record, data: bytes) -> None:
        """Add a connection record; the first of a connection counts, and later ones repeat it."""
        try:
            described = data_fields(data)
        except UnreadableDataError:
            described = {}
        # Both have a topic; messages were recorded under the one in the header.
        number = record.number(b"conn") + self.id_offset
        self.connections.setdefault(number, described | record.fields)


def read_chunk(file: RecordFile, chunk: BagChunk, record: Record | None = None) -> ChunkRecords:
    """Read and decompress a chunk."""
    if chunk.is_unchunked:
        records = file.at(chunk.start, chunk.end - chunk.start)
        return ChunkRecords(np.frombuffer(records, np.uint8))
    record = record or file.record(chunk.start)
    if record.op != OP_CHUNK:
        raise UnreadableDataError("there is no chunk")
    size, length = record.number(b"size"), record.end - record.data
    compression = record.fields.get(b"compression", b"").decode(errors="replace")
    index = index_reader(file, chunk, record, size)
    if compression == "none":
        records = file.at(record.data, length)
        damage = "its end is cut off" if len(records) < length else ""
        return ChunkRecords(np.frombuffer(records, np.uint8), damage, index)
    content = file.at(record.data, length)
    if len(content) < length:
        prefix = decompress_prefix(content, compression, size)
        damage = f"its {compression} data is cut off"
        return ChunkRecords(np.frombuffer(prefix, np.uint8), damage, index)
    data = decompress(content, compression, size)
    return ChunkRecords(np.frombuffer(data, np.uint8), read_index=index)


def index_reader(
    file: RecordFile, chunk: BagChunk, record: Record, size: int
) -> Callable[[], bytes]:
    """Return what reads the index data behind a chunk.

    They have 12 bytes a message, less than the `size` of the records. Anything longer is damage.
    """
    return partial(file.at, record.end, max(0, min(chunk.end - record.end, size)))


def read_index(file: RecordFile, header: Record) -> BagIndex | None:
    """Return the index at the end of a bag."""
    index = BagIndex()
    try:
        at = header.number(b"index_pos", 8)
        end = at
        chunk_count = header.number(b"chunk_count")
        remaining = {
            OP_CONNECTION: header.number(b"conn_count"),
            OP_CHUNK_INFO: chunk_count,
        }
        # Messages before the index that are in no chunk can only be found by walking.
        if not header.end <= at <= file.size or (at > header.end and chunk_count == 0):
            return None
        file.source.expect([at], [min(file.size, at + MAX_INDEX)])
        while any(remaining.values()):
            record = file.record(at)
            if record.end > file.size or not remaining.get(record.op):
                return None
            remaining[record.op] -= 1
            data = file.at(record.data, record.end - record.data)
            if record.op == OP_CONNECTION:
                index.add_connection(record, data)
            else:
                index.chunks.append(chunk_of_info(record, data))
            at = record.end
    except UnreadableDataError:
        return None
    index.chunks.sort(key=lambda chunk: chunk.start)
    for chunk, following in zip(index.chunks, index.chunks[1:], strict=False):
        chunk.end = following.start
    if index.chunks:
        index.chunks[-1].end = end
    index.end = at
    begins = [chunk.start for chunk in index.chunks]
    is_full = len({*begins}) == len(begins) and begins[:1] in ([header.end], [])
    is_known = all(chunk.counts.keys() <= index.connections.keys() for chunk in index.chunks)
    return index if is_full and is_known else None


def chunk_of_info(record: Record, data: bytes) -> BagChunk:
    """Return the chunk that a chunk info record describes."""
    if record.number(b"ver") != 1 or len(data) != 8 * record.number(b"count"):
        raise UnreadableDataError("its chunk info is damaged")
    counts = np.frombuffer(data, "<u4").reshape(-1, 2)
    start = record.number(b"chunk_pos", 8)
    first_ns = record.time(b"start_time") if len(counts) else 0
    last_ns = record.time(b"end_time") if len(counts) else 0
    return BagChunk(start, start, first_ns, dict(counts.tolist()), last_ns=last_ns)
