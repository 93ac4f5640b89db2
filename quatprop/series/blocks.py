"""Blocks of fixed size: what is computed of each does not depend on how samples arrived."""

from __future__ import annotations

import math
from itertools import repeat, tee, zip_longest
from typing import TYPE_CHECKING, TypeVar

from quatprop.series import GyroSeries

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.arrays import Float64

Item = TypeVar("Item")

BLOCK = 131_072
"""Samples in a block of :func:`reblock`: 4 MiB of rates, enough to make calls cheap."""


def blocks(rows: int) -> Iterator[slice]:
    """Yield slices of so many rows: what is computed of each needs no memory for all of them."""
    for start in range(0, rows, BLOCK):
        yield slice(start, start + BLOCK)


def rms(error: Float64) -> float:
    """Return the root of the mean square."""
    squares = sum(float((error[rows] ** 2).sum()) for rows in blocks(len(error)))
    return math.sqrt(squares / len(error))


def reblock(batches: Iterable[GyroSeries], size: int = BLOCK) -> Iterator[GyroSeries]:
    """Cut a stream of samples at fixed sample indices, wherever its batches ended.

    What is computed block by block is then the same to the bit however the samples arrived.
    """
    held: list[GyroSeries] = []
    count = 0
    for batch in batches:
        start = 0
        while count + len(batch) - start >= size:
            stop = start + size - count
            yield GyroSeries.joined([*held, batch[start:stop]])
            held, count, start = [], 0, stop
        if start < len(batch):
            held.append(batch[start:])
            count += len(batch) - start
    if count:
        yield GyroSeries.joined(held)


def with_next(items: Iterable[Item], *, look_ahead: bool) -> Iterator[tuple[Item, Item | None]]:
    """Yield each item with the next one, which is None after the last.

    `look_ahead`: whether to wait for the next one; otherwise it is always None
    """
    if not look_ahead:
        yield from zip(items, repeat(None), strict=False)
        return
    these, following = tee(items)
    next(following, None)
    yield from zip_longest(these, following)
