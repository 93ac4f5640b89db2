"""The blocks of a topic: the first are held for several readers, and small ones go together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.containers.base import MessageLog
    from quatprop.messages.blocks import Channel, MessageBlock

ROOM = 1 << 23
"""Bytes of messages that are held at most: some 20,000 of a usual topic."""

ENOUGH_MESSAGES = 1 << 13
"""Messages that are decoded together."""

ENOUGH_BYTES = 1 << 22
"""Bytes of blocks that wait to be decoded at most, which still are in the processor's cache."""


@dataclass(slots=True)
class _Place:
    """A place in a stream of blocks, and what follows there once somebody has read it."""

    following: tuple[MessageBlock, _Place] | None = None


class FirstBlocks:
    """The blocks of a channel; all who begin to read it share them while there is room for them.

    Those who go on in step share what follows, too. Who begins after that reads again.
    """

    def __init__(self, log: MessageLog, channel: Channel) -> None:
        self._log, self._channel = log, channel
        self._first: _Place | None = None
        self._rest: Iterator[MessageBlock] = iter(())
        self._room = self._turn = 0

    def __iter__(self) -> Iterator[MessageBlock]:
        """Return the blocks from the first one on."""
        if self._first is None:
            self._first, self._room = _Place(), ROOM
            self._rest = self._read(self._turn)
        return _blocks_from(self._first, self._rest)

    def _read(self, turn: int) -> Iterator[MessageBlock]:
        try:
            for block in self._log.blocks(self._channel):
                if self._turn != turn:
                    yield block
                    continue
                # There is nothing to gain where the buffer holds little else.
                size = int((block.ends - block.starts).sum())
                held = block if 2 * size > len(block.data) else block.compacted()
                self._room -= len(held.data)
                yield held
                if self._room < 0 and self._turn == turn:
                    self.release()
        except Exception:
            # Who begins later would take the blocks before an error for all that there are.
            self.release()
            raise

    def release(self) -> None:
        """Hold nothing: who begins now reads again."""
        # What reads the rest refers to it: a cycle would be left to the garbage collector.
        self._first, self._rest, self._turn = None, iter(()), self._turn + 1


def _blocks_from(place: _Place, rest: Iterator[MessageBlock]) -> Iterator[MessageBlock]:
    """Yield blocks; unlike `tee`, which keeps up to 57, hold none that all readers are past."""
    while True:
        if place.following is None:
            block = next(rest, None)
            if block is None:
                return
            place.following = block, _Place()
        block, place = place.following
        yield block


def decoded_together(blocks: Iterable[MessageBlock]) -> Iterator[list[MessageBlock]]:
    """Yield blocks that are decoded together, since it takes time for each.

    The first is by itself, for who reads only the beginning; then about twice as many messages as
    before are together.
    """
    waiting: list[MessageBlock] = []
    messages = size = enough = 0
    for block in blocks:
        waiting.append(block)
        messages += len(block)
        size += len(block.data)
        if messages >= enough or size >= ENOUGH_BYTES:
            yield waiting
            enough = min(ENOUGH_MESSAGES, 2 * messages)
            waiting, messages, size = [], 0, 0
    if waiting:
        yield waiting
