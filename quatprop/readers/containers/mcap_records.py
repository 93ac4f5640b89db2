"""Records of an MCAP file, and the chunks that hold them.

Importing the mcap library would take longer than propagating a small log.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from itertools import islice
from operator import itemgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import os_reason
from quatprop.stores.checksum import crc32
from quatprop.stores.compression import (
    CHECKSUMS,
    MAX_SIZE,
    DecompressionBudget,
    UnreadableDataError,
    checksums_matter,
    decompress,
    decompress_prefix,
)
from quatprop.stores.file_source import LARGE

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Sequence

    from numpy.typing import NDArray

    from quatprop.stores.compression import Buffer
    from quatprop.stores.file_source import FileSource


MALFORMED = (ValueError, struct.error)
"""Exceptions that damaged records raise."""


class SchemaRecord(NamedTuple):
    """A schema, with the fields of ``mcap.records.Schema``."""

    id: int
    name: str
    encoding: str
    data: bytes

    @property
    def identity(self) -> tuple[str, str, bytes]:
        """Name, encoding and text: schemas with the same identity are equal."""
        return self.name, self.encoding, self.data


class ChannelRecord(NamedTuple):
    """A channel, with the fields of ``mcap.records.Channel``."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: dict[str, str]

    @property
    def identity(self) -> tuple[str, str, int]:
        """Topic, encoding and schema: channels with the same identity are equal."""
        return self.topic, self.message_encoding, self.schema_id


def read_schema(content: Buffer) -> SchemaRecord:
    """Return a schema from the content of its record."""
    (id_,) = struct.unpack_from("<H", content)
    name, encoding, data = prefixed(content, 2, 3)
    rest = bytes(content[2 + 3 * 4 + len(name) + len(encoding) + len(data) :])
    if rest.isascii() and rest.decode().strip().isprintable() and rest.strip():
        raise ValueError  # text behind the definition: its length is damaged
    return SchemaRecord(id_, name.decode(), encoding.decode(), data)


def read_channel(content: Buffer) -> ChannelRecord:
    """Return a channel from the content of its record."""
    id_, schema_id = struct.unpack_from("<HH", content)
    topic, encoding, metadata = prefixed(content, 4, 3)
    return ChannelRecord(id_, schema_id, topic.decode(), encoding.decode(), _mapping(metadata))


def read_metadata(content: Buffer) -> tuple[str, dict[str, str]]:
    """Return the name and entries of a metadata record."""
    name, entries = prefixed(content, 0, 2)
    return name.decode(), _mapping(entries)


def prefixed(content: Buffer, begin: int, count: int) -> list[bytes]:
    """Return the first `count` length-prefixed values of a record, from an offset on."""
    parts = list(islice(_parts(content, begin), count))
    if len(parts) < count:
        raise ValueError
    return parts


def _mapping(data: bytes) -> dict[str, str]:
    parts = [part.decode() for part in _parts(data, 0)]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def _parts(content: Buffer, begin: int) -> Iterator[bytes]:
    while begin < len(content):
        (length,) = struct.unpack_from("<I", content, begin)
        begin += 4 + length
        if begin > len(content):
            raise ValueError
        yield bytes(content[begin - length : begin])


# The chunks of an MCAP file; a run of messages outside chunks is treated as a chunk.
#
# Reference: The MCAP format specification: every record has an opcode (1 byte), a length (8 bytes)
# and content of that length, all little-endian.


MAGIC = b"\x89MCAP0\r\n"
"""The first and the last bytes of every MCAP file."""
HEADER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 3, 4, 5, 6, 7
ATTACHMENT, METADATA, DATA_END = 9, 12, 15
"""Opcodes."""
_COMPRESSIONS = frozenset({"", "lz4", "zstd"})
RECORD = struct.Struct("<BQ")
"""The head of every record: opcode and length of the content."""
CHUNK_HEAD = struct.Struct("<QQQII")
"""Start time, end time, decompressed size, CRC, length of the compression's name."""
PEEK = 128
"""Bytes that contain the head of any record that is read."""
_UNCOMPRESSED_HEAD = RECORD.size + CHUNK_HEAD.size + 8
"""Bytes of an uncompressed chunk record before its records."""
_AT_ONCE = 1 << 26
"""Chunks of up to this many bytes are read in one call with their head."""

INDEX_HEAD = struct.Struct("<BQHI")
"""Opcode, length, channel and bytes of the entries of a message index."""
INDEX_ENTRY = 16
"""Bytes of a message index entry: log time and offset."""


