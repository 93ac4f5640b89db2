"""Read the messages of a channel in the regions of an MCAP file, and note what is lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.containers.byte_ranges import LARGE
from quatprop.containers.chunks import ChunkReader
from quatprop.containers.compression import UnreadableDataError
from quatprop.containers.limits import CHECKSUMS, checksums_matter
from quatprop.containers.mcap.index import UNDEFINED
from quatprop.containers.mcap.messages import (
    index_of,
    indexed_offsets,
    messages_at,
    messages_past_damage,
    only_messages,
)
from quatprop.containers.mcap.regions import PEEK, Loaded, Region, load
from quatprop.containers.mcap.selected import selected_messages
from quatprop.containers.mcap.walk import walk_records
from quatprop.errors import UnsupportedLogError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.base import MessageBlock
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.messages import LocatedMessages
    from quatprop.containers.mcap.redefinitions import DefinitionCheck

    Bytes = NDArray[np.uint8]


class McapReader(ChunkReader[Region, Loaded]):
    """Reads the messages of one channel.

    Parameters
    ----------
    source
        The file.
    definitions
        Compares definitions inside chunks with those of the index, to which losses are added.
    topic, ids
        The channel, and its ids in the index.
    unchecked
        Where chunks begin of which only selected messages were read; grows.

    Attributes
    ----------
    lost
        Messages that are known to be lost.
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

    def expected(self, chunk: Region) -> list[tuple[int, int]]:
        """Return the bytes of a region, or head and index of a chunk that is read in part."""
        head_end = chunk.start + PEEK
        if self._is_read_in_part(chunk):
            return [(chunk.start, head_end), (chunk.start + chunk.length, chunk.end)]
        return [(chunk.start, max(chunk.end, head_end))]

    def size_of(self, chunk: Region) -> int:
        """Return the bytes of the records of a region by the index."""
        return chunk.size

    def is_mixed(self, chunk: Region) -> bool:
        """Return whether a region is a chunk with other channels, by an index of its messages."""
        if not chunk.is_chunk or not chunk.index_length or chunk.holds is None:
            return False
        return not set(chunk.holds) <= set(chunk.own(self.ids))

    def _is_read_in_part(self, chunk: Region) -> bool:
        return chunk.is_uncompressed and chunk.length >= LARGE and self.is_mixed(chunk)

    def whole(self, chunk: Region) -> Loaded:
        """Return the records of a region."""
        try:
            return load(self.source, chunk, self.budget)
        except UnreadableDataError as error:
            return Loaded(damage=error.reason, is_readable=False)

    def selected(self, chunk: Region, whole: Loaded | None = None) -> Loaded | None:
        """Return copies of the wanted messages of a chunk, if they are all that is needed."""
        if whole is None and not self._is_read_in_part(chunk):
            return None
        own = chunk.own(self.ids)
        try:
            return selected_messages(self.source, chunk, own, self.definitions, whole)
        except (UnreadableDataError, OSError):
            return None  # it is read whole, compared with its checksum, and the error noted

    def messages_at(self, content: Loaded, chunk: Region) -> MessageBlock | None:
        """Return the messages that were selected; None where they are others."""
        offsets = content.offsets
        messages = None if offsets is None else messages_at(content.data, offsets)
        if (
            messages is None
            or not messages.are_all_of(chunk.own(self.ids))
            or not chunk.may_have_logged(messages.block.log_ns)
        ):
            self.unchecked.discard(chunk.start)
            return None
        return messages.block

    def located(self, content: Loaded, chunk: Region) -> MessageBlock | None:
        """Return the messages of a loaded region."""
        if content.is_partial:
            self.unchecked.add(chunk.start)
        return super().located(content, chunk)

    def only_messages(self, data: Bytes, chunk: Region) -> tuple[MessageBlock, int] | None:
        """Return the messages of a region that holds nothing else behind its definitions."""
        try:
            begin = self.definitions.check_leading(data.data, chunk, chunk.own(self.ids))
        except UnreadableDataError:
            return None
        messages = only_messages(data.data, begin)
        return None if messages is None else (messages.block, int(messages.channels[0]))

    def may_have(self, chunk: Region, log_ns: NDArray[np.int64], id_: int) -> bool:
        """Return whether an id is wanted, and a region may have messages with these log times."""
        is_counted = id_ in chunk.own(self.ids) and chunk.count(id_) in {len(log_ns), None}
        return is_counted and chunk.may_have_logged(log_ns)

    def messages(self, content: Loaded, chunk: Region) -> MessageBlock | None:
        """Return the messages of one region, and note what is lost of them.

        Raises
        ------
        UnsupportedLogError
            A chunk redefines the channel.
        """
        reason = content.damage
        if content.is_readable:
            try:
                messages = self._by_index_or_walk(content, chunk)
            except UnreadableDataError as error:
                self._refuse_redefined(content, chunk, error)
                reason = error.reason
            else:
                return messages.block if messages else None
        # An index that lists none may be damaged.
        lost = message_count([chunk], self.ids) or None
        self.losses.note(chunk.place, reason, lost, self.topic)
        self.lost += lost or 0
        return None

    def _by_index_or_walk(self, loaded: Loaded, region: Region) -> LocatedMessages | None:
        """Locate the messages of a region by its index or, if that fails, by its records."""
        data, damage = loaded.data, loaded.damage
        ids = region.own(self.ids)
        index = index_of(self.source, region)
        offsets = indexed_offsets(index, region, ids)
        messages = None if offsets is None else messages_at(data, offsets)
        if messages and messages.are_all_of(ids):
            leading = self.definitions.check_leading(data, region, ids)
            # Among other records there may be messages that no index lists.
            if messages.fill(data, leading):
                _check_times(loaded, region, messages)
                return messages
        walked = walk_records(data)
        self.definitions.check(data, walked.definitions, region, ids)
        if walked.malformed:
            self.losses.note(region.place, "too short to be messages", walked.malformed)
        indexed = indexed_offsets(index, region, list(region.holds or ()))
        if walked.end < len(data) and indexed is not None:
            messages = messages_past_damage(data, walked.offsets, indexed)
        else:
            messages = messages_at(data, walked.offsets)
        if messages:
            _check_times(loaded, region, messages)
        every = messages
        messages = messages.of(ids) if messages else None
        found = len(messages) if messages else 0
        listed = found if offsets is None else len(offsets)
        lost = max(0, listed - found - walked.malformed)
        if every and not lost:
            self._note_undefined(region, every)
        if walked.end < len(data):
            damage = (
                damage or f"its records cannot be followed beyond byte {walked.end} of {len(data)}"
            )
        elif lost:
            damage = damage or "its message index lists messages that are not among its records"
        if damage:
            self.losses.note(region.place, damage, lost or None, self.topic)
        self.lost += lost
        return messages

    def _refuse_redefined(self, loaded: Loaded, region: Region, error: UnreadableDataError) -> None:
        """Refuse a chunk that its checksum shows to be as it was written, not damaged."""
        if loaded.has_checksum:
            raise UnsupportedLogError(
                self.source.path,
                f"{region.place}: {error.reason}; MCAP forbids that; copy the messages with an "
                "MCAP library into a file in which each definition has its own id",
            ) from error

    def _note_undefined(self, region: Region, messages: LocatedMessages) -> None:
        """Note the messages of channels that no record defines."""
        for id_, count in messages.counts().items():
            if region.first_id + id_ not in self.index.channels:
                self.losses.note(f"channel {id_}", UNDEFINED, count, region.start)


def _check_times(loaded: Loaded, region: Region, messages: LocatedMessages) -> None:
    """Refuse a chunk that no checksum shows to be whole, and whose times are not as stated.

    Raises
    ------
    UnreadableDataError
        Log times are outside the range that the chunk states.
    """
    if loaded.has_checksum or region.may_have_logged(messages.block.log_ns):
        return
    if checksums_matter():
        raise UnreadableDataError(
            "its log times are outside the range that it states, so it is not what was recorded; "
            f"with {CHECKSUMS}=ignore it is read all the same"
        )


def message_count(regions: Sequence[Region], ids: Sequence[int]) -> int | None:
    """Return how many messages of some channels the regions hold; None if that is unknown."""
    counts = [region.count(id_) for region in regions for id_ in region.own(ids)]
    return None if None in counts else sum(count for count in counts if count is not None)
