"""MCAP files: any profile, chunked or not, with or without a summary."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from quatprop.containers.chunks import ChunkedLog, parts_within
from quatprop.containers.compressed_messages import decompressed
from quatprop.containers.mcap.chunks import Chunk, head_of
from quatprop.containers.mcap.definitions import DefinitionCheck, ids_by_channel, read_definitions
from quatprop.containers.mcap.loading import UNDEFINED, McapReader
from quatprop.containers.mcap.scan import Scan
from quatprop.containers.mcap.summary import (
    MAGIC,
    Footer,
    McapIndex,
    Summary,
    read_footer,
    read_provenance,
    read_summary,
)
from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.messages.blocks import Channel, MessageBlock, by_topic
from quatprop.stores.zero_filled import ZeroFilledSource
from quatprop.text import Remark, quoted
from quatprop.times import LATEST

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence
    from pathlib import Path

    from quatprop.stores.file_source import FileSource
    from quatprop.tables.model import TimeRange

_CLAMPED = Remark(
    "clamped-times",
    "log times after the year 2262 do not fit int64 ns and are read as the last that does",
)


class McapLog(ChunkedLog[Chunk]):
    """An MCAP file; see :class:`quatprop.containers.base.MessageLog`.

    `is_zstd`: whether messages are compressed one by one; for CDR this is detected, too
    """

    kind = "mcap"
    has_publish_time = True

    def __init__(self, log: Path | FileSource, *, is_zstd: bool = False) -> None:
        self._is_zstd = is_zstd
        super().__init__(log)

    def read_index(self) -> None:
        """Read the index of the file."""
        magic = self.source.read(0, len(MAGIC))
        if magic != MAGIC:
            self._refuse(magic)
        self.index = index = build_index(self.source)
        self._chunks = index.chunks
        self._ids = ids_by_channel(index)
        self._definitions = DefinitionCheck(index)
        self._unchecked: set[int] = set()
        self._stated = index.counts
        self.losses = index.losses
        if self.losses and not (self._ids or self._chunks):
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
        """Return all channels in order of topic, with or without messages."""
        return by_topic(replace(c, count=self._count(ids)) for c, ids in self._ids.items())

    def _count(self, ids: Sequence[int]) -> int | None:
        """Return the number of messages of some channel ids; None if unknown."""
        if self._are_accounted_for(ids):
            return self._stated_of(ids)
        # A damaged index may list no messages.
        return self._stated_of(ids) or self._listed_of(ids) or None

    def _stated_of(self, ids: Sequence[int]) -> int | None:
        """Return the number of messages of some channels by the statistics; None without these."""
        return None if self._stated is None else sum(self._stated.get(id_, 0) for id_ in ids)

    def _listed_of(self, ids: Sequence[int]) -> int | None:
        """Return the number of messages of some channels by the chunk indexes; None if unknown."""
        return None if self._listed is None else sum(self._listed[id_] for id_ in ids)

    @cached_property
    def _listed(self) -> Counter[int] | None:
        total: Counter[int] = Counter()
        for chunk in self._chunks:
            listed = chunk.listed()
            if listed is None:
                return None
            for id_, count in listed.items():
                total[chunk.id_offset + id_] += count
        return total

    def _are_accounted_for(self, ids: Sequence[int]) -> bool:
        """Return whether the indexes list as many messages of some channels as the statistics.

        Otherwise a damaged index may lack a channel that its chunk has.
        """
        stated = self._stated_of(ids)
        return stated is not None and stated == self._listed_of(ids)

    def chunks_of(self, channel: Channel) -> list[Chunk]:
        """Return the chunks that may have messages of a channel, in order of time."""
        ids, chunks = self._ids.get(channel, []), self._chunks
        if self._are_accounted_for(ids):
            chunks = [chunk for chunk in chunks if not set(ids).isdisjoint(chunk.ids)]
        return sorted(chunks, key=lambda chunk: (chunk.first_ns, chunk.start))

    def blocks(self, channel: Channel, within: TimeRange | None = None) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, and compare their number with the statistics."""
        count = yield from self.read(channel, parts_within(self.chunks_of(channel), within))
        if within is None:
            self._check_count(channel.topic, self._ids.get(channel, []), count)

    def read(self, channel: Channel, chunks: Sequence[Chunk]) -> Generator[MessageBlock, None, int]:
        """Yield the messages of one channel in some chunks; return the number read or lost."""
        ids = self._ids.get(channel, [])
        reader = McapReader(self.source, self._definitions, channel.topic, ids, self._unchecked)
        count = 0
        for block in reader.blocks(chunks):
            count += len(block)
            self.unchecked_chunks = len(self._unchecked)
            self._remark_on_clamped(block)
            messages, lost = decompressed(block, channel.encoding, is_known=self._is_zstd)
            if lost:
                place, reason = f"topic {quoted(channel.topic)}", "their zstd data is damaged"
                self.losses.note(place, reason, lost, int(block.log_ns[0]))
            if len(messages):
                yield messages
        return count + reader.lost

    def complete(self, completed: Callable[[Channel], Channel]) -> None:
        """Add definitions that channels lack."""
        ids_of: dict[Channel, list[int]] = {}
        for channel, ids in self._ids.items():
            ids_of.setdefault(completed(channel), []).extend(ids)
        self._ids = ids_of

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic as JSON, from the metadata records."""
        try:
            return read_provenance(self.source, self.index.metadata)
        except OSError as error:
            raise self.unreadable(error) from error

    def _remark_on_clamped(self, block: MessageBlock) -> None:
        if block.log_ns.max() == LATEST and _CLAMPED not in self.remarks:
            self.remarks = [*self.remarks, _CLAMPED]

    def _check_count(self, topic: str, ids: Sequence[int], count: int) -> None:
        """Record a loss if the statistics state more messages than were read or lost."""
        missing = (self._stated_of(ids) or 0) - count - self._undefined()
        if missing > 0:
            reason = f"it counts {missing} messages more than there are"
            self.losses.note("summary", reason, missing, topic)

    def _undefined(self) -> int:
        """Return the number of lost messages of undefined channels, which may be any channel's."""
        stated = {f"channel {id_}" for id_ in self._stated or ()}
        lost = [loss for loss in self.losses if loss.reason == UNDEFINED]
        return sum(loss.messages or 0 for loss in lost if loss.place not in stated)


