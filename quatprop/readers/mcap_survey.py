"""What an MCAP file holds and where: channels, schemas, and the regions with messages.

The summary at the end of the file is taken where it is whole and agrees with the file. What it
does not cover, or the whole file where it is missing, is scanned: record by record, over the
content of chunks and attachments without reading it.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

from quatprop.readers.base import Loss
from quatprop.readers.compression import MAX_SIZE
from quatprop.readers.mcap_messages import LATEST, at_offsets, walk
from quatprop.readers.mcap_regions import (
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    INDEX_HEAD,
    MESSAGE,
    MESSAGE_INDEX,
    RECORD,
    SCHEMA,
    Region,
    RegionError,
    load,
)
from quatprop.readers.mcap_summary import MAGIC, Summary, read_footer, read_summary

if TYPE_CHECKING:
    from quatprop.readers.compression import Buffer
    from quatprop.readers.mcap_regions import Source
    from quatprop.readers.mcap_summary import Survey

_DATA_END = 15
_STRETCH = 1 << 22
"""Bytes of messages outside chunks that are one region."""
_PEEK = 64
_NOT_MESSAGES = frozenset(range(256)) - {SCHEMA, CHANNEL, MESSAGE}
_LAST_OPCODE, _FIRST_PRIVATE_OPCODE = _DATA_END, 0x80


def survey(source: Source) -> Survey:
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
    end = source.size if footer is None else footer.data_end
    scan = _Scan(source, end, summary.chunks)
    scan.run(is_closed=footer is not None)
    if scan.known:  # chunks that the scan passed over: the summary does not fit the file
        summary = Summary()
        scan = _Scan(source, end, {})
        scan.run(is_closed=footer is not None)
    found = summary.found
    found.regions, found.losses = scan.regions, [*found.losses, *scan.losses]
    for opcode, content, place in scan.definitions:
        found.define(opcode, content, place)
    _look_inside(source, found, is_complete=summary.is_complete)
    for channel in {id_ for region in found.regions for id_ in region.holds or ()}:
        if channel not in found.channels:
            found.losses.append(Loss(f"channel {channel}", "no record says what it is"))
    return found


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
    """

    def __init__(self, source: Source, end: int, known: dict[int, Region]) -> None:
        self.source = source
        self.end = end
        self.known = known
        self.starts = sorted(known)
        self.regions: list[Region] = []
        self.definitions: list[tuple[int, Buffer, str]] = []
        self.losses: list[Loss] = []

    def run(self, *, is_closed: bool) -> None:
        """Scan everything; `is_closed` tells whether the file has its footer."""
        position = len(MAGIC)
        ended = False
        while position < self.end:
            region = self.known.pop(position, None)
            if region is not None:
                self.regions.append(region)
                position = region.end
                continue
            opcode, position = self._step(position)
            if opcode == _DATA_END:
                ended = True
                position = self._next_known(position)
        if is_closed or ended:
            return
        if not self.losses:
            self.losses.append(
                Loss(f"byte {self.end}", "the file ends without a footer; it was not closed")
            )
        if self.regions and self.regions[-1].is_chunk:
            # Message indexes may be missing after the last chunk.
            self.regions[-1].index_length = 0
            self.regions[-1].holds = None

    def _step(self, position: int) -> tuple[int, int]:
        """Take the record at `position`; return its opcode and where the next one begins."""
        head = self.source.read(position, min(_PEEK, self.end - position))
        opcode, length = RECORD.unpack_from(head.ljust(RECORD.size, b"\0"))
        end = position + RECORD.size + length
        if end > self.end or len(head) < RECORD.size or opcode == 0:
            return opcode, self._damaged(position, opcode)
        if opcode == MESSAGE:
            end = self._messages(position, end)
        elif opcode == CHUNK:
            self._chunk(position, length, head)
        elif opcode == MESSAGE_INDEX:
            self._message_index(position, length, head)
        elif opcode in {SCHEMA, CHANNEL}:
            content = self.source.read(position + RECORD.size, min(length, MAX_SIZE))
            self.definitions.append((opcode, content, f"at byte {position}"))
        return opcode, end

    def _damaged(self, position: int, opcode: int) -> int:
        """Note that the record at `position` cannot be taken; return where to go on."""
        going_on = self._next_known(position)
        is_opcode = 0 < opcode <= _LAST_OPCODE or opcode >= _FIRST_PRIVATE_OPCODE
        if is_opcode and going_on == self.end == self.source.size:
            place = f"chunk at byte {position}" if opcode == CHUNK else f"byte {position}"
            self.losses.append(Loss(place, "the file ends inside it"))
        else:
            reason = f"no record begins there; {going_on - position} bytes are skipped"
            self.losses.append(Loss(f"byte {position}", reason))
        return going_on

    def _next_known(self, position: int) -> int:
        after = bisect_right(self.starts, position)
        return self.starts[after] if after < len(self.starts) else self.end

    def _chunk(self, position: int, length: int, head: bytes) -> None:
        if length < CHUNK_HEAD.size:
            self.losses.append(Loss(f"chunk at byte {position}", "its header is damaged"))
            return
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
            self.losses.append(Loss(f"message at byte {position}", "it is too large"))
            return end
        size = min(max(_STRETCH, end - position), self.end - position)
        data = self.source.read(position, size)
        walked = walk(data, stop_at=_NOT_MESSAGES)
        if walked.malformed:
            place = f"messages at byte {position}"
            self.losses.append(Loss(place, "too short to be messages", walked.malformed))
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


def _look_inside(source: Source, found: Survey, *, is_complete: bool) -> None:
    """Read the chunks that may hold channels and schemas not seen yet."""
    for region in found.regions:
        if region.holds is None:
            wanted = not is_complete or not all(map(found.is_defined, found.channels))
        else:
            wanted = not all(map(found.is_defined, region.holds))
        if not wanted:
            continue
        try:
            data, _ = load(source, region)
        except RegionError:
            continue  # told when its messages are wanted
        walked = walk(data)
        for opcode, begin, stop in walked.definitions:
            found.define(opcode, memoryview(data)[begin:stop], f"in the {region.place}")
        if region.holds is None and walked.end == len(data):
            messages = at_offsets(data, walked.offsets)
            region.counts = messages.counts() if messages else {}
            region.holds = dict.fromkeys(region.counts, 0)
