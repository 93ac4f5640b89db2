"""A scan of the data section of an MCAP file, from record to record.

The content of chunks and attachments is skipped. After damage the scan resumes at the next record
that is recognised with certainty.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import Losses
from quatprop.base.times import LATEST
from quatprop.readers.containers.mcap_index import Definitions, leading_definitions, messages_at
from quatprop.readers.containers.mcap_records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    HEADER,
    INDEX_ENTRY,
    INDEX_HEAD,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    PEEK,
    RECORD,
    SCHEMA,
    TORN,
    Chunk,
    chunk_head,
    plausible_chunk,
    walk_records,
)
from quatprop.readers.containers.parts import first_accepted
from quatprop.stores.checksum import crc32
from quatprop.stores.compression import MAX_SIZE, checksums_matter

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator

    from quatprop.stores.file_source import FileSource, ZeroFilledSource


# Find the next record after damage.
#
# The length of a record is stated by its head and follows, for most kinds, from its content; later
# versions of the format may add fields behind it. A damaged length leads into the middle of a later
# record, or into an attached MCAP file.
#
# Any 9 bytes could be the head of a record. A candidate is accepted if its lengths are consistent,
# as those of a chunk must be, or if its length leads to a second record, and that to a third.
#
# Reference: The MCAP format specification, "Records": strings, maps and arrays are length-prefixed.


CHUNKS = frozenset({CHUNK})
"""Opcodes to search for in what may be an uncompressed chunk: messages in it would match, too."""

CHUNK_ENDS = frozenset({CHUNK, MESSAGE_INDEX, ATTACHMENT, METADATA, DATA_END})
"""Opcodes to search for behind a chunk of unknown length."""

RECORDS = frozenset(
    {SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, ATTACHMENT, METADATA, DATA_END}
)
"""Opcodes to search for elsewhere."""

_CHAIN = 3
"""Number of consecutive records that are required to accept the first."""

_FOOTER_HEAD, _FOOTER_SIZE = RECORD.pack(2, 20), 20
"""The beginning of the last record of a file, and the bytes of its content."""

_TRIES = 200_000
"""Maximum number of candidates, so that the search ends on hostile files."""

_HIGH = slice(5, RECORD.size)
"""The bytes of a record head that are 0 in records below a terabyte."""

_MESSAGE_FIXED = 22


class _Form(NamedTuple):
    """The layout of a record's content.

    `before`: bytes before the first length
    `short`: number of values with lengths of 4 bytes
    `long`: number of values with lengths of 8 bytes, behind them
    `after`: bytes at the end
    """

    before: int
    short: int
    long: int = 0
    after: int = 0


_FORMS = {
    HEADER: _Form(0, 2),
    SCHEMA: _Form(2, 3),
    CHANNEL: _Form(4, 3),
    CHUNK: _Form(28, 1, 1),
    MESSAGE_INDEX: _Form(2, 1),
    ATTACHMENT: _Form(16, 2, 1, 4),
    METADATA: _Form(0, 2),
    DATA_END: _Form(4, 0),
}


def length_by_content(source: FileSource, position: int, opcode: int, head: bytes) -> int | None:
    """Return the length of a record's content by the lengths in it; None if it has none."""
    form = _FORMS.get(opcode)
    if form is None:
        return None
    at = RECORD.size + form.before
    for size in (4,) * form.short + (8,) * form.long:
        field = head[at : at + size]
        if len(field) < size and position + at + size <= source.size:
            field = source.read(position + at, size)
        at += size + int.from_bytes(field, "little")
    length = at + form.after - RECORD.size
    return -1 if opcode == MESSAGE_INDEX and (length - 6) % INDEX_ENTRY else length


def next_record(
    source: FileSource, start: int, stop: int, end: int, kinds: Container[int]
) -> int | None:
    """Return the offset of the first record that is accepted; None if there is none."""

    def found(window: bytes) -> list[int]:
        return _candidates(window, kinds)

    def accepted(place: int) -> int | None:
        return place if is_record(source, place, end) else None

    return first_accepted(source.read, (start, stop, RECORD.size - 1), found, accepted, _TRIES)


def _candidates(window: bytes, kinds: Container[int]) -> list[int]:
    """Return the offsets of bytes that could be the head of a record."""
    count = len(window) - RECORD.size + 1
    if count <= 0:
        return []
    data = np.frombuffer(window, np.uint8)
    opcodes = np.array([opcode in kinds for opcode in range(256)])
    matches = opcodes[data[:count]]
    for byte in range(_HIGH.start + 1, _HIGH.stop):
        matches &= data[byte : byte + count] == 0
    return np.flatnonzero(matches).tolist()


