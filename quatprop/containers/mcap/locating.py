"""Locate the messages of a channel in loaded regions of an MCAP file, and note what is lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.coalesce import join_blocks
from quatprop.containers.mcap.index import UNDEFINED
from quatprop.containers.mcap.messages import (
    indexed_offsets,
    messages_at,
    messages_past_damage,
    only_messages,
)
from quatprop.containers.mcap.redefinitions import DefinitionCheck
from quatprop.containers.mcap.regions import Loaded, RegionError, index_of
from quatprop.containers.mcap.selected import Selected
from quatprop.containers.mcap.walk import walk_records
from quatprop.errors import UnsupportedLogError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.containers.base import MessageBlock
    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.loading import LoadedGroup
    from quatprop.containers.mcap.loading import Content
    from quatprop.containers.mcap.messages import LocatedMessages
    from quatprop.containers.mcap.regions import Region
    from quatprop.containers.mcap.summary import McapIndex


class MessageLocator:
    """Locates messages in loaded regions.

    Parameters
    ----------
    source
        The file.
    index
        What it holds; losses are added.

    Attributes
    ----------
    definitions
        Compares definitions inside chunks with those of the index.
    unchecked
        Where chunks begin of which only selected messages were read.
    """

    def __init__(self, source: FileSource, index: McapIndex) -> None:
        self.source = source
        self.index = index
        self.losses = index.losses
        self.definitions = DefinitionCheck(index)
        self.unchecked: set[int] = set()

    def block(
        self, loaded: LoadedGroup[Region, Content], topic: str, ids: Sequence[int]
    ) -> tuple[MessageBlock | None, int]:
        """Return the messages of loaded regions; also how many more are known to be lost.

        Parameters
        ----------
        loaded
            The regions.
        topic, ids
            The channel that is wanted, and its ids.

        Raises
        ------
        UnsupportedLogError
            A chunk redefines the channel.
        """
        group, data = loaded.group, _records(loaded)
        everything = self._only_messages(data, loaded, ids)
        if everything is not None:
            return everything.block(data), 0
        blocks, begins, lost = [], [], 0
        for content, region, begin in zip(loaded.contents, group.chunks, group.begins, strict=True):
            messages, missing = self._of_region(content, region, topic, ids)
            lost += missing
            if messages:
                blocks.append(messages.block(data))
                begins.append(begin)
        if not blocks:
            return None, lost
        return join_blocks(np.frombuffer(data, np.uint8), blocks, begins), lost

    def _only_messages(
        self, data: Buffer, loaded: LoadedGroup[Region, Content], ids: Sequence[int]
    ) -> LocatedMessages | None:
        """Return the messages of regions that hold nothing else, which is quick; else None."""
        group = loaded.group
        if any(not isinstance(each, Loaded) or each.damage for each in loaded.contents):
            return None
        first = group.chunks[0]
        try:
            begin = self.definitions.check_leading(data, first, first.own(ids))
        except RegionError:
            return None
        messages = only_messages(data, begin)
        if messages is None:
            return None
        for region, end in zip(group.chunks, [*group.begins[1:], len(data)], strict=True):
            count, rest = divmod(end - begin, messages.stride)
            (id_,) = messages.counts()
            if rest or id_ not in region.own(ids) or region.count(id_) not in {count, None}:
                return None
            begin = end
        return messages

    def _of_region(
        self,
        content: Content,
        region: Region,
        topic: str,
        ids: Sequence[int],
    ) -> tuple[LocatedMessages | None, int]:
        """Locate the messages of one region; also return how many more are known to be lost."""
        if isinstance(content, RegionError):
            return None, self._note_lost(content, region, topic, ids)
        if isinstance(content, Selected):
            self.unchecked.add(region.start)
            return content.messages, 0
        try:
            return self._messages(content, region, topic, ids)
        except RegionError as error:
            self._refuse_redefined(content, region, error)
            return None, self._note_lost(error, region, topic, ids)

    def _messages(
        self, loaded: Loaded, region: Region, topic: str, ids: Sequence[int]
    ) -> tuple[LocatedMessages | None, int]:
        """Locate the messages of a region by its index or, if that fails, by its records.

        Also returns how many more the index lists.
        """
        data, damage, _ = loaded
        ids = region.own(ids)
        index = index_of(self.source, region)
        offsets = indexed_offsets(index, region, ids)
        if offsets is not None:
            messages = messages_at(data, offsets)
            if messages is not None and messages.are_all_of(ids):
                self.definitions.check_beside(data, index, region, ids, messages)
                return messages, 0
        walked = walk_records(data)
        self.definitions.check(data, walked.definitions, region, ids)
        if walked.malformed:
            self.losses.note(region.place, "too short to be messages", walked.malformed)
        indexed = indexed_offsets(index, region, list(region.holds or ()))
        if walked.end < len(data) and indexed is not None:
            messages = messages_past_damage(data, walked.offsets, indexed)
        else:
            messages = messages_at(data, walked.offsets)
        if offsets is None and messages:
            self._note_undefined(region, messages)
        messages = messages.of(ids) if messages else None
        found = len(messages) if messages else 0
        listed = found if offsets is None else len(offsets)
        lost = max(0, listed - found - walked.malformed)
        if damage:
            self.losses.note(region.place, damage, lost or None, topic)
        elif walked.end < len(data):
            reason = f"its records cannot be followed beyond byte {walked.end} of {len(data)}"
            self.losses.note(region.place, reason, lost or None, topic)
        elif lost:
            reason = "its message index lists messages that are not among its records"
            self.losses.note(region.place, reason, lost, topic)
        return messages, lost

    def _note_lost(self, error: RegionError, region: Region, topic: str, ids: Sequence[int]) -> int:
        lost = message_count([region], ids)
        self.losses.note(region.place, error.reason, lost, topic)
        return lost or 0

    def _refuse_redefined(self, loaded: Loaded, region: Region, error: RegionError) -> None:
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


def message_count(regions: Sequence[Region], ids: Sequence[int]) -> int | None:
    """Return how many messages of some channels the regions hold; None if that is unknown."""
    counts = [region.count(id_) for region in regions for id_ in region.own(ids)]
    return None if None in counts else sum(count for count in counts if count is not None)


def _records(loaded: LoadedGroup[Region, Content]) -> Buffer:
    """Return the records of all regions, one after another."""
    if loaded.group.buffer is not None:
        return loaded.group.buffer.data
    (content,) = loaded.contents
    return b"" if isinstance(content, RegionError) else content.data
