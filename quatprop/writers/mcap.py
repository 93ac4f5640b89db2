"""Write MCAP files, a chunk at a time.

Schemas and channels come first, then chunks of messages, then the summary. The mcap package encodes
all records but messages, chunks and message indexes, which are many.
"""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, BinaryIO

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
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
from quatprop.stores.checksum import crc32
from quatprop.writers.atomic import OutputFile
from quatprop.writers.base import MessageWriter, RecordBlock, empty_records, provenance_json
from quatprop.writers.message_encoders import PROFILES, Topic

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Iterator, Mapping
    from pathlib import Path

    from mcap.records import McapRecord

    from quatprop.base.arrays import Int64, Records
    from quatprop.stores.compression import Buffer


# Chunks of MCAP files: compressed records, and the message index of each channel.
#
# The record of a message has a head of 31 bytes. A chunk of messages of one size is one array that
# is filled a column at a time, and its message index is two columns: the mcap package would need a
# call for each message.


CHUNK_BYTES = 1 << 20
"""Approximate bytes of a chunk before compression."""

INDEX_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])
"""One message in a message index."""

_RECORD_HEAD_BYTES = 9
_ZSTD_LEVEL = -3
"""Attitudes hardly compress: level 1 would save another 3 % for half again the time."""

COMPRESSIONS: Mapping[str, Callable[[Buffer], Buffer]] = {
    "none": lambda data: data,
    "lz4": lz4.frame.compress,
    "zstd": lambda data: zstandard.ZstdCompressor(_ZSTD_LEVEL).compress(data),
}
"""Compressions of chunks."""


@dataclass(frozen=True, slots=True)
class McapChunk:
    """A chunk to be written.

    `compression`: a key of :data:`COMPRESSIONS`
    `first`, `last`: earliest and latest log time, ns
    `size`, `crc`: bytes and checksum of the records before compression
    `indexes`: the message index of each channel, by id
    """

    compression: str
    first: int
    last: int
    size: int
    crc: int
    data: Buffer
    indexes: Mapping[int, Records]


def compressed_chunk(
    compression: str, records: Buffer, indexes: Mapping[int, Records]
) -> McapChunk:
    """Return a chunk of records."""
    return McapChunk(
        compression=compression,
        first=min(int(index["log"].min()) for index in indexes.values()),
        last=max(int(index["log"].max()) for index in indexes.values()),
        size=len(records),
        crc=crc32(records),
        data=COMPRESSIONS[compression](records),
        indexes=indexes,
    )


def chunk_of_messages(compression: str, messages: Records) -> McapChunk:
    """Return a chunk of messages of one channel, with the fields of :func:`empty_messages`."""
    index = np.empty(len(messages), INDEX_ENTRY)
    index["log"] = messages["log"]
    index["offset"] = np.arange(len(messages)) * messages.itemsize
    records = messages.view(np.uint8).data
    return compressed_chunk(compression, records, {int(messages["channel"][0]): index})


def empty_messages(channel: int, chunk_bytes: int, size: int) -> Records:
    """Return records of messages of `size` bytes for one chunk, without times and data."""
    head = {
        "opcode": "u1",
        "length": "<u8",
        "channel": "<u2",
        "sequence": "<u4",
        "log": "<u8",
        "publish": "<u8",
    }
    rows = empty_records(head, size, chunk_bytes)
    rows["opcode"] = Opcode.MESSAGE
    rows["length"] = rows.itemsize - _RECORD_HEAD_BYTES
    rows["channel"] = channel
    return rows


# The contents of an MCAP file being written, and their summary section.


_CRC_BYTES = 4


