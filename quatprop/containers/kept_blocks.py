"""Blocks of messages that several readers need, and that are read once."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.containers.base import MessageLog
    from quatprop.messages.blocks import Channel, MessageBlock
    from quatprop.tables.log import Log

ROOM = 1 << 25
"""Bytes of messages that are kept of all channels of a log at most."""


@dataclass(slots=True)
class _Place:
    """A place in a stream of blocks, and what follows there once somebody has read it."""

    following: tuple[MessageBlock, _Place] | None = None


@dataclass(slots=True, eq=False)
class _Beginning:
    """Where a channel begins, and what of it is still to be read."""

    place: _Place
    rest: Iterator[MessageBlock]
    size: int = 0


class KeptBlocks:
    """The blocks at the beginning of channels; all of them where there is room for them.

    Whoever begins to read a channel that is kept shares its blocks, to the end with those who go
    on in step. Where there is no more room, the channel that was begun longest ago is dropped.
    """

    def __init__(self) -> None:
        self._kept: dict[Channel, _Beginning] = {}

    def of(self, log: MessageLog, channel: Channel) -> Iterator[MessageBlock]:
        """Return the blocks of a channel."""
        own = self._kept.pop(channel, None)
        if own is None:
            own = _Beginning(_Place(), iter(()))
            own.rest = self._read(log, channel, own)
        self._kept[channel] = own
        return _blocks_from(own.place, own.rest)

    def _read(self, log: MessageLog, channel: Channel, own: _Beginning) -> Iterator[MessageBlock]:
        try:
            for block in log.blocks(channel):
                if self._kept.get(channel) is not own:
                    yield block
                    continue
                # There is nothing to gain where the buffer holds little else.
                size = int((block.ends - block.starts).sum())
                kept = block if 2 * size > len(block.data) else block.compacted()
                own.size += len(kept.data)
                yield kept
                self.keep_at_most(ROOM)
        except Exception:
            # Who begins later would take the blocks before an error for all that there are.
            self.keep_at_most(-1)
            raise

    def keep_at_most(self, size: int) -> None:
        """Drop channels until no more bytes are kept than these; -1: all."""
        while self._kept and sum(each.size for each in self._kept.values()) > size:
            dropped = self._kept.pop(next(iter(self._kept)))
            # What reads the rest refers to it: a cycle would be left to the garbage collector.
            dropped.place, dropped.rest = _Place(), iter(())


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


@contextmanager
def beginnings_kept(log: Log) -> Iterator[None]:
    """Keep in this block what is read of messages, for who reads their beginning several times."""
    if not hasattr(log, "kept"):
        yield  # a file of rows has no messages
        return
    outer = log.kept
    log.kept = kept = outer or KeptBlocks()
    try:
        yield
    finally:
        log.kept = outer
        if outer is None:
            kept.keep_at_most(-1)


def blocks_of(log: MessageLog, channel: Channel) -> Iterator[MessageBlock]:
    """Return the blocks of a channel; those that are kept are not read again."""
    return log.blocks(channel) if log.kept is None else log.kept.of(log, channel)
