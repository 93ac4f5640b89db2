"""ROS 1 bags of one topic, by the block: messages of one size are one array, and so is a chunk.

A record is a head of named fields and its data, each after its length. Where every message has
the same size, so has every record: a chunk is filled a column at a time, and so is its index.
"""

from __future__ import annotations

import bz2
import struct
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np

from quatprop.writers.in_order import InOrder

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import BinaryIO

    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]

MAGIC = b"#ROSBAG V2.0\n"
CHUNK_BYTES = 1 << 20
"""About how large a chunk is before it is compressed."""

NS_PER_S = 1_000_000_000
_HEAD_BYTES = 4096
"""Bytes of the bag's first record: padded, since it is written again at the end."""

_CONNECTION = 0
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION_INFO = (
    bytes([op]) for op in (2, 3, 4, 5, 6, 7)
)
_ENTRY = np.dtype([("sec", "<u4"), ("nanosec", "<u4"), ("offset", "<u4")])

COMPRESSIONS: Mapping[str, Callable[[bytes], bytes]] = {
    "none": lambda data: data,
    "lz4": lz4.frame.compress,
    "bz2": bz2.compress,
}
"""What a chunk can be compressed with."""


@dataclass(frozen=True, slots=True)
class _Chunk:
    """A chunk as it is written, with the index that follows it."""

    packed: bytes
    size: int
    first: int
    last: int
    index: bytes
    count: int


class BagFile:
    """A ROS 1 bag being written, of one topic whose messages all have one size.

    Parameters
    ----------
    stream
        Where the bag goes; seekable, since it begins with where its index is.
    compression
        A key of :data:`COMPRESSIONS`.
    topic, kind, definition, md5sum
        What is published where; the type as ROS 1 names it.
    """

    def __init__(  # noqa: PLR0913  # a connection, told in full
        self,
        stream: BinaryIO,
        compression: str,
        *,
        topic: str,
        kind: str,
        definition: str,
        md5sum: str,
    ) -> None:
        self._stream = stream
        self._compression = compression
        self._topic = topic
        self._connection = {
            "topic": topic.encode(),
            "type": kind.encode(),
            "md5sum": md5sum.encode(),
            "message_definition": definition.encode(),
        }
        self._works = InOrder(partial(_packed, compression), self._put_chunk)
        self._infos: list[bytes] = []
        self._rows: NDArray[np.void] | None = None
        self._filled = 0
        # The first chunk begins with the connection, as other readers than ours may expect.
        self._ahead = self._connection_record()
        self._place = 0
        self._put(MAGIC)
        self._put(_bag_record(0, 0, 0))

    def write(self, log_ns: Int64, messages: NDArray[np.void]) -> None:
        """Append messages; chunks end at fixed messages, wherever a batch happened to end.

        Parameters
        ----------
        log_ns
            When each arrived, shape ``(N,)``, ns, from 1970 to 2106.
        messages
            Shape ``(N,)``, always of the same item size.
        """
        if self._rows is None:
            self._rows = _blank_rows(messages.itemsize)
        data = messages.view(self._rows.dtype["data"])
        seconds, nanoseconds = np.divmod(log_ns, NS_PER_S)
        done = 0
        while done < len(data):
            take = min(len(data) - done, len(self._rows) - self._filled)
            source, place = slice(done, done + take), slice(self._filled, self._filled + take)
            rows = self._rows[place]
            rows["sec"], rows["nanosec"] = seconds[source], nanoseconds[source]
            rows["data"] = data[source]
            self._filled += take
            done += take
            if self._filled == len(self._rows):
                self._flush()

    def finish(self, provenance: str = "") -> None:
        """Write what is still held, the index and where it is; the stream is left open.

        Parameters
        ----------
        provenance
            Words that are kept with the connection, where the index repeats it.
        """
        self._flush()
        self._works.finish()
        self._works.stop()
        index = self._place
        if provenance:
            self._connection["quatprop"] = provenance.encode()
        self._put(self._connection_record())
        for info in self._infos:
            self._put(info)
        self._stream.seek(len(MAGIC))
        self._stream.write(_bag_record(index, 1, len(self._infos)))

    def abort(self) -> None:
        """Let go of what is held; harmless after the end."""
        self._works.stop()

    def _flush(self) -> None:
        if self._filled and self._rows is not None:
            self._works.give(self._ahead, self._rows[: self._filled].copy())
            self._ahead, self._filled = b"", 0

    def _put_chunk(self, chunk: _Chunk) -> None:
        place = self._place
        self._put(
            _record(
                _CHUNK,
                {"compression": self._compression.encode(), "size": _u4(chunk.size)},
                chunk.packed,
            )
        )
        head = {"ver": _u4(1), "conn": _u4(_CONNECTION), "count": _u4(chunk.count)}
        self._put(_record(_INDEX, head, chunk.index))
        fields = {
            "ver": _u4(1),
            "chunk_pos": struct.pack("<Q", place),
            "start_time": _time(chunk.first),
            "end_time": _time(chunk.last),
            "count": _u4(1),
        }
        counts = _u4(_CONNECTION) + _u4(chunk.count)
        self._infos.append(_record(_CHUNK_INFO, fields, counts))

    def _connection_record(self) -> bytes:
        head = {"conn": _u4(_CONNECTION), "topic": self._topic.encode()}
        return _record(_CONNECTION_INFO, head, _fields(self._connection))

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._place += len(data)


