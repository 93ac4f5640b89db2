"""The stretches of an MCAP file that hold messages: chunks, and runs of messages outside chunks.

References
----------
The MCAP format specification: every record is an opcode (1 byte), a length (8 bytes) and as many
bytes of content, all little-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from quatprop.checksum import crc32
from quatprop.containers.compression import CompressionError, decompress, front
from quatprop.containers.limits import CHECKSUMS, checksums_matter

if TYPE_CHECKING:
    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.limits import UnpackBudget

SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, DATA_END = 3, 4, 5, 6, 7, 15
"""Opcodes."""
RECORD = struct.Struct("<BQ")
"""Opcode and length of the content: how every record begins."""
CHUNK_HEAD = struct.Struct("<QQQII")
"""Start time, end time, unpacked size, CRC, length of the compression's name."""
PLAIN_HEAD = RECORD.size + CHUNK_HEAD.size + 8
"""Bytes of a chunk record before its records, where it is not compressed."""

PEEK = 128
"""Bytes that are enough for the head of any record that is looked into."""

INDEX_HEAD = struct.Struct("<BQHI")
"""Opcode, length, channel and size of the entries of a message index."""
INDEX_ENTRY = 16
"""Bytes of one entry of a message index: log time and offset."""


@dataclass(slots=True)
class Region:
    """A chunk, or a run of messages outside chunks.

    Parameters
    ----------
    start, length
        The chunk record, or the messages, in the file, bytes.
    is_chunk
        Whether it is a chunk.
    first_ns
        Its earliest log time, ns.
    index_length
        Bytes of message index right after it.
    holds
        Channel id to where its message index is in the file, 0 where there is none. None where it
        is not known which channels the region holds.
    counts
        Channel id to number of messages where they were counted.
    """

    start: int
    length: int
    is_chunk: bool
    first_ns: int
    index_length: int = 0
    holds: dict[int, int] | None = None
    counts: dict[int, int] | None = None

    @property
    def end(self) -> int:
        """Where the next record begins in the file."""
        return self.start + self.length + self.index_length

    @property
    def place(self) -> str:
        """Where it is, for people."""
        return f"{'chunk' if self.is_chunk else 'messages'} at byte {self.start}"

    def count(self, channel: int) -> int | None:
        """Return how many messages of a channel it holds, where that is known."""
        if self.counts is not None:
            return self.counts.get(channel, 0)
        if self.holds is None:
            return None
        if channel not in self.holds:
            return 0
        ends = [at for at in self.holds.values() if at > self.holds[channel]]
        size = min(ends, default=self.end) - self.holds[channel] - INDEX_HEAD.size
        return max(0, size // INDEX_ENTRY)


class RegionError(Exception):
    """A region that cannot be read.

    Parameters
    ----------
    reason
        Why.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def is_plain(source: FileSource, region: Region) -> bool:
    """Tell whether a region is a chunk that is not compressed, and begins where it should."""
    if not region.is_chunk:
        return False
    head = source.read(region.start, PLAIN_HEAD)
    if len(head) < PLAIN_HEAD or RECORD.unpack_from(head) != (CHUNK, region.length - RECORD.size):
        return False
    _, _, size, _, name_length = CHUNK_HEAD.unpack_from(head, RECORD.size)
    return bool(name_length == 0 and size == region.length - PLAIN_HEAD)


class Loaded(NamedTuple):
    """A region that was read.

    Parameters
    ----------
    data
        The unpacked records.
    raw
        The region and its message index as they are in the file.
    damage
        Why `data` end early, or ``""``.
    """

    data: Buffer
    raw: Buffer
    damage: str = ""


TORN = "the file ends inside it"
"""The damage of what a recorder was writing when it died."""


def load(source: FileSource, region: Region, budget: UnpackBudget, *, check: bool = True) -> Loaded:
    """Read a region, its message index with it, and unpack it.

    Parameters
    ----------
    source
        The file.
    region
        Where in it.
    budget
        How much may be unpacked.
    check
        Whether to refuse a chunk whose checksum is wrong.

    Raises
    ------
    RegionError
        The region is damaged.
    """
    try:
        raw = source.read(region.start, region.length + region.index_length)
    except OSError as error:
        raise RegionError(f"it cannot be read: {error.strerror}") from error
    is_torn = len(raw) < region.length
    damage = TORN if is_torn else ""
    if not region.is_chunk:
        return Loaded(raw, raw, damage)
    chunk = chunk_head(raw, region.length)
    if chunk is None:
        raise RegionError("no chunk of the indexed length begins there")
    packed = memoryview(raw)[chunk.begin : chunk.end]
    try:
        budget.check()
        if is_torn:
            return Loaded(front(packed, chunk.compression, chunk.size), raw, damage)
        data = decompress(packed, chunk.compression, chunk.size)
    except CompressionError as error:
        raise RegionError(error.reason) from error
    budget.spend(len(data) if chunk.compression else 0)
    if check and chunk.crc and crc32(data) != chunk.crc and checksums_matter():
        raise RegionError(
            f"its checksum is wrong, so it is not what was recorded; with {CHECKSUMS}=ignore "
            "it is read all the same"
        )
    return Loaded(data, raw)


class ChunkHead(NamedTuple):
    """What a chunk says before its data.

    Parameters
    ----------
    first_ns
        Earliest log time, ns, without sign.
    size
        Bytes unpacked.
    crc
        Checksum of the unpacked data; 0 where there is none.
    compression
        How it is packed.
    begin, end
        Where the packed data are, from the begin of the record.
    """

    first_ns: int
    size: int
    crc: int
    compression: str
    begin: int
    end: int


def chunk_head(record: Buffer, length: int) -> ChunkHead | None:
    """Return the head of a chunk record.

    Parameters
    ----------
    record
        The beginning of the record.
    length
        Bytes of the whole record.

    Returns
    -------
    ChunkHead or None
        None where `record` is too short, no chunk, or its lengths contradict each other.
    """
    fixed = RECORD.size + CHUNK_HEAD.size
    if len(record) < fixed + 8 or RECORD.unpack_from(record) != (CHUNK, length - RECORD.size):
        return None
    first, _, size, crc, name_length = CHUNK_HEAD.unpack_from(record, RECORD.size)
    begin = fixed + name_length + 8
    if begin > len(record):
        return None
    (packed,) = struct.unpack_from("<Q", record, begin - 8)
    if begin + packed > length:
        return None
    compression = bytes(record[fixed : fixed + name_length]).decode(errors="replace")
    return ChunkHead(first, size, crc, compression, begin, begin + packed)
