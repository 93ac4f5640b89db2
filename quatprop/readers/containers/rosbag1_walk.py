"""Walk the records of a ROS 1 bag, or of a chunk of one, and find the next one after damage."""

from __future__ import annotations

import re
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING

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
    from collections.abc import Container, Iterator

    import numpy as np
    from numpy.typing import NDArray


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

_TRIES = 50_000
"""Maximum number of candidates, so that the search ends on hostile files."""

_CHAIN = 2
"""Number of consecutive messages that are required to accept the first."""


def next_record(file: RecordFile, start: int, stop: int, kinds: Container[int]) -> int | None:
    """Return the offset of the first record that is accepted; None if there is none.

    `kinds`: values of ``op`` that it may have
    """

    def found(window: bytes) -> list[int]:
        return [op.start() for op in re.finditer(_OP, window, re.DOTALL) if op[1][0] in kinds]

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


def _record_around(file: RecordFile, op: int, start: int) -> Record | None:
    """Return the record whose field ``op`` is at an offset; None if no header contains it."""
    first = max(start, op - _REACH)
    data = file.tried(first, 2 * _REACH)
    for at in range(op - first - 4, -1, -1):
        size = int.from_bytes(data[at : at + 4], "little")
        # The header ends after the field, and not far from it.
        if not op - first + _OP_SIZE <= at + 4 + size <= len(data):
            continue
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

    def at(self, start: int, size: int) -> bytes:
        """Return `size` bytes at `start`, or fewer at the end."""
        return bytes(self._data[start : start + size])

    tried = at

    def next_record(self, start: int, indexed: Container[int]) -> int | None:
        """Return the offset of the first record from `start` that is indexed or leads to another.

        At most 1000 candidates are tried in a chunk, so that the search ends on hostile ones.
        """
        for op in islice(_IN_CHUNK.finditer(self._data, start), self._tries):
            self._tries -= 1
            record = _record_around(self, op.start(), start)
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
