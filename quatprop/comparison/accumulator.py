"""Errors of pairs of attitudes, accumulated block by block: size, drift, and the worst pair."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from quatprop.comparison.settings import BY_ALL
from quatprop.comparison.statistics import S_PER_H, ErrorStatistics
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.series.blocks import blocks
from quatprop.timeline.stamps import GAP_FACTOR, MEDIAN_WINDOW
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.comparison.alignment import Alignment


PIECE = 16_384
"""Number of pairs measured at once: their arrays fit into the cache."""


@dataclass(frozen=True, slots=True)
class ComparedSample:
    """One pair of attitudes and its error.

    `t_ns`: its time in A's clock, ns
    `at`: the series with this sample: ``"A"`` or ``"B"``
    `index`: index of the sample, in order of time
    `error_rad`: its error, rad
    """

    t_ns: int
    at: str
    index: int
    error_rad: float


class CoveredTime:
    """The time covered by timestamps, without gaps, accumulated block by block.

    `first_ns`, `last_ns`: first and last timestamp so far, ns
    """

    def __init__(self) -> None:
        self.first_ns = self.last_ns = 0
        self._intervals: list[Int64] = []
        self._limit: float | None = None
        self._ns = 0

    @classmethod
    def of(cls, t_ns: Int64) -> Self:
        """Return the time covered by the timestamps of a series."""
        covered = cls()
        for rows in blocks(len(t_ns)):
            covered.add(t_ns[rows])
        return covered

    def add(self, t_ns: Int64) -> None:
        """Add the next timestamps, shape ``(N,)``, N > 0, ns, in rising order."""
        if not self._intervals:
            self.first_ns = self.last_ns = int(t_ns[0])
        self._intervals.append(np.diff(t_ns, prepend=np.int64(self.last_ns)))
        self.last_ns = int(t_ns[-1])
        if self._limit is not None or sum(map(len, self._intervals)) > MEDIAN_WINDOW:
            self._count()

    def _count(self) -> None:
        intervals = np.concatenate(self._intervals)
        if self._limit is None:
            # The first interval is from the first timestamp to itself.
            usual = intervals[1 : MEDIAN_WINDOW + 1]
            self._limit = GAP_FACTOR * float(np.median(usual)) if len(usual) else 0.0
        self._ns += int(intervals[intervals <= self._limit].sum())
        self._intervals = [intervals[:0]]

    def share_of(self, reference: CoveredTime) -> float:
        """Return the percentage of the time of a reference that is covered."""
        return min(100 * self.ns / reference.ns, 100.0) if reference.ns else 100.0

    @property
    def ns(self) -> int:
        """The time covered so far, ns."""
        if self._intervals:
            self._count()
        return self._ns


class ErrorAccumulator:
    """Accumulates the errors of pairs of attitudes.

    The result does not depend on how pairs are divided into blocks.

    `at`: the series whose timestamps the pairs have: ``"A"`` or ``"B"``
    `limit`: maximum error that passes, rad
    `opposite_signs`: number of pairs of quaternions with a negative dot product
    `worst`: the pair with the largest error
    `first_exceeding`: the first pair with an error above the limit
    """

    def __init__(self, at: str, alignment: Alignment, limit: float) -> None:
        self.alignment = alignment
        self.opposite_signs = 0
        self.worst = ComparedSample(0, at, 0, -1.0)
        self.first_exceeding: ComparedSample | None = None
        self.covered = CoveredTime()
        self._limit = limit
        self._errors = array("d")
        self._block_ns = np.empty(PIECE, np.int64)
        self._filled = 0
        self._total = self._squares = 0.0
        # Means of time, h, and error; sums of squares and products of the differences from them.
        self._means, self._moments = np.zeros(2), np.zeros(2)

    def __len__(self) -> int:
        return len(self._errors)

    def add(self, t_ns: Int64, index: Int64, a: Float64, b: Float64) -> None:
        """Measure the next pairs."""
        start = 0
        while start < len(t_ns):
            rows = slice(start, min(start + PIECE - self._filled, len(t_ns)))
            self._add(t_ns[rows], index[rows], a[rows], b[rows])
            start = rows.stop

    def _add(self, t_ns: Int64, index: Int64, a: Float64, b: Float64) -> None:
        if self.alignment.name != "none":
            b = self.alignment.apply(b)
        errors = geodesic_angle(a, b)
        self.opposite_signs += int(np.count_nonzero(np.einsum("ij,ij->i", a, b) < 0))

        def sample(pair: int) -> ComparedSample:
            at = self.worst.at
            return ComparedSample(int(t_ns[pair]), at, int(index[pair]), float(errors[pair]))

        worst = sample(int(np.argmax(errors)))
        if worst.error_rad > self._limit and self.first_exceeding is None:
            self.first_exceeding = sample(int(np.argmax(errors > self._limit)))
        if worst.error_rad > self.worst.error_rad:
            self.worst = worst
        self.covered.add(t_ns)
        self._errors.frombytes(errors.tobytes())
        self._block_ns[self._filled : self._filled + len(errors)] = t_ns
        self._filled += len(errors)
        if self._filled == PIECE:
            self._flush()

    def _flush(self) -> None:
        """Add the filled part of the block to the sums.

        References
        ----------
        Chan, Golub and LeVeque, "Updating formulae and a pairwise algorithm for computing sample
        variances", Stanford STAN-CS-79-773, 1979.
        """
        count, total = self._filled, len(self._errors)
        errors = np.array(self._errors[-count:])
        self._total += float(errors.sum())
        self._squares += float((errors**2).sum())
        hours = (self._block_ns[:count] - self.covered.first_ns) / (NS_PER_S * S_PER_H)
        means = np.array([hours.mean(), errors.mean()])
        hours -= means[0]
        moments = np.array([(hours**2).sum(), (hours * (errors - means[1])).sum()])
        apart = means - self._means
        self._moments += moments + apart[0] * apart * ((total - count) * count / total)
        self._means += apart * (count / total)
        self._filled = 0

    def errors(self) -> Float64:
        """Return the errors, shape ``(N,)``, rad, after the last pair."""
        if self._filled:
            self._flush()
        return np.frombuffer(self._errors)

    def statistics(self, rising: Float64, final: float) -> ErrorStatistics:
        """Return the statistics of the errors.

        `rising`: the errors, sorted, rad
        `final`: the last error, rad
        """
        last = len(rising) - 1
        below = int(0.95 * last)
        around = rising[below : below + 2]
        return ErrorStatistics(
            max=self.worst.error_rad,
            rms=math.sqrt(self._squares / len(rising)),
            mean=self._total / len(rising),
            median=float(np.median(rising[last // 2 : len(rising) // 2 + 1])),
            p95=float(np.interp(0.95 * last, below + np.arange(len(around)), around)),
            final=final,
        )

    @property
    def drift_deg_h(self) -> float | None:
        """Least squares slope of the errors over time, deg/h; None if it is undefined."""
        power, shared = self._moments.tolist()
        if power == 0.0 or self.alignment.name in BY_ALL:
            return None
        return math.degrees(shared / power)
