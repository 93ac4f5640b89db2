"""Rows of a query, fetched in groups and combined into blocks of messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.containers.base import MessageBlock

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

ROWS = 256
"""Rows that are fetched together: they fit the processor's cache."""

FETCHES = 16
"""Fetches in a block, so that decoding costs little per message."""

BLOCK_BYTES = 4 << 20
"""Bytes from which a block is complete, for large messages."""


class Fetch(NamedTuple):
    """Rows fetched together: log times, ns, and the lengths and bytes of the messages."""

    times: NDArray[np.int64]
    lengths: NDArray[np.int64]
    data: bytes


def fetch_of(stamps: Sequence[int], messages: Sequence[bytes]) -> Fetch:
    """Return rows as arrays."""
    return Fetch(
        np.fromiter(stamps, np.int64, len(stamps)),
        np.fromiter(map(len, messages), np.int64, len(messages)),
        b"".join(messages),
    )


def next_group(fetches: Iterator[Fetch]) -> list[Fetch]:
    """Take the fetches of one block; none at the end."""
    group: list[Fetch] = []
    size = 0
    for fetch in fetches:
        group.append(fetch)
        size += len(fetch.data)
        if len(group) == FETCHES or size > BLOCK_BYTES:
            break
    return group


def combined(fetches: list[Fetch]) -> MessageBlock:
    """Combine fetches into one block."""
    times_of, lengths_of, data = zip(*fetches, strict=True)
    times, lengths = np.concatenate(times_of), np.concatenate(lengths_of)
    ends = np.cumsum(lengths)
    buffer = np.frombuffer(b"".join(data), np.uint8)
    return MessageBlock(buffer, ends - lengths, ends, times, times, int(times[-1]))
