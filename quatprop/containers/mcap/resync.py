"""Where the records of an MCAP file go on behind damage.

Any 9 bytes could be the head of a record. One is believed where its lengths fit into each other
as those of a chunk do, or where it leads to others: by its length to a second, and a third.
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
"""What is looked for where the messages of a plain chunk would be found too."""

RECORDS = frozenset({SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, DATA_END})
"""What is looked for elsewhere."""

_WINDOW = 1 << 22
_CHAIN = 3
"""Records that follow each other and are believed for that."""

_TRIES = 200_000
"""Places looked at before the search is given up: nobody waits for a file made of heads."""

_COMPRESSIONS = ("", "lz4", "zstd")
_HIGH = slice(5, RECORD.size)
"""The bytes of a length that are 0 in any record below a terabyte, within its head."""

_MESSAGE_FIXED = 22
_DATA_END_SIZE = 4


def next_record(
    source: FileSource, start: int, stop: int, end: int, kinds: Container[int]
) -> int | None:
    """Return where the first record that is one beyond doubt begins.

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
            if _is_believed(source, position + place, end):
                return position + place
            tries -= 1
            if tries == 0:
                return None
    return None


def _candidates(window: bytes, kinds: Container[int]) -> list[int]:
    """Return where bytes could be the head of a record."""
    count = len(window) - RECORD.size + 1
    if count <= 0:
        return []
    data = np.frombuffer(window, np.uint8)
    opcodes = np.array([opcode in kinds for opcode in range(256)])
    could = opcodes[data[:count]]
    for byte in range(_HIGH.start + 1, _HIGH.stop):
        could &= data[byte : byte + count] == 0
    return np.flatnonzero(could).tolist()


def _is_believed(source: FileSource, position: int, end: int) -> bool:
    """Tell whether a record begins at a place, and not by chance."""
    for _ in range(_CHAIN):
        head = source.read(position, PEEK)
        if len(head) < RECORD.size:
            return False
        opcode, length = RECORD.unpack_from(head)
        after = position + RECORD.size + length
        if opcode == CHUNK:
            return _is_chunk(head, length)
        if after > end or not _fits(opcode, length, head):
            return False
        if after == end:
            return True
        position = after
    return True


def _is_chunk(head: bytes, length: int) -> bool:
    """Tell whether the lengths of a chunk fit into each other exactly; its end may be missing."""
    chunk = chunk_head(head, RECORD.size + length)
    return (
        chunk is not None
        and chunk.end == RECORD.size + length
        and chunk.compression in _COMPRESSIONS
        and chunk.size <= MAX_SIZE
        and (chunk.compression != "" or chunk.size == chunk.end - chunk.begin)
    )


def _fits(opcode: int, length: int, head: bytes) -> bool:
    """Tell whether a record of this length can be of this kind."""
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
        # Both begin with an id; a channel has that of its schema before the first text.
        before = 2 if opcode == SCHEMA else 4
        at = RECORD.size + before
        return int.from_bytes(head[at : at + 4], "little") + before + 4 <= length
    return 0 < opcode < DATA_END
