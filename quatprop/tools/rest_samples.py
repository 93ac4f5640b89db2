"""Statistics of the samples at rest: sums, spacing, rounding, drift.

Missing samples are found by the grid of the others. Samples that come in bursts were
measured so, or evenly and delivered so; the log does not say which.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.propagation.conditioning.static_period import FEW, StepFinder, step_of
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.tools.allan import AllanSums

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.base.arrays import Float64, Int64
    from quatprop.kinematics.series import GyroSeries


LONG: Final = 1.5
"""Intervals of more than this many usual ones end a run of samples."""

FEWEST_RUNS: Final = 10
"""Minimum number of runs that show bursts."""

ALIKE: Final = 0.2
"""Runs are bursts if the time that each of their samples lacks scatters by less than this share
of it, between quartiles: samples get lost here and there."""

APART: Final = 0.05
"""Minimum of this time, as a share of the usual interval."""

ON_GRID: Final = 0.2
"""Maximum deviation of intervals from multiples of the usual one, RMS, in usual ones; 0.29 is that
of any intervals."""

MOST_MISSING: Final = 0.4
"""Maximum share of samples that are missing: of more, the grid is doubtful."""


class Bursts(NamedTuple):
    """Samples in bursts.

    `size`: usual number of samples in a burst
    `span_ns`, `period_ns`: usual time from its first to its last sample, and to the next burst, ns
    """

    size: int
    span_ns: int
    period_ns: int


class Spacing(NamedTuple):
    """How samples are spaced.

    `usual_ns`: their usual interval, ns; 0 if it is unknown
    `bursts`: the bursts in which they come; None if they do not
    `on_grid`: whether their intervals are multiples of the usual one, so that others are missing
    """

    usual_ns: int
    bursts: Bursts | None
    on_grid: bool


def spacing_of(t_ns: Int64) -> Spacing:
    """Return how samples are spaced, by the first ones."""
    intervals = np.diff(t_ns)
    positive = intervals[intervals > 0]
    if not len(positive):
        return Spacing(0, None, on_grid=False)
    usual = float(np.median(positive))
    inside = intervals[intervals <= GAP_FACTOR * usual] / usual
    off = inside - np.rint(inside)
    bursts = _bursts(t_ns, intervals, usual)
    on_grid = bursts is None and math.sqrt(float((off * off).mean())) < ON_GRID
    return Spacing(round(usual), bursts, on_grid)


def _bursts(t_ns: Int64, intervals: Int64, usual: float) -> Bursts | None:
    starts = np.flatnonzero(intervals > LONG * usual) + 1
    sizes, periods = np.diff(starts), np.diff(t_ns[starts])
    if len(sizes) < FEWEST_RUNS:
        return None
    low, lacks, high = np.quantile(periods / sizes - usual, [0.25, 0.5, 0.75])
    if high - low > ALIKE * lacks or lacks < APART * usual:
        return None
    size = int(np.median(sizes))
    return Bursts(size, round((size - 1) * usual), int(np.median(periods)))


class RestSamples:
    """Gathers the samples at rest.

    `ends`: first and last timestamp of each stationary period, ns
    `spacing`: how the samples are spaced
    `trend`: the trend to subtract from the rates; None: nothing
    """

    def __init__(
        self, ends: Sequence[tuple[int, int]], spacing: Spacing, trend: Trend | None = None
    ) -> None:
        self._ends, self._spacing, self._trend = ends, spacing, trend
        self.sums = AllanSums()
        self._steps, self._means = StepFinder(), RunningMeans()
        self._slots, self._span_ns = 0, 0

    def add(self, segment: Iterator[GyroSeries]) -> None:
        """Add those of a segment without gaps."""
        at, last_ns = -1, 0
        for block in segment:
            for number, (begin_ns, end_ns) in enumerate(self._ends):
                start, stop = np.searchsorted(block.t_ns, [begin_ns, end_ns + 1])
                if start == stop:
                    continue
                t_ns, rate = block.t_ns[start:stop], block.rate[start:stop]
                if number != at:
                    self.sums.begin_piece()
                    at, last_ns = number, int(t_ns[0])
                self._add(np.diff(t_ns, prepend=last_ns), t_ns, rate)
                last_ns = int(t_ns[-1])

    def _add(self, intervals: Int64, t_ns: Int64, rate: Float64) -> None:
        self._span_ns += int(intervals.sum())
        if self._spacing.on_grid:
            self._slots += int(np.rint(intervals / self._spacing.usual_ns).sum())
        self._note_values(rate)
        if self._trend is not None:
            rate = rate - self._trend.at(t_ns)
        self.sums.add(rate)
        self._means.add(t_ns, rate)

    def _note_values(self, rate: Float64) -> None:
        """Examine a part of the rates, and all of an axis that shows no more than two values."""
        self._steps.observe(rate)
        for axis, values in enumerate(self._steps.values):
            if values is not None and len(values) <= FEW:
                self._steps.values[axis] = np.union1d(values, rate[:, axis])

    @property
    def samples(self) -> int:
        """Number of samples."""
        return sum(self.sums.lengths)

    @property
    def mean_s(self) -> float:
        """Mean interval, s; 0 without two samples."""
        return self._span_ns / max(self.samples - len(self.sums.lengths), 1) / NS_PER_S

    @property
    def missing(self) -> int:
        """Number of samples that are missing between others; 0 if there is no grid."""
        missing = self._slots - (self.samples - len(self.sums.lengths))
        return missing if 0 < missing <= MOST_MISSING * self._slots else 0

    def steps(self) -> list[float]:
        """Return the step of each axis, rad/s; 0 if none is known."""
        return [0.0 if values is None else _step_of(values) for values in self._steps.values]

    def drifts(self) -> list[bool]:
        """Return of each axis whether it drifts along a smooth curve."""
        return is_smooth(*self._means.result())

    def trend(self, axes: Sequence[bool]) -> Trend:
        """Return the drift of some axes, as exponentials and a ramp."""
        return trend_of(*self._means.result(), axes)


def _step_of(values: Float64) -> float:
    """Return the step of an axis with these values, rad/s; 0 if none is known."""
    # Two may be several steps apart, of which they show the noise as little as of one.
    return float(np.ptp(values)) if 1 <= len(values) <= FEW else step_of(values)


# A drift along a smooth curve, such as warming up, is not a random walk.
#
# The steps of a random walk between means have nothing to do with each other. Those of a warming
# sensor fall exponentially; a ramp, which the fit of the variances has as a term, is left out.


MEAN: Final = 32
"""Number of samples of a mean."""

MOST_MEANS: Final = 16_384
"""Number of means from which neighbouring ones are joined."""

BINS: Final = (12, 24, 48, 96)
"""Numbers of steps in which a drift is looked for."""

CONSTANTS: Final = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0)
"""Time constants of the exponential, as shares of the duration."""

SURE: Final = 5.0
"""Significance of a drift, in standard deviations; the largest of 4,000 random walks was 4.3."""

TREND: Final = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28)
"""Time constants, as shares of the duration, whose sum is a trend."""


class Trend(NamedTuple):
    """A drift of the rates over time.

    `first_s`, `span_s`: when it begins, and its duration, s
    `sizes`: size of each part of :meth:`parts` for each axis, ``(K, 3)``, rad/s
    """

    first_s: float
    span_s: float
    sizes: Float64

    @staticmethod
    def parts(share: Float64) -> Float64:
        """Return a ramp and exponentials at shares of the duration, ``(N, K)``."""
        falls = np.exp(-np.maximum(share, 0.0)[:, None] / TREND)
        return np.column_stack([share, falls])

    def at(self, t_ns: Int64) -> Float64:
        """Return the drift at timestamps, ``(N, 3)``, rad/s."""
        found = self.parts((t_ns / NS_PER_S - self.first_s) / self.span_s)
        return np.asarray(
            sum(part[:, None] * size for part, size in zip(found.T, self.sizes, strict=True))
        )


def trend_of(count: Float64, time: Float64, rate: Float64, axes: Sequence[bool]) -> Trend:
    """Return the drift of some axes; as for :func:`is_smooth`."""
    middle = time / count
    first_s, span_s = float(middle[0]), float(middle[-1] - middle[0])
    parts = Trend.parts((middle - first_s) / span_s)
    weights = np.sqrt(count)[:, None]
    level = np.column_stack([parts, np.ones(len(count))]) * weights
    sizes = np.linalg.lstsq(level, rate / count[:, None] * weights, rcond=None)[0][:-1]
    return Trend(first_s, span_s, np.where(axes, sizes, 0.0))


class RunningMeans:
    """Means of consecutive samples, in bounded memory."""

    def __init__(self) -> None:
        self._rows: list[Float64] = []

    def add(self, t_ns: Int64, rate: Float64) -> None:
        """Add samples."""
        starts = np.arange(0, len(rate), MEAN)
        ends = np.append(starts[1:], len(rate))
        times = (t_ns[starts] + (t_ns[ends - 1] - t_ns[starts]) / 2) / NS_PER_S
        count, sums = ends - starts, np.add.reduceat(rate, starts, axis=0)
        self._rows.append(np.column_stack([count, count * times, sums]))
        if sum(map(len, self._rows)) > MOST_MEANS:
            rows = np.concatenate(self._rows)
            self._rows = [np.add.reduceat(rows, np.arange(0, len(rows), 2), axis=0)]

    def result(self) -> tuple[Float64, Float64, Float64]:
        """Return numbers of samples, sums of times, s, and of rates, ``(N,)``, ``(N, 3)``."""
        rows = np.concatenate([np.empty((0, 5)), *self._rows])
        return rows[:, 0], rows[:, 1], rows[:, 2:]


def is_smooth(count: Float64, time: Float64, rate: Float64) -> list[bool]:
    """Return of each axis whether its means drift along an exponential, besides a ramp.

    `count`, `time`, `rate`: number of samples of each mean, and sums of their times, s, and rates
    """
    most = np.zeros(rate.shape[1])
    middle = time / count
    for bins in BINS:
        if len(count) < bins:
            break
        share = (middle - middle[0]) / (middle[-1] - middle[0])
        at = np.minimum((share * bins).astype(np.intp), bins - 1)
        numbers = np.bincount(at, count, bins)
        known = numbers > 0
        if np.count_nonzero(known) < BINS[0]:
            continue
        means = np.stack([np.bincount(at, each, bins) for each in rate.T], axis=1)[known]
        times = np.bincount(at, share * count, bins)[known] / numbers[known]
        most = np.maximum(most, _significance(times, means / numbers[known, None]))
    return [bool(each) for each in most > SURE]


def _significance(times: Float64, means: Float64) -> Float64:
    """Return the significance of an exponential drift of means, in standard deviations.

    `times`: as shares of the duration
    """
    apart = np.diff(times)
    # The variance of a step of a random walk is as its time.
    weights = 1 / np.sqrt(apart)
    steps, freedoms = np.diff(means, axis=0) * weights[:, None], len(apart) - 2
    most = np.zeros(means.shape[1])
    for constant in CONSTANTS:
        falls = np.diff(np.exp(-times / constant))
        q, _ = np.linalg.qr(np.stack([apart, falls], axis=1) * weights[:, None])
        parts = q.T @ steps
        rest = np.maximum((steps**2).sum(axis=0) - (parts**2).sum(axis=0), 1e-300)
        # Student's t as a normal quantile: D. L. Wallace, Ann. Math. Stat. 30, 1959.
        size = np.sqrt(freedoms * np.log1p(parts[1] ** 2 / rest))
        most = np.maximum(most, size * (8 * freedoms + 1) / (8 * freedoms + 3))
    return np.asarray(most)
