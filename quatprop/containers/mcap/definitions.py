"""Schemas and channels of an MCAP file, whose ids may be redefined in the middle of it.

Concatenated files have ids of their own, each counted from 1. So the ids of an index are those of
the records plus :attr:`Chunk.id_offset`, which differs from part to part.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from quatprop.containers.mcap.chunks import CHANNEL, SCHEMA, Chunk, ChunkHead, load
from quatprop.containers.mcap.messages import messages_at
from quatprop.containers.mcap.records import MALFORMED, read_channel, read_schema
from quatprop.containers.mcap.summary import McapIndex
from quatprop.containers.mcap.walk import walk_records
from quatprop.messages.blocks import Channel
from quatprop.stores.compression import UnreadableDataError, decompress_prefix
from quatprop.stores.limits import DecompressionBudget
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.stores.compression import Buffer
    from quatprop.stores.file_source import FileSource

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
        loaded = load(source, chunk, budget, check=check)
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
