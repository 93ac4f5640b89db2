"""What a record is and where it ends, of which there are two witnesses: its head and its content.

A damaged length leads into the middle of a later record, or into an MCAP file that is attached; a
damaged opcode hides a record. Most contents say themselves how long they are; later versions of the
format may add fields behind them.

References
----------
The MCAP format specification, "Records": strings, maps and arrays stand behind their lengths.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quatprop.checksum import crc32
from quatprop.containers.mcap.regions import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    HEADER,
    INDEX_ENTRY,
    MESSAGE_INDEX,
    METADATA,
    RECORD,
    SCHEMA,
    plausible_chunk,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.containers.file_source import FileSource


class _Form(NamedTuple):
    """What the content of a record consists of.

    Parameters
    ----------
    before
        Bytes before the first length.
    short
        How many parts there are behind lengths of 4 bytes.
    long
        How many there are behind lengths of 8 bytes after them.
    after
        Bytes at the end.
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
"""Records with this opcode or a higher one are those of other programs."""
_PIECE = 1 << 22


def length_by_content(source: FileSource, position: int, opcode: int, head: bytes) -> int | None:
    """Return how long the content of a record says that it is.

    Parameters
    ----------
    source
        The file.
    position
        Where the record begins.
    opcode
        What it is taken for.
    head
        The bytes that it begins with, as many as were read.

    Returns
    -------
    int or None
        None where it does not say that: the content of a message, or of an unknown record.
    """
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
    """Return of which kind a record is that is not of the kind that its opcode says.

    The content must be exactly as long as that of the other kind would be. Only one bit of the
    opcode may differ, for programs may have records of their own; but none may write the opcodes
    that are reserved. A data end has no lengths that could show that it is one.
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
    """Return which of several places is the end of an attachment, by its checksum."""
    for end in ends:
        stored = int.from_bytes(source.read(end - 4, 4), "little")
        actual = 0
        for piece in _pieces(source, position + RECORD.size, end - 4):
            actual = crc32(piece, actual)
        if stored and stored == actual:
            return end
    return None


def _pieces(source: FileSource, begin: int, end: int) -> Iterator[bytes]:
    for start in range(begin, end, _PIECE):
        yield source.read(start, min(_PIECE, end - start))
