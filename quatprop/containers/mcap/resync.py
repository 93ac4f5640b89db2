"""Find the next record of an MCAP file after damage.

Any 9 bytes could be the head of a record. A candidate is accepted if its lengths are consistent, as
those of a chunk must be, or if its length leads to a second record, and that to a third.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.mcap.extents import length_by_content
from quatprop.containers.mcap.regions import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    PEEK,
    RECORD,
    SCHEMA,
    plausible_chunk,
)

if TYPE_CHECKING:
    from collections.abc import Container

    from quatprop.containers.file_source import FileSource

CHUNKS = frozenset({CHUNK})
"""Opcodes to look for where the messages inside an uncompressed chunk would match, too."""

RECORDS = frozenset(
    {SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, ATTACHMENT, METADATA, DATA_END}
)
"""Opcodes to look for elsewhere."""

_WINDOW = 1 << 22
_CHAIN = 3
"""Records that must follow each other for the first to be accepted."""

_TRIES = 200_000
"""Candidates that are tried before the search is given up, so that it ends on hostile files."""

_HIGH = slice(5, RECORD.size)
"""The bytes of a record head that are 0 in any record below a terabyte."""

_MESSAGE_FIXED = 22


def next_record(
    source: FileSource, start: int, stop: int, end: int, kinds: Container[int]
) -> int | None:
    """Return where the first record begins that can be accepted as one.

    Parameters
    ----------
    source
        The file.
    start, stop
        Where it may begin.
    end
        Where the data section ends.
    kinds
        Opcodes that it may have.

    Returns
    -------
    int or None
        None where there is no such record.
    """
    tries = _TRIES
    for position in range(start, stop, _WINDOW):
        size = min(_WINDOW, stop - position)
        window = source.read(position, size + RECORD.size - 1)
        for place in _candidates(window, kinds):
            if is_record(source, position + place, end):
                return position + place
            tries -= 1
            if tries == 0:
                return None
    return None


def _candidates(window: bytes, kinds: Container[int]) -> list[int]:
    """Return where the bytes could be the head of a record."""
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
    """Tell whether a record begins at a place, rather than bytes that look like one."""
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
    """Tell whether a record of this kind can have this length."""
    opcode, length = RECORD.unpack_from(head)
    if opcode == MESSAGE:
        return bool(length >= _MESSAGE_FIXED)
    needed = length_by_content(source, position, opcode, head) or 0
    return bool(0 < opcode <= DATA_END and 0 <= needed <= length)
