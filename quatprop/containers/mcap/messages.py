"""Locate the messages of a decompressed chunk of an MCAP file.

The offsets of messages are those of the message index, which are checked. If there is no index, or
it disagrees with the records, the records are walked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.mcap.chunks import INDEX_ENTRY, INDEX_HEAD, MESSAGE, MESSAGE_INDEX, RECORD
from quatprop.containers.mcap.walk import MESSAGE_HEAD
from quatprop.messages.blocks import MessageBlock
from quatprop.times import LATEST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from quatprop.containers.mcap.chunks import Chunk
    from quatprop.stores.compression import Buffer
    from quatprop.stores.file_source import FileSource

_HEAD = MESSAGE_HEAD.itemsize
_FIXED = _HEAD - RECORD.size
_CHANNEL_BITS = (1 << 24) - 1
"""Mask of the second 8 bytes of a message record: the end of its length, and its channel."""


@dataclass(slots=True)
class LocatedMessages:
    """Messages of several channels.

    `block`: the messages. Times after the year 2262, unsigned, are negative in its `publish_ns` and
        clamped to :data:`~quatprop.times.LATEST` in `log_ns`
    `channels`: channel id of each, shape ``(N,)``; may be a view of the buffer
    """

    block: MessageBlock
    channels: NDArray[np.uint16]

    def of(self, ids: Sequence[int]) -> LocatedMessages:
        """Return the messages of some channels."""
        # Evenly spaced messages are all of one channel.
        wanted = _is_one_of(self.channels[: 1 if self.block.stride else None], ids)
        if wanted.all():
            return self
        if self.block.stride:
            wanted = wanted.repeat(len(self))
        return LocatedMessages(self.block.at(wanted), self.channels[wanted])

    def __len__(self) -> int:
        return len(self.channels)

    def fill(self, data: Buffer, begin: int) -> bool:
        """Return whether these messages fill `data` from `begin` to its end without gaps."""
        starts, ends = self.block.starts, self.block.ends
        size = int((ends - starts).sum()) + len(starts) * _HEAD
        return int(starts[0]) - _HEAD == begin == len(data) - size

    def counts(self) -> dict[int, int]:
        """Return the number of messages of each channel."""
        ids, counts = np.unique(self.channels, return_counts=True)
        return dict(zip(ids.tolist(), counts.tolist(), strict=True))


def _is_one_of(channels: NDArray[np.uint16], ids: Sequence[int]) -> NDArray[np.bool_]:
    # For a few ids this is several times faster than np.isin.
    matches = np.zeros(len(channels), np.bool_)
    for id_ in ids:
        matches |= channels == id_
    return matches


def messages_at(data: Buffer, offsets: NDArray[np.int64]) -> LocatedMessages | None:
    """Return the messages at ascending offsets; None if no message begins at one of them.

    `offsets`: offsets of message records, shape ``(N,)``, int64
    """
    if len(offsets) == 0:
        none = MessageBlock(np.empty(0, np.uint8), offsets, offsets, offsets, offsets)
        return LocatedMessages(none, np.empty(0, np.uint16))
    if offsets[0] < 0 or max(offsets[0], offsets[-1]) > len(data) - _HEAD:
        return None
    count, first = len(offsets), int(offsets[0])
    stride = RECORD.size + RECORD.unpack_from(data, first)[1]
    messages = None
    if int(offsets[-1]) == first + (count - 1) * stride and first + count * stride <= len(data):
        messages = _evenly_spaced(data, first, count)
    return _anywhere(data, offsets) if messages is None else messages


def messages_past_damage(
    data: Buffer, walked: NDArray[np.int64], indexed: NDArray[np.int64]
) -> LocatedMessages | None:
    """Return the messages of a walk that ended at damage, and those after the damage.

    `walked`: offsets of messages that the walk found, shape ``(N,)``, int64; the length of the last
        may be damaged
    `indexed`: offsets of messages by the index, shape ``(M,)``, int64, ascending
    """
    after = indexed[indexed > walked[-1]] if len(walked) else indexed
    # The damaged message may be the last of the walk, or the first behind it.
    for before, later in ((walked, after), (walked[:-1], after), (walked, after[1:])):
        messages = messages_at(data, np.concatenate([before, later])) if len(later) else None
        if messages is not None:
            return messages
    return messages_at(data, walked)


def _evenly_spaced(data: Buffer, first: int, count: int) -> LocatedMessages | None:
    """Return `count` adjacent messages of one length and channel; None if there are others."""
    opcode, length = RECORD.unpack_from(data, first)
    stride = RECORD.size + length
    if opcode != MESSAGE or length < _FIXED:
        return None
    # The first 16 bytes have opcode, length and channel; one copy of them is faster than two
    # comparisons over the whole chunk.
    front = np.ndarray((count,), "V16", data, first, (stride,)).copy().view("<u8").reshape(-1, 2)
    back = front[:, 1] & _CHANNEL_BITS
    if np.count_nonzero(front[:, 0] != front[0, 0]) or np.count_nonzero(back != back[0]):
        return None
    head = np.ndarray((count,), MESSAGE_HEAD, data, first, (stride,))
    starts = np.arange(first + _HEAD, first + _HEAD + count * stride, stride)
    ends = starts + (length - _FIXED)
    return LocatedMessages(_block(data, starts, ends, head, stride), head["channel"])


def _anywhere(data: Buffer, offsets: NDArray[np.int64]) -> LocatedMessages | None:
    """Return the messages at ascending offsets, with or without other records between them."""
    if (offsets[1:] <= offsets[:-1]).any():
        return None
    head = heads_at(data, offsets)
    if head is None:
        return None
    length = head["length"]
    # A length below the minimum wraps to a very large unsigned number.
    if (length - _FIXED > len(data)).any():
        return None
    ends = offsets + length.astype(np.int64) + RECORD.size
    if ends[-1] > len(data) or (ends[:-1] > offsets[1:]).any():
        return None
    return LocatedMessages(_block(data, offsets + _HEAD, ends, head), head["channel"])


def heads_at(data: Buffer, offsets: NDArray[np.int64]) -> NDArray[np.void] | None:
    """Return the heads of the messages at ascending offsets; None if one is no message."""
    if offsets[-1] > len(data) - _HEAD:
        return None
    # One gather of whole heads is far cheaper than one of each field; a stride of 1 byte allows
    # any offset.
    every = np.ndarray((len(data) - _HEAD + 1,), f"V{_HEAD}", data, strides=(1,))
    head = every[offsets].view(MESSAGE_HEAD)
    return None if (head["opcode"] != MESSAGE).any() else head


def _block(
    data: Buffer,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    head: NDArray[np.void],
    stride: int = 0,
) -> MessageBlock:
    """Return messages with the times in their heads; log times are clamped to int64."""
    log_ns = head["log"].copy()
    if log_ns.min() < 0:
        log_ns[log_ns < 0] = LATEST
    buffer = np.frombuffer(data, np.uint8)
    return MessageBlock(buffer, starts, ends, log_ns, head["publish"], stride=stride)


def index_of(source: FileSource, chunk: Chunk) -> bytes:
    """Return the bytes of a chunk's message indexes; empty if they cannot be read."""
    try:
        return source.read(chunk.start + chunk.length, chunk.index_length)
    except OSError:
        return b""