@dataclass(slots=True)
class Chunk:
    """A chunk, or a run of messages outside chunks.

    `start`, `length`: offset and length of the chunk record, or of the messages, bytes
    `first_ns`, `last_ns`: earliest and latest log time, ns; the latest is None if no index states
        it
    `index_length`: bytes of the message indexes that follow it
    `message_index_offsets`: file offset of each channel's message index, by channel id; 0 if it has
        none. None if the channels of the chunk are unknown
    `counts`: number of messages by channel id, if they were counted
    `id_offset`: added to its channel ids, which may be defined otherwise elsewhere in the file
    `size`: bytes of its decompressed records by the index
    `head_last_ns`: latest log time by the chunk's head, ns; 0 if unknown. The head has no checksum,
        so no chunk is skipped because of this time
    """

    start: int
    length: int
    is_chunk: bool
    first_ns: int
    index_length: int = 0
    message_index_offsets: dict[int, int] | None = None
    counts: dict[int, int] | None = None
    id_offset: int = 0
    last_ns: int | None = None
    size: int = 0
    head_last_ns: int = 0

    @property
    def end(self) -> int:
        """Offset of the record behind the chunk and its message indexes."""
        return self.start + self.length + self.index_length

    @property
    def can_be_read_in_part(self) -> bool:
        """Whether it is large, uncompressed and indexed."""
        is_uncompressed = self.is_chunk and self.size == self.length - _UNCOMPRESSED_HEAD
        return is_uncompressed and self.length >= LARGE and self.index_length > 0

    @property
    def place(self) -> str:
        """Its position in the file, for sentences."""
        return f"{'chunk' if self.is_chunk else 'messages'} at byte {self.start}"

    @property
    def ids(self) -> list[int]:
        """Ids, in the index, of its channels; empty if unknown."""
        return [self.id_offset + id_ for id_ in self.message_index_offsets or ()]

    def may_have_logged(self, log_ns: NDArray[np.int64]) -> bool:
        """Return whether log times are in the chunk's stated range; True if it states none."""
        last_ns = self.last_ns or self.head_last_ns
        if not last_ns or not len(log_ns):
            return True
        return bool(self.first_ns <= log_ns.min() and log_ns.max() <= last_ns)

    def local_ids(self, ids: Sequence[int]) -> list[int]:
        """Return the ids in the chunk's records of channels, from their ids in the index."""
        own = (id_ - self.id_offset for id_ in ids)
        return [id_ for id_ in own if 0 <= id_ < 1 << 16]

    def listed(self) -> dict[int, int] | None:
        """Return the number of messages of each channel; None if unknown."""
        if self.counts is not None or self.message_index_offsets is None:
            return self.counts
        order = sorted(self.message_index_offsets.items(), key=itemgetter(1))
        # The distance to the next index gives the number of entries.
        ends = [*(place for _, place in order[1:]), self.end]
        return {
            id_: max(0, end - place - INDEX_HEAD.size) // INDEX_ENTRY
            for (id_, place), end in zip(order, ends, strict=True)
        }

    def count(self, channel: int) -> int | None:
        """Return the number of messages of a channel; None if unknown."""
        listed = self.listed()
        return None if listed is None else listed.get(channel, 0)


class Content(NamedTuple):
    """The content of a chunk.

    `data`: its decompressed records, as far as they can be read
    `damage`: the reason why they are incomplete, or ``""``
    `has_checksum`: whether a checksum was verified
    """

    data: Buffer = b""
    damage: str = ""
    has_checksum: bool = False


TORN = "the file ends inside it"
"""The damage of a record whose writing was interrupted."""


def load_chunk(
    source: FileSource, chunk: Chunk, budget: DecompressionBudget, *, check: bool = True
) -> Content:
    """Read and decompress a chunk; with `check`, raise an error if its checksum is wrong."""
    try:
        return _load(source, chunk, budget, check=check)
    except OSError as error:
        raise UnreadableDataError(os_reason(error)) from error


def _load(source: FileSource, chunk: Chunk, budget: DecompressionBudget, *, check: bool) -> Content:
    if not chunk.is_chunk:
        loose = source.read(chunk.start, chunk.length)
        return Content(loose, TORN if len(loose) < chunk.length else "")
    at_once = chunk.length <= _AT_ONCE
    front = memoryview(source.read(chunk.start, chunk.length if at_once else PEEK))
    head = chunk_head(front, chunk.length)
    if head is None:
        raise UnreadableDataError("no chunk of the indexed length begins there")
    budget.check()
    begin, size = chunk.start + head.begin, min(head.end, chunk.length) - head.begin
    content = front[head.begin :][:size] if at_once else source.read(begin, size)
    is_torn = len(content) < size or chunk.start + chunk.length > source.size
    if is_torn:
        data = decompress_prefix(content, head.compression, head.size)[: head.size]
        if len(data) < head.size:
            return Content(data, TORN)
    else:
        data = decompress(content, head.compression, head.size or None)
    budget.spend(len(data) if head.compression else 0)
    if check and head.crc and crc32(data) != head.crc and checksums_matter():
        raise UnreadableDataError(
            f"its checksum is wrong, so it is not what was recorded; with {CHECKSUMS}=ignore "
            "it is read anyway"
        )
    return Content(data, has_checksum=head.crc != 0)


