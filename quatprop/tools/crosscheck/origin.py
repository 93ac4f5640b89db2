"""Whether a source is made of another: its numbers follow from those of the other, to rounding.

Two quiet sensors may agree as well as one likes, and share what shakes them. But each has noise of
its own, far above the rounding of its numbers: a filter of one source never gives the other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.kinematics.propagate import rotation_vectors_between

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64, Int64, Intp
    from quatprop.tools.crosscheck.sources import Source

TAPS: Final = 24
"""Length of the filter from one source to the other, in samples before the same time."""

OWN: Final = 4
"""Length of its recursive part."""

ROWS: Final = 2000
"""Samples that are looked at: those in which the source turns most."""

FEWEST: Final = 400
"""Samples that are needed."""

PLACES: Final = 16
"""Parts of a log that are looked at."""

SHARED_STAMPS: Final = 0.98
"""Sources on one grid of times share at least this part of their timestamps."""

ROUNDING: Final = 1e-6
"""Rounding of a source is below this share of its motion, and the noise of sensors above it."""

EXPLAINED: Final = 0.01
"""Most of what its own past does not tell, as a share, that a source may lack that is made of
another."""


def is_made_of(a: Source, b: Source) -> bool:
    """Return whether a linear filter of A gives B."""
    in_a, in_b = _same_times(a.t_ns, b.t_ns)
    # Samples with a past; that of an orientation has one more.
    usable = (in_b > OWN) & (in_a > TAPS)
    in_a, in_b = in_a[usable], in_b[usable]
    if len(in_b) < FEWEST:
        return False
    part = _liveliest(b, in_b)
    in_a, in_b = in_a[part], in_b[part]
    rate_b = _rates_at(b, in_b, range(1))
    past = _rates_at(b, in_b, range(1, OWN + 1))
    with_a = np.concatenate((past, _rates_at(a, in_a, range(TAPS))), axis=1)
    size = float(np.sqrt(rate_b.var(axis=0).sum()))
    left = _left(with_a, rate_b)
    return left < ROUNDING * size and left < EXPLAINED * _left(past, rate_b)


def _same_times(t_a: Int64, t_b: Int64) -> tuple[Intp, Intp]:
    """Return the samples of both at equal times, or one by one; none if they are on two grids."""
    at = np.minimum(np.searchsorted(t_a, t_b), len(t_a) - 1)
    (in_b,) = np.nonzero(t_a[at] == t_b)
    if len(in_b) >= SHARED_STAMPS * len(t_b):
        return at[in_b], in_b
    every = np.arange(len(t_b) if len(t_a) == len(t_b) else 0)
    return every, every


def _liveliest(source: Source, rows: Intp) -> slice:
    """Return the part, at most :data:`ROWS`, in which a source turns most, of some parts."""
    starts = np.linspace(0, max(len(rows) - ROWS, 0), PLACES).astype(int).tolist()

    def motion(first: int) -> float:
        rate = _rates_at(source, rows[first : first + ROWS], range(1))
        return float(rate.var(axis=0).sum())

    first = max(starts, key=motion)
    return slice(first, first + ROWS)


def _rates_at(source: Source, rows: Intp, lags: range) -> Float64:
    """Return rates at earlier rows, side by side, ``(M, 3 len(lags))``, rad/s.

    Of an orientation, those over the interval before.
    """
    if source.is_rates:
        return np.concatenate([source.values[rows - lag] for lag in lags], axis=1)
    columns = []
    for lag in lags:
        after, before = rows - lag, rows - lag - 1
        steps = (source.t_ns[after] - source.t_ns[before])[:, None] / NS_PER_S
        both = np.stack((source.values[before], source.values[after]), axis=1).reshape(-1, 4)
        columns.append(rotation_vectors_between(both)[::2] / steps)
    return np.concatenate(columns, axis=1)


def _left(of: Float64, rate: Float64) -> float:
    """Return the RMS of what columns do not explain of rates."""
    columns = np.column_stack((of, np.ones(len(of))))
    by, *_ = np.linalg.lstsq(columns, rate, rcond=None)
    return float(np.sqrt(((rate - columns @ by) ** 2).sum(axis=1).mean()))
