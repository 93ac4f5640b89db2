"""MCAP files: profiles ros1, ros2 or any other, chunked or not, with or without summary."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.base import LATEST, Channel, MessageBlock, MessageLog
from quatprop.containers.compression import LARGE
from quatprop.containers.file_source import source_of
from quatprop.containers.limits import UnpackBudget
from quatprop.containers.mcap.messages import at_offsets, indexed, walk, with_marks
from quatprop.containers.mcap.metadata import recorded_provenance
from quatprop.containers.mcap.picked import picked
from quatprop.containers.mcap.regions import PEEK, Loaded, RegionError, chunk_head, is_plain, load
from quatprop.containers.mcap.summary import MAGIC
from quatprop.containers.mcap.survey import survey
from quatprop.containers.prefetch import Deferred, prefetch
from quatprop.errors import DamagedLogError, UnreadableLogError, UnsupportedLogError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence
    from pathlib import Path

    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.messages import Messages
    from quatprop.containers.mcap.regions import Region
    from quatprop.containers.mcap.summary import Survey

    Content = Loaded | tuple[Buffer, Messages] | RegionError

_ROS_ENCODINGS = frozenset({"ros1", "cdr"})


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
    contents
        What it holds.

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

    def __init__(self, log: Path | FileSource) -> None:
        self.source = source_of(log)
        super().__init__(self.source.path)
        try:
            magic = self.source.read(0, len(MAGIC))
            if magic != MAGIC:
                self._refuse(magic)
            found = survey(self.source)
        except BaseException as error:
            self.close()
            if isinstance(error, OSError):
                raise self._unreadable(error) from error
            raise
        self.contents = found
        self._regions = found.regions
        self._ids = _by_identity(found)
        self._stated = found.counts
        self.losses = found.losses
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
            self.path, "it does not begin as an MCAP file; check that it was copied whole"
        )

    def channels(self) -> list[Channel]:
        """Return every channel, in order of topic, with or without messages."""
        every = [replace(channel, count=self._count(ids)) for channel, ids in self._ids.items()]
        return sorted(every, key=lambda channel: (channel.topic, channel.type_name))

    def _count(self, ids: Sequence[int]) -> int | None:
        """Return how many messages the channels of these ids have, where that is known."""
        if self._stated is not None:
            return sum(self._stated.get(one, 0) for one in ids)
        return _total(self._regions, ids)

    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk in order of their first times.

        Packed chunks are read and unpacked ahead, in threads. Only chunks that hold the channel are
        read, and nothing is kept, so that memory does not grow with the file.

        Parameters
        ----------
        channel
            One of :meth:`channels`.

        Yields
        ------
        MessageBlock
            The messages of one chunk in the order of the chunk.
        """
        ids = self._ids.get(channel, [])
        regions = [r for r in self._regions if r.holds is None or any(i in r.holds for i in ids)]
        regions.sort(key=lambda region: (region.first_ns, region.start))
        bounds = [*(region.first_ns for region in regions), LATEST][1:]
        found = 0
        load_one = partial(_load, self.source, UnpackBudget(self.source.size), ids)
        with closing(_each(self.source, load_one, regions)) as loaded:
            for region, bound, content in zip(regions, bounds, loaded, strict=True):
                if isinstance(content, RegionError):
                    lost = _total([region], ids)
                    self.losses.note(region.place, content.reason, lost, channel.topic)
                    found += lost or 0
                    continue
                if isinstance(content, Loaded):
                    data, messages = content.data, self._messages(content, region, ids)
                else:
                    data, messages = content
                if messages:
                    found += len(messages)
                    yield _block(data, messages, bound)
        self._check_count(channel.topic, ids, found)

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic, which a metadata record may carry, as JSON."""
        try:
            return recorded_provenance(self.source)
        except OSError as error:
            raise self._unreadable(error) from error

    def close(self) -> None:
        """Close the file."""
        self.source.close()

    def _check_count(self, topic: str, ids: Sequence[int], told: int) -> None:
        """Note when the file states more messages than were read or told as lost."""
        if self._stated is None:
            return
        missing = sum(self._stated.get(one, 0) for one in ids) - told
        if missing > 0:
            reason = f"it counts {missing} messages more than there are"
            self.losses.note("summary", reason, missing, topic)

    def _unreadable(self, error: OSError) -> UnreadableLogError:
        return UnreadableLogError(self.path, f"{error.strerror}; check the path")

    def _messages(self, loaded: Loaded, region: Region, ids: Sequence[int]) -> Messages | None:
        """Locate the messages of a region: by its index, or where that fails by its records."""
        data, raw, damage = loaded
        offsets = indexed(raw, region.start, region, ids)
        if offsets is not None:
            messages = at_offsets(data, offsets)
            if messages is not None and messages.are_all_of(ids):
                return messages
        walked = walk(data)
        if damage:
            self.losses.note(region.place, damage)
        elif walked.end < len(data):
            reason = f"its records cannot be followed beyond byte {walked.end} of {len(data)}"
            self.losses.note(region.place, reason)
        if walked.malformed:
            self.losses.note(region.place, "too short to be messages", walked.malformed)
        every = indexed(raw, region.start, region, list(region.holds or ()))
        if walked.end < len(data) and every is not None:
            messages = with_marks(data, walked.offsets, every)
        else:
            messages = at_offsets(data, walked.offsets)
        return messages.of(ids) if messages else None


def _by_identity(found: Survey) -> dict[Channel, list[int]]:
    """Return the ids of each channel; MCAP gives one to every publisher."""
    ids: dict[Channel, list[int]] = {}
    for id_, record in sorted(found.channels.items()):
        schema = found.schemas.get(record.schema_id)
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
    """Return a ROS type as ``package/msg/Name``, any other as it is."""
    package, slash, rest = name.replace("::", "/").partition("/")
    if encoding not in _ROS_ENCODINGS or not slash:
        return name
    return f"{package}/{rest}" if "/" in rest else f"{package}/msg/{rest}"


def _each(
    source: FileSource, load_one: Callable[[Region], Content], regions: Sequence[Region]
) -> Generator[Content, None, None]:
    """Load regions one after another, ahead where that is worth threads: where they are packed."""

    def load_or_defer(region: Region) -> Content | Deferred[Content]:
        """Load a region; one that would be large only when it is asked for."""
        start = source.read(region.start, PEEK) if region.is_chunk else b""
        head = chunk_head(start, region.length)
        is_large = head is not None and head.size > LARGE
        return Deferred(partial(load_one, region)) if is_large else load_one(region)

    if not regions or is_plain(source, regions[0]):
        yield from map(load_one, regions)
        return
    loaded: Generator[Content, None, None] = prefetch(load_or_defer, regions)
    yield from loaded


def _load(source: FileSource, budget: UnpackBudget, ids: Sequence[int], region: Region) -> Content:
    """Return the picked messages of a region with the bytes around them, or all of it."""
    try:
        return picked(source, region, ids) or load(source, region, budget)
    except RegionError as error:
        return error


def _total(regions: Sequence[Region], ids: Sequence[int]) -> int | None:
    """Return how many messages of some channels the regions hold, where that is known."""
    counts = [region.count(one) for region in regions for one in ids]
    known = [count for count in counts if count is not None]
    return sum(known) if len(known) == len(counts) else None


def _block(data: Buffer, messages: Messages, not_before_ns: int) -> MessageBlock:
    return MessageBlock(
        np.frombuffer(data, np.uint8),
        messages.starts,
        messages.ends,
        messages.log_ns,
        messages.publish_ns,
        not_before_ns,
    )
