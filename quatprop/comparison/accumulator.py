"""Errors of pairs of attitudes, measured block by block: size, drift, and the worst pair."""

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
"""Pairs that are measured together: their arrays stay in the cache."""


@dataclass(frozen=True, slots=True)
class ComparedSample:
    """One pair of attitudes and its error.

    `t_ns`: its time in A's clock, ns
    `at`, `index`: which sample of which series: ``"A"`` or ``"B"``, from 0, in order of time
    `error_rad`: its error, rad
    """

    t_ns: int
    at: str
    index: int
    error_rad: float


class CoveredTime:
    """The time that stamps cover, without gaps, measured block by block.

    `first_ns`, `last_ns`: the first and the last stamp so far, ns
    """

    def __init__(self) -> None:
        self.first_ns = self.last_ns = 0
        self._intervals: list[Int64] = []
        self._limit: float | None = None
        self._ns = 0

    @classmethod
    def of(cls, t_ns: Int64) -> Self:
        """Return the time that the stamps of a series cover."""
        covered = cls()
        for rows in blocks(len(t_ns)):
            covered.add(t_ns[rows])
        return covered

    def add(self, t_ns: Int64) -> None:
        """Add the next stamps, shape ``(N,)``, at least one, ns, in rising order."""
        if not self._intervals:
            self.first_ns = self.last_ns = int(t_ns[0])
        self._intervals.append(np.diff(t_ns, prepend=np.int64(self.last_ns)))
        self.last_ns = int(t_ns[-1])
        if self._limit is not None or sum(map(len, self._intervals)) > MEDIAN_WINDOW:
            self._count()

    def _count(self) -> None:
        intervals = np.concatenate(self._intervals)
        if self._limit is None:
            # The first one is from the first stamp to itself.
            usual = intervals[1 : MEDIAN_WINDOW + 1]
            self._limit = GAP_FACTOR * float(np.median(usual)) if len(usual) else 0.0
        self._ns += int(intervals[intervals <= self._limit].sum())
        self._intervals = [intervals[:0]]

    def share_of(self, reference: CoveredTime) -> float:
        """Return how much of the time of a reference is covered, in percent."""
        return min(100 * self.ns / reference.ns, 100.0) if reference.ns else 100.0

    @property
    def ns(self) -> int:
        """The time covered so far, ns."""
        if self._intervals:
            self._count()
        return self._ns


class ErrorAccumulator:
    """Measures the errors of pairs of attitudes, block by block.

    What it finds does not depend on where blocks end.

    `at`: the series at whose stamps the pairs are: ``"A"`` or ``"B"``
    `limit`: the largest error that passes, rad
    `opposite`: pairs whose quaternions have a negative dot product
    `worst`, `first_exceeding`: the pair with the largest error, and the first with an error above
        the limit
    """

    def __init__(self, at: str, alignment: Alignment, limit: float) -> None:
        self.alignment = alignment
        self.opposite = 0
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
        self.opposite += int(np.count_nonzero(np.einsum("ij,ij->i", a, b) < 0))

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
            self._sum_up()

    def _sum_up(self) -> None:
        """Add a block to the sums.

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
        """Return the errors, rad, shape ``(N,)``; call it when all pairs have passed."""
        if self._filled:
            self._sum_up()
        return np.frombuffer(self._errors)

    def statistics(self, rising: Float64, final: float) -> ErrorStatistics:
        """Return the statistics of the errors."""
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
        """Least squares slope of the errors in time, deg/h; None if there is none to tell."""
        power, shared = self._moments.tolist()
        if power == 0.0 or self.alignment.name in BY_ALL:
            return None
        return math.degrees(shared / power)
