"""Write MCAP files, a chunk at a time.

Schemas and channels come first, then chunks of messages, then the summary. The mcap package encodes
all records but messages, chunks and message indexes, which are many.
"""

from __future__ import annotations

import struct
from functools import partial
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import lz4.frame
import numpy as np
import zstandard
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

from quatprop.base.threads import OrderedThreadPool
from quatprop.readers.containers.mcap_records import (
    CHUNK,
    CHUNK_HEAD,
    INDEX_HEAD,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD,
)
from quatprop.stores.checksum import crc32
from quatprop.writers.atomic import OutputFile
from quatprop.writers.base import MessageWriter, RecordBlock, empty_records, provenance_json
from quatprop.writers.message_encoders import PROFILES, Topic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from mcap.records import McapRecord

    from quatprop.base.arrays import Int64, Records
    from quatprop.stores.compression import Buffer


# Chunks: compressed records, and their message index.
#
# The record of a message has a head of 31 bytes. A chunk of messages of one size is one array that
# is filled a column at a time, and its message index is two columns: the mcap package would need a
# call for each message.


CHUNK_BYTES = 1 << 20
"""Approximate bytes of a chunk before compression."""

INDEX_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])
"""One message in a message index."""

_ID = 1
"""The id of the schema and of the channel."""
_ZSTD_LEVEL = -3
"""Attitudes hardly compress: level 1 would save another 3 % for half again the time."""

COMPRESSIONS: Mapping[str, Callable[[Buffer], Buffer]] = {
    "none": lambda data: data,
    "lz4": lz4.frame.compress,
    "zstd": lambda data: zstandard.ZstdCompressor(_ZSTD_LEVEL).compress(data),
}
"""Compressions of chunks."""


class _Chunk(NamedTuple):
    """A chunk to be written.

    `compression`: a key of :data:`COMPRESSIONS`
    `size`, `crc`: bytes and checksum of the records before compression
    `entries`: the message index of the channel
    """

    compression: str
    size: int
    crc: int
    data: Buffer
    entries: Records


def _chunk_of(compression: str, messages: Records) -> _Chunk:
    """Return a chunk of messages, with the fields of :func:`_empty_messages`."""
    index = np.empty(len(messages), INDEX_ENTRY)
    index["log"] = messages["log"]
    index["offset"] = np.arange(len(messages)) * messages.itemsize
    records = messages.view(np.uint8).data
    packed = COMPRESSIONS[compression](records)
    return _Chunk(compression, len(records), crc32(records), packed, index)


def _empty_messages(size: int) -> Records:
    """Return records of messages of `size` bytes for one chunk, without times and data."""
    head = {name: MESSAGE_HEAD[name].str for name in MESSAGE_HEAD.names or ()}
    rows = empty_records(head, size, CHUNK_BYTES)
    rows["opcode"] = MESSAGE
    rows["length"] = rows.itemsize - RECORD.size
    rows["channel"] = _ID
    return rows


# The file: its records, and the summary of them.


_CRC_BYTES = 4