def indexed_offsets(
    index: Buffer, chunk: Chunk, ids: Sequence[int] | None = None
) -> NDArray[np.int64] | None:
    """Return the message offsets in a chunk's message indexes.

    `ids`: the channels; None for all
    `Returns`: shape ``(N,)``, int64, ascending; None if there is no index or it is damaged
    """
    if not chunk.index_length or chunk.message_index_offsets is None:
        return None
    parts = []
    for channel in chunk.message_index_offsets:
        if ids is None or channel in ids:
            entries = index_entries(index, chunk, chunk.message_index_offsets[channel], channel)
            if entries is None:
                return None
            parts.append(entries[:, 1])
    if len(parts) == 1:
        return parts[0]
    return np.sort(np.concatenate([*parts, np.empty(0, np.int64)]))


def index_entries(
    index: Buffer, chunk: Chunk, place: int, channel: int
) -> NDArray[np.int64] | None:
    """Return the log times and message offsets in the message index of a channel.

    `Returns`: shape ``(N, 2)``, int64; None if it is damaged
    """
    at = place - chunk.start - chunk.length
    if at < 0 or at + INDEX_HEAD.size > len(index):
        return None
    opcode, length, of_channel, size = INDEX_HEAD.unpack_from(index, at)
    begin = at + INDEX_HEAD.size
    if (opcode, of_channel) != (MESSAGE_INDEX, channel) or size + 6 > length or size % INDEX_ENTRY:
        return None
    if begin + size > len(index):
        return None
    return np.frombuffer(index, "<i8", size // 8, begin).reshape(-1, 2)
