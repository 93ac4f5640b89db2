"""Write ROS 1 bags, a block at a time.

Messages of one size have records of one size: a chunk is one array that is filled a column at a
time, and so is its index. rosbags would need a call for each message. The provenance is stored as a
field of the connection record in the index, since bags have no metadata, and readers ignore unknown
fields.
"""

from __future__ import annotations

import bz2
import struct
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import lz4.frame
import numpy as np

from quatprop.base.threads import OrderedThreadPool
from quatprop.base.times import NS_PER_S
from quatprop.readers.containers.rosbag1_index import (
    INDEX_ENTRY,
    MAGIC,
    OP_BAG_HEADER,
    OP_CHUNK,
    OP_CHUNK_INFO,
    OP_CONNECTION,
    OP_INDEX_DATA,
    OP_MESSAGE,
)
from quatprop.writers.atomic import OutputFile
from quatprop.writers.base import MessageWriter, RecordBlock, empty_records, provenance_json
from quatprop.writers.targets import refuse_streams

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from quatprop.base.arrays import Int64, Records
    from quatprop.writers.message_encoders import Topic


# Encode records of ROS 1 bags: a head of named fields, then data.
#
# Reference: ROS wiki, "Bags/Format/2.0".


_ID = 0
"""The id of the connection."""
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = (
    bytes([op])
    for op in (OP_MESSAGE, OP_BAG_HEADER, OP_INDEX_DATA, OP_CHUNK, OP_CHUNK_INFO, OP_CONNECTION)
)
"""Kinds of records."""

_HEAD_BYTES = 4096
"""Bytes of the bag's first record; padded, since it is rewritten at the end."""


def _bag(index: int, connections: int, chunks: int) -> bytes:
    """Return the bag's first record: the offset and the counts of the index."""
    head = {
        "index_pos": struct.pack("<Q", index),
        "conn_count": _u4(connections),
        "chunk_count": _u4(chunks),
    }
    padding = _HEAD_BYTES - len(_record(BAG, head, b""))
    return _record(BAG, head, b" " * padding)


def _connection(values: Mapping[str, bytes]) -> bytes:
    """Return the record of the connection: its id, its topic and all its fields."""
    head = {"conn": _u4(_ID), "topic": values["topic"]}
    return _record(CONNECTION, head, _encoded_fields(values))


def _chunk(compression: str, size: int, data: bytes) -> bytes:
    """Return a chunk of compressed records of `size` bytes before compression."""
    return _record(CHUNK, {"compression": compression.encode(), "size": _u4(size)}, data)


def _index_data(entries: Records) -> bytes:
    """Return the index of the messages in the preceding chunk."""
    head = {"ver": _u4(1), "conn": _u4(_ID), "count": _u4(len(entries))}
    return _record(INDEX, head, entries.tobytes())


class _ChunkInfo(NamedTuple):
    """The index record of a chunk.

    `place`: offset of the chunk
    `start_ns`, `end_ns`: earliest and latest log time, ns
    `messages`: number of messages
    """

    place: int
    start_ns: int
    end_ns: int
    messages: int

    def encoded(self) -> bytes:
        """Return the record."""
        head = {
            "ver": _u4(1),
            "chunk_pos": struct.pack("<Q", self.place),
            "start_time": _time(self.start_ns),
            "end_time": _time(self.end_ns),
            "count": _u4(1),
        }
        return _record(CHUNK_INFO, head, _u4(_ID) + _u4(self.messages))


def _record(op: bytes, head: Mapping[str, bytes], data: bytes) -> bytes:
    """Return a record."""
    head_bytes = _encoded_fields({"op": op, **head})
    return _u4(len(head_bytes)) + head_bytes + _u4(len(data)) + data


def _encoded_fields(values: Mapping[str, bytes]) -> bytes:
    """Return named values, each length-prefixed."""
    joined = (name.encode() + b"=" + value for name, value in values.items())
    return b"".join(_u4(len(field)) + field for field in joined)


def _u4(number: int) -> bytes:
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


class BagWriter(MessageWriter):
    """Write messages to a ROS 1 bag.

    `target`: a path; not a pipe, since a bag begins with the offset of its index
    `compression`: a key of :data:`COMPRESSIONS`
    """

    _output: OutputFile

    def __init__(self, target: Path | str, topic: Topic, compression: str) -> None:
        refuse_streams(target, "a ROS 1 bag")
        super().__init__(OutputFile(target))
        self._fields = {
            "topic": topic.name.encode(),
            "type": topic.type_name.encode(),
            "md5sum": topic.digest.encode(),
            "message_definition": topic.schema,
        }
        self._pool = OrderedThreadPool(partial(_compressed, compression), self._append_chunk)
        self._chunks: list[_ChunkInfo] = []
        self._messages = RecordBlock(_empty_rows, self._submit)
        # The first chunk begins with the connection record, as some readers expect.
        self._prefix = _connection(self._fields)
        self._size = 0
        with self._opening():
            self._append(MAGIC)
            self._append(_bag(0, 0, 0))

    def _write(self, log_ns: Int64, messages: Records) -> None:
        # Times from 1970 to 2106.
        seconds, nanoseconds = np.divmod(log_ns, NS_PER_S)
        self._messages.write(messages, sec=seconds, nanosec=nanoseconds)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        self._messages.flush()
        self._pool.drain()
        self._pool.shutdown()
        index = self._size
        if provenance:
            self._fields["quatprop"] = provenance_json(provenance).encode()
        self._append(_connection(self._fields))
        infos = _in_order(self._chunks)
        for info in infos:
            self._append(info.encoded())
        self._output.stream.seek(len(MAGIC))
        self._output.stream.write(_bag(index, 1, len(infos)))

    def abort(self) -> None:
        """Discard uncommitted output."""
        self._pool.shutdown()
        super().abort()

    def _submit(self, rows: Records) -> None:
        self._pool.submit(self._prefix, rows)
        self._prefix = b""

    def _append_chunk(self, chunk: tuple[bytes, Records]) -> None:
        """Write a chunk and its index data."""
        data, entries = chunk
        log_ns = entries["sec"].astype(np.int64) * NS_PER_S + entries["nsec"]
        self._chunks.append(
            _ChunkInfo(self._size, int(log_ns.min()), int(log_ns.max()), len(entries))
        )
        self._append(data)
        self._append(_index_data(entries))

    def _append(self, data: bytes) -> None:
        self._output.stream.write(data)
        self._size += len(data)


def _in_order(chunks: list[_ChunkInfo]) -> list[_ChunkInfo]:
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


def _compressed(compression: str, prefix: bytes, rows: Records) -> tuple[bytes, Records]:
    """Return the record and the index of a chunk of a prefix and messages."""
    index = np.empty(len(rows), INDEX_ENTRY)
    index["sec"], index["nsec"] = rows["sec"], rows["nanosec"]
    index["offset"] = len(prefix) + np.arange(len(rows)) * rows.itemsize
    data = prefix + rows.tobytes()
    return _chunk(compression, len(data), COMPRESSIONS[compression](data)), index


def _empty_rows(size: int) -> Records:
    """Return records of messages of `size` bytes for one chunk, without times and data."""
    head = _encoded_fields({"op": MESSAGE, "conn": _u4(_ID), "time": bytes(8)})
    # The time is the last field of the head.
    before = struct.pack("<I", len(head)) + head[:-8]
    fields = {"before": f"V{len(before)}", "sec": "<u4", "nanosec": "<u4", "length": "<u4"}
    rows = empty_records(fields, size, CHUNK_BYTES)
    rows["before"] = np.void(before)
    rows["length"] = size
    return rows
