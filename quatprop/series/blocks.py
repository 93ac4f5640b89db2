"""Blocks of fixed size, so that results do not depend on the sizes of batches."""

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
"""Samples in a block of :func:`reblock`: 4 MiB of rates, enough to amortise calls."""


def blocks(rows: int) -> Iterator[slice]:
    """Yield slices of :data:`BLOCK` rows, to bound the memory of computations on them."""
    for start in range(0, rows, BLOCK):
        yield slice(start, start + BLOCK)


def rms(error: Float64) -> float:
    """Return the root of the mean square."""
    squares = sum(float((error[rows] ** 2).sum()) for rows in blocks(len(error)))
    return math.sqrt(squares / len(error))


def reblock(batches: Iterable[GyroSeries], size: int = BLOCK) -> Iterator[GyroSeries]:
    """Split a stream of samples at fixed sample indices, whatever its batches.

    Results of block-wise computations then have the same bits for all sizes of batches.
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
    """Yield each item with the next one; None after the last.

    `look_ahead`: whether to wait for the next one; otherwise it is always None
    """
    if not look_ahead:
        yield from zip(items, repeat(None), strict=False)
        return
    these, following = tee(items)
    next(following, None)
    yield from zip_longest(these, following)
