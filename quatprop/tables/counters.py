"""Counters of samples, which with a sample rate are a clock that includes lost samples."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.errors import UsageError
from quatprop.times import numbered_stamps

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from quatprop.arrays import Float64, Int64

_BITS = (8, 16, 32)
"""Sizes of counters that wrap around, bits."""

_LOST = 4
"""A counter wrapped around if this means a loss of less than 1/4 of its range."""

_TOO_LARGE = 1 << 61

_DOUBTFUL = 20
"""At most one step in so many may be zero or negative in a counter of samples."""

_LARGEST_STEP = 4
"""Maximum median step of a counter of samples that never steps by 1."""


class Counting(NamedTuple):
    """Steps of the first values of a counter.

    `step`: the most frequent step
    `is_by_one`: whether it counts samples one by one, apart from lost ones
    `has_gaps`: whether there are other steps
    """

    step: int
    is_by_one: bool
    has_gaps: bool


def counting(numbers: Float64) -> Counting | None:
    """Return the steps of a counter by its first values; None if it is not a counter."""
    if len(numbers) < 2 or not (np.abs(numbers) < 2**60).all() or (numbers % 1).any():  # noqa: PLR2004
        return None
    steps = np.diff(counted(numbers.astype(np.int64)))
    rising = steps[steps > 0]
    # A single damaged value is tolerated.
    if not len(rising) or len(steps) - len(rising) > max(1, len(steps) // _DOUBTFUL):
        return None
    sizes, times = np.unique(rising, return_counts=True)
    usual = int(sizes[times.argmax()])
    others = np.count_nonzero(rising % usual)
    is_mixed = others * _DOUBTFUL > len(rising) and np.median(rising) <= _LARGEST_STEP
    return Counting(usual, usual == 1 or bool(is_mixed), len(sizes) > 1)


def counted(values: Int64, before: tuple[int, int] | None = None) -> Int64:
    """Return the counts since the first value of a counter, unwrapped, shape ``(N,)``.

    `before`: last value and count of the preceding rows
    """
    if int(values.max()) >= _TOO_LARGE or int(values.min()) <= -_TOO_LARGE:
        raise OverflowError
    last, count = before or (int(values[0]), 0)
    steps = np.diff(values, prepend=last)
    for row in np.flatnonzero(steps < 0):
        highest = int(values[row] - steps[row])
        size = next((1 << bits for bits in _BITS if highest < 1 << bits), 0)
        if 0 < steps[row] + size < size // _LOST:
            steps[row] += size
    return count + np.cumsum(steps)


def counted_rows(
    batches: Iterator[tuple[Int64, Float64]],
    sample_rate: Fraction | float,
    note_lost: Callable[[int], None],
) -> Iterator[tuple[Int64, Float64]]:
    """Yield rows with the timestamps of their counts, the first at 0 ns.

    `sample_rate`: counts per second, Hz
    """
    before: tuple[int, int] | None = None
    rate = Fraction(str(sample_rate))
    lost = 0
    for values, numbers in batches:
        counts = counted(values, before)
        steps = np.diff(counts, prepend=counts[:1] if before is None else before[1])
        # A damaged count steps back as far as it was ahead.
        lost += int((steps[steps != 0] - 1).sum())
        before = int(values[-1]), int(counts[-1])
        try:
            t_ns = numbered_stamps(counts, rate)
        except UsageError as error:
            raise OverflowError from error
        yield t_ns, numbers
    if lost > 0:
        note_lost(lost)
