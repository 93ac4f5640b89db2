"""Footer and summary section of an MCAP file, and the metadata records listed in it."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from quatprop.containers.mcap.chunks import CHANNEL, DATA_END, METADATA, RECORD, SCHEMA, Chunk
from quatprop.containers.mcap.records import (
    MALFORMED,
    prefixed,
    read_channel,
    read_metadata,
    read_schema,
)
from quatprop.provenance import METADATA_KEY
from quatprop.stores.checksum import crc32
from quatprop.stores.compression import MAX_SIZE
from quatprop.tables.log import Losses
from quatprop.times import LATEST

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.containers.mcap.records import ChannelRecord, SchemaRecord
    from quatprop.stores.compression import Buffer
    from quatprop.stores.file_source import FileSource

MAGIC = b"\x89MCAP0\r\n"
"""The first and the last bytes of every MCAP file."""
_FOOTER, _CHUNK_INDEX, _ATTACHMENT_INDEX, _STATISTICS, _METADATA_INDEX = 2, 8, 10, 11, 13
_LARGEST_METADATA = 1 << 24
_FOOTER_FIELDS = struct.Struct("<QQI")
_TAIL = RECORD.size + _FOOTER_FIELDS.size + len(MAGIC)
_CHUNK_INDEX_HEAD = struct.Struct("<QQQQI")
_STATISTICS_HEAD = struct.Struct("<QHIIIIQQ")
_LONGEST_DATA_END = 64
_PLACE = struct.Struct("<QQ")
"""Offset and length of a record."""


@dataclass(slots=True)
class McapIndex:
    """The index of a file.

    `chunks`: its chunks, in the order of the file
    `channels`, `schemas`: the records by their ids
    `counts`: number of messages by channel id; None if the file does not state them
    `metadata`: offsets of the metadata records with provenance, by the summary
    """

    chunks: list[Chunk] = field(default_factory=list)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    schemas: dict[int, SchemaRecord] = field(default_factory=dict)
    counts: dict[int, int] | None = None
    metadata: list[int] = field(default_factory=list)
    losses: Losses = field(default_factory=Losses)

    def define(self, opcode: int, content: Buffer, place: str, id_offset: int = 0) -> None:
        """Add a schema or channel record, unless its id is defined already."""
        try:
            if opcode == SCHEMA:
                schema = read_schema(content)
                id_ = schema.id + id_offset
                self.schemas.setdefault(id_, schema._replace(id=id_))
            else:
                channel = read_channel(content)
                id_, schema_id = channel.id + id_offset, channel.schema_id
                schema_id += id_offset if schema_id else 0
                self.channels.setdefault(id_, channel._replace(id=id_, schema_id=schema_id))
        except MALFORMED:
            what = "schema" if opcode == SCHEMA else "channel"
            self.losses.note(f"{what} {place}", "it is damaged")

    def defines(self, ids: Iterable[int]) -> bool:
        """Return whether some channels and their schemas are defined."""
        channels = map(self.channels.get, ids)
        return all(c and (not c.schema_id or c.schema_id in self.schemas) for c in channels)


class Footer(NamedTuple):
    """Offsets of the end of the data, the summary (0 if none) and the footer; summary CRC."""

    data_end: int
    summary_start: int
    footer_start: int
    crc: int


def read_footer(source: FileSource) -> Footer | None:
    """Return the footer; None if the file does not end with one."""
    start = source.size - _TAIL
    tail = source.read(start, _TAIL) if start >= len(MAGIC) else b""
    if not tail.endswith(MAGIC) or RECORD.unpack_from(tail) != (_FOOTER, _FOOTER_FIELDS.size):
        return None
    summary_start, _, crc = _FOOTER_FIELDS.unpack_from(tail, RECORD.size)
    if not len(MAGIC) <= summary_start <= start or not _ends_data(source, summary_start):
        summary_start = 0
    return Footer(summary_start or start, summary_start, start, crc)


def _ends_data(source: FileSource, place: int) -> bool:
    """Return whether a data end record, which precedes any summary, ends at an offset."""
    begin = max(0, place - _LONGEST_DATA_END)
    tail = source.read(begin, place - begin)
    # Later versions of the format may add fields to the record.
    return any(
        RECORD.unpack_from(tail, at) == (DATA_END, len(tail) - at - RECORD.size)
        for at in reversed(range(len(tail) - RECORD.size - 3))
    )


@dataclass(slots=True)
class Summary:
    """The content of the summary section.

    `index`: channels, schemas, counts and metadata records
    `attachments`: length of each attachment by offset, bytes
    `channel_count`: number of channels by the statistics; None without statistics
    """

    index: McapIndex = field(default_factory=McapIndex)
    chunks: dict[int, Chunk] = field(default_factory=dict)
    attachments: dict[int, int] = field(default_factory=dict)
    channel_count: int | None = None
    is_complete: bool = False

    def __bool__(self) -> bool:
        return bool(self.index.channels or self.chunks)

    def add(self, opcode: int, content: memoryview, footer: Footer) -> None:
        """Add a record of the summary."""
        if opcode in {SCHEMA, CHANNEL}:
            self.index.define(opcode, content, "in the summary")
        elif opcode == _CHUNK_INDEX:
            chunk = _indexed_chunk(content, is_checked=footer.crc != 0)
            if len(MAGIC) <= chunk.start and chunk.end <= footer.data_end:
                self.chunks[chunk.start] = chunk
        elif opcode == _ATTACHMENT_INDEX:
            offset, length = _PLACE.unpack_from(content)
            self.attachments[offset] = length
        elif opcode == _STATISTICS:
            message_count, _, self.channel_count, *_ = _STATISTICS_HEAD.unpack_from(content)
            (counts,) = prefixed(content, _STATISTICS_HEAD.size, 1)
            by_channel = dict(struct.iter_unpack("<HQ", counts))
            if sum(by_channel.values()) == message_count:
                self.index.counts = by_channel
        elif opcode == _METADATA_INDEX:
            offset, _ = _PLACE.unpack_from(content)
            if prefixed(content, _PLACE.size, 1) == [METADATA_KEY]:
                self.index.metadata.append(offset)


def read_summary(source: FileSource, footer: Footer) -> Summary:
    """Return the summary; an empty one if there is none or it is damaged."""
    size = footer.footer_start - footer.summary_start
    if footer.summary_start == 0 or size > MAX_SIZE:
        return Summary()
    # The CRC covers the footer up to itself.
    data = source.read(footer.summary_start, size + RECORD.size + _FOOTER_FIELDS.size - 4)
    if footer.crc not in {0, crc32(data)}:
        return Summary()
    summary = Summary()
    try:
        for opcode, content in _records(memoryview(data)[:size]):
            summary.add(opcode, content, footer)
    except MALFORMED:
        return Summary()
    channels = len(summary.index.channels)
    is_whole = channels > 0 if summary.channel_count is None else channels == summary.channel_count
    summary.is_complete = is_whole and not summary.index.losses
    return summary


def _records(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the opcode and content of each record of the summary."""
    position = 0
    while position < len(data):
        opcode, length = RECORD.unpack_from(data, position)
        position += RECORD.size
        if length > len(data) - position:
            raise ValueError
        yield opcode, data[position : position + length]
        position += length


