"""What an MCAP file holds and where: channels, schemas, and the regions with messages.

The summary at the end of the file is used if it is whole and agrees with the file. What it does
not cover, or the whole file if it has none, is scanned record by record, skipping the content of
chunks and attachments. Where the records cannot be followed, the scan goes on at the next place
that is certain to be a record.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

from quatprop.checksum import crc32
from quatprop.containers.base import LATEST, Losses
from quatprop.containers.compression import MAX_SIZE
from quatprop.containers.limits import checksums_matter
from quatprop.containers.mcap.definitions import Definitions, leading_definitions, read_definitions
from quatprop.containers.mcap.messages import messages_at
from quatprop.containers.mcap.regions import (
    CHANNEL,
    CHUNK,
    DATA_END,
    INDEX_HEAD,
    MESSAGE,
    MESSAGE_INDEX,
    PEEK,
    RECORD,
    SCHEMA,
    TORN,
    Region,
    chunk_head,
    head_of,
)
from quatprop.containers.mcap.resync import CHUNKS, RECORDS, next_record
from quatprop.containers.mcap.summary import MAGIC, McapIndex, Summary, read_footer, read_summary
from quatprop.containers.mcap.walk import walk_records

if TYPE_CHECKING:
    from collections.abc import Container

    from quatprop.containers.file_source import FileSource
    from quatprop.containers.mcap.regions import ChunkHead

UNDEFINED = "no record defines it"
"""Why the messages of a channel are lost."""

_LOOSE_SIZE = 1 << 22
"""Bytes of messages outside chunks that are one region."""
_NOT_MESSAGES = frozenset(range(256)) - {SCHEMA, CHANNEL, MESSAGE}
_FIRST_PRIVATE_OPCODE = 0x80


def build_index(source: FileSource) -> McapIndex:
    """Build the index of a file that begins with :data:`MAGIC`.

    Parameters
    ----------
    source
        The file.

    Returns
    -------
    McapIndex
        What can be read of the file; `losses` says what cannot.
    """
    footer = read_footer(source)
    summary = Summary() if footer is None else read_summary(source, footer)
    end = source.size
    if footer is not None:
        end = footer.data_end if summary else footer.footer_start
    scan = _Scan(source, end, _usable_chunks(source, summary))
    scan.run(is_closed=footer is not None)
    if footer is not None and not summary and scan.summary_start not in {0, footer.data_end}:
        # Bytes are missing, or too many, before the summary: it is not where the footer says.
        summary = read_summary(source, footer._replace(summary_start=scan.summary_start))
    if scan.indexed:  # chunks that the scan did not come by: the summary does not fit the file
        summary = Summary()
        scan = _Scan(source, end, {})
        scan.run(is_closed=footer is not None)
    index = summary.index
    index.regions, index.losses = scan.regions, scan.losses
    for opcode, content, place, first_id in scan.definitions.records:
        index.define(opcode, content, place, first_id)
    read_definitions(source, index, is_complete=summary.is_complete)
    for region in index.regions:
        for id_ in region.own([id_ for id_ in region.ids if id_ not in index.channels]):
            index.losses.note(f"channel {id_}", UNDEFINED, region.count(id_), region.start)
    return index


def _usable_chunks(source: FileSource, summary: Summary) -> dict[int, Region]:
    """Return the chunks of the summary; none if bytes are missing or inserted before the last one.

    The definitions of the summary are used all the same.
    """
    if not summary.chunks:
        return {}
    last = summary.chunks[max(summary.chunks)]
    return summary.chunks if head_of(source, last) else {}


class _Scan:
    """A scan of the data section, from record to record.

    Parameters
    ----------
    source
        The file.
    end
        Where the data section ends.
    indexed
        Chunks of the summary, which are not scanned, by where they begin. Those that the scan
        comes by are removed.

    Attributes
    ----------
    summary_start
        Where the first data end record ends; 0 while none was read.
    is_ended
        Whether a data end was read, so that nothing more is expected.
    """

    def __init__(self, source: FileSource, end: int, indexed: dict[int, Region]) -> None:
        self.source = source
        self.end = end
        self.indexed = indexed
        self.starts = sorted(indexed)
        self.regions: list[Region] = []
        self.definitions = Definitions()
        self.losses = Losses()
        self.summary_start = 0
        self.is_ended = False

    def run(self, *, is_closed: bool) -> None:
        """Scan the data section; `is_closed` says whether the file has a footer."""
        position = len(MAGIC)
        while position < self.end:
            region = self.indexed.pop(position, None)
            if region is not None:
                self.regions.append(region)
                position = region.end
                continue
            begin = position
            opcode, position = self._step(position)
            if opcode == DATA_END and not self.summary_start:
                self.summary_start = position
                self._check_data(begin)
            self.is_ended = self.is_ended or opcode == DATA_END
        if is_closed or self.is_ended:
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
        """Process the record at `position`; return its opcode and where the next one begins."""
        head = self.source.read(position, min(PEEK, self.end - position))
        opcode, length = RECORD.unpack_from(head.ljust(RECORD.size, b"\0"))
        end = position + RECORD.size + length
        is_whole = len(head) >= RECORD.size and end <= self.end and opcode != 0
        if opcode == CHUNK:
            chunk = chunk_head(head, RECORD.size + length)
            if chunk is not None and (is_whole or self._is_torn(position)):
                self._chunk(position, RECORD.size + length, chunk)
                return opcode, min(end, self.end)
            is_whole = False
        if head.startswith(MAGIC):
            # Files that were put one behind another: a footer comes before, a header after.
            if opcode == MAGIC[0] and self.source.read(position + len(MAGIC), 8) == MAGIC:
                self.definitions.begin_file()
                self.is_ended = False
            return 0, position + len(MAGIC)
        if not is_whole:
            return 0, self._damaged(position, opcode)
        if opcode == MESSAGE:
            end = self._messages(position, end)
        elif opcode == MESSAGE_INDEX:
            self._message_index(position, length, head)
        elif opcode in {SCHEMA, CHANNEL}:
            content = self.source.read(position + RECORD.size, min(length, MAX_SIZE))
            self.definitions.add(opcode, content, f"at byte {position}")
        return opcode, end

    def _is_torn(self, position: int) -> bool:
        """Tell whether the file ends inside a chunk, and note that; False where others follow.

        If bytes are missing in the middle of a chunk, it seems to end beyond the file, too.
        """
        if (
            self.end < self.source.size
            or self._next_record(position + 1, self.end, CHUNKS) is not None
        ):
            return False
        self.losses.note(f"chunk at byte {position}", TORN)
        return True

    def _next_record(self, start: int, stop: int, kinds: Container[int]) -> int | None:
        return next_record(self.source, start, stop, self.end, kinds)

    def _damaged(self, position: int, opcode: int) -> int:
        """Note that no record can be read at `position`; return where to go on."""
        limit = self._next_indexed(position)
        last = self.regions[-1] if self.regions else None
        resumed_at = None
        if last is not None and last.is_chunk and last.end == position:
            # The length of the chunk before may be wrong.
            resumed_at = self._next_record(last.start + 1, position, CHUNKS)
            # The damage may have hit the message index of another channel of that chunk.
            last.holds, last.index_length = None, 0
        if resumed_at is None:
            resumed_at = self._next_record(position + 1, limit, RECORDS)
        skipped_to = limit if resumed_at is None else resumed_at
        if self.is_ended and resumed_at is None:
            return skipped_to  # a damaged summary, which holds no messages
        is_opcode = 0 < opcode <= DATA_END or opcode >= _FIRST_PRIVATE_OPCODE
        if is_opcode and skipped_to == self.end == self.source.size:
            place = f"chunk at byte {position}" if opcode == CHUNK else f"byte {position}"
            self.losses.note(place, TORN)
        else:
            size = max(0, skipped_to - position)
            reason = f"no record begins there; {size} bytes are skipped"
            self.losses.note(f"byte {position}", reason)
        return skipped_to

    def _next_indexed(self, position: int) -> int:
        after = bisect_right(self.starts, position)
        return self.starts[after] if after < len(self.starts) else self.end

    def _check_data(self, end: int) -> None:
        """Compare the checksum in the data end record, if there are no other checksums.

        Chunks have their own, and may be many gigabytes of which little is read.
        """
        record = self.source.read(end, RECORD.size + 4)
        crc = int.from_bytes(record[RECORD.size :], "little")
        if not crc or any(region.is_chunk for region in self.regions) or not checksums_matter():
            return
        actual = 0
        for start in range(0, end, _LOOSE_SIZE):
            actual = crc32(self.source.read(start, min(_LOOSE_SIZE, end - start)), actual)
        if actual != crc:
            reason = (
                "its checksum is wrong: it is not what was recorded, and there is no telling where"
            )
            self.losses.note("data section", reason)

    def _chunk(self, position: int, length: int, chunk: ChunkHead) -> None:
        first, last = min(chunk.first_ns, LATEST), min(chunk.last_ns, LATEST)
        region = Region(position, length, True, first, size=chunk.size, head_last_ns=last)
        for opcode, content in leading_definitions(self.source, position, chunk):
            self.definitions.add(opcode, content, f"in the {region.place}")
        region.first_id = self.definitions.first_id
        self.regions.append(region)

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
        """Add the messages outside chunks from `position` on; return where they end."""
        if end - position > MAX_SIZE:
            self.losses.note(f"message at byte {position}", "it is too large")
            return end
        size = min(max(_LOOSE_SIZE, end - position), self.end - position)
        data = self.source.read(position, size)
        walked = walk_records(data, stop_at=_NOT_MESSAGES)
        if walked.malformed:
            place = f"messages at byte {position}"
            self.losses.note(place, "too short to be messages", walked.malformed)
        end = walked.end
        for opcode, begin, stop in walked.definitions:
            if self.definitions.redefines(opcode, data[begin:stop]):
                end = begin - RECORD.size  # what follows is another region
                break
            place = f"at byte {position + begin - RECORD.size}"
            self.definitions.add(opcode, data[begin:stop], place)
        messages = messages_at(data, walked.offsets[walked.offsets < end])
        if messages:
            counts = messages.counts()
            first = int(messages.block.log_ns.min())
            holds = dict.fromkeys(counts, 0)
            region = Region(position, end, False, first, holds=holds, counts=counts, size=end)
            region.first_id = self.definitions.first_id
            self.regions.append(region)
        return position + end
