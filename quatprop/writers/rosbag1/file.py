"""ROS 1 bags by the block: messages of one size are one array, and so is a chunk.

Where every message has the same size, so has every record: a chunk is filled a column at a time,
and so is its index.
"""

from __future__ import annotations

import bz2
import struct
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np

from quatprop.writers.ordered_threads import OrderedThreadPool
from quatprop.writers.rosbag1 import records
from quatprop.writers.rosbag1.records import MAGIC, NS_PER_S, u4

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from typing import BinaryIO

    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]

CHUNK_BYTES = 1 << 20
"""About how large a chunk is before it is compressed."""

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
    index: NDArray[np.void]


class BagFile:
    """A ROS 1 bag being written, to which one topic is added whose messages all have one size.

    Parameters
    ----------
    stream
        Where the bag goes; seekable, since it begins with where its index is.
    compression
        A key of :data:`COMPRESSIONS`.
    topic, kind, definition, md5sum
        What is published where; the type as ROS 1 names it.
    connection
        The number of its connection.
    before
        Called with the first log time of a chunk, ns, before it is written: what else the bag
        holds has its place there.
    chunk_bytes
        About how large a chunk is before it is compressed.

    Attributes
    ----------
    place
        Bytes written so far.
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
        connection: int = 0,
        before: Callable[[int], None] = lambda _first_ns: None,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        self._stream = stream
        self._compression = compression
        self._id = connection
        self._before = before
        self._chunk_bytes = chunk_bytes
        self._described = {
            "topic": topic.encode(),
            "type": kind.encode(),
            "md5sum": md5sum.encode(),
            "message_definition": definition.encode(),
        }
        self._works = OrderedThreadPool(partial(_packed, compression), self._put_own)
        self._infos: list[bytes] = []
        self._rows: NDArray[np.void] | None = None
        self._filled = 0
        # The first chunk begins with the connection, as other readers than ours may expect.
        self._ahead = records.connection(connection, self._described)
        self.place = 0
        self._put(MAGIC)
        self._put(records.bag(0, 0, 0))

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
            self._rows = _blank_rows(self._id, messages.itemsize, self._chunk_bytes)
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
                self._give()

    def flush(self) -> None:
        """Write the messages that are still held."""
        self._give()
        self._works.finish()

    def finish(
        self, provenance: str = "", others: Mapping[int, Mapping[str, bytes]] | None = None
    ) -> None:
        """Write what is still held, the index and where it is; the stream is left open.

        Parameters
        ----------
        provenance
            Words that are kept with the connection, where the index repeats it.
        others
            What is known of the other connections of the bag, by number.
        """
        self.flush()
        self._works.stop()
        index = self.place
        if provenance:
            self._described["quatprop"] = provenance.encode()
        connections = {**(others or {}), self._id: self._described}
        for id_, described in connections.items():
            self._put(records.connection(id_, described))
        for info in self._infos:
            self._put(info)
        self._stream.seek(len(MAGIC))
        self._stream.write(records.bag(index, len(connections), len(self._infos)))

    def abort(self) -> None:
        """Let go of what is held; harmless after the end."""
        self._works.stop()

    def put_chunk(self, chunk: Iterable[bytes], indexes: Mapping[int, NDArray[np.void]]) -> None:
        """Write a chunk and its index data.

        Parameters
        ----------
        chunk
            The whole record, in pieces.
        indexes
            The messages of each connection in it, of type :data:`ENTRY
            <quatprop.writers.rosbag1.records.ENTRY>`.
        """
        self._infos.append(records.chunk_info(self.place, indexes))
        for piece in chunk:
            self._put(piece)
        for id_, entries in indexes.items():
            self._put(records.index_data(id_, entries))

    def _give(self) -> None:
        if self._filled and self._rows is not None:
            self._works.give(self._ahead, self._rows[: self._filled].copy())
            self._ahead, self._filled = b"", 0

    def _put_own(self, chunk: _Chunk) -> None:
        self._before(chunk.first)
        head = records.chunk_head(self._compression, chunk.size)
        self.put_chunk([records.record(records.CHUNK, head, chunk.packed)], {self._id: chunk.index})

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self.place += len(data)


def _packed(compression: str, ahead: bytes, rows: NDArray[np.void]) -> _Chunk:
    """Return a chunk of message records after what goes ahead of them."""
    index = np.empty(len(rows), records.ENTRY)
    index["sec"], index["nsec"] = rows["sec"], rows["nanosec"]
    index["offset"] = len(ahead) + np.arange(len(rows)) * rows.itemsize
    times = rows["sec"].astype(np.int64) * NS_PER_S + rows["nanosec"]
    data = ahead + rows.tobytes()
    return _Chunk(COMPRESSIONS[compression](data), len(data), int(times.min()), index)


def _blank_rows(connection: int, size: int, chunk_bytes: int) -> NDArray[np.void]:
    """Return the records of a chunk of messages, without times and data."""
    head = records.fields({"op": records.MESSAGE, "conn": u4(connection), "time": bytes(8)})
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
    rows = np.zeros(max(1, chunk_bytes // dtype.itemsize), dtype)
    rows["before"] = np.void(before)
    rows["length"] = size
    return rows
