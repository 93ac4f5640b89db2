"""MCAP files: any profile, chunked or not, with or without a summary."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import DamagedLogError, UnsupportedLogError
from quatprop.base.text import Remark, quoted
from quatprop.base.times import LATEST
from quatprop.readers.containers.mcap_index import (
    DefinitionCheck,
    Footer,
    McapIndex,
    Summary,
    heads_at,
    ids_by_channel,
    index_of,
    indexed_offsets,
    messages_at,
    read_definitions,
    read_footer,
    read_provenance,
    read_summary,
)
from quatprop.readers.containers.mcap_records import (
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    PEEK,
    RECORD,
    Chunk,
    load_chunk,
    read_chunk_head,
    walk_records,
)
from quatprop.readers.containers.mcap_scan import Scan
from quatprop.readers.containers.message_log import MessageLog
from quatprop.readers.containers.parts import (
    decompressed,
    opening,
    parts_within,
    read_parts,
    span_of,
    system_errors,
)
from quatprop.readers.messages.blocks import Channel, MessageBlock, by_topic
from quatprop.stores.compression import (
    CHECKSUMS,
    DecompressionBudget,
    UnreadableDataError,
    checksums_matter,
)
from quatprop.stores.file_source import (
    REMOTE_LARGE,
    ZeroFilledSource,
    ranges_worth_reading,
    source_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator, Sequence
    from pathlib import Path

    from quatprop.readers.containers.mcap_index import LocatedMessages
    from quatprop.readers.containers.mcap_records import Content, WalkedRecords
    from quatprop.readers.containers.parts import Loaded, Lost
    from quatprop.readers.tables.model import TimeRange
    from quatprop.stores.file_source import FileSource


# Read the messages of a channel from the chunks of an MCAP file, and record losses.


UNDEFINED = "no record defines it"
"""The reason of loss of a channel without a definition."""


class McapReader:
    """Reads the messages of one channel; see :class:`.PartReader`.

    `definitions`: compares definitions in chunks with those of the index, to which losses are added
    `unchecked`: offsets of the chunks of which only selected messages were read; grows
    `lost`: number of messages of the channel that were recorded as lost
    """

    def __init__(
        self,
        source: FileSource,
        definitions: DefinitionCheck,
        topic: str,
        ids: Sequence[int],
        unchecked: set[int],
    ) -> None:
        self.source, self.budget = source, DecompressionBudget(source.size)
        self.definitions, self.topic, self.ids = definitions, topic, ids
        self.index = definitions.index
        self.unchecked = unchecked
        self.lost = 0

    def is_mixed(self, part: Chunk) -> bool:
        """Return whether a chunk is known to have other channels."""
        return not {*part.ids} <= {*self.ids}

    def expected(self, part: Chunk) -> list[tuple[int, int]]:
        """Return the byte range of a chunk, or those of head and index if it is read in part."""
        head_end = part.start + PEEK
        if self._is_read_in_part(part):
            return [(part.start, head_end), (part.start + part.length, part.end)]
        return [(part.start, max(part.end, head_end))]

    def size_of(self, part: Chunk) -> int:
        """Return the bytes of the records of a chunk by the index."""
        return part.size

    def load(self, part: Chunk) -> Loaded:
        """Return the messages of the channel in a chunk, and what of it is lost."""
        if self._is_read_in_part(part):
            with suppress(UnreadableDataError, OSError):
                selected = self._selected(part)
                if selected is not None:
                    self.unchecked.add(part.start)
                    return self._block(selected, part), []
        try:
            return self._messages(load_chunk(self.source, part, self.budget), part)
        except UnreadableDataError as error:
            # An index without messages may be damaged.
            lost = message_count([part], self.ids) or None
            return None, [(part.place, error.reason, lost, self.topic)]

    def note(self, place: str, reason: str, messages: int | None, part: Hashable) -> None:
        """Record a loss, and count messages of the channel."""
        self.lost += (messages or 0) if part == self.topic else 0
        self.index.losses.note(place, reason, messages, part)

    def _is_read_in_part(self, chunk: Chunk) -> bool:
        is_large = not self.source.is_remote or chunk.length > REMOTE_LARGE
        return is_large and chunk.can_be_read_in_part and self.is_mixed(chunk)

    def _selected(self, chunk: Chunk) -> LocatedMessages | None:
        """Return the wanted messages of a chunk; None if it is better read whole.

        The records before the first message are read, too, and the heads of all messages, to verify
        that there are no others. The chunk's checksum is not verified.
        """
        own, index = chunk.local_ids(self.ids), index_of(self.source, chunk)
        wanted, every = indexed_offsets(index, chunk, own), indexed_offsets(index, chunk)
        head = read_chunk_head(self.source, chunk)
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
        selected = messages_at(data, begins[is_wanted])
        return selected if selected and chunk.may_have_logged(selected.block.log_ns) else None

    def _messages(self, content: Content, chunk: Chunk) -> Loaded:
        """Return the messages in the records of a chunk, and what is lost by its index."""
        data, ids = content.data, chunk.local_ids(self.ids)
        lost: list[Lost] = []
        index = index_of(self.source, chunk)
        listed, every = indexed_offsets(index, chunk, ids), indexed_offsets(index, chunk)
        walked = walk_records(data, stop_at={MESSAGE})
        located = None if every is None else messages_at(data, every)
        # Between other records there may be messages that no index lists.
        is_indexed = bool(located and located.fill(data, walked.end))
        if not is_indexed:
            walked = walk_records(data)
            # Where records cannot be followed, the length of the last one may be wrong.
            is_broken = walked.end < len(data) and not content.damage
            located = messages_at(data, walked.offsets[: -1 if is_broken else None])
        self._check_definitions(content, walked, chunk, ids)
        if located:
            _check_times(content, chunk, located)
        wanted = located.of(ids) if located else None
        missing = 0 if listed is None else len(listed) - len(wanted or ()) - walked.malformed
        if walked.malformed:
            lost.append((chunk.place, "too short to be messages", walked.malformed, None))
        if located and not is_indexed and missing <= 0:
            lost += self._undefined(chunk, located)
        damage = content.damage
        if not is_indexed and walked.end < len(data):
            damage = (
                damage or f"its records cannot be followed beyond byte {walked.end} of {len(data)}"
            )
        elif missing > 0:
            damage = damage or "its message index lists messages that are not among its records"
        if damage:
            lost.append((chunk.place, damage, max(0, missing) or None, self.topic))
        return (self._block(wanted, chunk) if wanted else None), lost

    def _block(self, messages: LocatedMessages, chunk: Chunk) -> MessageBlock:
        """Return messages, with their publishers if there are several."""
        if len(self.ids) == 1:
            return messages.block
        return messages.with_publishers(chunk.id_offset)

    def _check_definitions(
        self, content: Content, walked: WalkedRecords, chunk: Chunk, ids: Sequence[int]
    ) -> None:
        """Raise an error for a chunk that redefines a channel.

        It refuses the file if a checksum shows that the chunk is not damaged but written so.
        """
        try:
            self.definitions.check(content.data, walked.definitions, chunk, ids)
        except UnreadableDataError as error:
            if not content.has_checksum:
                raise
            raise UnsupportedLogError(
                self.source.path,
                f"{chunk.place}: {error.reason}; MCAP forbids that; copy the messages with an "
                "MCAP library into a file in which each definition has its own id",
            ) from error

    def _undefined(self, chunk: Chunk, messages: LocatedMessages) -> list[Lost]:
        """Return messages of undefined channels as lost."""
        return [
            (f"channel {id_}", UNDEFINED, count, chunk.start)
            for id_, count in messages.counts().items()
            if chunk.id_offset + id_ not in self.index.channels
        ]


def _check_times(content: Content, chunk: Chunk, messages: LocatedMessages) -> None:
    """Refuse a chunk without a checksum whose log times are outside its stated range."""
    if content.has_checksum or chunk.may_have_logged(messages.block.log_ns):
        return
    if checksums_matter():
        raise UnreadableDataError(
            "its log times are outside the range in its header, so it is not what was recorded; "
            f"with {CHECKSUMS}=ignore it is read anyway"
        )


def message_count(chunks: Sequence[Chunk], ids: Sequence[int]) -> int | None:
    """Return the number of messages of some channels in some chunks; None if unknown."""
    counts = [chunk.count(id_) for chunk in chunks for id_ in chunk.local_ids(ids)]
    return None if None in counts else sum(count for count in counts if count is not None)


_CLAMPED = Remark(
    "clamped-times",
    "log times after the year 2262 do not fit int64 ns and are read as the last that does",
)


class McapLog(MessageLog):
    """An MCAP file; see :class:`.MessageLog`.

    `is_zstd`: whether messages are compressed one by one; for CDR this is detected, too
    """

    kind = "mcap"
    has_publish_time = True

    def __init__(self, log: Path | FileSource, *, is_zstd: bool = False) -> None:
        self._is_zstd = is_zstd
        self.source = source_of(log)
        super().__init__(self.source.path)
        with opening(self.source):
            self._read_index()

    def _read_index(self) -> None:
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

    def parts(self, channel: Channel) -> list[Chunk]:
        """Return the chunks that may have messages of a channel, in order of time."""
        ids, chunks = self._ids.get(channel, []), self._chunks
        if self._are_accounted_for(ids):
            chunks = [chunk for chunk in chunks if not set(ids).isdisjoint(chunk.ids)]
        return sorted(chunks, key=lambda chunk: (chunk.first_ns, chunk.start))

    def recorded_span(self, channel: Channel) -> TimeRange | None:
        """Return the range of log times of a channel; None if the file has no index of chunks."""
        return span_of(self.parts(channel))

    def blocks(self, channel: Channel, within: TimeRange | None = None) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, and compare their number with the statistics."""
        ids = self._ids.get(channel, [])
        reader = McapReader(self.source, self._definitions, channel.topic, ids, self._unchecked)
        count = 0
        parts = parts_within(self.parts(channel), within)
        for block in read_parts(self.source, parts, reader):
            count += len(block)
            self.unchecked_chunks = len(self._unchecked)
            self._remark_on_clamped(block)
            messages, lost = decompressed(block, channel.encoding, is_known=self._is_zstd)
            if lost:
                place, reason = f"topic {quoted(channel.topic)}", "their zstd data is damaged"
                self.losses.note(place, reason, lost, int(block.log_ns[0]))
            if len(messages):
                yield messages
        if within is None:
            self._check_count(channel.topic, ids, count + reader.lost)

    def publishers(self, channel: Channel) -> dict[int, str]:
        """Return the publishers of a channel by channel ids, which each of them has of its own."""
        records = {id_: self.index.channels[id_] for id_ in self._ids.get(channel, [])}
        nodes = {
            id_: record.metadata.get("callerid") or f"channel-{id_}"
            for id_, record in records.items()
        }
        return nodes if len({*nodes.values()}) > 1 else {}

    def complete(self, completed: Callable[[Channel], Channel]) -> None:
        """Add definitions that channels lack."""
        ids_of: dict[Channel, list[int]] = {}
        for channel, ids in self._ids.items():
            ids_of.setdefault(completed(channel), []).extend(ids)
        self._ids = ids_of

    def recorded_provenance(self) -> dict[str, str]:
        """Return the provenance of each topic as JSON, from the metadata records."""
        with system_errors(self.path):
            return read_provenance(self.source, self.index.metadata)

    def close(self) -> None:
        """Close the file."""
        self.source.close()

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
    return summary.chunks if read_chunk_head(source, last) else {}
