"""What an MCAP file holds and where: channels, schemas, and the regions with messages.

The summary at the end of the file is taken where it is whole and agrees with the file. What it
does not cover, or the whole file where it is missing, is scanned: record by record, over the
content of chunks and attachments without reading it. Where the records cannot be followed, it goes
on at the next that is one beyond doubt.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from quatprop.checksum import crc32
from quatprop.containers.base import LATEST, Losses
from quatprop.containers.compression import MAX_SIZE
from quatprop.containers.limits import UnpackBudget, checksums_matter
from quatprop.containers.mcap.messages import at_offsets, walk
from quatprop.containers.mcap.regions import (
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    DATA_END,
    INDEX_HEAD,
    MESSAGE,
    MESSAGE_INDEX,
    PEEK,
    RECORD,
    SCHEMA,
    TORN,
    Region,
    RegionError,
    chunk_head,
    load,
)
from quatprop.containers.mcap.resync import CHUNKS, RECORDS, next_record
from quatprop.containers.mcap.summary import MAGIC, Summary, read_footer, read_summary

if TYPE_CHECKING:
    from collections.abc import Container

    from quatprop.containers.compression import Buffer
    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.summary import Footer, Survey

_STRETCH = 1 << 22
"""Bytes of messages outside chunks that are one region."""
_NOT_MESSAGES = frozenset(range(256)) - {SCHEMA, CHANNEL, MESSAGE}
_FIRST_PRIVATE_OPCODE = 0x80


def survey(source: FileSource) -> Survey:
    """Find out what a file that begins with :data:`MAGIC` holds.

    Parameters
    ----------
    source
        The file.

    Returns
    -------
    Survey
        All of it that can be read; `losses` says what cannot.
    """
    footer = read_footer(source)
    summary = Summary() if footer is None else read_summary(source, footer)
    end = _end_of_data(source, footer, summary)
    scan = _Scan(source, end, _where_it_says(source, summary))
    scan.run(is_closed=footer is not None)
    if footer is not None and not summary and scan.summary_start not in {0, footer.data_end}:
        # Bytes are missing, or too many, before the summary: it is not where the footer says.
        summary = read_summary(source, replace(footer, summary_start=scan.summary_start))
    if scan.known:  # chunks that the scan passed over: the summary does not fit the file
        summary = Summary()
        scan = _Scan(source, end, {})
        scan.run(is_closed=footer is not None)
    found = summary.found
    found.regions, found.losses = scan.regions, scan.losses
    for opcode, content, place in scan.definitions:
        found.define(opcode, content, place)
    _look_inside(source, found, is_complete=summary.is_complete)
    for channel in {id_ for region in found.regions for id_ in region.holds or ()}:
        if channel not in found.channels:
            found.losses.note(f"channel {channel}", "no record says what it is")
    return found


def _end_of_data(source: FileSource, footer: Footer | None, summary: Summary) -> int:
    """Return where the scan ends at the latest."""
    if footer is None:
        return source.size
    return footer.data_end if summary else footer.footer_start


def _where_it_says(source: FileSource, summary: Summary) -> dict[int, Region]:
    """Return the chunks of the summary; none where bytes are missing or too many before the last.

    What else it says stands then all the same.
    """
    if not summary.chunks:
        return {}
    last = summary.chunks[max(summary.chunks)]
    return summary.chunks if chunk_head(_beginning(source, last.start), last.length) else {}


def _beginning(source: FileSource, position: int) -> bytes:
    return source.read(position, PEEK)


class _Scan:
    """Goes through the data section from record to record.

    Parameters
    ----------
    source
        The file.
    end
        Where the data section ends.
    known
        Chunks that need not be looked at, by where they are. Those that the scan comes by are
        taken out.

    Attributes
    ----------
    summary_start
        Where the record ends that ends the data; 0 while there is none.
    """

    def __init__(self, source: FileSource, end: int, known: dict[int, Region]) -> None:
        self.source = source
        self.end = end
        self.known = known
        self.starts = sorted(known)
        self.regions: list[Region] = []
        self.definitions: list[tuple[int, Buffer, str]] = []
        self.losses = Losses()
        self.summary_start = 0

    def run(self, *, is_closed: bool) -> None:
        """Scan everything; `is_closed` tells whether the file has its footer."""
        position = len(MAGIC)
        while position < self.end:
            region = self.known.pop(position, None)
            if region is not None:
                self.regions.append(region)
                position = region.end
                continue
            begin = position
            opcode, position = self._step(position)
            if opcode == DATA_END:
                self.summary_start = position
                self._check_data(begin)
                position = self._next_known(position)
        if is_closed or self.summary_start:
            return
        if not self.losses or self.losses[-1].reason != TORN:
            self.losses.note(
                f"byte {self.end}", "the file ends without a footer; it was not closed"
            )
        if self.regions and self.regions[-1].is_chunk:
            # Message indexes may be missing after the last chunk.
            self.regions[-1].index_length = 0
            self.regions[-1].holds = None

    def _step(self, position: int) -> tuple[int, int]:
        """Take the record at `position`; return its opcode and where the next one begins."""
        head = self.source.read(position, min(PEEK, self.end - position))
        opcode, length = RECORD.unpack_from(head.ljust(RECORD.size, b"\0"))
        end = position + RECORD.size + length
        is_whole = len(head) >= RECORD.size and end <= self.end and opcode != 0
        if opcode == CHUNK and chunk_head(head, RECORD.size + length) is not None:
            if is_whole or self._is_torn(position):
                self._chunk(position, length, head)
                return opcode, min(end, self.end)
            is_whole = False
        elif opcode == CHUNK:
            is_whole = False
        if not is_whole:
            return 0, self._damaged(position, opcode)
        if opcode == MESSAGE:
            end = self._messages(position, end)
        elif opcode == MESSAGE_INDEX:
            self._message_index(position, length, head)
        elif opcode in {SCHEMA, CHANNEL}:
            content = self.source.read(position + RECORD.size, min(length, MAX_SIZE))
            self.definitions.append((opcode, content, f"at byte {position}"))
        return opcode, end

    def _is_torn(self, position: int) -> bool:
        """Note that a chunk is the last of a file that ends inside it; False where others follow.

        Bytes that are missing in the middle of a chunk may let it seem to end beyond the file.
        """
        if self.end < self.source.size or self._found(position + 1, self.end, CHUNKS) is not None:
            return False
        self.losses.note(f"chunk at byte {position}", TORN)
        return True

    def _found(self, start: int, stop: int, kinds: Container[int]) -> int | None:
        return next_record(self.source, start, stop, self.end, kinds)

    def _damaged(self, position: int, opcode: int) -> int:
        """Note that the record at `position` cannot be taken; return where to go on."""
        limit = self._next_known(position)
        last = self.regions[-1] if self.regions else None
        going_on = None
        if last is not None and last.is_chunk and last.end == position:
            # It may be the chunk before whose length leads astray.
            going_on = self._found(last.start + 1, position, CHUNKS)
            # What is damaged may be the index of another channel that it holds.
            last.holds, last.index_length = None, 0
        if going_on is None:
            going_on = self._found(position + 1, limit, RECORDS)
        skipped_to = limit if going_on is None else going_on
        is_opcode = 0 < opcode <= DATA_END or opcode >= _FIRST_PRIVATE_OPCODE
        if is_opcode and skipped_to == self.end == self.source.size:
            place = f"chunk at byte {position}" if opcode == CHUNK else f"byte {position}"
            self.losses.note(place, TORN)
        else:
            size = max(0, skipped_to - position)
            reason = f"no record begins there; {size} bytes are skipped"
            self.losses.note(f"byte {position}", reason)
        return skipped_to

    def _next_known(self, position: int) -> int:
        after = bisect_right(self.starts, position)
        return self.starts[after] if after < len(self.starts) else self.end

    def _check_data(self, end: int) -> None:
        """Compare the checksum that the data end holds, where nothing else is checked.

        Chunks have checksums of their own, and may be many gigabytes of which little is read.
        """
        record = self.source.read(end, RECORD.size + 4)
        crc = int.from_bytes(record[RECORD.size :], "little")
        if not crc or any(region.is_chunk for region in self.regions) or not checksums_matter():
            return
        found = 0
        for start in range(0, end, _STRETCH):
            found = crc32(self.source.read(start, min(_STRETCH, end - start)), found)
        if found != crc:
            reason = (
                "its checksum is wrong: something in it is not what was recorded, and nothing "
                "tells what"
            )
            self.losses.note("data section", reason)

    def _chunk(self, position: int, length: int, head: bytes) -> None:
        first, *_ = CHUNK_HEAD.unpack_from(head, RECORD.size)
        self.regions.append(Region(position, RECORD.size + length, True, min(first, LATEST)))

    def _message_index(self, position: int, length: int, head: bytes) -> None:
        region = self.regions[-1] if self.regions else None
        if region is None or region.end != position or len(head) < INDEX_HEAD.size:
            return
        _, _, channel, _ = INDEX_HEAD.unpack_from(head)
        if region.holds is None:
            region.holds = {}
        region.holds[channel] = position
        region.index_length += RECORD.size + length

    def _messages(self, position: int, end: int) -> int:
        """Take the messages outside chunks from `position` on; return where they end."""
        if end - position > MAX_SIZE:
            self.losses.note(f"message at byte {position}", "it is too large")
            return end
        size = min(max(_STRETCH, end - position), self.end - position)
        data = self.source.read(position, size)
        walked = walk(data, stop_at=_NOT_MESSAGES)
        if walked.malformed:
            place = f"messages at byte {position}"
            self.losses.note(place, "too short to be messages", walked.malformed)
        for opcode, begin, stop in walked.definitions:
            place = f"at byte {position + begin - RECORD.size}"
            self.definitions.append((opcode, data[begin:stop], place))
        messages = at_offsets(data, walked.offsets)
        if messages:
            counts = messages.counts()
            first = int(messages.log_ns.min())
            holds = dict.fromkeys(counts, 0)
            self.regions.append(
                Region(position, walked.end, False, first, holds=holds, counts=counts)
            )
        return position + walked.end


def _look_inside(source: FileSource, found: Survey, *, is_complete: bool) -> None:
    """Read the chunks that may hold channels and schemas not seen yet."""
    suspect = []
    take = partial(_take_definitions, source, found, UnpackBudget(source.size))
    for region in found.regions:
        if region.holds is None:
            wanted = not is_complete or not all(map(found.is_defined, found.channels))
        else:
            wanted = not all(map(found.is_defined, region.holds))
        if wanted and not take(region, check=True):
            suspect.append(region)  # told when its messages are wanted
    # What a chunk with a wrong checksum says of channels is better than nothing.
    for region in suspect:
        if not (is_complete and all(map(found.is_defined, found.channels))):
            take(region, check=False)


def _take_definitions(
    source: FileSource, found: Survey, budget: UnpackBudget, region: Region, *, check: bool
) -> bool:
    """Take what a region defines; return whether it can be read."""
    try:
        loaded = load(source, region, budget, check=check)
    except RegionError:
        return False
    data = loaded.data
    walked = walk(data)
    for opcode, begin, stop in walked.definitions:
        found.define(opcode, memoryview(data)[begin:stop], f"in the {region.place}")
    if region.holds is None and walked.end == len(data) and not loaded.damage:
        messages = at_offsets(data, walked.offsets)
        region.counts = messages.counts() if messages else {}
        region.holds = dict.fromkeys(region.counts, 0)
    return True
