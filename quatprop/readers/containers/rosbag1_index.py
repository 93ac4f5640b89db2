"""The chunks of a ROS 1 bag, from its index or, without one, from a walk over its records.

A bag that was not closed (``.bag.active``, or truncated) has no index. Its records are walked from
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
"""Number of connection ids that a bag can have."""

MAX_INDEX = 1 << 24
"""Maximum bytes of an index that are requested in advance."""


@dataclass(slots=True)
class BagChunk:
    """A chunk, or a run of messages outside any chunk.

    `start`: offset of its record
    `end`: upper bound of the end of its index data
    `first_ns`, `last_ns`: earliest and latest log time, ns; the latest is None if unknown
    `counts`: number of messages of each connection
    `is_unchunked`: whether it is a run of messages outside any chunk
    `id_offset`: added to the ids of its connections: concatenated bags have ids of their own, each
        counted from 0
    `is_checked`: whether it ends where the next chunk begins, or all between them was read
    `is_missing`: whether `counts` is the missing part of a chunk whose rest was found elsewhere
    `is_proved`: whether `counts` is verified, so that it has no other connection; None if that was
        not checked yet
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
        """Its position in the file, for sentences."""
        return f"{'messages' if self.is_unchunked else 'chunk'} at byte {self.start}"

    def local_ids(self, connections: AbstractSet[int]) -> set[int]:
        """Return the ids in the chunk of connections, from their ids in the file."""
        return {conn - self.id_offset for conn in connections}


@dataclass(frozen=True, eq=False)
class ChunkRecords:
    """The content of a chunk.

    `data`: its decompressed records, as far as they can be read, shape ``(B,)``
    `damage`: the reason why they are incomplete, or ``""``
    `read_index`: reads the index data behind the chunk
    `offsets`: offsets of the wanted messages in `data`, if only these were read; None if all
    """

    data: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, np.uint8))
    damage: str = ""
    read_index: Callable[[], bytes] = bytes
    offsets: NDArray[np.int64] | None = None

    @cached_property
    def entries(self) -> dict[int, NDArray[np.void]]:
        """Index entries by connection."""
        try:
            return index_data(self.read_index())[0]
        except UnreadableDataError:
            return {}

    @property
    def indexed_offsets(self) -> NDArray[np.int64]:
        """Offsets of messages by the index data, shape ``(N,)``, int64, ascending."""
        return np.unique(offsets_of(self.entries))


def offsets_of(
    entries: dict[int, NDArray[np.void]], connections: Container[int] | None = None
) -> NDArray[np.int64]:
    """Return the offsets of the messages of some or all connections, ascending."""
    parts = [
        rows["offset"].astype(np.int64)
        for conn, rows in entries.items()
        if connections is None or conn in connections
    ]
    return np.sort(np.concatenate([*parts, np.empty(0, np.int64)]), kind="stable")


@dataclass(slots=True)
class BagIndex:
    """The connections and chunks of a bag.

    `connections`: header and data fields of the connection records, by id
    `id_offset`: added to connection ids in the current one of several concatenated bags
    `origin`: offset of the current bag, from which its own index counts
    `infos`: the chunks of the chunk infos that were found during a walk
    """

    connections: dict[int, dict[bytes, bytes]] = field(default_factory=dict)
    chunks: list[BagChunk] = field(default_factory=list)
    losses: Losses = field(default_factory=Losses)
    end: int = 0
    id_offset: int = 0
    origin: int = 0
    infos: list[BagChunk] = field(default_factory=list)

    def begin_bag(self, origin: int) -> None:
        """Begin another of several concatenated bags: no connection id keeps its meaning."""
        self.id_offset += _NUMBERS
        self.origin = origin

    def add_connection(self, record: Record, data: bytes) -> None:
        """Add a connection record, unless its id is defined already: later records repeat it."""
        try:
            described = data_fields(data)
        except UnreadableDataError:
            described = {}
        # Both have a topic; that of the header is the one that was recorded.
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
    """Return a function that reads the index data behind a chunk.

    It has 12 bytes per message, fewer than the `size` of the records: longer data are damaged.
    """
    return partial(file.at, record.end, max(0, min(chunk.end - record.end, size)))


def read_index(file: RecordFile, header: Record) -> BagIndex | None:
    """Return the index at the end of a bag; None if there is none or it is damaged."""
    index = BagIndex()
    try:
        at = header.number(b"index_pos", 8)
        end = at
        chunk_count = header.number(b"chunk_count")
        remaining = {
            OP_CONNECTION: header.number(b"conn_count"),
            OP_CHUNK_INFO: chunk_count,
        }
        # Messages outside chunks are only found by a walk.
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
