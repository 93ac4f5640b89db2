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

SHARED_STAMPS: Final = 0.98
"""Sources on one grid of times share at least this part of their timestamps."""

ROUNDING: Final = 1e-6
"""Rounding of a source is below this share of its motion, and the noise of sensors above it."""

EXPLAINED: Final = 0.01
"""Most of what its own past does not tell, as a share, that a source may lack that is made of
another."""


def is_made_of(a: Source, b: Source) -> bool:
    """Return whether a linear filter of A gives B."""
    (t_a, rate_a), (t_b, rate_b) = _steps(a), _steps(b)
    _, in_a, in_b = np.intersect1d(t_a, t_b, assume_unique=True, return_indices=True)
    if len(in_b) < SHARED_STAMPS * len(t_b):
        if len(t_a) != len(t_b):
            return False
        in_a = in_b = np.arange(len(t_a))
    # The part after which both have a past.
    usable = (in_b >= OWN) & (in_a >= TAPS)
    in_a, in_b = in_a[usable], in_b[usable]
    if len(in_b) < 2 * ROWS // 10:
        return False
    part = _liveliest(rate_b[in_b])
    in_a, in_b = in_a[part], in_b[part]
    size = float(np.sqrt(rate_b[in_b].var(axis=0).sum()))
    past = _taps(rate_b, in_b, range(1, OWN + 1))
    with_a = np.concatenate((past, _taps(rate_a, in_a, range(TAPS))), axis=1)
    left = _left(with_a, rate_b[in_b])
    return left < ROUNDING * size and left < EXPLAINED * _left(past, rate_b[in_b])


def _steps(source: Source) -> tuple[Int64, Float64]:
    """Return timestamps and rates, rad/s; of an orientation those over the interval before."""
    if source.is_rates:
        return source.t_ns, source.values
    steps = np.diff(source.t_ns)[:, None] / NS_PER_S
    return source.t_ns[1:], rotation_vectors_between(source.values) / steps


def _liveliest(rate: Float64) -> slice:
    """Return the rows, at most :data:`ROWS`, in which a source turns most."""
    starts = range(0, max(len(rate) - ROWS // 2, 1), ROWS)
    first = max(starts, key=lambda k: float(rate[k : k + ROWS].var(axis=0).sum()))
    return slice(first, first + ROWS)


def _taps(rate: Float64, rows: Intp, lags: range) -> Float64:
    """Return rates at earlier rows, side by side, ``(M, 3 len(lags))``."""
    return np.concatenate([rate[rows - lag] for lag in lags], axis=1)


def _left(of: Float64, rate: Float64) -> float:
    """Return the RMS of what columns do not explain of rates."""
    columns = np.column_stack((of, np.ones(len(of))))
    by, *_ = np.linalg.lstsq(columns, rate, rcond=None)
    return float(np.sqrt(((rate - columns @ by) ** 2).sum(axis=1).mean()))
