"""Find the next record of an MCAP file after damage.

Any 9 bytes could be the head of a record. A candidate is accepted if its lengths are consistent, as
those of a chunk must be, or if its length leads to a second record, and that to a third.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.compression import MAX_SIZE
from quatprop.containers.mcap.regions import (
    CHANNEL,
    CHUNK,
    DATA_END,
    INDEX_ENTRY,
    INDEX_HEAD,
    MESSAGE,
    MESSAGE_INDEX,
    PEEK,
    RECORD,
    SCHEMA,
    chunk_head,
)

if TYPE_CHECKING:
    from collections.abc import Container

    from quatprop.containers.file_source import FileSource

CHUNKS = frozenset({CHUNK})
"""Opcodes to look for where the messages inside an uncompressed chunk would match, too."""

RECORDS = frozenset({SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, DATA_END})
"""Opcodes to look for elsewhere."""

_WINDOW = 1 << 22
_CHAIN = 3
"""Records that must follow each other for the first to be accepted."""

_TRIES = 200_000
"""Candidates that are tried before the search is given up, so that it ends on hostile files."""

_COMPRESSIONS = ("", "lz4", "zstd")
_HIGH = slice(5, RECORD.size)
"""The bytes of a record head that are 0 in any record below a terabyte."""

_MESSAGE_FIXED = 22
_DATA_END_SIZE = 4


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
            if _is_record(source, position + place, end):
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


def _is_record(source: FileSource, position: int, end: int) -> bool:
    """Tell whether a record begins at a place, rather than bytes that look like one."""
    for _ in range(_CHAIN):
        head = source.read(position, PEEK)
        if len(head) < RECORD.size:
            return False
        opcode, length = RECORD.unpack_from(head)
        after = position + RECORD.size + length
        if opcode == CHUNK:
            return _is_chunk(head, length)
        if after > end or not _is_plausible(opcode, length, head):
            return False
        if after == end:
            return True
        position = after
    return True


def _is_chunk(head: bytes, length: int) -> bool:
    """Tell whether the lengths of a chunk are consistent; its end may be missing."""
    chunk = chunk_head(head, RECORD.size + length)
    return (
        chunk is not None
        and chunk.end == RECORD.size + length
        and chunk.compression in _COMPRESSIONS
        and chunk.size <= MAX_SIZE
        and (chunk.compression != "" or chunk.size == chunk.end - chunk.begin)
    )


def _is_plausible(opcode: int, length: int, head: bytes) -> bool:
    """Tell whether a record of this kind can have this length."""
    if opcode == MESSAGE:
        return length >= _MESSAGE_FIXED
    if opcode == DATA_END:
        return length >= _DATA_END_SIZE
    if opcode == MESSAGE_INDEX:
        if len(head) < INDEX_HEAD.size:
            return False
        _, _, _, size = INDEX_HEAD.unpack_from(head)
        return bool(size + 6 == length and size % INDEX_ENTRY == 0)
    if opcode in {SCHEMA, CHANNEL}:
        # Both begin with an id; in a channel, that of its schema follows before the first string.
        before = 2 if opcode == SCHEMA else 4
        at = RECORD.size + before
        return int.from_bytes(head[at : at + 4], "little") + before + 4 <= length
    return 0 < opcode < DATA_END
