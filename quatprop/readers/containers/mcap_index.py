"""Index of an MCAP file: its summary, the messages of a chunk, the definitions of channels."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import Losses
from quatprop.base.provenance import METADATA_KEY
from quatprop.base.text import plain
from quatprop.base.times import LATEST
from quatprop.readers.containers.mcap_records import (
    CHANNEL,
    DATA_END,
    INDEX_ENTRY,
    INDEX_HEAD,
    MAGIC,
    MALFORMED,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    METADATA,
    RECORD,
    SCHEMA,
    Chunk,
    ChunkHead,
    load_chunk,
    prefixed,
    read_channel,
    read_metadata,
    read_schema,
    walk_records,
)
from quatprop.readers.messages.blocks import Channel, MessageBlock
from quatprop.stores.checksum import crc32
from quatprop.stores.compression import (
    MAX_SIZE,
    DecompressionBudget,
    UnreadableDataError,
    decompress_prefix,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from quatprop.readers.containers.mcap_records import ChannelRecord, SchemaRecord
    from quatprop.stores.compression import Buffer
    from quatprop.stores.file_source import FileSource


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


# Locate the messages of a decompressed chunk of an MCAP file.
#
# The offsets of messages are those of the message index, which are checked. If there is no index,
# or it disagrees with the records, the records are walked.


_HEAD = MESSAGE_HEAD.itemsize
_FIXED = _HEAD - RECORD.size
_CHANNEL_BITS = (1 << 24) - 1
"""Mask of the second 8 bytes of a message record: the end of its length, and its channel."""


@dataclass(slots=True)
class LocatedMessages:
    """Messages of several channels.

    `block`: the messages. Times after the year 2262, unsigned, are negative in its `publish_ns` and
        clamped to :data:`~quatprop.base.times.LATEST` in `log_ns`
    `channels`: channel id of each, shape ``(N,)``; may be a view of the buffer
    """

    block: MessageBlock
    channels: NDArray[np.uint16]

    def of(self, ids: Sequence[int]) -> LocatedMessages:
        """Return the messages of some channels."""
        # Evenly spaced messages are all of one channel.
        wanted = _is_one_of(self.channels[: 1 if self.block.stride else None], ids)
        if wanted.all():
            return self
        if self.block.stride:
            wanted = wanted.repeat(len(self))
        return LocatedMessages(self.block.at(wanted), self.channels[wanted])

    def with_publishers(self, id_offset: int) -> MessageBlock:
        """Return the messages with the ids of their channels in the whole file."""
        return replace(self.block, publishers=self.channels.astype(np.int64) + id_offset)

    def __len__(self) -> int:
        return len(self.channels)

    def fill(self, data: Buffer, begin: int) -> bool:
        """Return whether these messages fill `data` from `begin` to its end without gaps."""
        starts, ends = self.block.starts, self.block.ends
        size = int((ends - starts).sum()) + len(starts) * _HEAD
        return int(starts[0]) - _HEAD == begin == len(data) - size

    def counts(self) -> dict[int, int]:
        """Return the number of messages of each channel."""
        ids, counts = np.unique(self.channels, return_counts=True)
        return dict(zip(ids.tolist(), counts.tolist(), strict=True))


def _is_one_of(channels: NDArray[np.uint16], ids: Sequence[int]) -> NDArray[np.bool_]:
    # For a few ids this is several times faster than np.isin.
    matches = np.zeros(len(channels), np.bool_)
    for id_ in ids:
        matches |= channels == id_
    return matches


def messages_at(data: Buffer, offsets: NDArray[np.int64]) -> LocatedMessages | None:
    """Return the messages at ascending offsets; None if no message begins at one of them.

    `offsets`: offsets of message records, shape ``(N,)``, int64
    """
    if len(offsets) == 0:
        none = MessageBlock(np.empty(0, np.uint8), offsets, offsets, offsets, offsets)
        return LocatedMessages(none, np.empty(0, np.uint16))
    if offsets[0] < 0 or max(offsets[0], offsets[-1]) > len(data) - _HEAD:
        return None
    count, first = len(offsets), int(offsets[0])
    stride = RECORD.size + RECORD.unpack_from(data, first)[1]
    messages = None
    if int(offsets[-1]) == first + (count - 1) * stride and first + count * stride <= len(data):
        messages = _evenly_spaced(data, first, count)
    return _anywhere(data, offsets) if messages is None else messages


def _evenly_spaced(data: Buffer, first: int, count: int) -> LocatedMessages | None:
    """Return `count` adjacent messages of one length and channel; None if there are others."""
    opcode, length = RECORD.unpack_from(data, first)
    stride = RECORD.size + length
    if opcode != MESSAGE or length < _FIXED:
        return None
    # The first 16 bytes have opcode, length and channel; one copy of them is faster than two
    # comparisons over the whole chunk.
    front = np.ndarray((count,), "V16", data, first, (stride,)).copy().view("<u8").reshape(-1, 2)
    back = front[:, 1] & _CHANNEL_BITS
    if np.count_nonzero(front[:, 0] != front[0, 0]) or np.count_nonzero(back != back[0]):
        return None
    head = np.ndarray((count,), MESSAGE_HEAD, data, first, (stride,))
    starts = np.arange(first + _HEAD, first + _HEAD + count * stride, stride)
    ends = starts + (length - _FIXED)
    return LocatedMessages(_block(data, starts, ends, head, stride), head["channel"])


def _anywhere(data: Buffer, offsets: NDArray[np.int64]) -> LocatedMessages | None:
    """Return the messages at ascending offsets, with or without other records between them."""
    if (offsets[1:] <= offsets[:-1]).any():
        return None
    head = heads_at(data, offsets)
    if head is None:
        return None
    length = head["length"]
    # A length below the minimum wraps to a very large unsigned number.
    if (length - _FIXED > len(data)).any():
        return None
    ends = offsets + length.astype(np.int64) + RECORD.size
    if ends[-1] > len(data) or (ends[:-1] > offsets[1:]).any():
        return None
    return LocatedMessages(_block(data, offsets + _HEAD, ends, head), head["channel"])


def heads_at(data: Buffer, offsets: NDArray[np.int64]) -> NDArray[np.void] | None:
    """Return the heads of the messages at ascending offsets; None if one is no message."""
    if offsets[-1] > len(data) - _HEAD:
        return None
    # One gather of whole heads is far cheaper than one of each field; a stride of 1 byte allows
    # any offset.
    every = np.ndarray((len(data) - _HEAD + 1,), f"V{_HEAD}", data, strides=(1,))
    head = every[offsets].view(MESSAGE_HEAD)
    return None if (head["opcode"] != MESSAGE).any() else head


def _block(
    data: Buffer,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    head: NDArray[np.void],
    stride: int = 0,
) -> MessageBlock:
    """Return messages with the times in their heads; log times are clamped to int64."""
    log_ns = head["log"].copy()
    if log_ns.min() < 0:
        log_ns[log_ns < 0] = LATEST
    buffer = np.frombuffer(data, np.uint8)
    return MessageBlock(buffer, starts, ends, log_ns, head["publish"], stride=stride)


def index_of(source: FileSource, chunk: Chunk) -> bytes:
    """Return the bytes of a chunk's message indexes; empty if they cannot be read."""
    try:
        return source.read(chunk.start + chunk.length, chunk.index_length)
    except OSError:
        return b""