def _packed(compression: str, ahead: bytes, rows: NDArray[np.void]) -> _Chunk:
    """Return a chunk of message records after what goes ahead of them."""
    index = np.empty(len(rows), _ENTRY)
    index["sec"], index["nanosec"] = rows["sec"], rows["nanosec"]
    index["offset"] = len(ahead) + np.arange(len(rows)) * rows.itemsize
    times = rows["sec"].astype(np.int64) * NS_PER_S + rows["nanosec"]
    records = ahead + rows.tobytes()
    return _Chunk(
        packed=COMPRESSIONS[compression](records),
        size=len(records),
        first=int(times.min()),
        last=int(times.max()),
        index=index.tobytes(),
        count=len(rows),
    )


def _blank_rows(size: int) -> NDArray[np.void]:
    """Return the records of a chunk of messages, without times and data."""
    head = _fields({"op": _MESSAGE, "conn": _u4(_CONNECTION), "time": bytes(8)})
    # The time is the last field of the head.
    before = struct.pack("<I", len(head)) + head[:-8]
    dtype = np.dtype(
        [
            ("before", f"V{len(before)}"),
            ("sec", "<u4"),
            ("nanosec", "<u4"),
            ("length", "<u4"),
            ("data", f"V{size}"),
        ]
    )
    rows = np.zeros(max(1, CHUNK_BYTES // dtype.itemsize), dtype)
    rows["before"] = np.void(before)
    rows["length"] = size
    return rows


def _bag_record(index: int, connections: int, chunks: int) -> bytes:
    """Return the bag's first record, padded to its fixed size."""
    fields = {
        "index_pos": struct.pack("<Q", index),
        "conn_count": _u4(connections),
        "chunk_count": _u4(chunks),
    }
    padding = _HEAD_BYTES - len(_record(_BAG, fields, b""))
    return _record(_BAG, fields, b" " * padding)


def _record(op: bytes, fields: Mapping[str, bytes], data: bytes) -> bytes:
    head = _fields({"op": op, **fields})
    return _u4(len(head)) + head + _u4(len(data)) + data


def _fields(fields: Mapping[str, bytes]) -> bytes:
    named = (name.encode() + b"=" + value for name, value in fields.items())
    return b"".join(_u4(len(field)) + field for field in named)


def _u4(number: int) -> bytes:
    return struct.pack("<I", number)


def _time(ns: int) -> bytes:
    return struct.pack("<II", *divmod(ns, NS_PER_S))
