"""The chunks of a ROS 1 bag, from its index or, without one, from a walk over its records.

A bag that was not closed (``.bag.active``, or truncated) has no index. Its records are walked from
the beginning: counts and times are in the index data that follows each chunk, and the connections
are in the chunks themselves.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from quatprop.base.errors import Losses, os_reason
from quatprop.base.times import NS_PER_S
from quatprop.stores.compression import UnreadableDataError, decompress, decompress_prefix
from quatprop.stores.file_source import ZeroFilledSource

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator, Sequence
    from collections.abc import Set as AbstractSet

    from numpy.typing import NDArray

    from quatprop.stores.file_source import FileSource

    Buffer = bytes | memoryview


# The records of ROS 1 bags, format 2.0.
#
# A bag is a sequence of records: a header of ``name=value`` fields, then data, each preceded by its
# length. The data of a chunk record are records. It is followed by index data records with the
# offsets of the messages of each connection.
#
# Reference: ROS wiki, "Bags/Format/2.0".


OP_MESSAGE = 2
OP_BAG_HEADER = 3
OP_INDEX_DATA = 4
OP_CHUNK = 5
OP_CHUNK_INFO = 6
OP_CONNECTION = 7

MAX_HEADER = 1 << 20
"""Maximum bytes of a record header; real ones have less than a thousand."""

HEAD = 512
"""Bytes that are read for a header of unknown length."""

INDEX_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])

_LENGTH = struct.Struct("<I")

Data = TypeVar("Data")


@dataclass(frozen=True, slots=True)
class Record:
    """A record: its position in the file and its header.

    `start`, `data`, `end`: offsets of the record, of its data, and of its end
    `fields`: the header
    """

    start: int
    data: int
    end: int
    fields: dict[bytes, bytes]

    def number(self, name: bytes, size: int = 4) -> int:
        """Return an unsigned number of `size` bytes from the header."""
        value = self.fields.get(name, b"")
        if len(value) != size:
            raise UnreadableDataError(f"its field {name.decode()} is missing or damaged")
        return int.from_bytes(value, "little")

    def time(self, name: bytes) -> int:
        """Return a time from the header, ns."""
        both = self.number(name, 8)
        return (both & 0xFFFFFFFF) * NS_PER_S + (both >> 32)

    @property
    def op(self) -> int:
        """The kind of record."""
        return self.number(b"op", 1)


class RecordFile:
    """Reads records from a bag.

    `size`: its length, bytes
    """

    def __init__(self, source: FileSource) -> None:
        self.source = source
        self.size = source.size
        self._zero_filled = ZeroFilledSource(source)

    def at(self, start: int, size: int) -> bytes:
        """Return `size` bytes at `start`, or fewer at the end of the file."""
        return _read(self.source.read, start, size)

    def tried(self, start: int, size: int) -> bytes:
        """Return the same, for searches: zeros where the file cannot be read."""
        return self._zero_filled.read(start, size)

    def at_ranges(self, begins: Sequence[int], ends: Sequence[int]) -> bytes:
        """Return the bytes of some ranges, concatenated."""
        return _read(self.source.read_ranges, begins, ends)

    def record(self, start: int) -> Record:
        """Return the record at `start`; it may end beyond the file."""
        head = self.at(start, HEAD)
        size = int.from_bytes(head[:4], "little") + 8
        if size > MAX_HEADER:
            raise UnreadableDataError("there is no record")
        return record_at(head if size <= len(head) else self.at(start, size), 0, start)


def _read(read: Callable[..., Data], *place: object) -> Data:
    try:
        return read(*place)
    except OSError as error:
        # A worn memory card fails at some positions only: the rest of the bag is still readable.
        raise UnreadableDataError(os_reason(error)) from error


def record_at(data: Buffer, at: int, origin: int = 0) -> Record:
    """Return the record at `at` of a buffer that begins at `origin`; its data may end behind it."""
    header_end = header_end_of(data, at)
    if header_end + 4 > len(data):
        raise UnreadableDataError("its record is cut off")
    fields = {
        name: bytes(data[begin:end]) for name, begin, end in fields_of(data, at + 4, header_end)
    }
    begin = origin + header_end + 4
    return Record(origin + at, begin, begin + _LENGTH.unpack_from(data, header_end)[0], fields)


def header_end_of(data: Buffer, at: int) -> int:
    """Return the end of the header at `at`; raise an error if it is incomplete."""
    end = at + 4
    if end <= len(data):
        end += _LENGTH.unpack_from(data, at)[0]
    if end > len(data):
        raise UnreadableDataError("its record is cut off")
    return end


def data_fields(data: bytes) -> dict[bytes, bytes]:
    """Return the fields in a connection record's data, which has the format of a header."""
    return {name: data[value:end] for name, value, end in fields_of(data, 0, len(data))}


def fields_of(data: Buffer, at: int, stop: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield the name and the begin and end of the value of each field of a header."""
    while at < stop:
        end = header_end_of(data, at)  # fields are length-prefixed as headers are
        name, equals, _ = bytes(data[at + 4 : min(end, stop)]).partition(b"=")
        if end > stop or not equals:
            raise UnreadableDataError("its header is damaged")
        yield name, at + 5 + len(name), end
        at = end


def index_data(data: bytes) -> tuple[dict[int, NDArray[np.void]], int]:
    """Return the index entries by connection from the records behind a chunk, and their end.

    Reading stops at another or an incomplete record, or a second one of a connection; the messages
    are then found by walking the chunk.
    """
    entries: dict[int, NDArray[np.void]] = {}
    at = 0
    with suppress(UnreadableDataError):
        while at < len(data):
            record = record_at(data, at)
            conn, count = record.number(b"conn"), record.number(b"count")
            is_index = record.op == OP_INDEX_DATA and record.number(b"ver") == 1
            size = count * INDEX_ENTRY.itemsize
            is_whole = record.end - record.data == size and record.end <= len(data)
            if not is_index or not is_whole or conn in entries:
                break
            entries[conn] = np.frombuffer(data, INDEX_ENTRY, count, record.data)
            at = record.end
    return entries, at


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
    `is_resized`: whether its length was wrong, or bytes were inserted into it or lost
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
    is_resized: bool = False

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
