"""MCAP files written by the chunk.

First come schemas and channels, then chunks of messages, then what is needed to find them. The few
records that are not messages are those of the mcap package.
"""

from __future__ import annotations

import struct
from functools import partial
from typing import TYPE_CHECKING

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, DataEnd, Header, Metadata, MetadataIndex, Schema

from quatprop.checksum import crc32
from quatprop.writers.mcap.channel import CHUNK_BYTES, ENTRY_BYTES, MessageChannel, packed
from quatprop.writers.mcap.contents import Contents, encoded
from quatprop.writers.ordered_threads import OrderedThreadPool

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Mapping
    from typing import BinaryIO

    from mcap.records import McapRecord

    from quatprop.writers.mcap.channel import Chunk

MAGIC = b"\x89MCAP0\r\n"
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_INDEX_HEAD = struct.Struct("<BQHI")
_RECORD_HEAD_BYTES = 9


class McapFile:
    """An MCAP file being written.

    Schemas and channels stand ahead of the chunks; a chunk holds the messages of one channel.

    Parameters
    ----------
    stream
        Where the file goes, from its first byte; it need not be seekable.
    header
        What the file begins with; or only its profile, ``"ros2"`` or nothing.
    compression
        A key of :data:`COMPRESSIONS`.
    contents
        Schemas and channels that the file has besides those that are added, so that ids do not
        clash; who knows them writes them with :meth:`put`, ahead of what is added.
    before
        Called with the first log time of a chunk, ns, before it is written: what else the file
        holds has its place there.
    chunk_bytes
        About how large a chunk is before it is compressed.

    Attributes
    ----------
    contents
        What the file holds so far.
    place
        Bytes written so far.
    """

    def __init__(  # noqa: PLR0913  # a file of its own needs the first three
        self,
        stream: BinaryIO,
        header: Header | str,
        compression: str,
        *,
        contents: Contents | None = None,
        before: Callable[[int], None] = lambda _first_ns: None,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        self._stream = stream
        self._compression = compression
        self._before = before
        self._chunk_bytes = chunk_bytes
        self._channels: list[MessageChannel] = []
        self._works = OrderedThreadPool(partial(packed, compression), self._put_chunk)
        self.contents = Contents() if contents is None else contents
        self.place = 0
        self._crc = 0
        self.put(MAGIC)
        self._put_record(Header(header, "quatprop") if isinstance(header, str) else header)

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a type of messages and return its id: that of the same one if there is one."""
        told = (name, encoding, data)
        for known in self.contents.schemas.values():
            if (known.name, known.encoding, known.data) == told:
                return int(known.id)
        schema = Schema(id=_free(self.contents.schemas), name=name, encoding=encoding, data=data)
        self._put_record(schema)
        self.contents.schemas[schema.id] = schema
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
            id=_free(self.contents.channels),
            topic=topic,
            message_encoding=encoding,
            metadata=dict(metadata or {}),
            schema_id=schema,
        )
        self._put_record(record)
        self.contents.channels[record.id] = record
        channel = MessageChannel(self._works.give, record.id, self._chunk_bytes)
        self._channels.append(channel)
        return channel

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Add words that tell about the file as a whole, after the messages written so far."""
        self.flush()
        begin = self.place
        self._put_record(Metadata(name=name, metadata=dict(content)))
        self.contents.metadata.append(MetadataIndex(begin, self.place - begin, name))

    def finish(self) -> None:
        """Write what is still held, the summary and the end; the stream is left open."""
        self.flush()
        self._works.stop()
        self._put_record(DataEnd(self._crc))
        self.put(self.contents.summary(self.place))
        self.put(MAGIC)

    def abort(self) -> None:
        """Let go of what is held; harmless after the end."""
        self._works.stop()

    def flush(self) -> None:
        """Write everything that is still held."""
        for channel in self._channels:
            channel.flush()
        self._works.finish()

    def _put_chunk(self, chunk: Chunk) -> None:
        """Write a chunk and its message index, after what is earlier."""
        self._before(chunk.first)
        named = "" if self._compression == "none" else self._compression
        tail = struct.pack("<I", len(named)) + named.encode() + struct.pack("<Q", len(chunk.packed))
        length = _CHUNK_HEAD.size - _RECORD_HEAD_BYTES + len(tail) + len(chunk.packed)
        head = _CHUNK_HEAD.pack(
            Opcode.CHUNK, length, chunk.first, chunk.last, chunk.size, chunk.crc
        )
        begin = self.place
        self.put(head + tail)
        self.put(chunk.packed)
        end = self.place
        entries = len(chunk.index)
        self.put(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + entries, chunk.channel, entries))
        self.put(chunk.index)
        self.contents.chunks.append(
            ChunkIndex(
                message_start_time=chunk.first,
                message_end_time=chunk.last,
                chunk_start_offset=begin,
                chunk_length=end - begin,
                message_index_offsets={chunk.channel: end},
                message_index_length=self.place - end,
                compression=named,
                compressed_size=len(chunk.packed),
                uncompressed_size=chunk.size,
            )
        )
        self.contents.counts[chunk.channel] += entries // ENTRY_BYTES

    def put(self, data: bytes) -> None:
        """Write whole records as they are."""
        self._stream.write(data)
        self._crc = crc32(data, self._crc)
        self.place += len(data)

    def _put_record(self, record: McapRecord) -> None:
        self.put(encoded([record]))


def _free(ids: Container[int]) -> int:
    """Return the first id that is not taken; 0 means none."""
    return next(id_ for id_ in range(1, 1 << 16) if id_ not in ids)
