"""Walk the records of a ROS 1 bag, or of a chunk of one, and find the next one after damage."""

from __future__ import annotations

import re
from bisect import bisect_left
from contextlib import suppress
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from quatprop.readers.containers.parts import first_accepted
from quatprop.readers.containers.rosbag1_index import (
    INDEX_ENTRY,
    OP_BAG_HEADER,
    OP_CHUNK,
    OP_CHUNK_INFO,
    OP_CONNECTION,
    OP_INDEX_DATA,
    OP_MESSAGE,
    ChunkRecords,
    Record,
    RecordFile,
    data_fields,
    record_at,
)
from quatprop.stores.compression import UnreadableDataError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Sequence

    from numpy.typing import NDArray

    from quatprop.readers.containers.rosbag1_index import Buffer


# Find the next record of a ROS 1 bag after damage.
#
# Every record has a field ``op`` in its header. Around each such field a header is searched; it is
# accepted if its fields and lengths are consistent, or if it leads to further records.


CHUNKS = frozenset({OP_CHUNK})
"""Kinds of record to search for where messages in an uncompressed chunk would match, too."""

ENDS = CHUNKS | {OP_INDEX_DATA}
"""Kinds of record that end an uncompressed chunk, whatever its length says."""

RECORDS = frozenset(
    {OP_MESSAGE, OP_BAG_HEADER, OP_INDEX_DATA, OP_CHUNK, OP_CHUNK_INFO, OP_CONNECTION}
)
"""Kinds of record to search for elsewhere."""

COMPRESSIONS = (b"none", b"bz2", b"lz4")

_OP = rb"\x04\x00\x00\x00op=(.)"
_OP_SIZE = 8
"""Bytes of the field ``op``."""

_REACH = 1 << 10
"""Maximum bytes of a header before its field ``op``."""

_PIECE_BYTES = 1 << 16
"""Bytes of which the lengths are looked at together."""

_TRIES = 50_000
"""Maximum number of candidates, so that the search ends on hostile files."""

_CHAIN = 2
"""Number of consecutive messages that are required to accept the first."""


def next_record(file: RecordFile, start: int, stop: int, kinds: Container[int]) -> int | None:
    """Return the offset of the first record that is accepted; None if there is none.

    `kinds`: values of ``op`` that it may have
    """

    def found(window: bytes) -> list[int]:
        ops = (op.start() for op in re.finditer(_OP, window, re.DOTALL) if op[1][0] in kinds)
        return _in_headers(window, [*ops])

    def accepted(place: int) -> int | None:
        record = _record_around(file, place, start)
        is_found = record is not None and record.start < stop and _is_record(file, record)
        return record.start if record and is_found else None

    within = start, min(stop + _REACH, file.size), _OP_SIZE - 1
    return first_accepted(file.tried, within, found, accepted, _TRIES)


def is_chunk(record: Record) -> bool:
    """Return whether the fields of a chunk header are consistent."""
    try:
        size = record.number(b"size")
    except UnreadableDataError:
        return False
    compression = record.fields.get(b"compression")
    length = record.end - record.data
    return compression in COMPRESSIONS and (compression != b"none" or size == length)


def _header_ends(data: Buffer) -> NDArray[np.int64]:
    """Return the end of the header that may begin at each byte but the last seven; 0: none does.

    It is one if its first field ends in it.
    """
    if len(data) <= _OP_SIZE:
        return np.zeros(1, np.int64)
    first, *others = (np.frombuffer(data, np.uint8)[k : len(data) - 3 + k] for k in range(4))
    lengths = first.astype(np.int64)
    for k, part in enumerate(others, 1):
        lengths += part.astype(np.int64) << (8 * k)
    sizes, fields = lengths[:-4], lengths[4:]
    is_one = (fields > 0) & (fields + 4 <= sizes) & (sizes < 2 * _REACH)
    return np.where(is_one, np.arange(4, len(sizes) + 4) + sizes, 0)


def _in_headers(data: Buffer, ops: Sequence[int]) -> list[int]:
    """Return the fields ``op``, by their offsets, that may be in a header, by its length.

    Those near the begin may be in one that begins before the data.
    """
    places = np.array(ops, np.int64)
    found: list[int] = []
    for begin in range(0, len(data) if ops else 0, _PIECE_BYTES):
        first = max(0, begin - _REACH)
        own = places[np.searchsorted(places, begin) : np.searchsorted(places, begin + _PIECE_BYTES)]
        if len(own):
            ends = _header_ends(data[first : int(own[-1]) + _OP_SIZE])
            furthest = first + np.maximum.accumulate(ends)[np.maximum(own - first - 4, 0)]
            found += own[(furthest >= own + _OP_SIZE) | (own < _REACH)].tolist()
    return found


