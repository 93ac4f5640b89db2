"""MCAP files: profiles ros1, ros2 or any other, chunked or not, with or without summary."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.base import LATEST, Channel, MessageBlock, MessageLog, TimeRange
from quatprop.containers.file_source import source_of
from quatprop.containers.mcap.definitions import ids_by_channel
from quatprop.containers.mcap.index import UNDEFINED, build_index
from quatprop.containers.mcap.loading import load_regions
from quatprop.containers.mcap.messages import (
    LocatedMessages,
    indexed_offsets,
    messages_at,
    messages_past_damage,
    only_messages,
)
from quatprop.containers.mcap.metadata import read_provenance
from quatprop.containers.mcap.redefinitions import DefinitionCheck
from quatprop.containers.mcap.regions import Loaded, RegionError, index_of
from quatprop.containers.mcap.selected import Selected
from quatprop.containers.mcap.summary import MAGIC
from quatprop.containers.mcap.walk import walk_records
from quatprop.errors import DamagedLogError, UnreadableLogError, UnsupportedLogError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence
    from pathlib import Path

    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.loading import LoadedGroup
    from quatprop.containers.mcap.loading import Content
    from quatprop.containers.mcap.regions import Region


class McapLog(MessageLog):
    """An MCAP file; see :class:`quatprop.containers.base.MessageLog`.

    Parameters
    ----------
    log
        The file.

    Attributes
    ----------
    source
        The open file.
    index
        What it holds and where.

    Raises
    ------
    UnreadableLogError
        The file is missing or may not be read.
    UnsupportedLogError
        It is of another major version.
    DamagedLogError
        It is no MCAP file, or nothing of it can be read.
    """

    kind = "mcap"
    has_publish_time = True

    def __init__(self, log: Path | FileSource) -> None:
        self.source = source_of(log)
        super().__init__(self.source.path)
        try:
            magic = self.source.read(0, len(MAGIC))
            if magic != MAGIC:
                self._refuse(magic)
            self.index = index = build_index(self.source)
        except BaseException as error:
            self.close()
            if isinstance(error, OSError):
                raise self._unreadable(error) from error
            raise
        self._regions = index.regions
        self._unchecked: set[int] = set()
        self._ids = ids_by_channel(index)
        self._definitions = DefinitionCheck(index)
        self._stated = index.counts
        self.losses = index.losses
        if self.losses and not (self._ids or self._regions):
            first = self.losses[0]
            raise DamagedLogError(
                self.path, f"nothing of it can be read; {first.place}: {first.reason}"
            )

    def _refuse(self, magic: bytes) -> None:
        if len(magic) == len(MAGIC) and magic[:5] + magic[6:] == MAGIC[:5] + MAGIC[6:]:
            version = chr(magic[5])
            raise UnsupportedLogError(
                self.path, f"it is MCAP of version {version!r} and only version '0' is read"
            )
        raise DamagedLogError(
            self.path, "it does not begin as an MCAP file; check that the whole file was copied"
        )

    def channels(self) -> list[Channel]:
        """Return every channel, in order of topic, with or without messages."""
        channels = [replace(channel, count=self._count(ids)) for channel, ids in self._ids.items()]
        return sorted(channels, key=lambda channel: (channel.topic, channel.type_name))

    def _count(self, ids: Sequence[int]) -> int | None:
        """Return how many messages the channels of these ids have; None if that is unknown."""
        if self._stated is not None:
            return sum(self._stated.get(id_, 0) for id_ in ids)
        return _message_count(self._regions, ids)

    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk in order of their first times.

        Compressed chunks are read and decompressed ahead, in threads. Only chunks that hold the
        channel are read, and none is kept, so memory use does not grow with the file.

        Parameters
        ----------
        channel
            One of :meth:`channels`.

        Yields
        ------
        MessageBlock
            The messages of one chunk in the order of the chunk.
        """
        ids, regions = self._regions_of(channel)
        count = yield from self._blocks(channel, ids, regions)
        self._check_count(channel.topic, ids, count)

    def recorded_span(self, channel: Channel) -> TimeRange | None:
        """Return when a channel was recorded; None where the file has no chunk index."""
        _, regions = self._regions_of(channel)
        last = [region.last_ns for region in regions if region.last_ns is not None]
        if not regions or len(last) < len(regions):
            return None
        return TimeRange(regions[0].first_ns, max(last))

    def blocks_within(self, channel: Channel, within: TimeRange) -> Iterator[MessageBlock]:
        """Yield the messages of the chunks that overlap a range of log times."""
        ids, regions = self._regions_of(channel)
        yield from self._blocks(
            channel,
            ids,
            [r for r in regions if r.last_ns is None or within.overlaps(r.first_ns, r.last_ns)],
        )

    def _regions_of(self, channel: Channel) -> tuple[list[int], list[Region]]:
        """Return the ids of a channel, and the regions that may hold it, in order of time."""
        ids = self._ids.get(channel, [])
        regions = [r for r in self._regions if r.holds is None or not set(ids).isdisjoint(r.ids)]
        return ids, sorted(regions, key=lambda region: (region.first_ns, region.start))

    def _blocks(
        self, channel: Channel, ids: list[int], regions: list[Region]
    ) -> Generator[MessageBlock, None, int]:
        """Yield the messages in some regions, and return how many there were or are lost."""
        bounds = [*(region.first_ns for region in regions), LATEST]
        done = count = 0
        with closing(load_regions(self.source, regions, ids, self._definitions)) as groups:
            for group in groups:
                done += len(group.contents)
                data, messages, lost = self._located(group, channel.topic, ids)
                count += len(messages) + lost
                if len(messages):
                    self._remark_on_clamped(messages)
                    yield _block(data, messages, bounds[done])
        return count

    def _located(
        self, loaded: LoadedGroup[Region, Content], topic: str, ids: Sequence[int]
    ) -> tuple[Buffer, LocatedMessages, int]:
        """Locate the messages of a group; also return how many more are known to be lost."""
        group = loaded.group
        everything = self._only_messages(loaded, ids)
        if everything is not None:
            return _records(loaded), everything, 0
        parts, lost = [], 0
        each = zip(loaded.contents, group.chunks, group.begins, strict=True)
        for content, region, begin in each:
            messages, missing = self._of_region(content, region, topic, ids)
            lost += missing
            if messages:
                parts.append(messages.moved(begin))
        return _records(loaded), LocatedMessages.joined(parts), lost

    def _only_messages(
        self, loaded: LoadedGroup[Region, Content], ids: Sequence[int]
    ) -> LocatedMessages | None:
        """Return the messages of regions that hold nothing else, which is quick; else None."""
        data, group = _records(loaded), loaded.group
        if any(not isinstance(each, Loaded) or each.damage for each in loaded.contents):
            return None
        first = group.chunks[0]
        try:
            begin = self._definitions.check_leading(data, first, first.own(ids))
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
            self._unchecked.add(region.start)
            self.unchecked_chunks = len(self._unchecked)
            return content.messages, 0
        try:
            return self._messages(content, region, topic, ids)
        except RegionError as error:
            self._refuse_redefined(content, region, error)
            return None, self._note_lost(error, region, topic, ids)

    def complete(self, completed: Callable[[Channel], Channel]) -> None:
        """Add definitions that channels lack."""
        ids_by_channel: dict[Channel, list[int]] = {}
        for channel, ids in self._ids.items():
            ids_by_channel.setdefault(completed(channel), []).extend(ids)
        self._ids = ids_by_channel

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic, which a metadata record may carry, as JSON."""
        try:
            return read_provenance(self.source, self.index.metadata)
        except OSError as error:
            raise self._unreadable(error) from error

    def close(self) -> None:
        """Close the file."""
        self.source.close()

    def _remark_on_clamped(self, messages: LocatedMessages) -> None:
        remark = (
            "log times after the year 2262 do not fit int64 ns and are read as the last that does"
        )
        if messages.log_ns.max() == LATEST and remark not in self.remarks:
            self.remarks = [*self.remarks, remark]

    def _check_count(self, topic: str, ids: Sequence[int], count: int) -> None:
        """Note a loss if the file states more messages than were read or lost."""
        if self._stated is None:
            return
        missing = sum(self._stated.get(id_, 0) for id_ in ids) - count
        if missing > 0:
            reason = f"it counts {missing} messages more than there are"
            self.losses.note("summary", reason, missing, topic)

    def _unreadable(self, error: OSError) -> UnreadableLogError:
        return UnreadableLogError(self.path, f"{error.strerror}; check the path")

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
                self._definitions.check_beside(data, index, region, ids, messages)
                return messages, 0
        walked = walk_records(data)
        self._definitions.check(data, walked.definitions, region, ids)
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
        lost = _message_count([region], ids)
        self.losses.note(region.place, error.reason, lost, topic)
        return lost or 0

    def _refuse_redefined(self, loaded: Loaded, region: Region, error: RegionError) -> None:
        """Refuse a chunk that its checksum shows to be as it was written, not damaged."""
        if loaded.has_checksum:
            raise UnsupportedLogError(
                self.path,
                f"{region.place}: {error.reason}; MCAP forbids that; copy the messages with an "
                "MCAP library into a file in which each definition has its own id",
            ) from error

    def _note_undefined(self, region: Region, messages: LocatedMessages) -> None:
        """Note the messages of channels that no record defines."""
        for id_, count in messages.counts().items():
            if region.first_id + id_ not in self.index.channels:
                self.losses.note(f"channel {id_}", UNDEFINED, count, region.start)


def _message_count(regions: Sequence[Region], ids: Sequence[int]) -> int | None:
    """Return how many messages of some channels the regions hold; None if that is unknown."""
    counts = [region.count(id_) for region in regions for id_ in region.own(ids)]
    return None if None in counts else sum(count for count in counts if count is not None)


def _records(loaded: LoadedGroup[Region, Content]) -> Buffer:
    """Return the records of all regions, one after another."""
    if loaded.group.buffer is not None:
        return loaded.group.buffer.data
    (content,) = loaded.contents
    return b"" if isinstance(content, RegionError) else content.data


def _block(data: Buffer, messages: LocatedMessages, not_before_ns: int) -> MessageBlock:
    return MessageBlock(
        np.frombuffer(data, np.uint8),
        messages.starts,
        messages.ends,
        messages.log_ns,
        messages.publish_ns,
        not_before_ns,
        messages.stride,
    )