def is_record(source: FileSource, position: int, end: int) -> bool:
    """Return whether a record begins at `position`, rather than bytes that look like one."""
    for _ in range(_CHAIN):
        head = source.read(position, PEEK)
        if len(head) < RECORD.size:
            return False
        opcode, length = RECORD.unpack_from(head)
        after = position + RECORD.size + length
        if opcode == CHUNK:
            return plausible_chunk(head, length)
        if head.startswith(MAGIC):
            return True  # another file follows
        if after > end or not _is_plausible(source, position, head):
            return False
        if after == end:
            return True
        position = after
    return True


def _is_plausible(source: FileSource, position: int, head: bytes) -> bool:
    """Return whether a record of this kind can have this length."""
    opcode, length = RECORD.unpack_from(head)
    if opcode == MESSAGE:
        return bool(length >= _MESSAGE_FIXED)
    needed = length_by_content(source, position, opcode, head) or 0
    return bool(0 < opcode <= DATA_END and 0 <= needed <= length)


_LOOSE_SIZE = 1 << 22
"""Bytes of messages outside chunks that are treated as one chunk."""
_NOT_MESSAGES = frozenset(range(256)) - {SCHEMA, CHANNEL, MESSAGE}


class Scan:
    """A scan of the data section, from record to record.

    `indexed`: chunks of the summary by offset, which are not scanned. Those that the scan reaches
        are removed
    `attachments`: lengths of the attachments in the summary by offset, bytes
    `summary_start`: offset behind the first data end record; 0 before it is read
    `is_ended`: whether a data end was read, so that no more records are expected
    """

    def __init__(
        self,
        source: ZeroFilledSource,
        end: int,
        indexed: dict[int, Chunk],
        attachments: dict[int, int],
    ) -> None:
        self.source, self.end = source, end
        self.indexed, self.attachments = indexed, attachments
        self.starts = sorted(indexed)
        self.chunks: list[Chunk] = []
        self.definitions = Definitions()
        self.losses = Losses()
        self.summary_start = 0
        self.is_ended = False
        self._searched: set[int] = set()

    def run(self, *, is_closed: bool) -> None:
        """Scan the data section; `is_closed` if the file has a footer."""
        position = len(MAGIC)
        while position < self.end:
            chunk = self.indexed.pop(position, None)
            if chunk is not None:
                self.chunks.append(chunk)
                position = chunk.end
                continue
            position = self._read_record(position)
        if is_closed or self.is_ended:
            return
        if not self.losses or self.losses[-1].reason != TORN:
            self.losses.note(
                f"byte {self.end}", "the file ends without a footer; it was not closed"
            )

    def add_lost(self, chunks: Iterable[Chunk]) -> None:
        """Add chunks of the summary that the scan did not find, so that their loss is counted."""
        starts = {chunk.start for chunk in self.chunks}
        for chunk in [chunk for chunk in chunks if chunk.start not in starts]:
            if all(chunk.end <= each.start or each.end <= chunk.start for each in self.chunks):
                self.chunks.append(chunk)
        self.chunks.sort(key=lambda chunk: chunk.start)

    def _read_record(self, position: int) -> int:
        """Process the record at `position`; return the offset of the next one."""
        head = self.source.read(position, min(PEEK, self.end - position)).ljust(RECORD.size, b"\0")
        if head.startswith(MAGIC):
            # Between concatenated files the magic is repeated: a footer precedes, a header follows.
            if self.source.read(position + len(MAGIC), 8) == MAGIC:
                self.definitions.begin_file()
                self.is_ended = False
            return position + len(MAGIC)
        opcode, length = RECORD.unpack_from(head)
        end: int = position + RECORD.size + length
        if opcode == CHUNK or plausible_chunk(head, length):
            return self._chunk(position, end, head)
        if opcode == ATTACHMENT:
            return self._attachment(position, end, head)
        by_content = length_by_content(self.source, position, opcode, head)
        is_whole = opcode == MESSAGE or by_content == length
        if not opcode or end > self.end or not (is_whole or self._is_followed(end)):
            return self._damaged(position, opcode)
        if opcode == MESSAGE:
            end = self._messages(position, end)
        elif opcode in {SCHEMA, CHANNEL}:
            end = self._definition(opcode, position, end)
        elif opcode == MESSAGE_INDEX and is_whole:
            self._message_index(position, end - position, head)
        elif opcode == DATA_END and is_whole:
            self.is_ended = True
            if not self.summary_start:
                self.summary_start = end
                self._check_data(position)
        return end

    def _is_followed(self, end: int) -> bool:
        """Return whether a record, or another file, begins at an offset, or the data end there."""
        if end >= self.end:
            return end == self.end
        return is_record(self.source, end, self.end)

    def _attachment(self, position: int, end: int, head: bytes) -> int:
        """Return the end of an attachment; records in it may be those of another file."""
        by_content = length_by_content(self.source, position, ATTACHMENT, head) or 0
        ends = {end, position + RECORD.size + by_content}
        indexed = position + self.attachments.get(position, 0)
        if indexed in ends:
            return indexed
        if len(ends) == 1 and end <= self.end:
            return end
        if min(ends) < end and self._is_followed(end) and not self._is_followed(min(ends)):
            return end  # later versions of the format may add fields
        followed = [each for each in ends if position < each and self._is_followed(each)]
        resumed_at = max(followed, default=None) or self._next_behind_attachment(position)
        is_torn = min(ends) > self.end and resumed_at == self.end
        reason = TORN if is_torn else "its length is damaged"
        self.losses.note(f"attachment at byte {position}", reason)
        return resumed_at

    def _next_behind_attachment(self, position: int) -> int:
        """Return the offset of the next record behind an attachment of unknown length.

        If a log is attached, that is behind its end; the rest is lost if this is not there.
        """
        begin, limit = position + 1, self._next_indexed(position)
        if limit < self.end:
            return limit
        for place in self._magics(begin):
            if self.source.read(place + len(MAGIC), len(MAGIC)) == MAGIC:
                limit = place  # another file is joined to this one
                break
            begin = place + len(MAGIC) if self._is_end(place) else limit
        found = next_record(self.source, begin, limit, self.end, RECORDS) if begin < limit else None
        return limit if found is None else found

    def _is_end(self, magic: int) -> bool:
        """Return whether magic bytes are those at the end of a file, not at its beginning."""
        head = self.source.read(magic - _FOOTER_SIZE - len(_FOOTER_HEAD), len(_FOOTER_HEAD))
        return head == _FOOTER_HEAD

    def _magics(self, begin: int) -> Iterator[int]:
        """Yield the offsets of magic bytes from an offset on."""
        for first in range(begin, self.end, _LOOSE_SIZE):
            size = min(_LOOSE_SIZE + len(MAGIC) - 1, self.end - first)
            for magic in re.finditer(re.escape(MAGIC), self.source.read(first, size)):
                yield first + magic.start()

    def _is_torn(self, position: int) -> bool:
        """Return whether the file ends inside a chunk, and record the loss.

        If another chunk follows, bytes are missing in the middle of this one instead.
        """
        if (
            self.end < self.source.size
            or next_record(self.source, position + 1, self.end, self.end, CHUNKS) is not None
        ):
            return False
        self.losses.note(f"chunk at byte {position}", TORN)
        return True

    def _damaged(self, position: int, opcode: int) -> int:
        """Record that no record can be read at `position`; return where to resume."""
        limit = self._next_indexed(position)
        last = self.chunks[-1] if self.chunks else None
        resumed_at = None
        if (
            last is not None
            and last.is_chunk
            and last.end == position
            and position not in self._searched
        ):
            # Once: what is found may end here too.
            self._searched.add(position)
            # The previous chunk may lack bytes, so that what follows it begins inside of it.
            resumed_at = next_record(self.source, last.start + 1, position, self.end, CHUNK_ENDS)
            # The damaged record may be a message index of that chunk, of another channel.
            length = last.length if resumed_at is None else resumed_at - last.start
            self.chunks[-1] = replace(
                last, length=length, message_index_offsets=None, index_length=0
            )
        if resumed_at is None:
            resumed_at = self._next_outside(position, limit, RECORDS)
        skipped_to = limit if resumed_at is None else resumed_at
        if self.is_ended and resumed_at is None:
            return skipped_to  # a damaged summary, which has no messages
        is_unreadable = self._is_unreadable(position, skipped_to)
        if last is not None and skipped_to <= position:
            self.losses.note(last.place, "its length is damaged")
        elif opcode and not is_unreadable and skipped_to == self.end == self.source.size:
            self.losses.note(f"byte {position}", TORN)
        else:
            size = skipped_to - position
            reason = "it cannot be read" if is_unreadable else "no record begins there"
            self.losses.note(f"byte {position}", f"{reason}; {size} bytes are skipped")
        return skipped_to

    def _next_outside(self, position: int, limit: int, kinds: Container[int]) -> int | None:
        """Return the offset of the next record behind `position` that is in no attachment."""
        found = next_record(self.source, position + 1, limit, self.end, kinds)
        for begin, length in self.attachments.items():
            if found is not None and begin <= found < begin + length <= limit:
                found = begin + length  # records in an attachment are not of this file
        return found

    def _is_unreadable(self, begin: int, end: int) -> bool:
        return self.source.first_unreadable(begin, end) is not None

    def _next_indexed(self, position: int) -> int:
        after = bisect_right(self.starts, position)
        return self.starts[after] if after < len(self.starts) else self.end

    def _check_data(self, end: int) -> None:
        """Verify the checksum in the data end record, if there are no chunks.

        Chunks have their own, and of many gigabytes of chunks little may be read.
        """
        record = self.source.read(end, RECORD.size + 4)
        crc = int.from_bytes(record[RECORD.size :], "little")
        if not crc or any(chunk.is_chunk for chunk in self.chunks) or not checksums_matter():
            return
        actual = 0
        for start in range(0, end, _LOOSE_SIZE):
            actual = crc32(self.source.read(start, min(_LOOSE_SIZE, end - start)), actual)
        if actual != crc and not self._is_unreadable(0, end):
            reason = "its checksum is wrong: it is not what was recorded, and the place is unknown"
            self.losses.note("data section", reason)

    def _chunk(self, position: int, end: int, head: bytes) -> int:
        """Add a chunk; return the offset behind it.

        One whose head is damaged ends at the next record. It cannot be loaded, and the message
        indexes behind it tell what is lost.
        """
        stated = chunk_head(head, end - position)
        is_exact = stated is not None and position + stated.end == end
        if end > self.end:
            is_damaged = not (is_exact and self._is_torn(position))
        else:
            is_damaged = not (is_exact or self._is_followed(end))
        if is_damaged:
            limit = self._next_indexed(position)
            found = self._next_outside(position, limit, CHUNK_ENDS)
            if found is None and limit == self.end == self.source.size:
                self.losses.note(f"chunk at byte {position}", TORN)
                return self.end
            end = limit if found is None else found
            stated = chunk_head(head, end - position)
        chunk = Chunk(position, end - position, True, 0)
        if stated is not None:
            chunk.first_ns, chunk.size = min(stated.first_ns, LATEST), stated.size
            chunk.head_last_ns = min(stated.last_ns, LATEST)
            with suppress(OSError):
                for opcode, content in leading_definitions(self.source.original, position, stated):
                    self.definitions.add(opcode, content, f"in the {chunk.place}")
        chunk.id_offset = self.definitions.id_offset
        self.chunks.append(chunk)
        return min(end, self.end)

    def _message_index(self, position: int, length: int, head: bytes) -> None:
        chunk = self.chunks[-1] if self.chunks else None
        if chunk is None or not chunk.is_chunk or chunk.end != position:
            return
        _, _, channel, _ = INDEX_HEAD.unpack_from(head)
        if chunk.message_index_offsets is None:
            chunk.message_index_offsets = {}
        chunk.message_index_offsets[channel] = position
        chunk.index_length += length

    def _definition(self, opcode: int, position: int, end: int) -> int:
        """Add a schema or channel; return where to continue."""
        begin = position + RECORD.size
        content = self.source.read(begin, min(end - begin, MAX_SIZE))
        if self._is_unreadable(position, end):
            return self._damaged(position, opcode)
        self.definitions.add(opcode, content, f"at byte {position}")
        return end

    def _messages(self, position: int, end: int) -> int:
        """Add the messages outside chunks from `position` on; return the end of their run."""
        if end - position > MAX_SIZE:
            self.losses.note(f"message at byte {position}", "it is too large")
            return end
        size = min(max(_LOOSE_SIZE, end - position), self.end - position)
        data = self.source.read(position, size)
        unreadable = self.source.first_unreadable(position, position + size)
        if unreadable is not None:
            data = data[: unreadable - position]
        walked = walk_records(data, stop_at=_NOT_MESSAGES)
        if not walked.end:
            return self._damaged(position, MESSAGE)
        if walked.malformed:
            place = f"messages at byte {position}"
            self.losses.note(place, "too short to be messages", walked.malformed)
        end = walked.end
        for opcode, begin, stop in walked.definitions:
            if self.definitions.redefines(opcode, data[begin:stop]):
                end = begin - RECORD.size  # a new run of messages begins
                break
            place = f"at byte {position + begin - RECORD.size}"
            self.definitions.add(opcode, data[begin:stop], place)
        messages = messages_at(data, walked.offsets[walked.offsets < end])
        if messages:
            counts = messages.counts()
            first = int(messages.block.log_ns.min())
            offsets = dict.fromkeys(counts, 0)
            chunk = Chunk(
                position, end, False, first, message_index_offsets=offsets, counts=counts, size=end
            )
            chunk.id_offset = self.definitions.id_offset
            self.chunks.append(chunk)
        return position + end
