"""Quantisation: the step in which a log gives rates, and what it leaves of a mean at rest.

Where the noise is less than the step, the mean of many samples is not that of the rate: at one
level it tells no more than the level.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.conditioning.window_sums import Rows

MAX_VALUES: Final = 20_000
"""An axis that shows more values than this among those looked at is not taken as quantised."""

HEAD: Final = 4_096
"""Rows of each batch that are looked at."""

IN_STEPS: Final = 0.02
"""Values may be off the grid by this share of a step, as rounded numbers are."""

ROUNDING: Final = 1e-12
"""Numbers that differ by less than this share of the largest were rounded by the processor."""

LARGEST: Final = 1e100
"""rad/s: numbers that are no rates."""

TERMS: Final = 1000
"""Sines that are summed; what is left of them is less than a thousandth."""

FINE: Final = 2.0
"""Noise of so many steps or more leaves nothing of the quantisation in a mean."""


FEW, MAX_SHARED = 2, 100
"""An axis of so many values or fewer has the step that all axes share, if they show few, too."""

SAME, FEWEST_STEPS, MOST_STEPS = 1e-6, 8, 1e5
"""Numbers that differ by less than this share of the largest are the same; and how many steps that
has to be at least and at most: two numbers are multiples of some step by chance."""


class Levels(NamedTuple):
    """How the samples of a rest lie on the grid of a quantised axis.

    `step`: of the grid, rad/s
    `counts`: samples at each of the levels that occur, the most frequent first
    """

    step: float
    counts: Int64

    @property
    def sigma(self) -> float:
        """Standard deviation of the mean from the rate, beside that of the noise, rad/s.

        The noise is at least that which takes as many samples off the two most frequent levels as
        were found there. With noise s and steps Q the mean is off by a sum of sines of the rate,
        with amplitudes Q / (pi k) exp(-2 pi^2 k^2 s^2 / Q^2); at one level that is Q / sqrt(12).

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
    """Finds the step of each axis of rates that pass."""

    def __init__(self) -> None:
        self._values: list[Float64 | None] = [np.empty(0)] * 3

    def noted(self, rate: Float64) -> Float64:
        """Note some rates, ``(N, 3)``, rad/s, and return all of them."""
        for axis, known in enumerate(self._values):
            if known is not None:
                values = np.unique(np.concatenate([known, rate[:HEAD, axis]]))
                values = values[np.isfinite(values)]
                self._values[axis] = values if len(values) <= MAX_VALUES else None
        return rate

    def above(self, scatters: list[float]) -> list[list[float]]:
        """Return the step of each axis in each rest, rad/s; 0 for none, or where noise hides it.

        `scatters`: RMS deviations of the rates from the mean, over all three axes, rad/s
        """
        known = [values for values in self._values if values is not None]
        shared = shared_step(np.concatenate(known)) if known else 0.0
        steps = [
            0.0 if values is None else (shared if len(values) <= FEW else step_of(values))
            for values in self._values
        ]
        return [[step if scatter < FINE * step else 0.0 for step in steps] for scatter in scatters]


def step_of(values: Float64) -> float:
    """Return the step of which all differences of values are multiples, or 0.

    `values`: in any order, shape ``(N,)``
    """
    # Damaged numbers may be as far apart as there are numbers.
    values = np.sort(values[np.abs(values) < LARGEST])
    apart = np.diff(values)
    apart = apart[apart > 0]
    if len(apart) < 2:  # noqa: PLR2004  # differences that may agree
        return 0.0
    ratios = apart / apart.min()
    steps = np.rint(ratios)
    # Numbers whose differences are large multiples of the smallest are on every grid.
    if (
        np.sort(steps)[len(steps) // 2] > 1 / IN_STEPS
        or (np.abs(ratios - steps) > IN_STEPS * steps).any()
        or apart.min() < ROUNDING * np.abs(values[[0, -1]]).max()
    ):
        return 0.0
    return float((values[-1] - values[0]) / steps.sum())


def shared_step(values: Float64) -> float:
    """Return the step of which all values of a gyroscope are multiples, or 0.

    That of an axis that shows too few values to have one of its own.

    `values`: of all axes, in any order, shape ``(N,)``
    """
    values = np.unique(np.abs(values[np.abs(values) < LARGEST]))
    if not FEW <= len(values) <= MAX_SHARED:
        return 0.0
    largest = float(values[-1])
    step = 0.0
    for value in values.tolist():
        # Euclid's algorithm, of numbers that are rounded.
        rest = value
        while rest > SAME * largest:
            step, rest = rest, abs(step - rest * round(step / rest))
    return step if FEWEST_STEPS * step <= largest <= MOST_STEPS * step else 0.0


def levels_of(
    rows: Rows, ranges: list[tuple[int, int]], steps: list[list[float]]
) -> list[tuple[Levels, ...]]:
    """Return how the samples of each rest lie on the grids of the axes that have one.

    `rows`: stamps, and rates, ``(N, 3)``, rad/s
    `ranges`: where the rests are, ends included, ns
    `steps`: of each axis in each of them, rad/s; 0 for none
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
