"""Determine the kind and end of damaged MCAP records, and find the next record after damage.

The kind and the length of a record are stated by its head and follow, for most kinds, from its
content; later versions of the format may add fields behind it. A damaged length leads into the
middle of a later record, or into an attached MCAP file; a damaged opcode hides a record.

Any 9 bytes could be the head of a record. A candidate is accepted if its lengths are consistent, as
those of a chunk must be, or if its length leads to a second record, and that to a third.

References
----------
The MCAP format specification, "Records": strings, maps and arrays are length-prefixed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.containers.mcap.chunks import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    HEADER,
    INDEX_ENTRY,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    PEEK,
    RECORD,
    SCHEMA,
    plausible_chunk,
)
from quatprop.containers.resync import WINDOW, first_accepted
from quatprop.stores.checksum import crc32

if TYPE_CHECKING:
    from collections.abc import Container

    from quatprop.stores.file_source import FileSource

CHUNKS = frozenset({CHUNK})
"""Opcodes to search for where messages in an uncompressed chunk would match, too."""

RECORDS = frozenset(
    {SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, ATTACHMENT, METADATA, DATA_END}
)
"""Opcodes to search for elsewhere."""

_CHAIN = 3
"""Number of consecutive records that are required to accept the first."""

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
FIRST_PRIVATE_OPCODE = 0x80
"""This opcode and higher ones are reserved for other programs."""


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


def opcode_by_content(source: FileSource, position: int, head: bytes) -> int | None:
    """Return the opcode of a record whose stated opcode is damaged; None if it is unknown.

    The length must be exactly that of the content of the other kind. Only one bit of the opcode may
    differ, since programs may write private records; any reserved opcode may be a damaged chunk. A
    data end has no lengths by which to recognise it.
    """
    opcode, length = RECORD.unpack_from(head)
    others: list[int] = [opcode ^ 1 << bit for bit in range(8)]
    for other in [*others, CHUNK] if opcode < FIRST_PRIVATE_OPCODE else others:
        if other == DATA_END or length_by_content(source, position, other, head) != length:
            continue
        if other != CHUNK or plausible_chunk(head, length):
            return other
    return None


def attachment_end(source: FileSource, position: int, ends: list[int]) -> int | None:
    """Return the offset, of several, at which an attachment ends by its checksum, or None."""
    for end in ends:
        stored = int.from_bytes(source.read(end - 4, 4), "little")
        actual = 0
        for begin in range(position + RECORD.size, end - 4, WINDOW):
            actual = crc32(source.read(begin, min(WINDOW, end - 4 - begin)), actual)
        if stored == actual:
            return end
    return None


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
