"""Write ROS 1 bags, a block at a time.

Messages of one size have records of one size: a chunk is one array that is filled a column at a
time, and so is its index. rosbags would need a call for each message. The provenance is stored as a
field of the connection record in the index, since bags have no metadata, and readers ignore unknown
fields.
"""

from __future__ import annotations

import bz2
import struct
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, BinaryIO

import lz4.frame
import numpy as np

from quatprop.base.threads import OrderedThreadPool
from quatprop.base.times import NS_PER_S
from quatprop.writers.atomic import OutputFile
from quatprop.writers.base import MessageWriter, RecordBlock, empty_records, provenance_json
from quatprop.writers.targets import refuse_streams

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    from quatprop.base.arrays import Int64, Records
    from quatprop.writers.message_encoders import Topic


# Encode records of ROS 1 bags: a head of named fields, then data.
#
# Reference: ROS wiki, "Bags/Format/2.0".


MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = (bytes([op]) for op in (2, 3, 4, 5, 6, 7))
"""Kinds of records."""

ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])
"""An entry of index data: log time and offset of a message in its chunk."""

_HEAD_BYTES = 4096
"""Bytes of the bag's first record; padded, since it is rewritten at the end."""


def bag(index: int, connections: int, chunks: int) -> bytes:
    """Return the bag's first record: the offset and the counts of the index."""
    head = {
        "index_pos": struct.pack("<Q", index),
        "conn_count": u4(connections),
        "chunk_count": u4(chunks),
    }
    padding = _HEAD_BYTES - len(record(BAG, head, b""))
    return record(BAG, head, b" " * padding)


def connection_record(id_: int, values: Mapping[str, bytes]) -> bytes:
    """Return the record of a connection: its id, its topic and all its fields."""
    return record(CONNECTION, {"conn": u4(id_), "topic": values["topic"]}, encoded_fields(values))


def chunk(compression: str, size: int, data: bytes) -> bytes:
    """Return a chunk of compressed records of `size` bytes before compression."""
    return record(CHUNK, {"compression": compression.encode(), "size": u4(size)}, data)


def index_data(id_: int, entries: Records) -> bytes:
    """Return the index of the messages of a connection in the preceding chunk."""
    head = {"ver": u4(1), "conn": u4(id_), "count": u4(len(entries))}
    return record(INDEX, head, entries.tobytes())


@dataclass(frozen=True, slots=True)
class ChunkInfo:
    """The index record of a chunk.

    `place`: offset of the chunk
    `start_ns`, `end_ns`: earliest and latest log time, ns
    `counts`: number of messages by connection id
    """

    place: int
    start_ns: int
    end_ns: int
    counts: Mapping[int, int]

    @classmethod
    def from_indexes(cls, place: int, indexes: Mapping[int, Records]) -> ChunkInfo:
        """Return the chunk info of a chunk with some index data."""
        log_ns = np.concatenate([np.zeros(0, np.int64), *map(times, indexes.values())])
        span = (int(log_ns.min()), int(log_ns.max())) if len(log_ns) else (0, 0)
        return cls(place, *span, {id_: len(entries) for id_, entries in indexes.items()})

    def encoded(self) -> bytes:
        """Return the record."""
        head = {
            "ver": u4(1),
            "chunk_pos": struct.pack("<Q", self.place),
            "start_time": _time(self.start_ns),
            "end_time": _time(self.end_ns),
            "count": u4(len(self.counts)),
        }
        counts = (u4(id_) + u4(count) for id_, count in self.counts.items())
        return record(CHUNK_INFO, head, b"".join(counts))


def times(entries: Records) -> Int64:
    """Return the log times of index data, shape ``(N,)``, ns."""
    log_ns: Int64 = entries["sec"].astype(np.int64) * NS_PER_S + entries["nsec"]
    return log_ns


def record(op: bytes, head: Mapping[str, bytes], data: bytes) -> bytes:
    """Return a record."""
    head_bytes = encoded_fields({"op": op, **head})
    return u4(len(head_bytes)) + head_bytes + u4(len(data)) + data


def encoded_fields(values: Mapping[str, bytes]) -> bytes:
    """Return named values, each length-prefixed."""
    joined = (name.encode() + b"=" + value for name, value in values.items())
    return b"".join(u4(len(field)) + field for field in joined)


def u4(number: int) -> bytes:
    """Return a number in four bytes."""
    return struct.pack("<I", number)


def _time(ns: int) -> bytes:
    return struct.pack("<II", *divmod(ns, NS_PER_S))


CHUNK_BYTES = 1 << 20
"""Approximate bytes of a chunk before compression."""

COMPRESSIONS: Mapping[str, Callable[[bytes], bytes]] = {
    "none": lambda data: data,
    "lz4": lz4.frame.compress,
    "bz2": bz2.compress,
}
"""Compressions of chunks."""


