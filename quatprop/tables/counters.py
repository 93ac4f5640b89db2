"""Counters of samples: with a steady rate they are a clock that knows of lost samples."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import UsageError
from quatprop.times import numbered_stamps

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64, Int64

_BITS = (8, 16, 32)
"""Sizes of counters, which begin again at 0."""

_LOST = 4
"""A counter that begins again has lost less than this part of its range."""


_TOO_LARGE = 1 << 61


def counted(values: Int64, before: tuple[int, int] | None = None) -> Int64:
    """Return how many samples a counter has counted since its first value, shape ``(N,)``.

    Parameters
    ----------
    values
        Of the counter, which may begin again at 0.
    before
        The value before them, and how many it had counted.

    Raises
    ------
    OverflowError
        They are no counts of samples: their differences do not fit in 64 bits.
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
    batches: Iterator[tuple[Int64, Float64]], sample_rate: Fraction | float
) -> Iterator[tuple[Int64, Float64]]:
    """Yield rows at the stamps of their counters, the first at 0 ns.

    Raises
    ------
    OverflowError
        A stamp does not fit in 64 bits.
    """
    before: tuple[int, int] | None = None
    rate = Fraction(str(sample_rate))
    for values, numbers in batches:
        counts = counted(values, before)
        before = int(values[-1]), int(counts[-1])
        try:
            t_ns = numbered_stamps(counts, rate)
        except UsageError as error:
            raise OverflowError from error
        yield t_ns, numbers