def _record_around(file: RecordFile, op: int, start: int) -> Record | None:
    """Return the record whose field ``op`` is at an offset; None if no header contains it."""
    first = max(start, op - _REACH)
    data = file.tried(first, 2 * _REACH)
    ends = _header_ends(data[: op - first + 4])
    # The header ends after the field, and not far from it.
    for at in np.flatnonzero((ends >= op - first + _OP_SIZE) & (ends <= len(data)))[::-1].tolist():
        try:
            record = record_at(data, at, first)
        except UnreadableDataError:
            continue
        if record.fields.get(b"op") is not None:
            return record
    return None


def _is_record(file: RecordFile, record: Record) -> bool:
    """Return whether a candidate is a record, rather than bytes that look like one."""
    for _ in range(_CHAIN):
        try:
            if record.op != OP_MESSAGE:
                return _is_plausible(file, record)
            record.number(b"conn")
            record.time(b"time")
            if record.end >= file.size:
                return record.end == file.size
            record = file.record(record.end)
        except UnreadableDataError:
            return False
    return True


def _is_plausible(file: RecordFile, record: Record) -> bool:
    """Return whether the fields of a record agree with its length."""
    length = record.end - record.data
    if record.op == OP_CHUNK:
        return is_chunk(record)
    if record.end > file.size:
        return False
    if record.op == OP_BAG_HEADER:
        return b"index_pos" in record.fields
    if record.op == OP_INDEX_DATA:
        return length == record.number(b"count") * INDEX_ENTRY.itemsize
    if record.op == OP_CHUNK_INFO:
        return length == 8 * record.number(b"count")
    return record.op == OP_CONNECTION and b"type" in data_fields(file.tried(record.data, length))


# Walk the records of a chunk, which are connections and messages.


_IN_CHUNK = re.compile(rb"\x04\x00\x00\x00op=[\x02\x07]")
_TRIES_IN_CHUNK = 1000


def walked_records(data: NDArray[np.uint8]) -> Iterator[Record]:
    """Yield the records of a decompressed chunk."""
    at = 0
    while at < len(data):
        record = _complete_record(data.data, at, len(data))
        yield record
        at = record.end


def surviving_records(content: ChunkRecords) -> tuple[list[Record], str]:
    """Return the intact records of a chunk, and the damage, or ``""``."""
    data, records = content.data, list[Record]()
    try:
        records.extend(walked_records(data))
    except UnreadableDataError as error:
        damage = str(error)
    else:
        return records, ""
    indexed, chunk = {*content.indexed_offsets.tolist()}, _ChunkFile(data.data)
    at = records[-1].end if records else 0
    while at < len(data):
        try:
            records.append(_complete_record(data.data, at, len(data)))
            at = records[-1].end
        except UnreadableDataError:
            has_before = bool(records) and records[-1].end == at
            resumed_at = chunk.next_record(records[-1].data if has_before else at + 1, indexed)
            is_cut_off = bool(content.damage) and resumed_at is None
            if has_before and not (is_cut_off or _is_intact_before(at, resumed_at, indexed)):
                del records[-1]
            at = len(data) if resumed_at is None else resumed_at
    return records, damage


def _is_intact_before(at: int, resumed_at: int | None, indexed: Container[int]) -> bool:
    """Return whether the record before damage ends there, at `at`, with all of its bytes.

    Where bytes were inserted or lost, the records behind them are not where the index says.
    """
    return at in indexed and (resumed_at is None or resumed_at in indexed)


class _ChunkFile(RecordFile):
    """A decompressed chunk, as a file of records."""

    def __init__(self, data: memoryview) -> None:
        self._data = data
        self.size = len(data)
        self._tries = _TRIES_IN_CHUNK

    @cached_property
    def _ops(self) -> list[int]:
        """Offsets of the fields ``op`` of connections and messages, in order."""
        return _in_headers(self._data, [op.start() for op in _IN_CHUNK.finditer(self._data)])

    def at(self, start: int, size: int) -> bytes:
        """Return `size` bytes at `start`, or fewer at the end."""
        return bytes(self._data[start : start + size])

    tried = at

    def next_record(self, start: int, indexed: Container[int]) -> int | None:
        """Return the offset of the first record from `start` that is indexed or leads to another.

        At most 1000 candidates are tried in a chunk, so that the search ends on hostile ones.
        """
        begin = bisect_left(self._ops, start)
        for op in self._ops[begin : begin + self._tries]:
            self._tries -= 1
            record = _record_around(self, op, start)
            with suppress(UnreadableDataError):
                if record is not None and (record.start in indexed or _is_record(self, record)):
                    return _complete_record(self._data, record.start, self.size).start
        return None


def _complete_record(data: memoryview, at: int, limit: int) -> Record:
    record = record_at(data, at)
    if record.end > limit:
        raise UnreadableDataError("a record in it is damaged or cut off")
    kind = record.op
    if kind not in {OP_CONNECTION, OP_MESSAGE}:
        raise UnreadableDataError("a record in it is of another kind")
    record.number(b"conn")
    if kind == OP_MESSAGE:
        record.time(b"time")
    return record
