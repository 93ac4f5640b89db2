"""A stationary period, and the bias estimated from it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

import numpy as np

from quatprop.base.text import Remark, Setting
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.time_series import BLOCK

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from quatprop.base.arrays import Bool, Float64, Int64, Intp

    Rows: TypeAlias = Iterable[tuple[Int64, Float64]]
    WindowSums: TypeAlias = NDArray[np.void]


AT_REST = 0.05
"""Maximum scatter of rates at rest, rad/s."""

ORDINARY_CHANGE = math.radians(0.1)
"""Change of the bias between stationary periods, rad/s, that needs no remark: that of MEMS
gyroscopes changes by hundredths of a deg/s as they warm up. The sigma of the bias includes it."""

COMPARED = 0.035
"""Maximum difference, rad/s per axis (2 deg/s), of periods that no orientation confirms: one that
differs by more is a constant rotation. A larger bias about the vertical may be one."""

SAME_RATE = 1e-6
"""Scatter, as a share of the mean, that is only rounding."""

WIDENS = 3.0
"""Difference of means, in standard errors, above which it increases the sigma of the bias."""


class OtherRest(NamedTuple):
    """The other stationary period with the most different mean rate.

    `first_ns`: its first timestamp, ns
    `last_ns`: its last timestamp, ns
    `difference_rad_s`: difference of the mean rate on the worst axis, rad/s
    """

    first_ns: int
    last_ns: int
    difference_rad_s: float


class StaticPeriod(NamedTuple):
    """A period of a log in which the sensor was at rest.

    `first_ns`: first timestamp at rest, ns
    `last_ns`: last timestamp at rest, ns
    `samples`: number of samples
    `mean_rad_s`: mean rate, which is the bias, shape ``(3,)``, rad/s
    `scatter_rad_s`: RMS deviation of the rates from the mean, over all three axes, rad/s
    `noisiest_rad_s`: RMS deviation on the axis where it is largest, rad/s
    `steady`: signals that confirm it: ``"rate"``, ``"accelerometer"``, ``"orientation"``
    `unconfirmed_rad_s`: the part of the mean that may be a steady rotation, by these signals, rad/s
    `searched_first_ns`: start of the part of the log that was searched, ns: all of it, even if only
        a part is propagated
    `searched_last_ns`: end of that part, ns
    `other`: the stationary period that differs most, by more than noise; None: none differs
    `spread_rad_s`: uncertainty of the bias from the different means of other periods, on the worst
        axis, rad/s
    `levels`: quantisation levels of the axes with noise below the step
    """

    first_ns: int
    last_ns: int
    samples: int
    mean_rad_s: Float64
    scatter_rad_s: float
    noisiest_rad_s: float
    steady: tuple[str, ...]
    unconfirmed_rad_s: float
    searched_first_ns: int
    searched_last_ns: int
    other: OtherRest | None
    spread_rad_s: float
    levels: tuple[Levels, ...] = ()

    @property
    def span_s(self) -> float:
        """Duration, s."""
        return (self.last_ns - self.first_ns) / NS_PER_S

    @property
    def noise_density(self) -> float:
        """Noise density of the rates, rad/s/sqrt(Hz)."""
        coarsest = max((each.step for each in self.levels), default=0.0)
        # Of three axes that are equally noisy, one scatters most by chance.
        noisiest = self.noisiest_rad_s / (1 + WIDENS / math.sqrt(2 * self.samples))
        scatter = max(self.scatter_rad_s / math.sqrt(3), noisiest, coarsest / math.sqrt(12))
        return scatter * math.sqrt(self.span_s / (self.samples - 1))

    def bias_sigma(self, density: float) -> float:
        """Return the standard deviation of the mean due to noise and quantisation, rad/s.

        `density`: noise density, rad/s/sqrt(Hz)
        """
        return math.hypot(density / math.sqrt(self.span_s), self.quantisation_rad_s)

    @property
    def quantisation_rad_s(self) -> float:
        """Standard deviation of the bias due to quantisation, of the worst axis, rad/s."""
        return max((each.sigma for each in self.levels), default=0.0)

    @property
    def hides_errors(self) -> bool:
        """Whether all rates are equal, and the quantisation step is unknown."""
        rounding = SAME_RATE * float(np.linalg.norm(self.mean_rad_s))
        return not self.levels and self.scatter_rad_s <= rounding

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """Remarks on the period."""
        found = {
            "rest-moves": self._moves(),
            "rest-unconfirmed": self._unconfirmed(),
            "rests-differ": self._differs(),
            "rest-coarse": self._coarse(),
            "rest-one-value": self._one_value(),
        }
        return tuple(Remark(code, text) for code, text in found.items() if text)

    def _moves(self) -> str:
        if self.scatter_rad_s <= AT_REST:
            return ""
        return (
            f"the rates from {self.first_ns} to {self.last_ns} ns, from which the bias is "
            f"estimated, scatter by {self.scatter_rad_s:.3g} rad/s: the body moves there"
        )

    def _unconfirmed(self) -> str:
        degrees = math.degrees(self.unconfirmed_rad_s)
        if "accelerometer" in self.steady and self.unconfirmed_rad_s > COMPARED:
            return (
                f"{degrees:.3g} deg/s of the bias are about the vertical, where the accelerometer "
                "does not tell a bias from a steady rotation, as of a vehicle in a curve: is the "
                "body at rest there?"
            )
        if self.steady != ("rate",) or not degrees:
            return ""
        return (
            "no accelerometer and no orientation confirms the stationary period that the bias "
            f"is estimated from: a steady rotation at {degrees:.3g} deg/s would look the same"
        )

    def _differs(self) -> str:
        # The mean of either rest is off by what the step of the rates hides.
        by_steps = WIDENS * math.sqrt(2) * self.quantisation_rad_s
        if self.other is None or self.other.difference_rad_s <= max(ORDINARY_CHANGE, by_steps):
            return ""
        degrees = math.degrees(self.other.difference_rad_s)
        way = Setting("bias", f"static@{self.other.first_ns}..{self.other.last_ns}")
        return (
            f"the mean rate at rest from {self.first_ns} to {self.last_ns} ns differs by "
            f"{degrees:.3g} deg/s from the mean of another rest, {way}: the bias changed "
            "between the two, or the body turned steadily in one of them"
        )

    def _coarse(self) -> str:
        sigma = self.quantisation_rad_s
        if sigma <= self.scatter_rad_s / math.sqrt(3 * self.samples):
            return ""
        step = math.degrees(max(each.step for each in self.levels))
        return (
            f"the rates are in steps of up to {step:.3g} deg/s, and the stationary period shows "
            f"hardly more than one: the bias is known only to {math.degrees(sigma):.2g} deg/s "
            "(1 sigma)"
        )

    def _one_value(self) -> str:
        if not self.hides_errors:
            return ""
        return (
            f"the rates do not change from {self.first_ns} to {self.last_ns} ns, from where the "
            "bias is taken, and the log shows no step in which they are given: how well the bias "
            "is known, and with it the attitude, is unknown"
        )


# Quantisation: the step of recorded rates, and the error of a mean at rest that it causes.
#
# If the noise is below the step, the mean of many samples is biased; if all samples are at one
# level, the mean is just that level.


MAX_VALUES: Final = 20_000
"""Maximum number of distinct values of a quantised axis."""

HEAD: Final = 4_096
"""Number of rows examined per batch."""

IN_STEPS: Final = 0.02
"""Tolerance of values on the grid, as a share of the step, for rounded numbers."""

ROUNDING: Final = 1e-12
"""Differences below this share of the largest value are floating-point rounding."""

LARGEST: Final = 1e100
"""Values above this, rad/s, are not rates."""

TERMS: Final = 1000
"""Number of terms of a series, with a remainder below 0.1 %."""

FINE: Final = 2.0
"""With noise of this many steps or more, quantisation does not affect the mean."""

FEW, MAX_SHARED = 2, 100
"""An axis with up to FEW values takes the step common to all, if these have up to MAX_SHARED."""

SAME, FEWEST_STEPS, MOST_STEPS = 1e-6, 8, 1e5
"""Relative tolerance of equal values, and minimum and maximum of the largest value in common steps:
any two numbers are multiples of some step by chance."""


class Levels(NamedTuple):
    """Distribution of the samples of a stationary period over the levels of a quantised axis.

    `step`: quantisation step, rad/s
    `counts`: number of samples at each level, the most frequent first
    """

    step: float
    counts: Int64

    @property
    def sigma(self) -> float:
        """Standard deviation of the mean due to quantisation, rad/s.

        The noise s is estimated from the samples off the two most frequent levels. With step Q, the
        error of the mean is a sum of sines of the rate, with amplitudes
        Q / (pi k) exp(-2 pi^2 k^2 s^2 / Q^2); at one level, it is Q / sqrt(12).

        References
        ----------
        B. Widrow and I. Kollar, Quantization Noise, Cambridge University Press, 2008, chapter 4.
        """
        off = float(self.counts[2:].sum() / self.counts.sum())
        if not off:
            return self.step / math.sqrt(12)
        from statistics import NormalDist

        noise = math.inf if off >= 0.5 else -0.5 / NormalDist().inv_cdf(off)  # noqa: PLR2004
        k = np.arange(1, TERMS + 1)
        amplitudes = self.step / (math.pi * k) * np.exp(-2 * (math.pi * k * noise) ** 2)
        return math.sqrt((amplitudes**2).sum() / 2)


class StepFinder:
    """Finds the quantisation step of each axis.

    `values`: distinct values of each axis; None if there are more than of one with steps
    """

    def __init__(self) -> None:
        self.values: list[Float64 | None] = [np.empty(0)] * 3

    def observe(self, rate: Float64) -> Float64:
        """Examine rates, ``(N, 3)``, rad/s, and return them unchanged."""
        for axis, known in enumerate(self.values):
            if known is not None:
                values = np.unique(np.concatenate([known, rate[:HEAD, axis]]))
                values = values[np.isfinite(values)]
                self.values[axis] = values if len(values) <= MAX_VALUES else None
        return rate

    def above(self, scatters: list[float]) -> list[list[float]]:
        """Return the step of each axis in each stationary period, rad/s; 0 if hidden by noise.

        `scatters`: RMS deviation of the rates in each period, over all three axes, rad/s
        """
        known = (values for values in self.values if values is not None)
        shared = shared_step(np.concatenate([np.empty(0), *known]))
        steps = [
            0.0 if values is None else (shared if len(values) <= FEW else step_of(values))
            for values in self.values
        ]
        return [[step if scatter < FINE * step else 0.0 for step in steps] for scatter in scatters]


def step_of(values: Float64) -> float:
    """Return the largest step that divides all differences of values, or 0.

    `values`: in any order, shape ``(N,)``
    """
    # Differences of damaged numbers could overflow.
    values = np.sort(values[np.abs(values) < LARGEST])
    apart = np.diff(values)
    apart = apart[apart > 0]
    if len(apart) < 2:  # noqa: PLR2004  # differences that may agree
        return 0.0
    # Before dividing: a difference that is only rounding can be too small a divisor.
    if apart.min() < ROUNDING * np.abs(values[[0, -1]]).max():
        return 0.0
    ratios = apart / apart.min()
    steps = np.rint(ratios)
    # Differences that are large multiples of the smallest fit any step.
    if (
        np.sort(steps)[len(steps) // 2] > 1 / IN_STEPS
        or (np.abs(ratios - steps) > IN_STEPS * steps).any()
    ):
        return 0.0
    return float((values[-1] - values[0]) / steps.sum())


def shared_step(values: Float64) -> float:
    """Return the largest step that divides all values of a gyroscope, or 0.

    It is used for axes with too few values for a step of their own.

    `values`: values of all axes, in any order, shape ``(N,)``
    """
    values = np.unique(np.abs(values[np.abs(values) < LARGEST]))
    if not FEW <= len(values) <= MAX_SHARED:
        return 0.0
    largest = float(values[-1])
    step = 0.0
    for value in values.tolist():
        # Euclid's algorithm for rounded numbers.
        rest = value
        while rest > SAME * largest:
            step, rest = rest, abs(step - rest * round(step / rest))
    return step if FEWEST_STEPS * step <= largest <= MOST_STEPS * step else 0.0


def levels_of(
    rows: Rows, ranges: list[tuple[int, int]], steps: list[list[float]]
) -> list[tuple[Levels, ...]]:
    """Return the levels of each stationary period, for each quantised axis.

    `rows`: timestamps, and rates, ``(N, 3)``, rad/s
    `ranges`: the periods, ends included, ns
    `steps`: step of each axis in each period, rad/s; 0: none
    """
    tallies: list[list[dict[int, int]]] = [[{} for _ in each] for each in steps]
    for t_ns, rate in rows:
        for (first_ns, last_ns), of_rest, of_axes in zip(ranges, steps, tallies, strict=True):
            inside = (t_ns >= first_ns) & (t_ns <= last_ns)
            for values, step, tally in zip(rate[inside].T, of_rest, of_axes, strict=True):
                if not step:
                    continue
                levels, numbers = np.unique(np.rint(values / step), return_counts=True)
                for level, number in zip(levels.tolist(), numbers.tolist(), strict=True):
                    tally[level] = tally.get(level, 0) + number
    return [
        tuple(
            Levels(step, np.array(sorted(tally.values(), reverse=True)))
            for step, tally in zip(of_rest, of_axes, strict=True)
            if tally
        )
        for of_rest, of_axes in zip(steps, tallies, strict=True)
    ]


# Sums of a signal over windows of equal duration, for its mean and scatter.


def window_sums(
    rows: Rows, window_ns: int, origin_ns: int | None = None, width: int = 3
) -> WindowSums:
    """Return the sums of every window, in order of time, over finite rows.

    The result does not depend on how rows are divided into batches, to the last bit.

    `rows`: timestamps, ns, and values, shape ``(N, width)``
    `window_ns`: length of a window, ns
    `origin_ns`: start of the first window, ns; None: the first timestamp
    """
    kind = np.dtype(
        [(name, np.int64) for name in ("index", "first_ns", "last_ns")]
        + [("count", np.float64), ("total", np.float64, width), ("squares", np.float64, width)]
    )
    parts = [np.zeros(0, dtype=kind)]
    for t_ns, values in _in_blocks(rows):
        origin_ns = int(t_ns[0]) if origin_ns is None else origin_ns
        finite: Bool = np.logical_and.reduce(np.isfinite(values), axis=1)
        known = np.where(finite[:, None], values, 0.0)
        index = (t_ns - origin_ns) // window_ns
        starts = np.flatnonzero(np.diff(index, prepend=index[0] - 1))
        sums = np.zeros(len(starts), dtype=kind)
        sums["index"] = index[starts]
        sums["first_ns"] = np.minimum.reduceat(t_ns, starts)
        sums["last_ns"] = np.maximum.reduceat(t_ns, starts)
        sums["count"] = np.add.reduceat(finite, starts, dtype=np.float64)
        sums["total"] = np.add.reduceat(known, starts, axis=0)
        with np.errstate(over="ignore"):
            sums["squares"] = np.add.reduceat(known**2, starts, axis=0)
        parts.append(sums)
    sums = np.concatenate(parts)
    return _by_index(sums[np.argsort(sums["index"], kind="stable")])


def _in_blocks(rows: Rows) -> Rows:
    """Yield rows in blocks of fixed size, independent of their batches."""
    held: list[tuple[Int64, Float64]] = []
    room = BLOCK
    for t_ns, values in rows:
        start = 0
        while len(t_ns) - start >= room:
            held.append((t_ns[start : start + room], values[start : start + room]))
            yield _joined(held)
            start, room, held = start + room, BLOCK, []
        if start < len(t_ns):
            held.append((t_ns[start:], values[start:]))
            room -= len(t_ns) - start
    if held:
        yield _joined(held)


def _joined(rows: list[tuple[Int64, Float64]]) -> tuple[Int64, Float64]:
    if len(rows) == 1:
        return rows[0]
    return np.concatenate([t_ns for t_ns, _ in rows]), np.concatenate([each for _, each in rows])


def aligned_window_sums(
    rates: WindowSums, rows: Rows, window_ns: int, width: int = 3
) -> WindowSums | None:
    """Return the sums of another signal in the windows of the rates; None if it is absent.

    Without an accelerometer, drivers leave its fields empty, NaN or zero.
    """
    origin_ns = int(rates["first_ns"][np.searchsorted(rates["index"], 0)])
    sums = window_sums(rows, window_ns, origin_ns, width)
    aligned = np.zeros(len(rates), dtype=sums.dtype)
    _, ours, theirs = np.intersect1d(rates["index"], sums["index"], return_indices=True)
    aligned[ours] = sums[theirs]
    return aligned if aligned["squares"].any() else None


def between(rows: Rows, first_ns: int, last_ns: int) -> Rows:
    """Yield the rows in a time range, ends included."""
    for t_ns, values in rows:
        inside = (t_ns >= first_ns) & (t_ns <= last_ns)
        yield t_ns[inside], values[inside]


def outer_products(rows: Rows) -> Rows:
    """Yield q q^T, ``(N, 16)``, for quaternions: equal for q and -q."""
    for t_ns, wxyz in rows:
        yield t_ns, np.einsum("ij,ik->ijk", wxyz, wxyz).reshape(-1, 16)


def _by_index(rows: WindowSums) -> WindowSums:
    """Sum neighbouring rows of the same window."""
    if not len(rows):
        return rows
    return merged(rows, np.flatnonzero(np.diff(rows["index"], prepend=rows["index"][0] - 1)))


def merged(rows: WindowSums, starts: Intp) -> WindowSums:
    """Sum the rows from each start to the next."""
    merged = rows[starts]
    merged["first_ns"] = np.minimum.reduceat(rows["first_ns"], starts)
    merged["last_ns"] = np.maximum.reduceat(rows["last_ns"], starts)
    for name in ("count", "total", "squares"):
        merged[name] = np.add.reduceat(rows[name], starts, axis=0)
    return merged


def mean_of(sums: WindowSums) -> Float64:
    """Return the mean of each window, ``(N, width)``; NaN if empty."""
    with np.errstate(invalid="ignore"):
        return np.asarray(sums["total"] / sums["count"][:, None])


def variances_of(sums: WindowSums) -> Float64:
    """Return the variance of each column in each window, ``(N, width)``; NaN where it is empty."""
    with np.errstate(over="ignore", invalid="ignore"):
        variances = sums["squares"] / sums["count"][:, None] - mean_of(sums) ** 2
    variances[np.isinf(sums["squares"])] = np.inf
    return np.asarray(np.maximum(variances, 0.0))


def scatter_of(sums: WindowSums) -> Float64:
    """Return the RMS deviation from the mean in each window; NaN if empty."""
    return np.asarray(np.sqrt(variances_of(sums).sum(axis=1)))
