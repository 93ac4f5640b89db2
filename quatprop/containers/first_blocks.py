"""Buffer the first blocks of a topic for several readers, and group small blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.containers.base import MessageLog
    from quatprop.messages.blocks import Channel, MessageBlock

ROOM = 1 << 23
"""Maximum bytes of buffered messages: some 20,000 of a usual topic."""

ENOUGH_MESSAGES = 1 << 13
"""Number of messages that are decoded together."""

ENOUGH_BYTES = 1 << 22
"""Maximum bytes of blocks that are decoded together: they stay in the processor's cache."""


@dataclass(slots=True)
class _Node:
    """A node of a linked list of blocks; `following` is None until the next block is read."""

    following: tuple[MessageBlock, _Node] | None = None


class FirstBlocks:
    """The blocks of a channel, read once for all iterators that begin while the buffer has room.

    Those that go on in step share the later blocks, too. A later iterator reads the log again.
    """

    def __init__(self, log: MessageLog, channel: Channel) -> None:
        self._log, self._channel = log, channel
        self._first: _Node | None = None
        self._rest: Iterator[MessageBlock] = iter(())
        self._room = self._turn = 0

    def __iter__(self) -> Iterator[MessageBlock]:
        """Iterate over all blocks, from the first on."""
        if self._first is None:
            self._first, self._room = _Node(), ROOM
            self._rest = self._read(self._turn)
        return _blocks_from(self._first, self._rest)

    def _read(self, turn: int) -> Iterator[MessageBlock]:
        try:
            for block in self._log.blocks(self._channel):
                if self._turn != turn:
                    yield block
                    continue
                # Compacting does not pay if the buffer has few other bytes.
                size = int((block.ends - block.starts).sum())
                held = block if 2 * size > len(block.data) else block.compacted()
                self._room -= len(held.data)
                yield held
                if self._room < 0 and self._turn == turn:
                    self.release()
        except Exception:
            # A later iterator would take the blocks before the error for all blocks.
            self.release()
            raise

    def release(self) -> None:
        """Drop the buffer: the next iterator reads the log again."""
        # The iterator refers to this object: the cycle would wait for the garbage collector.
        self._first, self._rest, self._turn = None, iter(()), self._turn + 1


def _blocks_from(node: _Node, rest: Iterator[MessageBlock]) -> Iterator[MessageBlock]:
    """Yield blocks; `itertools.tee` would keep up to 57 that all iterators are past."""
    while True:
        if node.following is None:
            block = next(rest, None)
            if block is None:
                return
            node.following = block, _Node()
        block, node = node.following
        yield block


def decoded_together(blocks: Iterable[MessageBlock]) -> Iterator[list[MessageBlock]]:
    """Yield groups of blocks that are decoded together, since each call takes time.

    The first block is alone, for callers that read only the beginning; each further group has about
    twice as many messages as the one before.
    """
    group: list[MessageBlock] = []
    messages = size = enough = 0
    for block in blocks:
        group.append(block)
        messages += len(block)
        size += len(block.data)
        if messages >= enough or size >= ENOUGH_BYTES:
            yield group
            enough = min(ENOUGH_MESSAGES, 2 * messages)
            group, messages, size = [], 0, 0
    if group:
        yield group
