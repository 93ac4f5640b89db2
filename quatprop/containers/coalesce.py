"""Coalescing of small blocks of messages, since decoding costs time per block.

A topic that is recorded beside images has only a few messages in each chunk.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.base import MessageBlock
from quatprop.stores.byte_ranges import ranges_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence


ENOUGH_MESSAGES = 4096
"""Messages of a block that is large enough."""

ENOUGH_BYTES = 1 << 22
"""Bytes of messages that are collected at most, so that large messages do not fill the memory."""

_GAP = 256
"""Bytes between two messages that are copied with them: record heads and small other messages."""


def coalesce_blocks(blocks: Iterable[MessageBlock]) -> Iterator[MessageBlock]:
    """Combine small blocks that follow each other."""
    waiting: list[MessageBlock] = []
    messages = size = 0
    for block in blocks:
        is_large = len(block) >= ENOUGH_MESSAGES // 2
        if not is_large:
            waiting.append(compacted(block))
            messages += len(block)
            size += len(waiting[-1].data)
        if is_large or messages >= ENOUGH_MESSAGES or size >= ENOUGH_BYTES:
            yield from [combined(waiting)] if waiting else []
            waiting, messages, size = [], 0, 0
        if is_large:
            yield block
    yield from [combined(waiting)] if waiting else []


def compacted(block: MessageBlock) -> MessageBlock:
    """Return a copy of a block without the bytes between its messages."""
    if not len(block):
        return block
    ranges = ranges_of(block.starts, block.ends, _GAP)
    return replace(
        block,
        data=ranges.of(block.data),
        starts=block.starts - ranges.moved,
        ends=block.ends - ranges.moved,
        publish_ns=block.publish_ns.copy(),
        stride=0,
    )


def combined(blocks: Sequence[MessageBlock]) -> MessageBlock:
    """Return one block with copies of several, at least one."""
    if len(blocks) == 1:
        return blocks[0]
    begins = list(accumulate((len(block.data) for block in blocks[:-1]), initial=0))
    placed = list(zip(blocks, begins, strict=True))
    return MessageBlock(
        np.concatenate([block.data for block in blocks]),
        np.concatenate([block.starts + begin for block, begin in placed]),
        np.concatenate([block.ends + begin for block, begin in placed]),
        np.concatenate([block.log_ns for block in blocks]),
        np.concatenate([block.publish_ns for block in blocks]),
        blocks[-1].not_before_ns,
    )
