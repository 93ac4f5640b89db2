"""Copy MCAP files and add attitudes."""

from __future__ import annotations

import struct
from bisect import bisect_right
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, Header, MetadataIndex, Schema
from ruamel.yaml import YAML

from quatprop.base.errors import DamagedLogError, UnreadableLogError, UnsupportedLogError, os_reason
from quatprop.base.guarded_text import read_yaml
from quatprop.base.text import Setting
from quatprop.readers.containers.mcap_index import (
    IDS,
    MAGIC,
    index_entries,
    messages_at,
    read_footer,
)
from quatprop.readers.containers.mcap_records import (
    INDEX_HEAD,
    MALFORMED,
    PEEK,
    RECORD,
    chunk_head,
    load,
    prefixed,
    read_channel,
    read_metadata,
    read_schema,
    walk_records,
)
from quatprop.stores.compression import DecompressionBudget, UnreadableDataError
from quatprop.writers import attitude_encoder
from quatprop.writers.atomic import OutputFile
from quatprop.writers.base import MessageWriter
from quatprop.writers.mcap import (
    INDEX_ENTRY,
    McapChunk,
    McapContents,
    McapFile,
    compressed_chunk,
    encoded,
    finish_with_provenance,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, MutableMapping, Sequence

    from quatprop.base.arrays import Int64, Records
    from quatprop.readers.containers.mcap import McapLog
    from quatprop.readers.containers.mcap_records import Chunk
    from quatprop.stores.compression import Buffer
    from quatprop.stores.file_source import FileSource
    from quatprop.writers.formats import Message
    from quatprop.writers.message_encoders import Topic

    Indexes = dict[int, Records]
    YamlMapping = MutableMapping[str, Any]


# Copy the records of an MCAP file, unchanged and in their order.
#
# Chunks are decompressed only if their message index is missing and must be rebuilt. Index records
# are not copied, since all offsets change.


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


# Add a topic to the metadata of a ROS 2 bag.
#
# rosbag2 stores them in metadata.yaml, below a root key, and in each storage file, without that
# key.


_ROOT = "rosbag2_bagfile_information"

_WITH_CUSTOM_DATA = 6
"""The first version of the metadata with custom data."""


@dataclass(slots=True)
class Added:
    """The messages added to a part.

    `first`, `last`: their first and last log time, ns; if there are none, `first` > `last`
    """

    count: int = 0
    first: int = np.iinfo(np.int64).max
    last: int = np.iinfo(np.int64).min

    def add(self, log_ns: Int64) -> None:
        """Count messages with these log times."""
        if len(log_ns):
            self.count += len(log_ns)
            self.first = min(self.first, int(log_ns.min()))
            self.last = max(self.last, int(log_ns.max()))


def extended(
    text: str,
    topic: Topic,
    parts: Sequence[Added],
    custom: Mapping[str, str],
    *,
    has_root: bool = True,
) -> str | None:
    """Return metadata with a topic added; None if they are damaged."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    try:
        content = read_yaml(text)
        # Copies by earlier versions of this package have the root key in storage files, too.
        bag = content[_ROOT] if has_root or _ROOT in content else content
        _extend(bag, topic, parts, custom)
    except (KeyError, TypeError, AttributeError, ValueError):
        return None
    out = StringIO()
    yaml.dump(content if has_root else bag, out)
    return out.getvalue()


def extended_record(
    text: str, topic: Topic, parts: Sequence[Added], custom: Mapping[str, str] | None = None
) -> str:
    """Return the metadata of a storage file with a topic added; unchanged if damaged."""
    return extended(text, topic, parts, custom or {}, has_root=False) or text


def _extend(
    bag: YamlMapping, topic: Topic, parts: Sequence[Added], custom: Mapping[str, str]
) -> None:
    count = sum(part.count for part in parts)
    bag["message_count"] += count
    topics = bag["topics_with_message_count"]
    topics.append({"message_count": count, "topic_metadata": _topic_metadata(topic, topics)})
    _extend_span(bag, parts)
    for file, part in zip(bag.get("files") or (), parts, strict=False):
        file["message_count"] += part.count
        _extend_span(file, [part])
    if custom and bag["version"] >= _WITH_CUSTOM_DATA:
        bag["custom_data"] = {**(bag.get("custom_data") or {}), **custom}


def _topic_metadata(topic: Topic, others: Sequence[YamlMapping]) -> YamlMapping:
    """Return the metadata of the new topic, in the same version as the others."""
    entry: YamlMapping = {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": topic.encoding,
    }
    entries = [other["topic_metadata"] for other in others]
    if any("offered_qos_profiles" in other for other in entries):
        as_list = any(isinstance(other.get("offered_qos_profiles"), list) for other in entries)
        entry["offered_qos_profiles"] = [] if as_list else ""
    if any("type_description_hash" in other for other in entries):
        entry["type_description_hash"] = topic.digest
    return entry


def _extend_span(entry: YamlMapping, parts: Sequence[Added]) -> None:
    """Extend a start time and duration to include the added messages."""
    start = entry["starting_time"]["nanoseconds_since_epoch"]
    end = start + entry["duration"]["nanoseconds"]
    for part in parts:
        start, end = min(start, part.first), max(end, part.last)
    entry["starting_time"]["nanoseconds_since_epoch"] = start
    entry["duration"]["nanoseconds"] = end - start


_CHUNK_BYTES = 1 << 17
"""Bytes of a chunk of attitudes: small, so that it is near the log's chunks of its time."""


class McapPart:
    """A copy of an MCAP file to which messages of one topic are added.

    `log`: the file to copy; it stays open until the part is finished
    `place`: the destination: a path that does not exist, or a stream
    `encoder`: the encoder of attitudes for this file
    """

    def __init__(self, log: McapLog, place: Path | BinaryIO, message: Message) -> None:
        with ExitStack() as resources:
            self._copy = McapCopy(log)
            ros = "ros1" if self._copy.header.profile == "ros1" else "cdr"
            self.encoder = attitude_encoder(message, (ros, "protobuf"))
            self.added = Added()
            if isinstance(place, Path):
                place = resources.enter_context(place.open("xb"))
            contents = self._copy.contents
            self._file = McapFile(
                place,
                self._copy.header,
                "zstd",
                contents=contents,
                before=lambda first_ns: self._copy.up_to(first_ns, self._file),
                chunk_bytes=_CHUNK_BYTES,
            )
            resources.callback(self._file.abort)
            # Some recorders declare topics without messages in the summary only.
            self._file.append(encoded([*contents.schemas.values(), *contents.channels.values()]))
            self._file.add_channel(self.encoder.topic)
            self._resources = resources.pop_all()

    def write(self, log_ns: Int64, messages: Records) -> None:
        """Append messages, after the parts of the log that are earlier."""
        self._file.write(log_ns, messages)
        self.added.add(log_ns)

    def finish(
        self, extend: Callable[[str], str], provenance: Mapping[str, object] | None = None
    ) -> None:
        """Copy the rest of the log and finish the file."""
        self._file.flush()
        self._copy.up_to(None, self._file)
        if self._copy.bag_metadata is not None:
            self._file.add_metadata(ROSBAG2, {SERIALIZED: extend(self._copy.bag_metadata)})
        finish_with_provenance(self._file, self.encoder.topic.name, provenance or {})
        self.close()

    def close(self) -> None:
        """Close the copy; may be called twice."""
        self._resources.close()


class McapCopyWriter(MessageWriter):
    """Copy an MCAP file and add attitudes to it."""

    _output: OutputFile

    def __init__(self, log: McapLog, target: Path | str, message: Message) -> None:
        super().__init__(OutputFile(target))
        with self._opening():
            self._part = McapPart(log, self._output.stream, message)
        self.encoder = self._part.encoder

    def _write(self, log_ns: Int64, messages: Records) -> None:
        self._part.write(log_ns, messages)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        topic, part = self.encoder.topic, self._part
        part.finish(lambda text: extended_record(text, topic, [part.added]), provenance)

    def abort(self) -> None:
        """Discard uncommitted output."""
        self._part.close()
        super().abort()
