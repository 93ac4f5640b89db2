"""Walk the records of a ROS 1 bag, or of a chunk of one, and find the next one after damage."""

from __future__ import annotations

import re
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


def walked_records(data: NDArray[np.uint8]) -> Iterator[Record]:
    """Yield the records of a decompressed chunk."""
    at = 0
    while at < len(data):
        record = _complete_record(data.data, at, len(data))
        yield record
        at = record.end


def surviving_records(content: ChunkRecords) -> tuple[list[Record], str]:
    """Return the intact records of a chunk up to any damage, and the damage, or ``""``."""
    records: list[Record] = []
    try:
        records.extend(walked_records(content.data))
    except UnreadableDataError as error:
        # Unless the chunk is cut off there, the length of the last one may be wrong.
        return records if content.damage else records[:-1], str(error)
    return records, ""


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
