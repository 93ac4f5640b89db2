"""Fetch the rows of a query in groups, and combine them into blocks of messages."""

from __future__ import annotations

from array import array
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import apsw
import numpy as np

from quatprop.messages.blocks import MessageBlock

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

ROWS = 256
"""Maximum number of rows that are fetched together: they fit the processor's cache."""

FETCHES = 16
"""Number of fetches in a block: large blocks cost less to decode."""

BLOCK_BYTES = 4 << 20
"""Bytes from which a block is complete, even of fewer fetches."""


class Fetch(NamedTuple):
    """Rows that were fetched together: log times, ns, lengths and bytes of the messages."""

    times: NDArray[np.int64]
    lengths: NDArray[np.int64]
    data: bytes


def fetch_of(rows: Sequence[tuple[int | None, bytes]]) -> Fetch:
    """Return rows of log time and bytes as arrays, without rows that have no time."""
    times, messages = zip(*rows, strict=True)
    if None in times:
        timed = [row for row in rows if row[0] is not None]
        times, messages = zip(*timed, strict=True) if timed else ((), ())
    return Fetch(
        # NumPy's conversion would accept fractions.
        np.frombuffer(array("q", times), np.int64),
        np.fromiter(map(len, messages), np.int64, len(messages)),
        b"".join(messages),
    )


def fetched(cursor: Iterator[tuple[Any, ...]]) -> Iterator[tuple[int, Fetch]]:
    """Yield the rows of a query in groups: their number, and the fetch of those with a time."""
    size = 64
    damage = None
    while damage is None:
        rows: list[Any] = []
        try:
            # Rows before an error stay in the list.
            rows.extend(islice(cursor, size))
        except apsw.Error as error:
            damage = error
        if not rows:
            break
        fetch = fetch_of(rows)
        yield len(rows), fetch
        size = min(ROWS, max(1, BLOCK_BYTES * len(rows) // (len(fetch.data) + 1)))
    if damage is not None:
        raise damage


def next_group(fetches: Iterator[Fetch]) -> list[Fetch]:
    """Return the next fetches, enough for one block; empty at the end."""
    group: list[Fetch] = []
    size = 0
    for fetch in fetches:
        if len(fetch.times):
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