class BagFile:
    """A ROS 1 bag being written, with one topic whose messages all have one size.

    `stream`: the output stream; seekable, since the bag begins with the offset of its index
    `compression`: a key of :data:`COMPRESSIONS`
    `before`: called with the first log time of a chunk, ns, before it is written, so that the
        caller can append earlier messages
    `chunk_bytes`: approximate bytes of a chunk before compression
    """

    def __init__(  # noqa: PLR0913  # a new bag needs the first three only
        self,
        stream: BinaryIO,
        topic: Topic,
        compression: str,
        *,
        connection: int = 0,
        before: Callable[[int], None] = lambda _first_ns: None,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        self._stream = stream
        self._id = connection
        self._before = before
        self._fields = {
            "topic": topic.name.encode(),
            "type": topic.type_name.encode(),
            "md5sum": topic.digest.encode(),
            "message_definition": topic.schema,
        }
        self._pool = OrderedThreadPool(partial(_compressed, compression), self._append_own)
        self._chunks: list[ChunkInfo] = []
        self._messages = RecordBlock(partial(_empty_rows, connection, chunk_bytes), self._submit)
        # The first chunk begins with the connection record, as some readers expect.
        self._prefix = connection_record(connection, self._fields)
        self._size = 0
        self._append(MAGIC)
        self._append(bag(0, 0, 0))

    def write(self, log_ns: Int64, messages: Records) -> None:
        """Append messages, shape ``(N,)``, with their log times, ns, from 1970 to 2106."""
        seconds, nanoseconds = np.divmod(log_ns, NS_PER_S)
        self._messages.write(messages, sec=seconds, nanosec=nanoseconds)

    def flush(self) -> None:
        """Write buffered messages."""
        self._messages.flush()
        self._pool.drain()

    def finish(
        self,
        provenance: Mapping[str, object],
        others: Mapping[int, Mapping[str, bytes]] | None = None,
    ) -> None:
        """Write buffered messages, the index and its offset; the stream is left open."""
        self.flush()
        self._pool.shutdown()
        index = self._size
        if provenance:
            self._fields["quatprop"] = provenance_json(provenance).encode()
        connections = {**(others or {}), self._id: self._fields}
        for id_, fields in connections.items():
            self._append(connection_record(id_, fields))
        infos = _in_order(self._chunks)
        for info in infos:
            self._append(info.encoded())
        self._stream.seek(len(MAGIC))
        self._stream.write(bag(index, len(connections), len(infos)))

    def abort(self) -> None:
        """Drop buffered messages; does nothing after :meth:`finish`."""
        self._pool.shutdown()

    def append_chunk(self, chunk: Iterable[bytes], indexes: Mapping[int, Records]) -> None:
        """Write a chunk and its index data."""
        self._chunks.append(ChunkInfo.from_indexes(self._size, indexes))
        for piece in chunk:
            self._append(piece)
        for id_, entries in indexes.items():
            self._append(index_data(id_, entries))

    def _submit(self, rows: Records) -> None:
        self._pool.submit(self._prefix, rows)
        self._prefix = b""

    def _append_own(self, chunk: tuple[int, bytes, Records]) -> None:
        first_ns, record, index = chunk
        self._before(first_ns)
        self.append_chunk([record], {self._id: index})

    def _append(self, data: bytes) -> None:
        self._stream.write(data)
        self._size += len(data)


def _in_order(chunks: list[ChunkInfo]) -> list[ChunkInfo]:
    """Return the chunk infos with the earliest chunk first and the latest last.

    Readers take the start and the end of a bag from these two; the order of the others is free.
    """
    if len(chunks) < 2:  # noqa: PLR2004  # a first and a last
        return chunks
    first = min(chunks, key=lambda info: info.start_ns)
    last = max(
        (info for info in reversed(chunks) if info is not first), key=lambda info: info.end_ns
    )
    return [first, *(info for info in chunks if info not in (first, last)), last]


def _compressed(compression: str, prefix: bytes, rows: Records) -> tuple[int, bytes, Records]:
    """Return the first log time, record and index of a chunk of a prefix and messages."""
    index = np.empty(len(rows), ENTRY)
    index["sec"], index["nsec"] = rows["sec"], rows["nanosec"]
    index["offset"] = len(prefix) + np.arange(len(rows)) * rows.itemsize
    times = rows["sec"].astype(np.int64) * NS_PER_S + rows["nanosec"]
    data = prefix + rows.tobytes()
    record = chunk(compression, len(data), COMPRESSIONS[compression](data))
    return int(times.min()), record, index


def _empty_rows(connection: int, chunk_bytes: int, size: int) -> Records:
    """Return records of messages of `size` bytes for one chunk, without times and data."""
    head = encoded_fields({"op": MESSAGE, "conn": u4(connection), "time": bytes(8)})
    # The time is the last field of the head.
    before = struct.pack("<I", len(head)) + head[:-8]
    fields = {"before": f"V{len(before)}", "sec": "<u4", "nanosec": "<u4", "length": "<u4"}
    rows = empty_records(fields, size, chunk_bytes)
    rows["before"] = np.void(before)
    rows["length"] = size
    return rows


class BagWriter(MessageWriter):
    """Write messages to a ROS 1 bag.

    `target`: a path; not a pipe, since a bag begins with the offset of its index
    `compression`: compression of chunks: ``"none"``, ``"lz4"`` or ``"bz2"``
    """

    _output: OutputFile

    def __init__(
        self,
        target: Path | str,
        topic: Topic,
        compression: str,
        **options: Any,
    ) -> None:
        refuse_streams(target, "a ROS 1 bag")
        super().__init__(OutputFile(target))
        with self._opening():
            self._bag = BagFile(self._output.stream, topic, compression, **options)

    def _write(self, log_ns: Int64, messages: Records) -> None:
        self._bag.write(log_ns, messages)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        self._bag.finish(provenance)

    def abort(self) -> None:
        """Discard uncommitted output."""
        self._bag.abort()
        super().abort()
