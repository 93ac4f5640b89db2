"""Blocks of messages that several readers need, and that are read once."""

from __future__ import annotations

from contextlib import contextmanager
from itertools import tee
from typing import TYPE_CHECKING

from quatprop.containers.coalesce import compacted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.containers.base import Channel, MessageBlock, MessageLog


@contextmanager
def beginning_kept(log: MessageLog) -> Iterator[None]:
    """Keep in this block what is read of messages, for who reads their beginning several times."""
    log.kept = {}
    try:
        yield
    finally:
        log.kept = None


@contextmanager
def blocks_shared(log: MessageLog, channels: Iterable[Channel]) -> Iterator[None]:
    """Let those who begin in this block to read channels share their blocks, and go on in step."""
    log.kept = {channel: log.blocks(channel) for channel in channels}
    try:
        yield
    finally:
        log.kept = None


def blocks_of(log: MessageLog, channel: Channel) -> Iterator[MessageBlock]:
    """Return the blocks of a channel; those that are kept are not read again."""
    if log.kept is None:
        return log.blocks(channel)
    first = log.kept.get(channel) or map(compacted, log.blocks(channel))
    log.kept[channel], blocks = tee(first)
    return blocks