class ChunkHead(NamedTuple):
    """The fields of a chunk before its data.

    `first_ns`, `last_ns`: earliest and latest log time, unsigned ns
    `size`: bytes of the decompressed data
    `crc`: checksum of the decompressed data; 0 if there is none
    `begin`, `end`: offsets of the compressed data from the beginning of the record
    """

    first_ns: int
    last_ns: int
    size: int
    crc: int
    compression: str
    begin: int
    end: int

    @property
    def is_uncompressed(self) -> bool:
        """Whether the records are not compressed."""
        return not self.compression and self.size == self.end - self.begin


def read_chunk_head(source: FileSource, chunk: Chunk) -> ChunkHead | None:
    """Return the head of a chunk; None if no chunk of this length begins there."""
    return chunk_head(source.read(chunk.start, PEEK), chunk.length)


def chunk_head(record: Buffer, length: int) -> ChunkHead | None:
    """Return the head of a chunk record of a length; None if it is none.

    Of the head of the record and the lengths in its content, one is enough.
    """
    fixed = RECORD.size + CHUNK_HEAD.size
    if len(record) < fixed + 8:
        return None
    first, last, size, crc, name_length = CHUNK_HEAD.unpack_from(record, RECORD.size)
    begin = fixed + name_length + 8
    if begin > len(record):
        return None
    (size_in_file,) = struct.unpack_from("<Q", record, begin - 8)
    end = begin + size_in_file
    compression = bytes(record[fixed : begin - 8]).decode(errors="replace")
    is_stated = RECORD.unpack_from(record) == (CHUNK, length - RECORD.size) and end <= length
    if not is_stated and (end != length or compression not in _COMPRESSIONS):
        return None
    return ChunkHead(first, last, size, crc, compression, begin, end)


def plausible_chunk(head: bytes, length: int) -> bool:
    """Return whether a record with content of this `length` is a chunk, whatever its opcode."""
    stated = chunk_head(head, RECORD.size + length)
    return (
        stated is not None
        and stated.end == RECORD.size + length
        and stated.compression in _COMPRESSIONS
        and stated.size <= MAX_SIZE
        and (stated.compression != "" or stated.size == stated.end - stated.begin)
    )


# Walk the records of a decompressed chunk, or of messages outside chunks.


MESSAGE_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<i8"),
        ("publish", "<i8"),
    ]
)
_FIXED = MESSAGE_HEAD.itemsize - RECORD.size
_LONG_RUN = 16
"""Number of equal lengths in a row after which records of that length are searched in bulk."""


@dataclass(slots=True)
class WalkedRecords:
    """The result of a walk.

    `offsets`: offset of each message record, shape ``(N,)``, int64
    `definitions`: opcode, and begin and end of the content, of each schema and channel
    `end`: end of the walk: behind the last complete record, or before one to stop at
    `malformed`: number of message records that are too short
    """

    offsets: NDArray[np.int64]
    definitions: list[tuple[int, int, int]] = field(default_factory=list)
    end: int = 0
    malformed: int = 0


def walk_records(data: Buffer, stop_at: Container[int] = frozenset({0})) -> WalkedRecords:
    """Walk the records of `data` by their lengths, up to an opcode in `stop_at`."""
    result = WalkedRecords(np.empty(0, np.int64))
    parts: list[NDArray[np.int64]] = []
    single: list[int] = []
    size = len(data)
    position = run = 0
    previous = -1
    while position + RECORD.size <= size:
        opcode, length = RECORD.unpack_from(data, position)
        end = position + RECORD.size + length
        if end > size or opcode in stop_at:
            break
        if opcode != MESSAGE:
            if opcode in {SCHEMA, CHANNEL}:
                result.definitions.append((opcode, position + RECORD.size, end))
        elif length < _FIXED:
            result.malformed += 1
        else:
            single.append(position)
            run = run + 1 if length == previous else 0
            previous = length
            if run >= _LONG_RUN:
                more = _run(data, end, length)
                stride = end - position
                parts += (np.array(single), end + stride * np.arange(more))
                single = []
                end += stride * more
                run = 0
        position = end
    result.offsets = np.concatenate([*parts, np.array(single, np.int64)])
    result.end = position
    return result


def _run(data: Buffer, position: int, length: int) -> int:
    """Return the number of consecutive message records of one length from `position` on."""
    stride = RECORD.size + length
    possible = (len(data) - position) // stride
    done, ask = 0, 64
    while done < possible:
        ask = min(4 * ask, possible - done)
        head = np.ndarray(
            (ask,), MESSAGE_HEAD, data, offset=position + done * stride, strides=(stride,)
        )
        same = (head["opcode"] == MESSAGE) & (head["length"] == length)
        if not same.all():
            return done + int(same.argmin())
        done += ask
    return done