@dataclass(slots=True)
class McapContents:
    """The records that the summary of a file lists."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)

    def summary(self, start: int) -> bytes:
        """Return the summary section and the footer."""
        parts: list[bytes] = []
        offsets: list[McapRecord] = []
        place = start
        for opcode, records in self._groups():
            data = encoded(records)
            if data:
                parts.append(data)
                offsets.append(SummaryOffset(opcode, place, len(data)))
                place += len(data)
        # The CRC covers the section, and the footer up to the CRC.
        section = b"".join([*parts, encoded(offsets)])
        footer = encoded([Footer(start, place, 0)])
        crc = crc32(footer[:-_CRC_BYTES], crc32(section))
        return section + footer[:-_CRC_BYTES] + crc.to_bytes(_CRC_BYTES, "little")

    def _groups(self) -> Iterator[tuple[Opcode, Iterable[McapRecord]]]:
        yield Opcode.SCHEMA, self.schemas.values()
        yield Opcode.CHANNEL, self.channels.values()
        yield Opcode.STATISTICS, [self._statistics()]
        yield Opcode.CHUNK_INDEX, self.chunks
        yield Opcode.ATTACHMENT_INDEX, self.attachments
        yield Opcode.METADATA_INDEX, self.metadata

    def _statistics(self) -> Statistics:
        # The times of a chunk without messages are zero and meaningless.
        filled = [chunk for chunk in self.chunks if chunk.message_index_offsets]
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts={k: self.counts[k] for k in sorted(self.counts)},
            chunk_count=len(self.chunks),
            message_count=self.counts.total(),
            message_start_time=min((chunk.message_start_time for chunk in filled), default=0),
            message_end_time=max((chunk.message_end_time for chunk in filled), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )


def encoded(records: Iterable[McapRecord]) -> bytes:
    """Return the bytes of records, concatenated."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


MAGIC = b"\x89MCAP0\r\n"
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_INDEX_HEAD = struct.Struct("<BQHI")


