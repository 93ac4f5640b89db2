"""ROS 2 bag folders: SQLite or MCAP, split or not, compressed or not, with or without metadata."""

from __future__ import annotations

import heapq
from collections import defaultdict
from contextlib import closing, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING

from quatprop.base.errors import (
    DamagedLogError,
    LogError,
    Loss,
    UnreadableLogError,
    UnsupportedLogError,
    os_reason,
)
from quatprop.base.provenance import of_all_topics
from quatprop.base.text import plain, quoted
from quatprop.readers.containers.message_log import MessageLog
from quatprop.readers.containers.rosbag2_parts import METADATA, Part, folder, total_count
from quatprop.readers.messages.blocks import Channel, MessageBlock, by_topic
from quatprop.readers.tables.model import NO_BOUND, TimeRange
from quatprop.stores.compression import (
    MAGIC_BYTES,
    DecompressedCopy,
    UnreadableDataError,
    file_compression,
)
from quatprop.stores.file_source import FileSource

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from pathlib import Path


MAX_OPEN = 16
"""Maximum number of parts kept open: a database takes some megabytes. Others are reopened."""


class Rosbag2Log(MessageLog):
    """A ROS 2 bag folder.

    `source_of_part`: opens a part that is not compressed
    """

    kind = "rosbag2"

    def __init__(
        self, path: Path, source_of_part: Callable[[Path], FileSource] = FileSource
    ) -> None:
        super().__init__(path)
        self._source_of_part = source_of_part
        if not path.is_dir():
            raise UnreadableLogError(path, "no such folder; name a ROS 2 bag folder")
        found = folder(path)
        self.losses = found.losses
        self._recorded = of_all_topics(found.custom)
        self._is_zstd = found.message_compression is not None
        if found.message_compression not in (None, "zstd"):
            raise UnsupportedLogError(
                path,
                f"its messages are compressed with {quoted(found.message_compression)} and only "
                "zstd is read; decompress it with `ros2 bag convert`",
            )
        self._parts: list[Part] = []
        try:
            for file in found.parts:
                self._add(file)
        except BaseException:
            self.close()
            raise
        if not self._parts:
            first = self.losses[0]
            raise DamagedLogError(
                path, f"none of its parts can be read; {first.place}: {first.reason}"
            )
        self._stated = found.counts
        self._channels = self._unite_channels(found.counts)

    def _add(self, file: Path) -> None:
        """Add a part, or record why it cannot be opened."""
        part = Part(file)
        try:
            log = self._open(part)
            part.channels = {channel: channel for channel in log.channels()}
        except (LogError, UnreadableDataError, OSError) as error:
            self._give_up(part, error)
            if part.copy:
                part.copy.close()
            return
        self.has_publish_time = log.has_publish_time and (self.has_publish_time or not self._parts)
        self._note(part, log.losses)
        self._parts.append(part)
        if len(self._parts) <= MAX_OPEN:
            part.log = log
        else:
            log.close()

    def _open(self, part: Part) -> MessageLog:
        """Open a part; its compression and storage are detected by content."""
        source = FileSource(part.copy.path) if part.copy else self._source_of_part(part.path)
        if part.copy is None and file_compression(source.read(0, MAGIC_BYTES)):
            source.close()
            part.copy = DecompressedCopy(part.path)
            if part.copy.damage:
                self._note(part, [Loss("end of the file", part.copy.damage)])
            source = FileSource(part.copy.path)
        if source.read(0, 6) == b"SQLite":
            source.close()
            from quatprop.readers.containers.db3 import Db3Log

            return Db3Log(source.path, is_zstd=self._is_zstd)
        from quatprop.readers.containers.mcap import McapLog

        return McapLog(source, is_zstd=self._is_zstd)

    def _note(self, part: Part, losses: Iterable[Loss]) -> None:
        """Record losses of a part."""
        for loss in losses:
            place = f"{plain(part.path.name)}: {loss.place}"
            self.losses.note(place, loss.reason, loss.messages)

    def _give_up(self, part: Part, error: LogError | UnreadableDataError | OSError) -> None:
        reason = os_reason(error) if isinstance(error, OSError) else error.reason
        self._note(part, [Loss("the whole part", str(reason))])

    def _unite_channels(self, stated: dict[tuple[str, str], int]) -> list[Channel]:
        """Group the channels of the parts, and count their messages.

        A missing definition is taken from another part, if all others agree.
        """
        definitions: defaultdict[tuple[str, str], set[tuple[str, bytes]]] = defaultdict(set)
        for channel in (channel for part in self._parts for channel in part.channels):
            if channel.schema:
                definition = channel.schema_encoding, channel.schema
                definitions[channel.type_name, channel.encoding].add(definition)
        counts: dict[Channel, list[int | None]] = {}
        for part in self._parts:
            for channel in part.channels:
                whole = channel
                choices = definitions[channel.type_name, channel.encoding]
                if not channel.schema and len(choices) == 1:
                    ((schema_encoding, schema),) = choices
                    whole = replace(channel, schema_encoding=schema_encoding, schema=schema)
                part.channels[channel] = whole
                counts.setdefault(whole, []).append(channel.count)
        return by_topic(
            replace(channel, count=total_count(found, stated.get(_name(channel))))
            for channel, found in counts.items()
        )

    def channels(self) -> list[Channel]:
        """Return the channels of all parts in order of topic."""
        return list(self._channels)

    def recorded_span(self, channel: Channel) -> TimeRange | None:
        """Return the range of log times of a channel; None if a part has no index of the times."""
        spans = []
        for part, own in self._holding(channel):
            if own.count != 0:
                span = part.log.recorded_span(own) if part.log else None
                if span is None:
                    return None
                spans.append(span)
        ends = [span.first_ns for span in spans], [span.last_ns for span in spans]
        return TimeRange(min(ends[0]), max(ends[1])) if spans else None

    def _holding(self, channel: Channel) -> list[tuple[Part, Channel]]:
        """Return the parts that have a channel, and the part's own channel."""
        return [
            (part, own)
            for part in self._parts
            for own, whole in part.channels.items()
            if whole == channel
        ]

    def blocks(self, channel: Channel, within: TimeRange | None = None) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, always from the part with the earliest next block.

        Consecutive parts are read one after another, overlapping parts alternately.
        """
        streams = [(part, own, within) for part, own in self._holding(channel)]
        waiting = [(NO_BOUND, 0)] if len(streams) == 1 else self._starts(streams)
        heapq.heapify(waiting)
        count = 0
        running: dict[int, Iterator[MessageBlock]] = {}
        while waiting:
            _, k = heapq.heappop(waiting)
            stream = running.pop(k, None) or self._stream(*streams[k])
            block = next(stream, None)
            if block is None:
                continue
            running[k] = stream
            # Not later than the block's end, so that a finished part is closed at once.
            watermark_ns = min(block.watermark_ns, int(block.log_ns.max()))
            heapq.heappush(waiting, (watermark_ns, k))
            count += len(block)
            yield replace(block, watermark_ns=waiting[0][0])
        if within is None:
            self._check_count(channel, count)

    def _check_count(self, channel: Channel, count: int) -> None:
        """Record a loss if metadata.yaml counts more messages than were read or lost."""
        name = _name(channel)
        namesakes = sum(_name(each) == name for each in self._channels)
        lost = sum(loss.messages or 0 for loss in self.losses if loss.place != METADATA)
        missing = self._stated.get(name, 0) - count - lost
        if missing > 0 and namesakes == 1:
            topic = quoted(channel.topic)
            reason = f"it counts {missing} messages of topic {topic} more than there are"
            self.losses.note(METADATA, reason, missing)

    def _starts(
        self, streams: list[tuple[Part, Channel, TimeRange | None]]
    ) -> list[tuple[int, int]]:
        """Return a lower bound of the log times of each stream, and the stream's number.

        The times are read from the parts: after a crash of the recorder the metadata are stale.
        """
        starts = []
        for k, stream in enumerate(streams):
            with closing(self._stream(*stream)) as blocks:
                first = next(blocks, None)
            if first is not None:
                starts.append((min(first.watermark_ns, int(first.log_ns.min())), k))
        return starts

    def _stream(
        self, part: Part, own: Channel, within: TimeRange | None
    ) -> Generator[MessageBlock, None, None]:
        """Yield the messages of one channel of one part."""
        try:
            log = part.log or self._open(part)
        except (LogError, OSError) as error:
            self._give_up(part, error)
            return
        with nullcontext() if part.log else log:
            yield from log.blocks(own, within)
            self._note(part, log.losses)

    def complete(self, completed: Callable[[Channel], Channel]) -> None:
        """Add definitions that channels lack."""
        for part in self._parts:
            part.channels = {own: completed(whole) for own, whole in part.channels.items()}
        self._channels = [completed(channel) for channel in self._channels]

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic as JSON, from metadata.yaml."""
        return self._recorded

    def close(self) -> None:
        """Close the parts and remove the decompressed copies."""
        for part in self._parts:
            if part.log:
                part.log.close()
            if part.copy:
                part.copy.close()


def _name(channel: Channel) -> tuple[str, str]:
    return channel.topic, channel.type_name
