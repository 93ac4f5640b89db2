"""Copy the records of an MCAP file, unchanged and in their order.

Chunks are decompressed only if their message index is missing and must be rebuilt. Index records
are not copied, since all offsets change.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, Header, MetadataIndex, Schema

from quatprop.containers.mcap.chunks import INDEX_HEAD, PEEK, RECORD, chunk_head, load
from quatprop.containers.mcap.definitions import IDS
from quatprop.containers.mcap.messages import index_entries, messages_at
from quatprop.containers.mcap.records import (
    MALFORMED,
    prefixed,
    read_channel,
    read_metadata,
    read_schema,
)
from quatprop.containers.mcap.summary import MAGIC, read_footer
from quatprop.containers.mcap.walk import walk_records
from quatprop.errors import DamagedLogError, UnreadableLogError, UnsupportedLogError, os_reason
from quatprop.stores.compression import UnreadableDataError
from quatprop.stores.limits import DecompressionBudget
from quatprop.text import Setting
from quatprop.writers.mcap.chunk import INDEX_ENTRY, McapChunk, compressed_chunk
from quatprop.writers.mcap.contents import McapContents

if TYPE_CHECKING:
    from quatprop.arrays import Records
    from quatprop.containers.mcap.chunks import Chunk
    from quatprop.containers.mcap.log import McapLog
    from quatprop.stores.compression import Buffer
    from quatprop.stores.file_source import FileSource
    from quatprop.writers.mcap.file import McapFile

    Indexes = dict[int, Records]

ROSBAG2, SERIALIZED = "rosbag2", "serialized_metadata"
"""Name and key of the metadata record with the metadata of a ROS 2 bag."""

_PIECE = 1 << 20
_NAMES = 1 << 16
"""Maximum bytes of an attachment that are read for its name and type."""

_COPIED = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.METADATA})
"""Records that are copied besides chunks and private records; the others are rewritten."""


class McapCopy:
    """Copies a file incrementally, up to a given time.

    `log`: the file, which stays open until the copy is finished
    `contents`: its schemas and channels, and the records copied so far
    `bag_metadata`: the metadata of a ROS 2 bag, if it has them; not copied, since they change
    """

    def __init__(self, log: McapLog) -> None:
        self._path, self._source, overview = log.path, log.source, log.index
        if any(id_ >= IDS for id_ in overview.channels):
            raise UnsupportedLogError(
                log.path,
                "it defines channel ids more than once, as files that were put one behind another "
                f"do; write the attitudes to a file of their own with {Setting('output')}",
            )
        self._budget = DecompressionBudget(self._source.size)
        try:
            footer = read_footer(self._source)
            self.header = _header(self._source)
        except OSError as error:
            raise UnreadableLogError(log.path, os_reason(error)) from error
        self.contents = McapContents(
            {id_: Schema(**record._asdict()) for id_, record in overview.schemas.items()},
            {id_: Channel(**record._asdict()) for id_, record in overview.channels.items()},
        )
        self._chunks = {chunk.start: chunk for chunk in overview.chunks}
        self._starts = sorted(self._chunks)
        self._position = len(MAGIC)
        self.bag_metadata: str | None = None
        data_end = self._source.size if footer is None else footer.data_end
        # The reader may find messages after the data end record.
        self._end = max([data_end, *(chunk.end for chunk in overview.chunks)])

    def up_to(self, first_ns: int | None, file: McapFile) -> None:
        """Copy the records before the first chunk that begins after `first_ns`, or all if None."""
        while self._position < self._end:
            chunk = self._chunks.get(self._position)
            if chunk is None:
                self._position = self._copy_record(file)
                continue
            if first_ns is not None and chunk.first_ns > first_ns:
                return
            if chunk.is_chunk:
                self._copy_chunk(chunk, file)
            else:
                # Messages outside chunks are put into a chunk.
                data = self._read(chunk.start, chunk.length)
                if indexes := _indexes(data):
                    file.append_chunk(compressed_chunk("none", data, indexes))
            self._position = chunk.end

    def _copy_chunk(self, chunk: Chunk, file: McapFile) -> None:
        """Copy a chunk, and copy or rebuild its message index."""
        if chunk.start + chunk.length > self._source.size:
            return  # the reader of its messages reports the loss
        head = chunk_head(self._read(chunk.start, min(PEEK, chunk.length)), chunk.length)
        if head is None:
            return
        file.append_chunk(
            McapChunk(
                compression=head.compression or "none",
                first=head.first_ns,
                last=head.last_ns,
                size=head.size,
                crc=head.crc,
                data=self._read(chunk.start + head.begin, min(head.end, chunk.length) - head.begin),
                indexes=self._indexes_of(chunk),
            )
        )

    def _indexes_of(self, chunk: Chunk) -> Indexes:
        """Return the message index of a chunk, rebuilt from its messages if it is damaged."""
        index = self._read(chunk.start + chunk.length, chunk.index_length)
        indexes = {
            id_: entries.view(INDEX_ENTRY).reshape(-1)
            for id_, place in (chunk.message_index_offsets or {}).items()
            if (entries := index_entries(index, chunk, place, id_)) is not None
        }
        if 0 < len(index) == sum(INDEX_HEAD.size + each.nbytes for each in indexes.values()):
            return indexes
        try:
            return _indexes(load(self._source, chunk, self._budget).data)
        except UnreadableDataError:
            return {}  # copied unchanged; the reader of its messages reports the loss

    def _copy_record(self, file: McapFile) -> int:
        """Copy the next record, unless it is of a kind that is rewritten; return its end."""
        at = self._position
        head = self._read(at, min(RECORD.size, self._end - at)).ljust(RECORD.size, b"\0")
        opcode, length = RECORD.unpack(head)
        end: int = at + RECORD.size + length
        if opcode in {0, Opcode.DATA_END} or end > self._end:
            after = bisect_right(self._starts, at)
            return self._starts[after] if after < len(self._starts) else self._end
        is_known = opcode <= Opcode.DATA_END
        if not is_known or (
            opcode in _COPIED and self._add_to_contents(opcode, at, length, file.size)
        ):
            self._copy_bytes(at, end - at, file)
        return end

    def _add_to_contents(self, opcode: int, at: int, length: int, place: int) -> bool:
        """Add a record to the contents; return whether it is copied unchanged."""
        size = min(length, _NAMES) if opcode == Opcode.ATTACHMENT else length
        content = self._read(at + RECORD.size, size)
        total = RECORD.size + length
        try:
            if opcode == Opcode.METADATA:
                name, entries = read_metadata(content)
                if name == ROSBAG2 and SERIALIZED in entries:
                    self.bag_metadata = entries[SERIALIZED]
                    return False
                self.contents.metadata.append(MetadataIndex(place, total, name))
            elif opcode == Opcode.ATTACHMENT:
                self.contents.attachments.append(_attachment(content, place, total))
            else:
                (read_schema if opcode == Opcode.SCHEMA else read_channel)(content)
        except MALFORMED:
            return False
        return True

    def _copy_bytes(self, start: int, length: int, file: McapFile) -> None:
        """Copy bytes unchanged."""
        for begin in range(start, start + length, _PIECE):
            file.append(self._read(begin, min(_PIECE, start + length - begin)))

    def _read(self, start: int, length: int) -> bytes:
        try:
            data = self._source.read(start, length)
        except OSError as error:
            raise UnreadableLogError(self._path, os_reason(error)) from error
        if len(data) < length:
            raise DamagedLogError(self._path, "it became shorter while it was read; copy it first")
        return data


def _header(source: FileSource) -> Header:
    """Return the header of a file; empty if it is damaged."""
    opcode, length = RECORD.unpack(source.read(len(MAGIC), RECORD.size).ljust(RECORD.size, b"\0"))
    with suppress(*MALFORMED):
        if opcode == Opcode.HEADER:
            content = source.read(len(MAGIC) + RECORD.size, min(length, _NAMES))
            return Header(*(part.decode() for part in prefixed(content, 0, 2)))
    return Header("", "")


def _attachment(content: bytes, place: int, length: int) -> AttachmentIndex:
    """Return the index record of an attachment from the beginning of its content."""
    log_ns, made_ns = struct.unpack_from("<QQ", content)
    name, kind = prefixed(content, 16, 2)
    (size,) = struct.unpack_from("<Q", content, 24 + len(name) + len(kind))
    return AttachmentIndex(place, length, log_ns, made_ns, size, name.decode(), kind.decode())


def _indexes(data: Buffer) -> Indexes:
    """Return the message index of each channel in some records, in order of log time."""
    messages = messages_at(data, walk_records(data).offsets)
    if not messages:
        return {}
    entries = np.empty(len(messages), INDEX_ENTRY)
    entries["log"] = messages.block.log_ns
    entries["offset"] = messages.block.starts - _MESSAGE_HEAD_BYTES
    order = np.argsort(entries["log"], kind="stable")
    ids, entries = messages.channels[order], entries[order]
    return {int(id_): entries[ids == id_] for id_ in np.unique(ids)}


_MESSAGE_HEAD_BYTES = RECORD.size + 2 + 4 + 8 + 8