class McapFile:
    """An MCAP file being written.

    Schemas and channels precede their chunks. The messages of a channel all have one size.

    `stream`: the output stream, from the first byte on; it need not be seekable
    `header`: the header record, or only its profile, ``"ros2"`` or ``""``
    `compression`: a key of :data:`COMPRESSIONS`
    `contents`: schemas and channels that the caller writes with :meth:`append`, whose ids are not
        used for others
    `before`: called with the first log time of a chunk, ns, before it is written, so that the
        caller can append earlier messages
    `chunk_bytes`: approximate bytes of a chunk before compression
    `contents`: the contents of the file so far
    `size`: bytes written so far
    """

    def __init__(  # noqa: PLR0913  # a new file needs the first three only
        self,
        stream: BinaryIO,
        header: Header | str,
        compression: str,
        *,
        contents: McapContents | None = None,
        before: Callable[[int], None] = lambda _first_ns: None,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        self._stream = stream
        self._before = before
        self._chunk_bytes = chunk_bytes
        self._written = 0
        self._channels: list[RecordBlock] = []
        self._pool = OrderedThreadPool(partial(chunk_of_messages, compression), self._append_own)
        self.contents = McapContents() if contents is None else contents
        self.size = 0
        self._crc = 0
        self.append(MAGIC)
        self._append_record(Header(header, "quatprop") if isinstance(header, str) else header)

    def add_channel(self, topic: Topic, metadata: Mapping[str, str] | None = None) -> None:
        """Declare a channel to which messages are written."""
        record = Channel(
            id=_free_id(self.contents.channels),
            topic=topic.name,
            message_encoding=topic.encoding,
            metadata=dict(metadata or {}),
            schema_id=self._schema_id(topic),
        )
        self._append_record(record)
        self.contents.channels[record.id] = record
        empty = partial(empty_messages, record.id, self._chunk_bytes)
        self._channels.append(RecordBlock(empty, self._pool.submit))

    def write(self, log_ns: Int64, messages: Records, channel: int = 0) -> None:
        """Append messages, shape ``(N,)``, with their log and publish times, ns, from 1970 on.

        `channel`: index of their channel, in order of declaration
        """
        number = np.arange(self._written, self._written + len(messages), dtype=np.uint64)
        self._channels[channel].write(messages, sequence=number, log=log_ns, publish=log_ns)
        self._written += len(messages)

    def _schema_id(self, topic: Topic) -> int:
        """Return the id of a topic's definition, which is declared if it is new."""
        wanted = topic.type_name, topic.schema_encoding, topic.schema
        for schema in self.contents.schemas.values():
            if (schema.name, schema.encoding, schema.data) == wanted:
                return int(schema.id)
        schema = Schema(
            id=_free_id(self.contents.schemas),
            name=topic.type_name,
            encoding=topic.schema_encoding,
            data=topic.schema,
        )
        self._append_record(schema)
        self.contents.schemas[schema.id] = schema
        return schema.id

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Add a metadata record after the messages written so far."""
        self.flush()
        begin = self.size
        self._append_record(Metadata(name=name, metadata=dict(content)))
        self.contents.metadata.append(MetadataIndex(begin, self.size - begin, name))

    def finish(self) -> None:
        """Write buffered messages and the summary; the stream is left open."""
        self.flush()
        self._pool.shutdown()
        self._append_record(DataEnd(self._crc))
        self.append(self.contents.summary(self.size))
        self.append(MAGIC)

    def abort(self) -> None:
        """Drop buffered messages; does nothing after :meth:`finish`."""
        self._pool.shutdown()

    def flush(self) -> None:
        """Write buffered messages."""
        for channel in self._channels:
            channel.flush()
        self._pool.drain()

    def _append_own(self, chunk: McapChunk) -> None:
        """Write a chunk of an added channel, after the caller's earlier messages."""
        self._before(chunk.first)
        self.append_chunk(chunk)

    def append_chunk(self, chunk: McapChunk) -> None:
        """Write a chunk and its message indexes."""
        name = "" if chunk.compression == "none" else chunk.compression
        tail = struct.pack("<I", len(name)) + name.encode() + struct.pack("<Q", len(chunk.data))
        length = _CHUNK_HEAD.size - _RECORD_HEAD_BYTES + len(tail) + len(chunk.data)
        head = _CHUNK_HEAD.pack(
            Opcode.CHUNK, length, chunk.first, chunk.last, chunk.size, chunk.crc
        )
        begin = self.size
        self.append(head + tail)
        self.append(chunk.data)
        end = self.size
        offsets = self.append_indexes(chunk.indexes)
        self.contents.chunks.append(
            ChunkIndex(
                message_start_time=chunk.first,
                message_end_time=chunk.last,
                chunk_start_offset=begin,
                chunk_length=end - begin,
                message_index_offsets=offsets,
                message_index_length=self.size - end,
                compression=name,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.size,
            )
        )

    def append_indexes(self, indexes: Mapping[int, Records]) -> dict[int, int]:
        """Write the message indexes of a chunk; return the offset of each by channel id."""
        offsets = {}
        for id_, index in indexes.items():
            offsets[id_] = self.size
            size = index.nbytes
            self.append(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, id_, size))
            self.append(index.tobytes())
            self.contents.counts[id_] += len(index)
        return offsets

    def append(self, data: Buffer) -> None:
        """Write complete records unchanged."""
        self._stream.write(data)
        self._crc = crc32(data, self._crc)
        self.size += len(data)

    def _append_record(self, record: McapRecord) -> None:
        self.append(encoded([record]))


def _free_id(ids: Container[int]) -> int:
    """Return the lowest unused id; 0 is not an id."""
    return next(id_ for id_ in range(1, 1 << 16) if id_ not in ids)


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
            self._file.add_channel(topic)

    def _write(self, log_ns: Int64, messages: Records) -> None:
        self._file.write(log_ns, messages)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        finish_with_provenance(self._file, self._topic, provenance)

    def abort(self) -> None:
        """Discard uncommitted output."""
        self._file.abort()
        super().abort()


def finish_with_provenance(file: McapFile, topic: str, provenance: Mapping[str, object]) -> None:
    """Finish an MCAP file with the provenance of a topic, if there is any."""
    if provenance:
        record = {"provenance": provenance_json(provenance), "topic": topic}
        file.add_metadata(METADATA, record)
    file.finish()
