"""Small blocks of messages put together: decoding takes its time by the block, not the message.

A topic beside images has a handful of messages in each chunk.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.base import MessageBlock
from quatprop.containers.spans import spans_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

ENOUGH_MESSAGES = 4096
"""Messages in a block that is large enough by itself."""

ENOUGH_BYTES = 1 << 22
"""Bytes of messages that wait at most, so that large messages do not pile up."""

_GAP = 256
"""Bytes between messages that are copied along: the heads of records, small other messages."""


def joined(blocks: Iterable[MessageBlock]) -> Iterator[MessageBlock]:
    """Put small blocks that follow each other together.

    Parameters
    ----------
    blocks
        Messages of one channel.

    Yields
    ------
    MessageBlock
        The same messages in the same order. Nothing of a small block is kept but its messages,
        so that buffers that are mostly of other channels can go.
    """
    waiting: list[MessageBlock] = []
    messages = size = 0
    for block in blocks:
        is_large = len(block) >= ENOUGH_MESSAGES // 2
        if not is_large:
            waiting.append(_packed(block))
            messages += len(block)
            size += len(waiting[-1].data)
        if is_large or messages >= ENOUGH_MESSAGES or size >= ENOUGH_BYTES:
            yield from _all_of(waiting)
            waiting, messages, size = [], 0, 0
        if is_large:
            yield block
    yield from _all_of(waiting)


def _packed(block: MessageBlock) -> MessageBlock:
    """Return a block that has its messages' bytes for itself."""
    if not len(block):
        return block
    spans = spans_of(block.starts, block.ends, _GAP)
    return MessageBlock(
        spans.of(block.data),
        block.starts - spans.moved,
        block.ends - spans.moved,
        block.log_ns,
        block.publish_ns,
        block.not_before_ns,
    )


def _all_of(blocks: list[MessageBlock]) -> Iterator[MessageBlock]:
    """Yield blocks as one."""
    if len(blocks) <= 1:
        yield from blocks
        return
    sizes = np.array([len(block.data) for block in blocks])
    moved = (np.cumsum(sizes) - sizes).tolist()
    yield MessageBlock(
        np.concatenate([block.data for block in blocks]),
        np.concatenate([block.starts + by for block, by in zip(blocks, moved, strict=True)]),
        np.concatenate([block.ends + by for block, by in zip(blocks, moved, strict=True)]),
        np.concatenate([block.log_ns for block in blocks]),
        np.concatenate([block.publish_ns for block in blocks]),
        blocks[-1].not_before_ns,
    )