def _indexed_chunk(content: memoryview, *, is_checked: bool) -> Chunk:
    """Return the chunk that a chunk index record describes.

    Its latest time is used to skip it only if a checksum was verified.
    """
    first, last, start, length, map_size = _CHUNK_INDEX_HEAD.unpack_from(content)
    begin = _CHUNK_INDEX_HEAD.size
    offsets = dict(struct.iter_unpack("<HQ", content[begin : begin + map_size]))
    index_length, name_length = struct.unpack_from("<QI", content, begin + map_size)
    _, size = struct.unpack_from("<QQ", content, begin + map_size + 12 + name_length)
    if length < RECORD.size:
        raise ValueError
    return Chunk(
        *(start, length, True, min(first, LATEST), index_length, offsets or None),
        last_ns=min(last, LATEST) if is_checked else None,
        head_last_ns=min(last, LATEST),
        size=size,
    )


def read_provenance(source: FileSource, offsets: Iterable[int]) -> dict[str, str]:
    """Return the provenance of each topic as JSON; that of all other topics under ``""``."""
    entries = [_metadata_at(source, offset) for offset in offsets]
    return {
        entry.get("topic", ""): entry["provenance"] for entry in entries if "provenance" in entry
    }


def _metadata_at(source: FileSource, offset: int) -> dict[str, str]:
    """Return the entries of a metadata record; empty if it is damaged."""
    head = source.read(offset, RECORD.size)
    if len(head) < RECORD.size:
        return {}
    opcode, length = RECORD.unpack(head)
    if opcode != METADATA or length > _LARGEST_METADATA:
        return {}
    try:
        return read_metadata(source.read(offset + RECORD.size, length))[1]
    except MALFORMED:
        return {}