def indexed_offsets(
    index: Buffer, chunk: Chunk, ids: Sequence[int] | None = None
) -> NDArray[np.int64] | None:
    """Return the message offsets in a chunk's message indexes.

    `ids`: the channels; None for all
    `Returns`: shape ``(N,)``, int64, ascending; None if there is no index or it is damaged
    """
    if not chunk.index_length or chunk.message_index_offsets is None:
        return None
    parts = []
    for channel in chunk.message_index_offsets:
        if ids is None or channel in ids:
            entries = index_entries(index, chunk, chunk.message_index_offsets[channel], channel)
            if entries is None:
                return None
            parts.append(entries[:, 1])
    if len(parts) == 1:
        return parts[0]
    return np.sort(np.concatenate([*parts, np.empty(0, np.int64)]))


def index_entries(
    index: Buffer, chunk: Chunk, place: int, channel: int
) -> NDArray[np.int64] | None:
    """Return the log times and message offsets in the message index of a channel.

    `Returns`: shape ``(N, 2)``, int64; None if it is damaged
    """
    at = place - chunk.start - chunk.length
    if at < 0 or at + INDEX_HEAD.size > len(index):
        return None
    opcode, length, of_channel, size = INDEX_HEAD.unpack_from(index, at)
    begin = at + INDEX_HEAD.size
    if (opcode, of_channel) != (MESSAGE_INDEX, channel) or size + 6 > length or size % INDEX_ENTRY:
        return None
    if begin + size > len(index):
        return None
    return np.frombuffer(index, "<i8", size // 8, begin).reshape(-1, 2)


# Schemas and channels of an MCAP file, whose ids may be redefined in the middle of it.
#
# Concatenated files have ids of their own, each counted from 1. So the ids of an index are those of
# the records plus :attr:`Chunk.id_offset`, which differs from part to part.


IDS = 1 << 16
"""Number of ids that the records of one part can have."""

_LEADING = 1 << 14
"""Bytes of a chunk that are read for the definitions at its beginning."""
_ROS_ENCODINGS = frozenset({"ros1", "cdr"})
_NOT_DEFINITIONS = frozenset(range(256)) - {SCHEMA, CHANNEL}


class Definitions:
    """Schema and channel records in the order of the file.

    `id_offset`: added to the ids of the current part
    `records`: opcode, content, position and `id_offset` of each record
    """

    def __init__(self) -> None:
        self.id_offset = 0
        self.records: list[tuple[int, Buffer, str, int]] = []
        self._current: dict[tuple[int, bytes], tuple[Buffer, str]] = {}

    def begin_file(self) -> None:
        """Begin another of several concatenated files: no id keeps its meaning."""
        self.id_offset += IDS
        self._current.clear()

    def redefines(self, opcode: int, content: Buffer) -> bool:
        """Return whether a record gives an id a different channel or schema."""
        before = self._current.get((opcode, bytes(content[:2])))
        if before is None or before[0] == content:
            return False
        earlier, later = _identity(opcode, before[0]), _identity(opcode, content)
        return earlier is not None and later is not None and earlier != later

    def add(self, opcode: int, content: Buffer, place: str) -> None:
        """Add a record; one that redefines an id begins a new part."""
        key = opcode, bytes(content[:2])
        if self.redefines(opcode, content):
            self.id_offset += IDS
            self._current[key] = content, place
            for (kind, _), (earlier, where) in self._current.items():
                self.records.append((kind, earlier, where, self.id_offset))
        elif key not in self._current:
            self._current[key] = content, place
            self.records.append((opcode, content, place, self.id_offset))


def _identity(opcode: int, content: Buffer) -> tuple[str, str, int | bytes] | None:
    """Return the identity of the channel or schema in a record; None if it is damaged."""
    try:
        return (read_schema if opcode == SCHEMA else read_channel)(content).identity
    except MALFORMED:
        return None


def leading_definitions(
    source: FileSource, start: int, head: ChunkHead
) -> list[tuple[int, Buffer]]:
    """Return opcode and content of the definitions at the beginning of a chunk."""
    front = source.read(start + head.begin, min(head.end - head.begin, _LEADING))
    data = bytes(decompress_prefix(front, head.compression, min(head.size, 4 * _LEADING)))
    walked = walk_records(data, stop_at=_NOT_DEFINITIONS)
    return [(opcode, data[begin:end]) for opcode, begin, end in walked.definitions]


def read_definitions(
    source: FileSource, index: McapIndex, *, is_complete: bool, is_closed: bool
) -> None:
    """Read the chunks that may have definitions of undefined channels and schemas."""
    suspect = []
    define = partial(_define_from, source, index, DecompressionBudget(source.size))
    for chunk in index.chunks:
        if chunk.message_index_offsets is None or (chunk is index.chunks[-1] and not is_closed):
            needed = not (is_complete and index.defines(index.channels))
        else:
            needed = not index.defines(chunk.ids)
        if needed and not define(chunk, check=True):
            suspect.append(chunk)  # its loss is recorded when its messages are read
    # Definitions in a chunk with a wrong checksum are better than none.
    for chunk in suspect:
        if not (is_complete and index.defines(index.channels)):
            define(chunk, check=False)


def _define_from(
    source: FileSource,
    index: McapIndex,
    budget: DecompressionBudget,
    chunk: Chunk,
    *,
    check: bool,
) -> bool:
    """Add the definitions in a chunk; return whether it is readable."""
    try:
        loaded = load_chunk(source, chunk, budget, check=check)
    except UnreadableDataError:
        return False
    data = loaded.data
    walked = walk_records(data)
    for opcode, begin, stop in walked.definitions:
        content = memoryview(data)[begin:stop]
        index.define(opcode, content, f"in the {chunk.place}", chunk.id_offset)
    if walked.end == len(data) and not loaded.damage:
        # Its records are more reliable than an index, which may be damaged.
        messages = messages_at(data, walked.offsets)
        chunk.counts = messages.counts() if messages else {}
        chunk.message_index_offsets = dict.fromkeys(chunk.counts, 0)
    return True


class DefinitionCheck:
    """Compares the definitions in chunks, which the format forbids to differ, with the index.

    So no message is assigned to a wrong topic.

    `index`: the definitions with which messages are decoded
    """

    def __init__(self, index: McapIndex) -> None:
        self.index = index
        self._found: dict[tuple[int, int, bytes], tuple[list[int], str, str]] = {}

    def check(
        self,
        data: Buffer,
        definitions: Sequence[tuple[int, int, int]],
        chunk: Chunk,
        ids: Sequence[int],
    ) -> None:
        """Compare a chunk's definitions, given as opcode and begin and end of their content."""
        for opcode, begin, end in definitions:
            record = chunk.id_offset, opcode, bytes(data[begin:end])
            if record not in self._found:
                self._found[record] = self._redefined(*record)
            channels, what, change = self._found[record]
            if not set(ids).isdisjoint(chunk.local_ids(channels)):
                raise UnreadableDataError(
                    f"it redefines {what} ({change}), so it is not certain whose messages these are"
                )

    def _redefined(self, id_offset: int, opcode: int, content: bytes) -> tuple[list[int], str, str]:
        """Return the channels that a record redefines, its kind and id, and the difference."""
        index, here = self.index, McapIndex()
        here.define(opcode, content, "", id_offset)
        for kind, earlier, later in (
            ("channel", index.channels, here.channels),
            ("schema", index.schemas, here.schemas),
        ):
            for id_ in earlier.keys() & later.keys():
                before, now = earlier[id_].identity, later[id_].identity
                if before != now:
                    by_schema = [c.id for c in index.channels.values() if c.schema_id == id_]
                    channels = [id_] if kind == "channel" else by_schema
                    change = f"is now {plain(now[0])}" if before[0] != now[0] else "has changed"
                    return channels, f"{kind} {id_ % IDS}", f"{plain(before[0])} {change}"
        return [], "", ""


def ids_by_channel(index: McapIndex) -> dict[Channel, list[int]]:
    """Return the ids of each channel: in MCAP every publisher has an id of its own."""
    ids: dict[Channel, list[int]] = {}
    for id_, record in sorted(index.channels.items()):
        schema = index.schemas.get(record.schema_id)
        channel = Channel(
            topic=record.topic,
            type_name=_type_name(schema.name if schema else "", record.message_encoding),
            encoding=record.message_encoding,
            schema_encoding=schema.encoding if schema else "",
            schema=schema.data if schema else b"",
        )
        ids.setdefault(channel, []).append(id_)
    return ids


def _type_name(name: str, encoding: str) -> str:
    """Return a ROS type as ``package/msg/Name``, and any other unchanged."""
    package, slash, rest = name.replace("::", "/").partition("/")
    if encoding not in _ROS_ENCODINGS or not slash:
        return name
    return f"{package}/{rest}" if "/" in rest else f"{package}/msg/{rest}"
