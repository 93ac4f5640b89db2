"""The chunks of a ROS 1 bag, copied as they are in order of the file.

Chunks are not unpacked, unless their index data are missing or they are damaged. Those that are
cut off are written again with the messages that are whole.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.compression import CompressionError
from quatprop.containers.rosbag1.index import content
from quatprop.containers.rosbag1.records import (
    OP_CHUNK,
    OP_MESSAGE,
    MalformedRecordError,
    RecordFile,
    index_offsets,
    walked_records,
)
from quatprop.errors import DamagedLogError
from quatprop.writers.rosbag1 import records

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from quatprop.containers.rosbag1.index import Chunk
    from quatprop.containers.rosbag1.log import Rosbag1Log
    from quatprop.containers.rosbag1.records import Record
    from quatprop.writers.rosbag1.file import BagFile

    Indexes = dict[int, NDArray[np.void]]

_PIECE = 1 << 20


class BagCopy:
    """Copies a bag, bit by bit as the time comes.

    Parameters
    ----------
    log
        The bag, which stays open until the copy is finished.

    Attributes
    ----------
    connections
        What is known of each connection, by number.
    free
        A number that no connection has.

    """

    def __init__(self, log: Rosbag1Log) -> None:
        self._path, index = log.path, log.index
        self._file = RecordFile(log.source)
        self._chunks = sorted(index.chunks, key=lambda chunk: chunk.start)
        self._next = 0
        self.connections = {
            id_: {name.decode(): value for name, value in fields.items() if name not in _OF_HEAD}
            for id_, fields in index.connections.items()
        }
        used = {id_ for chunk in self._chunks for id_ in chunk.counts} | self.connections.keys()
        self.free = max(used, default=-1) + 1

    def topics(self) -> Iterator[str]:
        """Yield the topic of each connection."""
        for known in self.connections.values():
            yield known.get("topic", b"").decode(errors="replace")

    def up_to(self, first_ns: int | None, bag: BagFile) -> None:
        """Copy what comes before messages that arrived after `first_ns`; with None everything."""
        while self._next < len(self._chunks):
            chunk = self._chunks[self._next]
            if first_ns is not None and chunk.start_ns > first_ns:
                return
            self._next += 1
            self._copy(chunk, bag)

    def _copy(self, chunk: Chunk, bag: BagFile) -> None:
        try:
            record = None if chunk.loose else self._file.record(chunk.start)
            if record is not None and record.op == OP_CHUNK and record.end <= self._file.size:
                indexes = self._index_of(chunk, record)
                if indexes is not None:
                    bag.put_chunk(self._pieces(record), indexes)
                    return
            loaded = content(self._file, chunk)
        except (CompressionError, MalformedRecordError):
            return  # what reads its messages tells of it
        indexes, end = _walked(loaded.data)
        if record is not None and not loaded.damage and end == len(loaded.data):
            bag.put_chunk(self._pieces(record), indexes)
        elif indexes:
            data = loaded.data[:end].tobytes()
            whole = records.record(records.CHUNK, records.chunk_head("none", end), data)
            bag.put_chunk([whole], indexes)

    def _index_of(self, chunk: Chunk, record: Record) -> Indexes | None:
        """Return the index data of a chunk where they have all that the bag says it has."""
        if not record.end <= chunk.end <= self._file.size:
            return None
        indexes = index_offsets(self._file.at(record.end, chunk.end - record.end))
        counts = {id_: len(entries) for id_, entries in indexes.items()}
        return indexes if counts and counts == chunk.counts else None

    def _pieces(self, record: Record) -> Iterator[bytes]:
        for begin in range(record.start, record.end, _PIECE):
            size = min(_PIECE, record.end - begin)
            data = self._file.at(begin, size)
            if len(data) < size:
                raise DamagedLogError(
                    self._path, "it has become shorter while it was read; copy it first"
                )
            yield data


_OF_HEAD = (b"op", b"conn")
"""Fields of a connection's record that are not about the connection."""


def _walked(data: NDArray[np.uint8]) -> tuple[Indexes, int]:
    """Return the messages of each connection of a chunk, and where its whole records end."""
    rows: defaultdict[int, list[tuple[int, int, int]]] = defaultdict(list)
    end = 0
    try:
        for record in walked_records(data):
            if record.op == OP_MESSAGE:
                time = record.time(b"time")
                place = (*divmod(time, records.NS_PER_S), record.start)
                rows[record.number(b"conn")].append(place)
            end = record.end
    except MalformedRecordError:
        pass  # what is whole counts
    return {id_: np.array(entries, records.ENTRY) for id_, entries in rows.items()}, end
