"""Read the messages of a channel from the chunks of an MCAP file, and record losses."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.chunks import ChunkReader
from quatprop.containers.mcap.chunks import MESSAGE, PEEK, RECORD, Chunk, Loaded, head_of, load
from quatprop.containers.mcap.messages import (
    heads_at,
    index_of,
    indexed_offsets,
    messages_at,
    messages_past_damage,
)
from quatprop.containers.mcap.walk import MESSAGE_HEAD, walk_records
from quatprop.errors import UnsupportedLogError
from quatprop.stores.byte_ranges import REMOTE_LARGE, ranges_worth_reading
from quatprop.stores.compression import UnreadableDataError
from quatprop.stores.limits import CHECKSUMS, checksums_matter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.containers.mcap.definitions import DefinitionCheck
    from quatprop.containers.mcap.messages import LocatedMessages
    from quatprop.messages.blocks import MessageBlock
    from quatprop.stores.file_source import FileSource


UNDEFINED = "no record defines it"
"""The reason of loss of a channel without a definition."""


class McapReader(ChunkReader[Chunk, Loaded]):
    """Reads the messages of one channel.

    `definitions`: compares definitions in chunks with those of the index, to which losses are added
    `unchecked`: offsets of the chunks of which only selected messages were read; grows
    """

    def __init__(
        self,
        source: FileSource,
        definitions: DefinitionCheck,
        topic: str,
        ids: Sequence[int],
        unchecked: set[int],
    ) -> None:
        super().__init__(source)
        self.definitions, self.topic, self.ids = definitions, topic, ids
        self.index, self.losses = definitions.index, definitions.index.losses
        self.lost = 0
        self.unchecked = unchecked

    def is_mixed(self, chunk: Chunk) -> bool:
        """Return whether a chunk is known to have other channels."""
        return not {*chunk.ids} <= {*self.ids}

    def expected(self, chunk: Chunk, *, is_mixed: bool) -> list[tuple[int, int]]:
        """Return the byte range of a chunk, or those of head and index if it is read in part."""
        head_end = chunk.start + PEEK
        if is_mixed and self._is_read_in_part(chunk):
            return [(chunk.start, head_end), (chunk.start + chunk.length, chunk.end)]
        return [(chunk.start, max(chunk.end, head_end))]

    def size_of(self, chunk: Chunk) -> int:
        """Return the bytes of the records of a chunk by the index."""
        return chunk.size

    def load(self, chunk: Chunk, *, is_mixed: bool) -> Loaded:
        """Return the records of a chunk, or only the wanted messages of a large chunk."""
        if is_mixed and self._is_read_in_part(chunk):
            with suppress(UnreadableDataError, OSError):
                selected = self._load_messages(chunk)
                if selected is not None:
                    return selected
        return self._load_chunk(chunk)

    def _is_read_in_part(self, chunk: Chunk) -> bool:
        is_large = not self.source.is_remote or chunk.length > REMOTE_LARGE
        return is_large and chunk.can_be_read_in_part

    def _load_chunk(self, chunk: Chunk) -> Loaded:
        try:
            return load(self.source, chunk, self.budget)
        except UnreadableDataError as error:
            return Loaded(damage=error.reason, is_readable=False)

    def _load_messages(self, chunk: Chunk) -> Loaded | None:
        """Return the wanted messages of a chunk; None if it is better read whole.

        The records before the first message are read, too, and the heads of all messages, to verify
        that there are no others. The chunk's checksum is not verified.
        """
        own, index = chunk.local_ids(self.ids), index_of(self.source, chunk)
        wanted, every = indexed_offsets(index, chunk, own), indexed_offsets(index, chunk)
        head = head_of(self.source, chunk)
        is_right = head is not None and head.is_uncompressed and head.size == chunk.size
        if head is None or not is_right or wanted is None or every is None or not len(every):
            return None
        is_wanted, nexts = np.isin(every, wanted), np.append(every[1:], chunk.size)
        ends = np.where(is_wanted, nexts, np.minimum(every + MESSAGE_HEAD.itemsize, nexts))
        starts, ends = np.append(0, every), np.append(every[:1], ends)
        ranges = ranges_worth_reading(starts, ends, chunk.size)
        if ranges is None:
            return None
        at = chunk.start + head.begin
        data = self.source.read_ranges((at + ranges.begins).tolist(), (at + ranges.ends).tolist())
        begins = every - ranges.moved[1:]
        heads = heads_at(data, begins) if len(data) == ranges.size else None
        if (
            heads is None
            or (heads["length"] != nexts - every - RECORD.size).any()
            or (np.isin(heads["channel"], own) != is_wanted).any()
        ):
            return None
        walked = walk_records(data[: begins[0]])
        self.definitions.check(data, walked.definitions, chunk, own)
        return Loaded(data, offsets=begins[is_wanted])

    def indexed(self, content: Loaded, chunk: Chunk) -> MessageBlock | None:
        """Return the messages of a chunk by its index; None if its records disagree."""
        ids, data = chunk.local_ids(self.ids), content.data
        if content.offsets is not None:
            selected = messages_at(data, content.offsets)
            if selected is None or not chunk.may_have_logged(selected.block.log_ns):
                return None
            self.unchecked.add(chunk.start)
            return selected.block
        index = index_of(self.source, chunk)
        every, listed = indexed_offsets(index, chunk), indexed_offsets(index, chunk, ids)
        messages = None if every is None else messages_at(data, every)
        walked = walk_records(data, stop_at={MESSAGE})
        # Between other records there may be messages that no index lists.
        if listed is None or not messages or not messages.fill(data, walked.end):
            return None
        messages = messages.of(ids)
        if len(messages) != len(listed):
            return None
        try:
            self.definitions.check(data, walked.definitions, chunk, ids)
            _check_times(content, chunk, messages)
        except UnreadableDataError:
            return None  # raised again when the records are read
        return messages.block

    def messages(self, content: Loaded, chunk: Chunk) -> MessageBlock | None:
        """Return the messages of a chunk by its records, and record losses."""
        if content.offsets is not None:
            content = self._load_chunk(chunk)
        reason = content.damage
        if content.is_readable:
            try:
                messages = self._walked(content, chunk)
            except UnreadableDataError as error:
                self._refuse_redefined(content, chunk, error)
                reason = error.reason
            else:
                return messages.block if messages else None
        # An index without messages may be damaged.
        lost = message_count([chunk], self.ids) or None
        self.losses.note(chunk.place, reason, lost, self.topic)
        self.lost += lost or 0
        return None

    def _walked(self, loaded: Loaded, chunk: Chunk) -> LocatedMessages | None:
        """Locate the messages of a chunk by its records, and losses by its index."""
        data, damage, ids = loaded.data, loaded.damage, chunk.local_ids(self.ids)
        index = index_of(self.source, chunk)
        listed, every = indexed_offsets(index, chunk, ids), indexed_offsets(index, chunk)
        walked = walk_records(data)
        self.definitions.check(data, walked.definitions, chunk, ids)
        if walked.malformed:
            self.losses.note(chunk.place, "too short to be messages", walked.malformed)
        if walked.end < len(data) and every is not None:
            messages = messages_past_damage(data, walked.offsets, every)
        else:
            messages = messages_at(data, walked.offsets)
        if messages:
            _check_times(loaded, chunk, messages)
        wanted = messages.of(ids) if messages else None
        found = len(wanted) if wanted else 0
        lost = 0 if listed is None else max(0, len(listed) - found - walked.malformed)
        if messages and not lost:
            self._note_undefined(chunk, messages)
        if walked.end < len(data):
            damage = (
                damage or f"its records cannot be followed beyond byte {walked.end} of {len(data)}"
            )
        elif lost:
            damage = damage or "its message index lists messages that are not among its records"
        if damage:
            self.losses.note(chunk.place, damage, lost or None, self.topic)
        self.lost += lost
        return wanted

    def _refuse_redefined(self, loaded: Loaded, chunk: Chunk, error: UnreadableDataError) -> None:
        """Refuse the file if a checksum shows that the chunk is not damaged but written so."""
        if loaded.has_checksum:
            raise UnsupportedLogError(
                self.source.path,
                f"{chunk.place}: {error.reason}; MCAP forbids that; copy the messages with an "
                "MCAP library into a file in which each definition has its own id",
            ) from error

    def _note_undefined(self, chunk: Chunk, messages: LocatedMessages) -> None:
        """Record messages of undefined channels as lost."""
        for id_, count in messages.counts().items():
            if chunk.id_offset + id_ not in self.index.channels:
                self.losses.note(f"channel {id_}", UNDEFINED, count, chunk.start)


def _check_times(loaded: Loaded, chunk: Chunk, messages: LocatedMessages) -> None:
    """Refuse a chunk without a checksum whose log times are outside its stated range."""
    if loaded.has_checksum or chunk.may_have_logged(messages.block.log_ns):
        return
    if checksums_matter():
        raise UnreadableDataError(
            "its log times are outside the range that it states, so it is not what was recorded; "
            f"with {CHECKSUMS}=ignore it is read anyway"
        )


def message_count(chunks: Sequence[Chunk], ids: Sequence[int]) -> int | None:
    """Return the number of messages of some channels in some chunks; None if unknown."""
    counts = [chunk.count(id_) for chunk in chunks for id_ in chunk.local_ids(ids)]
    return None if None in counts else sum(count for count in counts if count is not None)
