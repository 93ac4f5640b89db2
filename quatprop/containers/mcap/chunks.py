"""The chunks of an MCAP file; a run of messages outside chunks is taken for one.

References
----------
The MCAP format specification: every record is an opcode (1 byte), a length (8 bytes) and as many
bytes of content, all little-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, NamedTuple

from quatprop.errors import os_reason
from quatprop.stores.byte_ranges import LARGE
from quatprop.stores.checksum import crc32
from quatprop.stores.compression import MAX_SIZE, UnreadableDataError, decompress, decompress_prefix
from quatprop.stores.limits import CHECKSUMS, DecompressionBudget, checksums_matter

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.stores.compression import Buffer
    from quatprop.stores.file_source import FileSource

HEADER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 3, 4, 5, 6, 7
ATTACHMENT, METADATA, DATA_END = 9, 12, 15
"""Opcodes."""
_COMPRESSIONS = frozenset({"", "lz4", "zstd"})
RECORD = struct.Struct("<BQ")
"""Opcode and length of the content: how every record begins."""
CHUNK_HEAD = struct.Struct("<QQQII")
"""Start time, end time, unpacked size, CRC, length of the compression's name."""
PEEK = 128
"""Bytes that hold the head of any record that is looked into."""
_UNCOMPRESSED_HEAD = RECORD.size + CHUNK_HEAD.size + 8
"""Bytes of a chunk record before records that are not compressed."""
_AT_ONCE = 1 << 26
"""Bytes of a chunk that are read together with its head at most."""

INDEX_HEAD = struct.Struct("<BQHI")
"""Opcode, length, channel and size of the entries of a message index."""
INDEX_ENTRY = 16
"""Bytes of one entry of a message index: log time and offset."""


