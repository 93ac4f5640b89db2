"""The records of ROS 1 bags, format 2.0.

A bag is a sequence of records: a header of ``name=value`` fields, then data, each preceded by its
length. The data of a chunk record are records. It is followed by index data records with the
offsets of the messages of each connection.

References
----------
ROS wiki, "Bags/Format/2.0".
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from quatprop.errors import os_reason
from quatprop.stores.compression import UnreadableDataError
from quatprop.stores.zero_filled import ZeroFilledSource
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from quatprop.stores.file_source import FileSource

    Buffer = bytes | memoryview

OP_MESSAGE = 2
OP_BAG_HEADER = 3
OP_INDEX_DATA = 4
OP_CHUNK = 5
OP_CHUNK_INFO = 6
OP_CONNECTION = 7

MAX_HEADER = 1 << 20
"""Maximum bytes of a record header; real ones have less than a thousand."""

HEAD = 512
"""Bytes that are read for a header of unknown length."""

INDEX_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])

_LENGTH = struct.Struct("<I")

Data = TypeVar("Data")


@dataclass(frozen=True, slots=True)
class Record:
    """A record: its position in the file and its header.

    `start`, `data`, `end`: offsets of the record, of its data, and of its end
    `fields`: the header
    """

    start: int
    data: int
    end: int
    fields: dict[bytes, bytes]

    def number(self, name: bytes, size: int = 4) -> int:
        """Return an unsigned number of `size` bytes from the header."""
        value = self.fields.get(name, b"")
        if len(value) != size:
            raise UnreadableDataError(f"its field {name.decode()} is missing or damaged")
        return int.from_bytes(value, "little")

    def time(self, name: bytes) -> int:
        """Return a time from the header, ns."""
        both = self.number(name, 8)
        return (both & 0xFFFFFFFF) * NS_PER_S + (both >> 32)

    @property
    def op(self) -> int:
        """The kind of record."""
        return self.number(b"op", 1)


class RecordFile:
    """Reads records from a bag.

    `size`: its length, bytes
    """

    def __init__(self, source: FileSource) -> None:
        self.source = source
        self.size = source.size
        self._zero_filled = ZeroFilledSource(source)

    def at(self, start: int, size: int) -> bytes:
        """Return `size` bytes at `start`, or fewer at the end of the file."""
        return _read(self.source.read, start, size)

    def tried(self, start: int, size: int) -> bytes:
        """Return the same, for searches: zeros where the file cannot be read."""
        return self._zero_filled.read(start, size)

    def at_ranges(self, begins: Sequence[int], ends: Sequence[int]) -> bytes:
        """Return the bytes of some ranges, concatenated."""
        return _read(self.source.read_ranges, begins, ends)

    def record(self, start: int) -> Record:
        """Return the record at `start`; it may end beyond the file."""
        head = self.at(start, HEAD)
        size = int.from_bytes(head[:4], "little") + 8
        if size > MAX_HEADER:
            raise UnreadableDataError("there is no record")
        return record_at(head if size <= len(head) else self.at(start, size), 0, start)


def _read(read: Callable[..., Data], *place: object) -> Data:
    try:
        return read(*place)
    except OSError as error:
        # A worn memory card fails at some positions only: the rest of the bag is still readable.
        raise UnreadableDataError(os_reason(error)) from error


def record_at(data: Buffer, at: int, origin: int = 0) -> Record:
    """Return the record at `at` of a buffer that begins at `origin`; its data may end behind it."""
    header_end = header_end_of(data, at)
    if header_end + 4 > len(data):
        raise UnreadableDataError("its record is cut off")
    fields = {
        name: bytes(data[begin:end]) for name, begin, end in fields_of(data, at + 4, header_end)
    }
    begin = origin + header_end + 4
    return Record(origin + at, begin, begin + _LENGTH.unpack_from(data, header_end)[0], fields)


def header_end_of(data: Buffer, at: int) -> int:
    """Return the end of the header at `at`; raise an error if it is incomplete."""
    end = at + 4
    if end <= len(data):
        end += _LENGTH.unpack_from(data, at)[0]
    if end > len(data):
        raise UnreadableDataError("its record is cut off")
    return end


def data_fields(data: bytes) -> dict[bytes, bytes]:
    """Return the fields in a connection record's data, which has the format of a header."""
    return {name: data[value:end] for name, value, end in fields_of(data, 0, len(data))}


def fields_of(data: Buffer, at: int, stop: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield the name and the begin and end of the value of each field of a header."""
    while at < stop:
        end = header_end_of(data, at)  # fields are length-prefixed as headers are
        name, equals, _ = bytes(data[at + 4 : min(end, stop)]).partition(b"=")
        if end > stop or not equals:
            raise UnreadableDataError("its header is damaged")
        yield name, at + 5 + len(name), end
        at = end


def index_data(data: bytes) -> tuple[dict[int, NDArray[np.void]], int]:
    """Return the index entries by connection from the records behind a chunk, and their end.

    Reading stops at another or an incomplete record, or a second one of a connection; the messages
    are then found by walking the chunk.
    """
    entries: dict[int, NDArray[np.void]] = {}
    at = 0
    with suppress(UnreadableDataError):
        while at < len(data):
            record = record_at(data, at)
            conn, count = record.number(b"conn"), record.number(b"count")
            is_index = record.op == OP_INDEX_DATA and record.number(b"ver") == 1
            size = count * INDEX_ENTRY.itemsize
            is_whole = record.end - record.data == size and record.end <= len(data)
            if not is_index or not is_whole or conn in entries:
                break
            entries[conn] = np.frombuffer(data, INDEX_ENTRY, count, record.data)
            at = record.end
    return entries, at


def walked_records(data: NDArray[np.uint8]) -> Iterator[Record]:
    """Yield the records of a decompressed chunk."""
    at = 0
    while at < len(data):
        record = _complete_record(data.data, at, len(data))
        yield record
        at = record.end


def surviving_records(
    data: NDArray[np.uint8], indexed: NDArray[np.int64]
) -> tuple[list[Record], str]:
    """Return the intact records of a decompressed chunk, and the damage, or ``""``.

    `data`: the chunk, shape ``(B,)``
    `indexed`: offsets of messages by the index data, shape ``(N,)``, ascending, at which the walk
        resumes after damage
    """
    records: list[Record] = []
    try:
        records.extend(walked_records(data))
    except UnreadableDataError as error:
        return max(records, _indexed_records(data, indexed), key=len), str(error)
    return records, ""


def _indexed_records(data: NDArray[np.uint8], indexed: NDArray[np.int64]) -> list[Record]:
    """Walk records by their lengths, but never beyond the next indexed offset."""
    records: list[Record] = []
    at = 0
    while at < len(data):
        after = int(indexed.searchsorted(at, "right"))
        limit = min(int(indexed[after]), len(data)) if after < len(indexed) else len(data)
        try:
            records.append(_complete_record(data.data, at, limit))
            at = records[-1].end
        except UnreadableDataError:
            at = limit
    return records


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
