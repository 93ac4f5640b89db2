"""Reduce a series of any length to as many points as a picture can show, in constant memory.

Time is cut into bins whose widths are powers of two of a nanosecond. How long the series will be
is not known beforehand, so the bins begin narrow, and neighbours are merged whenever there are too
many. Every bin keeps the first, lowest, highest and last value of each trace: drawn at the
resolution of the bins, this line equals that of all samples, so that a spike of one sample is
visible.

The edges of bins do not depend on the first sample or on batches, so the result does not depend on
how the samples arrived.

References
----------
Jugel, Jerzak, Hackenbroich and Markl, "M4: a visualization-oriented time series data
aggregation", Proc. VLDB Endowment 7(10), 2014.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.timeline.stamps import LONGEST_NS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.base.arrays import Bool, Float64, Int64, Intp

BINS = 2048
"""Most bins that are kept; they cover at least half as many dots of a printed page."""

LARGEST = 1e300
"""Values from here on are treated as infinite: matplotlib cannot lay out an axis for them."""

PENDING = 65_536
"""Samples that are collected before they are put into bins."""


@dataclass(frozen=True, slots=True)
class Reduced:
    """A reduced series: the bins that contain samples, in order of time.

    `first_ns`, `last_ns`: timestamps of the first and the last sample of each bin in time, shape
        ``(M,)``, int64 ns
    `first`, `low`, `high`, `last`: values of each trace, shape ``(traces, M)``. NaN where a sample
        is missing; `low` and `high` only if all are
    """

    first_ns: Int64
    last_ns: Int64
    first: Float64
    low: Float64
    high: Float64
    last: Float64

    def __len__(self) -> int:
        return len(self.first_ns)

    def gaps(self, limit_ns: int | None) -> Bool:
        """Return which bins are followed by a gap above a limit, ns, shape ``(M - 1,)``.

        Gaps inside a bin are narrower than a dot. No limit means no gaps.
        """
        limit_ns = LONGEST_NS if limit_ns is None else limit_ns
        return np.asarray(self.first_ns[1:] - self.last_ns[:-1] > limit_ns)


class Reduction:
    """Reduces a series batch by batch.

    `bins`: most bins to keep, at least 2: times on both sides of zero never share one
    """

    def __init__(self, traces: int, bins: int = BINS) -> None:
        self._bins = bins
        self._shift = 0
        self._index = np.empty(0, np.int64)
        empty = np.empty(0, np.int64)
        values = np.empty((traces, 0))
        self._kept = Reduced(empty, empty, values, values, values, values)
        self._pending: list[tuple[Int64, Float64]] = []
        self._waiting = 0

    def add(self, t_ns: Int64, values: Sequence[Float64] | Float64) -> None:
        """Add the next samples.

        `t_ns`: stamps, shape ``(N,)``, int64 ns, in any order
        `values`: of each trace, shape ``(traces, N)``; NaN, infinite or huge for none
        """
        if not len(t_ns):
            return
        self._pending.append((t_ns, np.array(values, dtype=np.float64)))
        self._waiting += len(t_ns)
        if self._waiting >= PENDING:
            self._bin_pending()

    def result(self) -> Reduced:
        """Return the reduction of all samples so far."""
        self._bin_pending()
        return self._kept

    def _bin_pending(self) -> None:
        """Put the pending samples into their bins."""
        if not self._pending:
            return
        t_ns = np.concatenate([stamps for stamps, _ in self._pending])
        values = np.concatenate([rows for _, rows in self._pending], axis=1)
        self._pending, self._waiting = [], 0
        with np.errstate(invalid="ignore"):  # signalling NaNs
            values[~(np.abs(values) < LARGEST)] = np.nan
        low_ns, high_ns = int(t_ns.min()), int(t_ns.max())
        if len(self._index):
            low_ns = min(low_ns, int(self._index[0]) << self._shift)
            high_ns = max(high_ns, int(self._index[-1]) << self._shift)
        before = self._shift
        while (high_ns >> self._shift) - (low_ns >> self._shift) >= self._bins:
            self._shift += 1
        samples = Reduced(t_ns, t_ns, values, values, values, values)
        index, new = _merge(t_ns >> self._shift, samples)
        old, kept = self._index >> (self._shift - before), self._kept
        both = ((getattr(kept, name), getattr(new, name)) for name in Reduced.__slots__)
        joined = Reduced(*(np.concatenate(parts, axis=-1) for parts in both))
        self._index, self._kept = _merge(np.concatenate([old, index]), joined)


def _merge(index: Int64, parts: Reduced) -> tuple[Int64, Reduced]:
    """Merge the parts of each bin; equal timestamps keep their order of arrival.

    `index`: the bin of each part, shape ``(N,)``, N at least 1
    """
    # The samples of a bin are contiguous in both orders, and bins are in order of time.
    by_first, by_last = _rising(parts.first_ns), _rising(parts.last_ns)
    index = index[by_first]
    starts = np.flatnonzero(np.concatenate([[True], index[1:] != index[:-1]]))
    ends = np.append(starts[1:], len(index)) - 1
    merged = Reduced(
        parts.first_ns[by_first][starts],
        parts.last_ns[by_last][ends],
        parts.first[:, by_first][:, starts],
        _extremes(np.minimum, np.fmin, parts.low[:, by_first], starts),
        _extremes(np.maximum, np.fmax, parts.high[:, by_first], starts),
        parts.last[:, by_last][:, ends],
    )
    return index[starts], merged


def _rising(t_ns: Int64) -> slice | Intp:
    """Return the index that sorts timestamps; a slice, without a copy, if they are sorted."""
    if (t_ns[1:] >= t_ns[:-1]).all():
        return slice(None)
    return np.argsort(t_ns, kind="stable")


def _extremes(plain: np.ufunc, skipping_nan: np.ufunc, values: Float64, starts: Intp) -> Float64:
    """Return the extremes of each run of values; skipping NaN is slower."""
    extreme = skipping_nan if np.isnan(values).any() else plain
    return np.asarray(extreme.reduceat(values, starts, axis=1))