@dataclass(slots=True)
class Chunk:
    """A chunk, or a run of messages outside chunks.

    `start`, `length`: the chunk record, or the messages, in the file, bytes
    `first_ns`, `last_ns`: its earliest and latest log time, ns; the latest is None if no index
        states it
    `index_length`: bytes of message index that follow it
    `message_index_offsets`: where in the file the message index of each channel is, by channel id;
        0 where it has none. None if it is unknown which channels the chunk has
    `counts`: number of messages of each channel, by channel id, where they were counted
    `id_offset`: what is added to its channel ids to tell them from those defined elsewhere in the
        file
    `size`: bytes of its decompressed records by the index
    `head_last_ns`: its latest log time by its head, ns, where no index states it; 0 if unknown. The
        head has no checksum, so no chunk is skipped because of this time
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
        """Where the next record begins in the file."""
        return self.start + self.length + self.index_length

    @property
    def can_be_read_in_part(self) -> bool:
        """Whether it is large, and its messages are indexed and in the file as they are."""
        is_uncompressed = self.is_chunk and self.size == self.length - _UNCOMPRESSED_HEAD
        return is_uncompressed and self.length >= LARGE and self.index_length > 0

    @property
    def place(self) -> str:
        """Where it is, for a sentence."""
        return f"{'chunk' if self.is_chunk else 'messages'} at byte {self.start}"

    @property
    def ids(self) -> list[int]:
        """Ids in the index of the channels that it holds, if known."""
        return [self.id_offset + id_ for id_ in self.message_index_offsets or ()]

    def may_have_logged(self, log_ns: NDArray[np.int64]) -> bool:
        """Return whether log times are in the range that it states; True if it states none."""
        last_ns = self.last_ns or self.head_last_ns
        if not last_ns or not len(log_ns):
            return True
        return bool(self.first_ns <= log_ns.min() and log_ns.max() <= last_ns)

    def local_ids(self, ids: Sequence[int]) -> list[int]:
        """Return the ids in its own records of channels of the index."""
        own = (id_ - self.id_offset for id_ in ids)
        return [id_ for id_ in own if 0 <= id_ < 1 << 16]

    def listed(self) -> dict[int, int] | None:
        """Return how many messages of each channel it holds; None if that is unknown."""
        if self.counts is not None or self.message_index_offsets is None:
            return self.counts
        order = sorted(self.message_index_offsets.items(), key=itemgetter(1))
        # Where the next index begins shows how many entries one has.
        ends = [*(place for _, place in order[1:]), self.end]
        return {
            id_: max(0, end - place - INDEX_HEAD.size) // INDEX_ENTRY
            for (id_, place), end in zip(order, ends, strict=True)
        }

    def count(self, channel: int) -> int | None:
        """Return how many messages of a channel it holds; None if that is unknown."""
        listed = self.listed()
        return None if listed is None else listed.get(channel, 0)


class Loaded(NamedTuple):
    """A chunk that was read.

    `data`: its decompressed records, as far as they could be read
    `damage`: why they end early, or ``""``
    `has_checksum`: whether a checksum shows that it is as it was written
    `is_readable`: whether anything of it can be read
    `offsets`: where the wanted messages begin in `data`, which has little else; None if it is
        whole
    """

    data: Buffer = b""
    damage: str = ""
    has_checksum: bool = False
    is_readable: bool = True
    offsets: NDArray[np.int64] | None = None


TORN = "the file ends inside it"
"""The damage of a record that the recorder was writing when it died."""


def load(
    source: FileSource, chunk: Chunk, budget: DecompressionBudget, *, check: bool = True
) -> Loaded:
    """Read a chunk and decompress it; `check` refuses a chunk whose checksum is wrong."""
    try:
        return _load(source, chunk, budget, check=check)
    except OSError as error:
        raise UnreadableDataError(os_reason(error)) from error


def _load(source: FileSource, chunk: Chunk, budget: DecompressionBudget, *, check: bool) -> Loaded:
    if not chunk.is_chunk:
        loose = source.read(chunk.start, chunk.length)
        return Loaded(loose, TORN if len(loose) < chunk.length else "")
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
        if len(data) < head.size or not head.crc:
            return Loaded(data, TORN)
    else:
        data = decompress(content, head.compression, head.size or None)
    budget.spend(len(data) if head.compression else 0)
    if check and head.crc and crc32(data) != head.crc and checksums_matter():
        raise UnreadableDataError(
            f"its checksum is wrong, so it is not what was recorded; with {CHECKSUMS}=ignore "
            "it is read anyway"
        )
    return Loaded(data, has_checksum=head.crc != 0)


class ChunkHead(NamedTuple):
    """The fields of a chunk before its data.

    `first_ns`, `last_ns`: earliest and latest log time, ns, without sign
    `size`: bytes of the decompressed data
    `crc`: checksum of the decompressed data; 0 if there is none
    `begin`, `end`: where the compressed data is, from the beginning of the record
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
        """Whether the records are in the file as they are."""
        return not self.compression and self.size == self.end - self.begin


def head_of(source: FileSource, chunk: Chunk) -> ChunkHead | None:
    """Return the head of a chunk; None if none of its length begins."""
    return chunk_head(source.read(chunk.start, PEEK), chunk.length)


def chunk_head(record: Buffer, length: int) -> ChunkHead | None:
    """Return the head of a chunk record."""
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
    is_stated = RECORD.unpack_from(record) == (CHUNK, length - RECORD.size)
    if not is_stated and (end != length or compression not in _COMPRESSIONS):
        return None
    return ChunkHead(first, last, size, crc, compression, begin, end)


def plausible_chunk(head: bytes, length: int) -> bool:
    """Tell whether a chunk's content has consistent lengths, in all `length`; it may be torn."""
    stated = chunk_head(head, RECORD.size + length)
    return (
        stated is not None
        and stated.end == RECORD.size + length
        and stated.compression in _COMPRESSIONS
        and stated.size <= MAX_SIZE
        and (stated.compression != "" or stated.size == stated.end - stated.begin)
    )
