"""MCAP files written by the chunk.

First come schemas and channels, then chunks of messages, then what is needed to find them. The few
records that are not messages are those of the mcap package.
"""

from __future__ import annotations

import struct
import zlib
from functools import partial
from typing import TYPE_CHECKING

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from quatprop.writers.in_order import InOrder
from quatprop.writers.mcap_channel import MessageChannel, packed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import BinaryIO

    from mcap.records import McapRecord

    from quatprop.writers.mcap_channel import Chunk

MAGIC = b"\x89MCAP0\r\n"
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_INDEX_HEAD = struct.Struct("<BQHI")
_FOOTER_TO_CRC = struct.Struct("<BQQQ")
_FOOTER_BYTES = 20
_RECORD_HEAD_BYTES = 9


class McapFile:
    """An MCAP file being written.

    Schemas and channels stand ahead of the chunks; a chunk holds the messages of one channel.

    Parameters
    ----------
    stream
        Where the file goes, from its first byte; it need not be seekable.
    profile
        What the file holds: ``"ros2"`` or nothing.
    compression
        A key of :data:`COMPRESSIONS`.
    """

    def __init__(self, stream: BinaryIO, profile: str, compression: str) -> None:
        self._stream = stream
        self._compression = compression
        self._schemas: list[Schema] = []
        self._channels: list[MessageChannel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._works = InOrder(partial(packed, compression), self._put_chunk)
        self._place = 0
        self._crc = 0
        self._put(MAGIC)
        self._put_records(Header(profile, "quatprop"))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a type of messages and return its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._put_records(schema)
        self._schemas.append(schema)
        return schema.id

    def add_channel(
        self,
        topic: str,
        encoding: str,
        schema: int,
        metadata: Mapping[str, str] | None = None,
    ) -> MessageChannel:
        """Declare a channel of messages that all have one size."""
        record = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            metadata=dict(metadata or {}),
            schema_id=schema,
        )
        self._put_records(record)
        channel = MessageChannel(self._works.give, record)
        self._channels.append(channel)
        return channel

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Add words that tell about the file as a whole, after the messages written so far."""
        self._put_chunks()
        begin = self._place
        self._put_records(Metadata(name=name, metadata=dict(content)))
        self._metadata.append(MetadataIndex(begin, self._place - begin, name))

    def finish(self) -> None:
        """Write what is still held, the summary and the end; the stream is left open."""
        self._put_chunks()
        self._works.stop()
        self._put_records(DataEnd(self._crc))
        self._put_summary()
        self._put(MAGIC)

    def abort(self) -> None:
        """Let go of what is held; harmless after the end."""
        self._works.stop()

    def _put_chunks(self) -> None:
        """Write everything that is still held."""
        for channel in self._channels:
            channel.flush()
        self._works.finish()

    def _put_chunk(self, chunk: Chunk) -> None:
        """Write a chunk and its message index."""
        named = "" if self._compression == "none" else self._compression
        tail = struct.pack("<I", len(named)) + named.encode() + struct.pack("<Q", len(chunk.packed))
        length = _CHUNK_HEAD.size - _RECORD_HEAD_BYTES + len(tail) + len(chunk.packed)
        head = _CHUNK_HEAD.pack(
            Opcode.CHUNK, length, chunk.first, chunk.last, chunk.size, chunk.crc
        )
        begin = self._place
        self._put(head + tail)
        self._put(chunk.packed)
        end = self._place
        entries = len(chunk.index)
        self._put(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + entries, chunk.channel, entries))
        self._put(chunk.index)
        self._chunks.append(
            ChunkIndex(
                message_start_time=chunk.first,
                message_end_time=chunk.last,
                chunk_start_offset=begin,
                chunk_length=end - begin,
                message_index_offsets={chunk.channel: end},
                message_index_length=self._place - end,
                compression=named,
                compressed_size=len(chunk.packed),
                uncompressed_size=chunk.size,
            )
        )

    def _put_summary(self) -> None:
        start = self._place
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, [channel.record for channel in self._channels]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        crc, offsets = 0, []
        for opcode, records in groups:
            begin = self._place
            crc = zlib.crc32(self._put_records(*records), crc)
            if records:
                offsets.append(SummaryOffset(opcode, begin, self._place - begin))
        offsets_start = self._place
        crc = zlib.crc32(self._put_records(*offsets), crc)
        footer = _FOOTER_TO_CRC.pack(Opcode.FOOTER, _FOOTER_BYTES, start, offsets_start)
        self._put_records(Footer(start, offsets_start, zlib.crc32(footer, crc)))

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts={c.record.id: c.written for c in self._channels if c.written},
            chunk_count=len(self._chunks),
            message_count=sum(channel.written for channel in self._channels),
            message_start_time=min((c.message_start_time for c in self._chunks), default=0),
            message_end_time=max((c.message_end_time for c in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _put_records(self, *records: McapRecord) -> bytes:
        """Write records and return their bytes."""
        builder = RecordBuilder()
        for record in records:
            record.write(builder)
        data: bytes = builder.end()  # type: ignore[no-untyped-call]
        self._put(data)
        return data

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._crc = zlib.crc32(data, self._crc)
        self._place += len(data)