def _encoded(records: Iterable[McapRecord]) -> bytes:
    """Return the bytes of records, concatenated."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


class McapFile:
    """An MCAP file of one channel being written, whose messages all have one size.

    `stream`: the output stream, from the first byte on; it need not be seekable
    `profile`: ``"ros2"`` or ``""``
    `compression`: a key of :data:`COMPRESSIONS`
    """

    def __init__(self, stream: BinaryIO, profile: str, compression: str) -> None:
        self._stream = stream
        self._size = self._crc = self._count = 0
        self._channel: list[McapRecord] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._pool = OrderedThreadPool(partial(_chunk_of, compression), self._append_chunk)
        self._messages = RecordBlock(_empty_messages, self._pool.submit)
        self._append(MAGIC)
        self._append_record(Header(profile, "quatprop"))

    def declare_channel(self, topic: Topic, metadata: Mapping[str, str] | None = None) -> None:
        """Write the records of the channel, which precede the messages."""
        schema = Schema(
            id=_ID, name=topic.type_name, encoding=topic.schema_encoding, data=topic.schema
        )
        channel = Channel(
            id=_ID,
            topic=topic.name,
            message_encoding=topic.encoding,
            metadata=dict(metadata or {}),
            schema_id=_ID,
        )
        self._channel = [schema, channel]
        for record in self._channel:
            self._append_record(record)

    def write(self, log_ns: Int64, messages: Records) -> None:
        """Append messages, shape ``(N,)``, with their log and publish times, ns, from 1970 on."""
        number = np.arange(self._count, self._count + len(messages), dtype=np.uint64)
        self._messages.write(messages, sequence=number, log=log_ns, publish=log_ns)
        self._count += len(messages)

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Add a metadata record after the messages written so far."""
        self._flush()
        begin = self._size
        self._append_record(Metadata(name=name, metadata=dict(content)))
        self._metadata.append(MetadataIndex(begin, self._size - begin, name))

    def finish(self) -> None:
        """Write buffered messages and the summary; the stream is left open."""
        self._flush()
        self._pool.shutdown()
        self._append_record(DataEnd(self._crc))
        self._append(self._summary(self._size))
        self._append(MAGIC)

    def abort(self) -> None:
        """Drop buffered messages; does nothing after :meth:`finish`."""
        self._pool.shutdown()

    def _flush(self) -> None:
        self._messages.flush()
        self._pool.drain()

    def _append_chunk(self, chunk: _Chunk) -> None:
        """Write a chunk and its message index."""
        name = "" if chunk.compression == "none" else chunk.compression
        tail = name.encode() + struct.pack("<Q", len(chunk.data))
        length = CHUNK_HEAD.size + len(tail) + len(chunk.data)
        first, last = int(chunk.entries["log"].min()), int(chunk.entries["log"].max())
        begin = self._size
        self._append(
            RECORD.pack(CHUNK, length)
            + CHUNK_HEAD.pack(first, last, chunk.size, chunk.crc, len(name))
            + tail
        )
        self._append(chunk.data)
        end, size = self._size, chunk.entries.nbytes
        self._append(INDEX_HEAD.pack(MESSAGE_INDEX, 6 + size, _ID, size))
        self._append(chunk.entries.tobytes())
        self._chunks.append(
            ChunkIndex(
                message_start_time=first,
                message_end_time=last,
                chunk_start_offset=begin,
                chunk_length=end - begin,
                message_index_offsets={_ID: end},
                message_index_length=self._size - end,
                compression=name,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.size,
            )
        )

    def _summary(self, start: int) -> bytes:
        """Return the summary section and the footer."""
        schema, channel = self._channel
        statistics = Statistics(
            attachment_count=0,
            channel_count=1,
            channel_message_counts={_ID: self._count} if self._count else {},
            chunk_count=len(self._chunks),
            message_count=self._count,
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=1,
        )
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, [schema]),
            (Opcode.CHANNEL, [channel]),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        parts: list[bytes] = []
        offsets: list[McapRecord] = []
        place = start
        for opcode, records in groups:
            if records:
                parts.append(_encoded(records))
                offsets.append(SummaryOffset(opcode, place, len(parts[-1])))
                place += len(parts[-1])
        # The CRC covers the section, and the footer up to the CRC.
        section = b"".join([*parts, _encoded(offsets)])
        footer = _encoded([Footer(start, place, 0)])
        crc = crc32(footer[:-_CRC_BYTES], crc32(section))
        return section + footer[:-_CRC_BYTES] + crc.to_bytes(_CRC_BYTES, "little")

    def _append_record(self, record: McapRecord) -> None:
        self._append(_encoded([record]))

    def _append(self, data: Buffer) -> None:
        """Write complete records."""
        self._stream.write(data)
        self._crc = crc32(data, self._crc)
        self._size += len(data)


METADATA = "quatprop"
"""Name of the metadata record with a topic's provenance; keys are ``provenance``, which is
JSON, and ``topic``."""


class McapWriter(MessageWriter):
    """Write messages to an MCAP file.

    `compression`: compression of chunks: ``"zstd"``, ``"lz4"`` or ``"none"``
    """

    _output: OutputFile

    def __init__(self, target: Path | str, topic: Topic, compression: str) -> None:
        self._topic = topic.name
        super().__init__(OutputFile(target))
        with self._opening():
            profile = PROFILES.get(topic.encoding, "")
            self._file = McapFile(self._output.stream, profile, compression)
            self._file.declare_channel(topic)

    def _write(self, log_ns: Int64, messages: Records) -> None:
        self._file.write(log_ns, messages)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        if provenance:
            record = {"provenance": provenance_json(provenance), "topic": self._topic}
            self._file.add_metadata(METADATA, record)
        self._file.finish()

    def abort(self) -> None:
        """Discard uncommitted output."""
        self._file.abort()
        super().abort()
