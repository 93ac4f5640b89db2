"""Walk the records of a decompressed chunk, or of messages outside chunks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.mcap.chunks import CHANNEL, MESSAGE, RECORD, SCHEMA

if TYPE_CHECKING:
    from collections.abc import Container

    from numpy.typing import NDArray

    from quatprop.stores.compression import Buffer

MESSAGE_HEAD = np.dtype(
    {
        "names": ["opcode", "length", "channel", "log", "publish"],
        "formats": ["u1", "<u8", "<u2", "<i8", "<i8"],
        "offsets": [0, 1, 9, 15, 23],
    }
)
_FIXED = MESSAGE_HEAD.itemsize - RECORD.size
_LONG_RUN = 16
"""Number of equal lengths in a row after which records of that length are searched in bulk."""


@dataclass(slots=True)
class WalkedRecords:
    """The result of a walk.

    `offsets`: offset of each message record, shape ``(N,)``, int64
    `definitions`: opcode, and begin and end of the content, of each schema and channel
    `end`: end of the walk: behind the last complete record, or before one to stop at
    `malformed`: number of message records that are too short
    """

    offsets: NDArray[np.int64]
    definitions: list[tuple[int, int, int]] = field(default_factory=list)
    end: int = 0
    malformed: int = 0


def walk_records(data: Buffer, stop_at: Container[int] = frozenset({0})) -> WalkedRecords:
    """Walk the records of `data` by their lengths, up to an opcode in `stop_at`."""
    result = WalkedRecords(np.empty(0, np.int64))
    parts: list[NDArray[np.int64]] = []
    single: list[int] = []
    size = len(data)
    position = run = 0
    previous = -1
    while position + RECORD.size <= size:
        opcode, length = RECORD.unpack_from(data, position)
        end = position + RECORD.size + length
        if end > size or opcode in stop_at:
            break
        if opcode != MESSAGE:
            if opcode in {SCHEMA, CHANNEL}:
                result.definitions.append((opcode, position + RECORD.size, end))
        elif length < _FIXED:
            result.malformed += 1
        else:
            single.append(position)
            run = run + 1 if length == previous else 0
            previous = length
            if run >= _LONG_RUN:
                more = _run(data, end, length)
                stride = end - position
                parts += (np.array(single), end + stride * np.arange(more))
                single = []
                end += stride * more
                run = 0
        position = end
    result.offsets = np.concatenate([*parts, np.array(single, np.int64)])
    result.end = position
    return result


def _run(data: Buffer, position: int, length: int) -> int:
    """Return the number of consecutive message records of one length from `position` on."""
    stride = RECORD.size + length
    possible = (len(data) - position) // stride
    done, ask = 0, 64
    while done < possible:
        ask = min(4 * ask, possible - done)
        head = np.ndarray(
            (ask,), MESSAGE_HEAD, data, offset=position + done * stride, strides=(stride,)
        )
        same = (head["opcode"] == MESSAGE) & (head["length"] == length)
        if not same.all():
            return done + int(same.argmin())
        done += ask
    return done