def build_index(source: FileSource) -> McapIndex:
    """Return the index of a file, with `losses` for what cannot be read.

    The summary at its end is used if it is intact and agrees with the file. Parts that it does not
    cover, or the whole file if it has none, are scanned record by record.
    """
    searched = ZeroFilledSource(source)
    footer = read_footer(searched)
    summary = Summary() if footer is None else _read_summary(searched, footer)
    end = source.size
    if footer is not None:
        end = footer.data_end if summary else footer.footer_start
    scan = _scanned(searched, end, summary, is_closed=footer is not None)
    if footer is not None and not summary and scan.summary_start not in {0, footer.data_end}:
        # Bytes are missing or inserted before the summary, so the footer's offset is wrong.
        summary = _read_summary(searched, footer._replace(summary_start=scan.summary_start))
    index = summary.index
    index.chunks, index.losses = scan.chunks, scan.losses
    for opcode, content, place, id_offset in scan.definitions.records:
        index.define(opcode, content, place, id_offset)
    read_definitions(source, index, is_complete=summary.is_complete, is_closed=footer is not None)
    for chunk in index.chunks:
        for id_ in chunk.message_index_offsets or ():
            if chunk.id_offset + id_ not in index.channels:
                index.losses.note(f"channel {id_}", UNDEFINED, chunk.count(id_), chunk.start)
    return index


def _read_summary(source: ZeroFilledSource, footer: Footer) -> Summary:
    """Return the summary; an empty one if a part of it cannot be read."""
    summary = read_summary(source, footer)
    unreadable = source.first_unreadable(footer.summary_start, source.size)
    return summary if unreadable is None else Summary()


def _scanned(source: ZeroFilledSource, end: int, summary: Summary, *, is_closed: bool) -> Scan:
    """Scan the data section, except for chunks of the summary that are where it states."""
    usable = _usable_chunks(source, summary)
    scan = Scan(source, end, dict(usable), summary.attachments)
    scan.run(is_closed=is_closed)
    # The scan missed a chunk, or no record begins where one ends.
    if usable and (scan.indexed or scan.losses):
        scan = Scan(source, end, {}, summary.attachments)
        scan.run(is_closed=is_closed)
    if scan.losses:
        scan.add_lost(summary.chunks.values())
    return scan


def _usable_chunks(source: FileSource, summary: Summary) -> dict[int, Chunk]:
    """Return the chunks of the summary; none if bytes are missing or inserted before the last one.

    The definitions in the summary are used in any case.
    """
    if not summary.chunks:
        return {}
    last = summary.chunks[max(summary.chunks)]
    return summary.chunks if head_of(source, last) else {}
