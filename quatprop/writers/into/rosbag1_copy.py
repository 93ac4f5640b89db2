"""Copy ROS 1 bags and add attitudes; chunks are copied unchanged and in their order.

Chunks are decompressed only if they are damaged, their index is missing, or there is only one.
Damaged ones are then rewritten with their intact messages.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import DamagedLogError, UnreadableLogError, UnsupportedLogError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S
from quatprop.readers.containers.rosbag1_index import (
    OP_MESSAGE,
    BagChunk,
    ChunkRecords,
    RecordFile,
    index_data,
    read_chunk,
    surviving_records,
    walked_records,
)
from quatprop.stores.compression import UnreadableDataError
from quatprop.writers import attitude_encoder, rosbag1
from quatprop.writers.rosbag1 import COMPRESSIONS, BagFile, BagWriter

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.base.arrays import Records
    from quatprop.readers.containers.rosbag1 import Rosbag1Log
    from quatprop.readers.containers.rosbag1_index import Record
    from quatprop.writers.formats import Message

    Indexes = dict[int, Records]

_CHUNK_BYTES = 1 << 17
"""Bytes of a chunk of attitudes: small, so that it is near the log's chunks of its time."""

_PIECE = 1 << 20


class BagCopyWriter(BagWriter):
    """Copy a ROS 1 bag and add attitudes to it."""

    def __init__(self, log: Rosbag1Log, target: Path | str, message: Message) -> None:
        self.encoder = attitude_encoder(message, ("ros1",))
        self._copy = BagCopy(log)
        super().__init__(
            target,
            self.encoder.topic,
            "none",
            connection=self._copy.free_id,
            before=lambda first_ns: self._copy.up_to(first_ns, self._bag),
            chunk_bytes=_CHUNK_BYTES,
        )

    def _finish(self, provenance: Mapping[str, object]) -> None:
        self._bag.flush()
        self._copy.up_to(None, self._bag)
        self._bag.finish(provenance, self._copy.connections)


class _WholeFile(RecordFile):
    """Reads a bag all of whose bytes are copied: what cannot be read any more ends the copy."""

    def at(self, start: int, size: int) -> bytes:
        """Return `size` bytes at `start`, or fewer at the end of the file."""
        try:
            data = super().at(start, size)
        except UnreadableDataError as error:
            raise UnreadableLogError(self.source.path, error.reason) from error
        if len(data) < min(size, self.size - start):
            reason = "it became shorter while it was read; copy it first"
            raise DamagedLogError(self.source.path, reason)
        return data


class BagCopy:
    """Copies a bag incrementally, up to a given time.

    `log`: the bag, which stays open until the copy is finished
    `free_id`: an unused connection id
    """

    def __init__(self, log: Rosbag1Log) -> None:
        log.check_index(log.index.chunks)
        index = log.index
        if any(chunk.id_offset for chunk in index.chunks):
            raise UnsupportedLogError(
                log.path,
                "several bags are joined in it, and nothing can be added to them; write the "
                f"attitudes to a file of their own with {Setting('output')}",
            )
        self._file = _WholeFile(log.source)
        self._chunks = sorted(index.chunks, key=lambda chunk: chunk.start)
        self._next = 0
        self.connections = {
            id_: {name.decode(): value for name, value in fields.items() if name not in _OF_HEAD}
            for id_, fields in index.connections.items()
        }
        ids = {id_ for chunk in self._chunks for id_ in chunk.counts} | self.connections.keys()
        self.free_id = max(ids, default=-1) + 1

    def up_to(self, first_ns: int | None, bag: BagFile) -> None:
        """Copy the chunks before the first that begins after `first_ns`, or all if None."""
        while self._next < len(self._chunks):
            chunk = self._chunks[self._next]
            if first_ns is not None and chunk.first_ns > first_ns:
                return
            self._next += 1
            self._copy(chunk, bag)

    def _copy(self, chunk: BagChunk, bag: BagFile) -> None:
        """Copy a chunk unchanged, or its records if it is damaged or has no index."""
        # A single chunk is split: readers take a bag's start and end from its first and last
        # chunk, and the attitudes may span less time.
        is_only = len(self._chunks) == 1
        try:
            record = None if chunk.is_unchunked else self._file.record(chunk.start)
            if record is not None and not is_only and (known := self._index_of(chunk, record)):
                bag.append_chunk(self._pieces(record), known)
                return
            loaded = read_chunk(self._file, chunk)
        except UnreadableDataError:
            return  # the reader of its messages reports the loss
        compression = "none"
        if record is not None and not loaded.damage:
            compression = record.fields[b"compression"].decode()
        indexes, intact = _intact(loaded)
        split = _split_offset(indexes) if is_only else 0
        for begin, stop in ((0, split), (split, len(intact))):
            part = _part(indexes, begin, stop)
            if part:
                data = intact[begin:stop].tobytes()
                packed = COMPRESSIONS[compression](data)
                bag.append_chunk([rosbag1.chunk(compression, len(data), packed)], part)

    def _index_of(self, chunk: BagChunk, record: Record) -> Indexes:
        """Return the index of a chunk; empty if its counts differ from the bag's index."""
        indexes, _ = index_data(self._file.at(record.end, max(0, chunk.end - record.end)))
        counts = {id_: len(entries) for id_, entries in indexes.items()}
        return indexes if counts == chunk.counts else {}

    def _pieces(self, record: Record) -> Iterator[bytes]:
        for begin in range(record.start, record.end, _PIECE):
            yield self._file.at(begin, min(_PIECE, record.end - begin))


_OF_HEAD = (b"op", b"conn")
"""Fields of a connection record that describe the record, not the connection."""


def _split_offset(indexes: Indexes) -> int:
    """Return the offset at which to split a chunk between its earliest and latest message."""
    entries = np.concatenate([np.zeros(0, rosbag1.ENTRY), *indexes.values()])
    entries = np.sort(entries, order="offset")
    log_ns = rosbag1.times(entries)
    if not len(log_ns):
        return 0
    earliest, latest = int(log_ns.argmin()), len(log_ns) - 1 - int(log_ns[::-1].argmax())
    return 0 if earliest == latest else int(entries["offset"][min(earliest, latest) + 1])


def _part(indexes: Indexes, begin: int, end: int) -> Indexes:
    """Return the index of the messages from `begin` to `end`, as that of a separate chunk."""
    part = {}
    for id_, entries in indexes.items():
        kept = entries[(entries["offset"] >= begin) & (entries["offset"] < end)]
        if len(kept):
            kept["offset"] -= begin
            part[id_] = kept
    return part


def _intact(loaded: ChunkRecords) -> tuple[Indexes, NDArray[np.uint8]]:
    """Return the index of each connection of a chunk, and its intact records."""
    try:
        return _indexes(loaded.data), loaded.data
    except UnreadableDataError:
        found, _ = surviving_records(loaded.data, loaded.indexed_offsets)
    parts = [loaded.data[record.start : record.end] for record in found]
    data = np.concatenate([loaded.data[:0], *parts])
    return _indexes(data), data


def _indexes(data: NDArray[np.uint8]) -> Indexes:
    """Return the index of each connection of intact records."""
    rows: defaultdict[int, list[tuple[int, int, int]]] = defaultdict(list)
    for record in walked_records(data):
        if record.op == OP_MESSAGE:
            time = record.time(b"time")
            place = (*divmod(time, NS_PER_S), record.start)
            rows[record.number(b"conn")].append(place)
    return {id_: np.array(entries, rosbag1.ENTRY) for id_, entries in rows.items()}
