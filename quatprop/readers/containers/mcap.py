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
    MAGIC,
    DefinitionCheck,
    Footer,
    McapIndex,
    Summary,
    heads_at,
    ids_by_channel,
    index_of,
    indexed_offsets,
    messages_at,
    messages_past_damage,
    read_definitions,
    read_footer,
    read_provenance,
    read_summary,
)
from quatprop.readers.containers.mcap_records import (
    MESSAGE,
    MESSAGE_HEAD,
    PEEK,
    RECORD,
    Chunk,
    Loaded,
    load,
    read_chunk_head,
    walk_records,
)
from quatprop.readers.containers.mcap_scan import Scan
from quatprop.readers.containers.topics import ChunkedLog, ChunkReader, decompressed, parts_within
from quatprop.readers.messages.blocks import Channel, MessageBlock, by_topic
from quatprop.stores.compression import CHECKSUMS, UnreadableDataError, checksums_matter
from quatprop.stores.file_source import REMOTE_LARGE, ZeroFilledSource, ranges_worth_reading

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence
    from pathlib import Path

    from quatprop.readers.containers.mcap_index import LocatedMessages
    from quatprop.readers.tables.model import TimeRange
    from quatprop.stores.file_source import FileSource


# Read the messages of a channel from the chunks of an MCAP file, and record losses.


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
        return Loaded(data, offsets=begins[is_wanted])

    def indexed(self, content: Loaded, chunk: Chunk) -> MessageBlock | None:
        """Return the messages of a chunk by its index; None if its records disagree."""
        ids, data = chunk.local_ids(self.ids), content.data
        if content.offsets is not None:
            selected = messages_at(data, content.offsets)
            if selected is None or not chunk.may_have_logged(selected.block.log_ns):
                return None
            self.unchecked.add(chunk.start)
            return self._block(selected, chunk)
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
        return self._block(messages, chunk)

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
                return self._block(messages, chunk) if messages else None
        # An index without messages may be damaged.
        lost = message_count([chunk], self.ids) or None
        self.losses.note(chunk.place, reason, lost, self.topic)
        self.lost += lost or 0
        return None

    def _block(self, messages: LocatedMessages, chunk: Chunk) -> MessageBlock:
        """Return messages, with their publishers if there are several."""
        if len(self.ids) == 1:
            return messages.block
        return messages.with_publishers(chunk.id_offset)

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


_CLAMPED = Remark(
    "clamped-times",
    "log times after the year 2262 do not fit int64 ns and are read as the last that does",
)


class McapLog(ChunkedLog[Chunk]):
    """An MCAP file; see :class:`quatprop.readers.containers.message_log.MessageLog`.

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
    return summary.chunks if read_chunk_head(source, last) else {}
