"""Saturated rates: samples at the end of a sensor's range, even if a calibration spread them.

No sample is changed here; each finding is one sentence.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark
from quatprop.propagation.checks.samples import NEIGHBOURS, SMALLEST_RANGE, has_noise

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.propagation.checks.samples import Samples, Unit


MIN_RUN_LENGTH = 3
"""This many neighbouring samples at exactly the same extreme are not a coincidence."""

HIGHEST = 64
"""Values next to the extreme that are counted, to distinguish saturation from a peak."""

NEXT_STEPS = 10.5
"""A quantised smooth peak has more samples within this many steps below its top than at the top:
the parabola y = -x^2 has 2.3 times as many from -11 to -1 as above -1. An extreme with at least
half as many there, allowing :data:`MIN_RUN_LENGTH` samples for noise, is such a peak."""

TOP = 0.95
"""Samples above this share of the extreme are at the end of the range. Calibration with scale
factors and misalignments spreads clipped samples over a few percent."""

BELOW = 0.75
"""Samples between this share and :data:`TOP` are below it. A stay at the end lasts until a sample
is further below."""

PILED_UP = 1.8
"""Ratio of samples at the end to those below it above which they are piled up: a smooth motion
with equal peaks, such as a sine, has 0.8."""

MIN_AT_END = 20
"""Fewest samples at the end that count as piled up."""

MIN_STAYS = 2
"""Fewest stays at the end that cause a remark, unless they are short: the body may have turned
steadily there."""

MIN_PLATEAU = 3.0
"""Samples, on average, of such a stay."""

MIN_STAY = 20
"""Fewest samples at exactly the extreme that noise next to them tells from a steady rotation."""

SHORT_S = 0.1
"""Shorter stays are not a steady rotation."""

LONGEST_S = 2.0
"""Longer stays, on average, are a steady rotation."""

MOST_AT_END = 0.5
"""A larger share of samples at the end is a steady rotation."""

CLIPPED = "saturated, so larger rates are missing, unless the body turns steadily there"
"""A short steady rotation looks the same where the noise is below the step of the rates."""


class Saturation:
    """Counts samples at the ends of the range of each axis."""

    def __init__(self) -> None:
        # Rows: the maxima of the rates, then of the negated rates.
        self._limits = np.full((2, 3), -np.inf)
        # With and without repeated samples.
        self._runs = np.zeros((2, 2, 3), dtype=np.bool_)
        # Samples at the end and below it, and stays; whether the last sample is in a stay.
        self._counts = np.zeros((2, 3, 3), dtype=np.int64)
        self._plateaus = np.zeros((2, 3), dtype=np.bool_)
        # Whether noise would show during a stay, and the first sample at the extreme.
        self._noisy = np.zeros((2, 3), dtype=np.bool_)
        self._first_ns: dict[tuple[int, int], int] = {}
        # The highest values, ascending, and the number of samples with each.
        self._highest = {(side, axis): np.zeros((2, 0)) for side in (0, 1) for axis in range(3)}

    def add(
        self,
        samples: Samples,
        old: int,
        reached: tuple[Float64, Float64],
        repeats: Bool | None,
    ) -> None:
        """Add samples, of which the first `old` were seen before.

        `repeats`: which samples repeat the one before on all axes; None if hardly any does
        """
        for side, largest in enumerate(reached):
            near = largest >= np.maximum(BELOW * self._limits[side], 0)
            self._plateaus[side] &= near
            for axis in np.flatnonzero(near).tolist():
                place, here = (side, axis), float(largest[axis])
                limit = float(self._limits[place])
                if here > limit:
                    self._runs[:, side, axis] = self._noisy[place] = False
                    self._first_ns.pop(place, None)
                    if TOP * here > limit:
                        self._counts[place], self._plateaus[place] = 0, False
                    self._limits[place] = limit = here
                if limit >= SMALLEST_RANGE:
                    values = -samples.columns[axis] if side else samples.columns[axis]
                    self._count_near_limit(values, samples.t_ns, old, place, repeats)

    def _count_near_limit(
        self,
        values: Float64,
        t_ns: Int64,
        old: int,
        place: tuple[int, int],
        repeats: Bool | None,
    ) -> None:
        """Count samples near the limit of a side and axis."""
        limit, new = float(self._limits[place]), values[old:]
        at_end, low = new >= TOP * limit, new < BELOW * limit
        count = int(np.count_nonzero(at_end))
        below = int(np.count_nonzero(new >= BELOW * limit)) - count
        starts = np.append(self._plateaus[place], at_end[at_end | low])
        self._plateaus[place] = starts[-1]
        self._counts[place] += (count, below, int(np.count_nonzero(starts[1:] > starts[:-1])))
        if not count:
            return
        known, numbers = self._highest[place]
        high = new[new >= (known[0] if len(known) == HIGHEST else TOP * limit)]
        each, places = np.unique(np.concatenate([known, high]), return_inverse=True)
        weights = np.concatenate([numbers, np.ones(len(high))])
        self._highest[place] = np.stack([each, np.bincount(places, weights)])[:, -HIGHEST:]
        hits = values == limit
        if hits.any():
            self._first_ns.setdefault(place, int(t_ns[hits.argmax()]))
            self._noisy[place] |= _has_noisy_neighbours(values, hits)
        # A held sample is not a new one.
        for kept, chosen in enumerate((hits, hits if repeats is None else hits[~repeats])):
            self._runs[(kept, *place)] |= _has_run(chosen)

    def remarks(
        self,
        samples: int,
        moving: Bool,
        hold: float,
        interval: float | None,
        unit: Unit,
    ) -> Iterator[Remark]:
        """Yield a sentence for each end of an axis that is saturated.

        `moving`: which axes do not have a constant rate
        `interval`: between rows, s
        `unit`: name of the unit in which rates are shown, and its size, rad/s
        """
        runs = self._runs[int(hold > 1)]
        for side, sign in enumerate("+-"):
            for axis in np.flatnonzero(moving).tolist():
                place = (side, axis)
                is_clipped = self._is_noisy_stay(place, samples)
                if not (is_clipped or self._may_be_clipped(place, samples, interval)):
                    continue
                limit = self._limits[place] * (1 if side == 0 else -1) / unit[1]
                name = f"axis {sign}{'xyz'[axis]}"
                if runs[place] and not self._is_rounded(place):
                    yield Remark(
                        "saturated",
                        f"{name} stays at its extreme of {limit:.6g} {unit[0]} for "
                        f"{MIN_RUN_LENGTH} samples or more{self._where(place, interval)}: "
                        f"{CLIPPED}",
                    )
                elif not is_clipped and self._piles_up(place, hold):
                    share = 100 * self._counts[place][0] / samples
                    end = f"{100 - 100 * TOP:.2g} % of its extreme of {limit:.4g} {unit[0]}"
                    yield Remark(
                        "piled-up",
                        f"{name} is within {end} in {share:.2g} % of the samples, and hardly ever "
                        f"shortly below: {CLIPPED}",
                    )

    def _is_noisy_stay(self, place: tuple[int, int], samples: int) -> bool:
        """Return whether the extreme has no noise, unlike the rates next to it."""
        at_extreme = self._highest[place][1][-1:].sum()
        return bool(self._noisy[place] and MIN_STAY <= at_extreme <= MOST_AT_END * samples)

    def _may_be_clipped(self, place: tuple[int, int], samples: int, interval: float | None) -> bool:
        """Return whether the samples at the end are not a steady rotation."""
        at_end, _, stays = (int(count) for count in self._counts[place])
        if not stays or at_end > MOST_AT_END * samples:
            return False
        mean_s = at_end / stays * (interval or 0.0)
        return mean_s <= (LONGEST_S if stays >= MIN_STAYS else SHORT_S)

    def _where(self, place: tuple[int, int], interval: float | None) -> str:
        """Return when the extreme is reached, for how long, and what a larger rate would add."""
        where = f", first at t = {self._first_ns[place]} ns"
        if interval is None:
            return where
        lasted = float(self._highest[place][1][-1]) * interval
        beyond = math.degrees(0.01 * float(self._limits[place]) * lasted)
        return f"{where}, {lasted:.3g} s in all, where 1 % more would add {beyond:.3g} deg"

    def _is_rounded(self, place: tuple[int, int]) -> bool:
        """Return whether the highest values are a smooth peak, rounded to steps."""
        values, numbers = self._highest[place]
        if len(values) < 2:  # noqa: PLR2004  # of which one is next to the extreme
            return False
        near = values[-1] - values <= NEXT_STEPS * np.diff(values).min()
        nearby = numbers[near][:-1].sum()
        return bool(nearby and numbers[-1] <= 2 * nearby + MIN_RUN_LENGTH)

    def _piles_up(self, place: tuple[int, int], hold: float) -> bool:
        at_end, below, stays = (int(count) for count in self._counts[place])
        return (
            stays >= MIN_STAYS
            and at_end >= MIN_AT_END * hold
            and at_end >= PILED_UP * below
            and at_end >= MIN_PLATEAU * hold * stays
        )


def _has_noisy_neighbours(values: Float64, hits: Bool) -> bool:
    """Return whether values next to those at the extreme have noise that is larger than a step."""
    first, last = int(hits.argmax()), len(hits) - int(hits[::-1].argmax())
    parts = values[max(first - NEIGHBOURS, 0) : first], values[last : last + NEIGHBOURS]
    return any(has_noise(part) for part in parts if len(part) >= NEIGHBOURS // 2)


def _has_run(hit: Bool) -> bool:
    """Return whether :data:`MIN_RUN_LENGTH` neighbouring samples are hits."""
    run = hit
    for shift in range(1, MIN_RUN_LENGTH):
        run = run[:-1] & hit[shift:]
    return bool(run.any())
