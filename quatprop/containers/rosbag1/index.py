"""Which chunks a ROS 1 bag has: from its index, or by walking it where there is none.

A bag that was not closed (``.bag.active``, or cut off) has no index. Its records are walked from
the start: what the index would say is in the index data that follow each chunk, and the
connections are in the chunks themselves.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.base import Losses
from quatprop.containers.compression import CompressionError, decompress, front
from quatprop.containers.rosbag1.records import (
    OP_CHUNK,
    OP_CHUNK_INFO,
    OP_CONNECTION,
    OP_INDEX_DATA,
    OP_MESSAGE,
    MalformedRecordError,
    Record,
    RecordFile,
    data_fields,
    index_offsets,
    surviving_records,
)
from quatprop.containers.rosbag1.resync import CHUNKS, RECORDS, is_chunk, next_record
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LOOSE_SIZE = 1 << 20
"""Bytes of messages outside any chunk that are read as if they were one."""


@dataclass(slots=True)
class Chunk:
    """A chunk, or a run of messages outside any chunk.

    Parameters
    ----------
    start
        Where its record begins.
    end
        Where its index data end at the latest.
    start_ns
        Log time of its earliest message.
    counts
        How many messages of which connection it has.
    loose
        Whether it is a run of messages outside any chunk.
    """

    start: int
    end: int
    start_ns: int = 0
    counts: dict[int, int] = field(default_factory=dict)
    loose: bool = False

    @property
    def place(self) -> str:
        """Where it is, in words."""
        return f"{'messages' if self.loose else 'chunk'} at byte {self.start}"


@dataclass(slots=True)
class Content:
    """The unpacked records of a chunk.

    Parameters
    ----------
    data
        The records, shape ``(B,)``, uint8.
    entries
        What the index data say, for each connection.
    damage
        Why `data` end early, or ``""``.
    """

    data: NDArray[np.uint8]
    entries: dict[int, NDArray[np.void]]
    damage: str = ""

    @property
    def marks(self) -> NDArray[np.int64]:
        """Where records begin by what the index data say, shape ``(N,)``, int64, ascending."""
        parts = [found["offset"].astype(np.int64) for found in self.entries.values()]
        return np.unique(np.concatenate([*parts, np.empty(0, np.int64)]))


@dataclass(slots=True)
class Index:
    """What a bag holds.

    Parameters
    ----------
    connections
        Header and data fields of the connection records, by number.
    chunks
        Every chunk.
    losses
        What could not be read.
    """

    connections: dict[int, dict[bytes, bytes]] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    losses: Losses = field(default_factory=Losses)

    def add_connection(self, record: Record, data: bytes) -> None:
        """Keep the first record of a connection; later ones repeat it."""
        try:
            described = data_fields(data)
        except MalformedRecordError:
            described = {}
        # Both name a topic. The one in the header is what the messages were recorded under.
        self.connections.setdefault(record.number(b"conn"), described | record.fields)


def content(file: RecordFile, chunk: Chunk) -> Content:
    """Read and unpack a chunk.

    Raises
    ------
    MalformedRecordError
        There is no chunk where the index says.
    CompressionError
        It cannot be unpacked.
    """
    if chunk.loose:
        loose = file.at(chunk.start, chunk.end - chunk.start)
        return Content(np.frombuffer(loose, np.uint8), {})
    record = file.record(chunk.start)
    if record.op != OP_CHUNK:
        raise MalformedRecordError("there is no chunk")
    size = record.number(b"size")
    compression = record.fields.get(b"compression", b"").decode(errors="replace")
    # What lies between a chunk and the next is index data, 12 bytes a message: less than the
    # chunk has. Anything longer is not believed.
    end = min(max(chunk.end, record.end), record.end + size)
    raw = memoryview(file.at(record.data, end - record.data))
    length = record.end - record.data
    packed = raw[:length]
    if compression == "none":
        data: bytes | bytearray | memoryview = packed
        damage = "its end is cut off" if len(packed) < length else ""
    elif len(packed) < length:
        data, damage = front(packed, compression, size), f"its {compression} data is cut off"
    else:
        data, damage = decompress(packed, compression, size), ""
    return Content(np.frombuffer(data, np.uint8), index_offsets(bytes(raw[length:])), damage)


def indexed(file: RecordFile, header: Record) -> Index | None:
    """Read the index at the end of a bag.

    Parameters
    ----------
    file
        The bag.
    header
        The bag header record, which says where the index is.

    Returns
    -------
    Index or None
        None where there is no whole index.
    """
    index = Index()
    try:
        at = header.number(b"index_pos", 8)
        end = at
        chunk_count = header.number(b"chunk_count")
        remaining = {
            OP_CONNECTION: header.number(b"conn_count"),
            OP_CHUNK_INFO: chunk_count,
        }
        # Something before the index that is no chunk can only be found by walking.
        if not header.end <= at <= file.size or (at > header.end and chunk_count == 0):
            return None
        while any(remaining.values()):
            record = file.record(at)
            if record.end > file.size or not remaining.get(record.op):
                return None
            remaining[record.op] -= 1
            data = file.at(record.data, record.end - record.data)
            if record.op == OP_CONNECTION:
                index.add_connection(record, data)
            else:
                index.chunks.append(_described(record, data))
            at = record.end
    except MalformedRecordError:
        return None
    index.chunks.sort(key=lambda chunk: chunk.start)
    for chunk, following in zip(index.chunks, index.chunks[1:], strict=False):
        chunk.end = following.start
    if index.chunks:
        index.chunks[-1].end = end
    return index


def _described(record: Record, data: bytes) -> Chunk:
    """Return the chunk that a chunk info record describes."""
    if record.number(b"ver") != 1 or len(data) != 8 * record.number(b"count"):
        raise MalformedRecordError("its chunk info is damaged")
    counts = np.frombuffer(data, "<u4").reshape(-1, 2)
    start = record.number(b"chunk_pos", 8)
    start_ns = record.time(b"start_time") if len(counts) else 0
    return Chunk(start, start, start_ns, dict(counts.tolist()))


def walked(file: RecordFile, at: int) -> Index:
    """Walk the records of a bag from `at` to its end; behind damage go on at the next record."""
    index = Index()
    while at < file.size:
        try:
            record = file.record(at)
            _take(file, index, record)
        except MalformedRecordError as error:
            at = _behind(file, index, at, str(error))
        else:
            at = record.end
    chunks = index.chunks
    for chunk in chunks:
        # The last chunk's index data may not all have been written, those of others be damaged.
        if (
            chunk is chunks[-1]
            or chunk.loose
            or not chunk.counts
            or not chunk.counts.keys() <= index.connections.keys()
        ):
            _survey(file, index, chunk)
    return index


def _behind(file: RecordFile, index: Index, at: int, reason: str) -> int:
    """Note that no record can be taken at a place; return where to go on."""
    last = index.chunks[-1] if index.chunks else None
    found = None
    if last is not None and not last.loose and last.end == at and not last.counts:
        # It may be the chunk before whose length leads astray.
        found = next_record(file, last.start + 1, at, CHUNKS)
    if found is None:
        found = next_record(file, at + 1, file.size, RECORDS)
    if found is None:
        index.losses.note(f"byte {at}", f"{reason}; what follows is not read")
        return file.size
    size = max(0, found - at)
    index.losses.note(f"byte {at}", f"{reason}; {size} bytes are skipped")
    return found


def _is_damaged_chunk(file: RecordFile, record: Record) -> bool:
    """Tell a chunk that must not be followed to its end: its fields or what comes contradict."""
    if not is_chunk(record):
        return True
    beyond = record.end > file.size
    return beyond and next_record(file, record.start + 1, file.size, CHUNKS) is not None


def _take(file: RecordFile, index: Index, record: Record) -> None:
    """Enter one record into the index."""
    whole = record.end <= file.size
    if record.op == OP_CHUNK:
        if _is_damaged_chunk(file, record):
            raise MalformedRecordError("its chunk is damaged")
        index.chunks.append(Chunk(record.start, min(record.end, file.size)))
    elif record.op == OP_MESSAGE:
        last = index.chunks[-1] if index.chunks else None
        if (
            last
            and last.loose
            and last.end == record.start
            and record.start - last.start < _LOOSE_SIZE
        ):
            last.end = min(record.end, file.size)
        else:
            index.chunks.append(Chunk(record.start, min(record.end, file.size), loose=True))
    elif not whole:
        raise MalformedRecordError("its record is cut off")
    elif record.op == OP_CONNECTION:
        index.add_connection(record, file.at(record.data, record.end - record.data))
    elif record.op == OP_INDEX_DATA and index.chunks:
        _enter_times(index.chunks[-1], file.at(record.start, record.end - record.start))
        index.chunks[-1].end = record.end


def _enter_times(chunk: Chunk, record: bytes) -> None:
    """Take counts and the earliest time from the index data of one connection."""
    for conn, entries in index_offsets(record).items():
        if len(entries):
            sec, nsec = (entries[name].astype(np.int64) for name in ("sec", "nsec"))
            earliest = int((sec * NS_PER_S + nsec).min())
            chunk.start_ns = min(chunk.start_ns, earliest) if chunk.counts else earliest
            chunk.counts[conn] = chunk.counts.get(conn, 0) + len(entries)


def _survey(file: RecordFile, index: Index, chunk: Chunk) -> None:
    """Walk the records of a chunk to learn its connections, counts and earliest time."""
    try:
        loaded = content(file, chunk)
    except (MalformedRecordError, CompressionError) as error:
        index.losses.note(chunk.place, str(error))
        return
    times: list[int] = []
    counts: Counter[int] = Counter()
    records, damage = surviving_records(loaded.data, loaded.marks)
    try:
        for record in records:
            if record.op == OP_CONNECTION:
                index.add_connection(record, loaded.data[record.data : record.end].tobytes())
            elif record.op == OP_MESSAGE:
                counts[record.number(b"conn")] += 1
                times.append(record.time(b"time"))
    except MalformedRecordError as error:
        damage = damage or str(error)
    if loaded.damage or damage:
        index.losses.note(chunk.place, loaded.damage or damage)
    if times:
        chunk.counts, chunk.start_ns = counts, min(times)
