"""Quantisation: the step of recorded rates, and the error of a mean at rest that it causes.

If the noise is below the step, the mean of many samples is biased; if all samples are at one level,
the mean is just that level.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.conditioning.window_sums import Rows

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
    """Finds the quantisation step of each axis."""

    def __init__(self) -> None:
        self._values: list[Float64 | None] = [np.empty(0)] * 3

    def noted(self, rate: Float64) -> Float64:
        """Examine rates, ``(N, 3)``, rad/s, and return them unchanged."""
        for axis, known in enumerate(self._values):
            if known is not None:
                values = np.unique(np.concatenate([known, rate[:HEAD, axis]]))
                values = values[np.isfinite(values)]
                self._values[axis] = values if len(values) <= MAX_VALUES else None
        return rate

    def above(self, scatters: list[float]) -> list[list[float]]:
        """Return the step of each axis in each stationary period, rad/s; 0 if hidden by noise.

        `scatters`: RMS deviation of the rates in each period, over all three axes, rad/s
        """
        known = (values for values in self._values if values is not None)
        shared = shared_step(np.concatenate([np.empty(0), *known]))
        steps = [
            0.0 if values is None else (shared if len(values) <= FEW else step_of(values))
            for values in self._values
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
    ratios = apart / apart.min()
    steps = np.rint(ratios)
    # Differences that are large multiples of the smallest fit any step.
    if (
        np.sort(steps)[len(steps) // 2] > 1 / IN_STEPS
        or (np.abs(ratios - steps) > IN_STEPS * steps).any()
        or apart.min() < ROUNDING * np.abs(values[[0, -1]]).max()
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
