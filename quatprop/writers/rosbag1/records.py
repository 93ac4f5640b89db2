"""Encode records of ROS 1 bags: a head of named fields, then data.

References
----------
ROS wiki, "Bags/Format/2.0".
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.arrays import Int64, Records

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


def connection(id_: int, values: Mapping[str, bytes]) -> bytes:
    """Return the record of a connection: its id, its topic and all its fields."""
    return record(CONNECTION, {"conn": u4(id_), "topic": values["topic"]}, fields(values))


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
    head_bytes = fields({"op": op, **head})
    return u4(len(head_bytes)) + head_bytes + u4(len(data)) + data


def fields(values: Mapping[str, bytes]) -> bytes:
    """Return named values, each length-prefixed."""
    joined = (name.encode() + b"=" + value for name, value in values.items())
    return b"".join(u4(len(field)) + field for field in joined)


def u4(number: int) -> bytes:
    """Return a number in four bytes."""
    return struct.pack("<I", number)


def _time(ns: int) -> bytes:
    return struct.pack("<II", *divmod(ns, NS_PER_S))
