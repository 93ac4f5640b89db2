"""Saturated rates: samples at the end of a sensor's range, also where a calibration spread them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Bool, Float64, Int64


SMALLEST_RANGE = math.radians(125.0)
"""rad/s: the narrowest range of common gyroscopes; smaller extremes are not saturation."""

HAS_RUN = 3
"""This many neighbouring samples at exactly the same extreme are no coincidence."""

TOP = 0.95
"""Samples above this share of the extreme are at the end of the range. Calibration with scale
factors and misalignments spreads what the sensor clipped over a few percent."""

BELOW = 0.90
"""Samples between this share and :data:`TOP` are below it."""

PILED_UP = 4.0
"""So many more samples at the end than below it are piled up there: a smooth motion whose peaks
are all equal, as a sine's, has 2.4 times as many."""

MIN_AT_END = 20
"""Fewer samples at the end are not remarked on."""

MIN_PLATEAUS = 3
"""Fewer stays at the end are not remarked on: the body may have turned steadily there."""

MIN_PLATEAU = 3.0
"""Samples, on average, of such a stay."""

LONGEST_PLATEAU_S = 1.0
"""Longer stays, on average, are a steady rotation."""

MOST_AT_END = 0.5
"""A larger share of samples at the end is a steady rotation."""


class Saturation:
    """Counts samples at the ends of the range of each axis, as they pass."""

    def __init__(self) -> None:
        # Sides in rows: + and -, as the largest of the rates and of their negatives.
        self._limits = np.full((2, 3), -np.inf)
        # With held samples, and without what repeats the sample before.
        self._runs = np.zeros((2, 2, 3), dtype=np.bool_)
        # At the end, below it, stays at the end.
        self._counts = np.zeros((2, 3, 3), dtype=np.int64)

    def add(
        self, columns: Float64, old: int, reached: tuple[Float64, Float64], repeats: Bool | None
    ) -> None:
        """Look at samples that follow.

        `columns`: rates of the three axes, shape ``(3, N)``, rad/s
        `repeats`: which samples repeat the one before on all axes; None where hardly any does
        """
        for side, largest in enumerate(reached):
            near = largest >= np.maximum(BELOW * self._limits[side], 0)
            for axis in np.flatnonzero(near).tolist():
                limit, here = float(self._limits[side, axis]), float(largest[axis])
                if here > limit:
                    self._runs[:, side, axis] = False
                    if TOP * here > limit:
                        self._counts[side, axis] = 0
                    self._limits[side, axis] = limit = here
                if limit >= SMALLEST_RANGE:
                    self._look(columns[axis], old, (side, axis), here, repeats)

    def _look(
        self,
        values: Float64,
        old: int,
        place: tuple[int, int],
        reached: float,
        repeats: Bool | None,
    ) -> None:
        limit = float(self._limits[place])
        sign = -1.0 if place[0] else 1.0
        beyond = np.less_equal if place[0] else np.greater_equal
        below = int(np.count_nonzero(beyond(values[old:], sign * BELOW * limit)))
        if reached < TOP * limit:
            self._counts[place][1] += below
            return
        at_end = beyond(values, sign * TOP * limit)
        count, begins = int(np.count_nonzero(at_end[old:])), max(old, 1)
        stays = int(np.count_nonzero(at_end[begins:] > at_end[begins - 1 : -1]))
        self._counts[place] += (count, below - count, stays + int(not old and at_end[0]))
        if reached == limit:
            hits = values == sign * limit
            # A held sample is no new one.
            for kept, chosen in enumerate((hits, hits if repeats is None else hits[~repeats])):
                self._runs[(kept, *place)] |= _has_run(chosen)

    def remarks(
        self, samples: int, moving: Bool, hold: float, interval: float | None
    ) -> Iterator[str]:
        """Yield a sentence for each end of an axis that is saturated.

        `moving`: which axes do not have one rate throughout
        `interval`: between rows, s
        """
        runs = self._runs[int(hold > 1)]
        for side, sign in enumerate("+-"):
            for axis in np.flatnonzero(moving):
                limit = self._limits[side, axis] * (1 if side == 0 else -1)
                name = f"axis {sign}{'xyz'[axis]}"
                if runs[side, axis]:
                    yield (
                        f"{name} stays at its extreme of {limit:.6g} rad/s for {HAS_RUN} samples "
                        "or more: saturated, so larger rates are missing"
                    )
                elif self._piles_up(self._counts[side, axis], samples, hold, interval):
                    share = 100 * self._counts[side, axis, 0] / samples
                    end = f"{100 - 100 * TOP:.2g} % of its extreme of {limit:.4g} rad/s"
                    yield (
                        f"{name} is within {end} in {share:.2g} % of the samples, and hardly ever "
                        "shortly below: saturated, so larger rates are missing"
                    )

    @staticmethod
    def _piles_up(counts: Int64, samples: int, hold: float, interval: float | None) -> bool:
        at_end, below, stays = (int(count) for count in counts)
        if at_end < MIN_AT_END * hold or stays < MIN_PLATEAUS or interval is None:
            return False
        plateau = at_end / stays
        return (
            at_end >= PILED_UP * below
            and at_end <= MOST_AT_END * samples
            and plateau >= MIN_PLATEAU * hold
            and plateau * interval <= LONGEST_PLATEAU_S
        )


def _has_run(hit: Bool) -> bool:
    """Tell whether :data:`HAS_RUN` neighbouring samples are hits."""
    run = hit
    for shift in range(1, HAS_RUN):
        run = run[:-1] & hit[shift:]
    return bool(run.any())
