"""Plausibility of rates: units, frozen, held or saturated samples, and a low sample rate.

Rates in the wrong unit, frozen, or clipped by the sensor's range give attitudes that look right.
No sample is changed here; each finding is one sentence.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark, Setting
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.series import reblock
from quatprop.propagation.axis_checks import (
    FROZEN_SAMPLES,
    NEIGHBOURS,
    SMALLEST_RANGE,
    Freezes,
    Wraps,
    has_noise,
)
from quatprop.propagation.conditioning.static_period import step_of
from quatprop.propagation.dropouts import Dropouts
from quatprop.propagation.exact_stretches import ExactStretches
from quatprop.propagation.interleaved import Turns
from quatprop.propagation.repeated_blocks import RepeatedBlocks
from quatprop.propagation.spikes import Spikes
from quatprop.propagation.unit_changes import UnitChange
from quatprop.settings.quantities import RATES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.kinematics.series import GyroSeries
    from quatprop.timeline.counts import Counts


# Saturated rates: samples at the end of a sensor's range, even if a calibration spread them.


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
        columns: Float64,
        t_ns: Int64,
        old: int,
        reached: tuple[Float64, Float64],
        repeats: Bool | None,
    ) -> None:
        """Add samples.

        `columns`: rates of the three axes, shape ``(3, N)``, rad/s, the first `old` seen before
        `t_ns`: their stamps, shape ``(N,)``
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
                    values = -columns[axis] if side else columns[axis]
                    self._count_near_limit(values, t_ns, old, place, repeats)

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
        unit: tuple[str, float],
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


WIDEST_RANGE = math.radians(4000.0)
"""rad/s: no common gyroscope measures more."""

STEP_LIMIT = math.radians(30.0)
"""rad: a larger rotation between two samples is too large for any integration rule."""

UNRESOLVED = 0.15
"""Variance of the difference of neighbouring samples, relative to white noise, above which the
motion between them is unknown."""

UNRESOLVED_STEP = math.radians(1.0)
"""rad: RMS difference of neighbouring rates, times their interval, that exceeds mere noise."""

MIN_NEIGHBOURS = 20
"""Fewest samples for a remark on the motion between them."""

LARGEST_SUM = 1e100
"""Larger sums of squares, (rad/s)^2, come from damaged numbers and are left out."""

AT_REST = 0.2
"""rad/s: the largest rate that may be the bias of a sensor at rest."""

TURNING = 0.1
"""rad/s: a body that turns faster has no two equal rates in a row, unless samples are held."""

MAYBE_HELD = 0.03
"""Share of equal neighbours on one axis above which all three are compared."""

HELD = 0.05
"""Smallest share of repeated rows, while the body turns, that causes a remark."""

CHANCE = 20.0
"""Ratio of that share to what it would be if the axes were equal independently of each other."""

MOST_JUMPS = 1000
"""Most changes after a repeated row that are examined."""

FEW_JUMPS = 27
"""Ways in which rounded rates change: a step up, down or none on each of three axes."""

DISTINCT = 0.2
"""Share of distinct changes, beyond :data:`FEW_JUMPS`, above which samples are held."""

LONGEST_HOLD = 20
"""Rows, on average: rates that do not change for longer are constant, not held."""

MIN_HELD = 100
"""Fewest repeated rows that cause a remark."""

_COLUMN = 16_384
"""Samples checked together."""

_OVERLAP = MIN_RUN_LENGTH - 1
"""Samples that are checked again with those that follow."""


SENSITIVITIES = (
    *(range_deg_s / 32768 for range_deg_s in (125, 245, 250, 300, 450, 500, 1000, 2000, 4000)),
    *(1 / per_deg_s for per_deg_s in (131, 131.2, 65.5, 65.6, 32.8, 16.4)),
    *(0.004375, 0.00875, 0.0175, 0.035, 0.07),
)
"""Steps of common gyroscopes, deg/s: a range in 16 bits, then those of InvenSense and of ST."""

SAME_STEP = 2e-4
"""Largest relative difference of equal steps: data sheets give few digits."""

STEPPED = 10_000
"""Number of samples whose step is determined."""

_DEG = math.radians(1.0)


class RateChecks:
    """Checks rates while they are read.

    The findings do not depend on where batches end.

    `unit`: unit of the rates in the log and in remarks
    `is_given`: whether the user gave the unit
    """

    def __init__(self, unit: str = "rad/s", *, is_given: bool = False) -> None:
        self._unit, self._is_given = (unit, RATES[unit]), is_given
        self._highest = np.full(3, -np.inf)
        self._lowest = np.full(3, np.inf)
        self._saturation = Saturation()
        self._samples = 0
        self._last, self._last_ns = np.empty((3, 0)), np.empty(0, np.int64)
        self._freezes, self._wraps, self._turns = Freezes(), Wraps(), Turns()
        self._dropouts, self._spikes, self._exact = Dropouts(), Spikes(), ExactStretches()
        self._unit_change = UnitChange()
        self._blocks = RepeatedBlocks()
        # Sums over neighbouring samples, per axis: rate, square, product; and their number.
        self._sums, self._neighbours = np.zeros((3, 3)), 0
        self._repeated = self._different = 0
        # Rows of which one axis is equal to the row before.
        self._equal = np.zeros(3)
        self._jumps = np.empty((3, 0))
        self._stored = np.empty((3, 0))

    def inspect_raw(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the samples of the log, and keep the first, whose steps are determined."""
        for batch in batches:
            if (room := STEPPED - self._stored.shape[1]) > 0:
                self._stored = np.concatenate([self._stored, batch.rate[:room].T], axis=1)
            yield batch

    def step_remarks(self) -> list[Remark]:
        """Return a remark if the rates come in the steps of a gyroscope in another unit."""
        unit, scale = self._unit
        steps = [*filter(None, map(step_of, self._stored))]
        for factor, than in ((1.0, "57.3 times as large as"), (_DEG**2, "57.3 times smaller than")):
            known = [factor * sensitivity for sensitivity in SENSITIVITIES]
            for step in steps:
                if any(abs(step - one) < SAME_STEP * one for one in known):
                    said = (
                        f"the rates come in steps of {step / scale:.6g} {unit}, {than} those of a "
                        f"common gyroscope: {other_unit(unit, are_too_large=factor == 1.0)}"
                    )
                    return [Remark("unit-by-steps", said)]
        return []

    def observe(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the samples in blocks, and check them."""
        for block in reblock(batches):
            self._samples += len(block)
            for start in range(0, len(block), _COLUMN):
                stop = start + _COLUMN
                self._check(block.rate[start:stop].T, block.t_ns[start:stop])
            yield block

    def _check(self, rate: Float64, t_ns: Int64) -> None:
        old = self._last.shape[1]
        # A run may continue from the samples before. Contiguous columns are checked faster.
        columns = np.empty((3, old + rate.shape[1]))
        columns[:, :old], columns[:, old:] = self._last, rate
        highest, lowest = np.fmax.reduce(columns, axis=1), np.fmin.reduce(columns, axis=1)
        self._highest = np.fmax(self._highest, highest)
        self._lowest = np.fmin(self._lowest, lowest)
        repeats = self._repeats(columns, max(old - 1, 0))
        every_ns = np.concatenate([self._last_ns, t_ns])
        self._saturation.add(columns, every_ns, old, (highest, -lowest), repeats)
        begin = max(old - 1, 0)
        self._add_motion(columns[:, begin:])
        self._freezes.add(columns[:, begin:], every_ns[begin:])
        extremes = np.maximum(self._highest, -self._lowest)
        self._wraps.add(columns[:, old:], t_ns, extremes, (highest, -lowest))
        self._turns.add(columns[:, old:], t_ns)
        with np.errstate(invalid="ignore", over="ignore"):
            reached = np.maximum(highest, -lowest)
        self._dropouts.add(columns[:, old:], t_ns, reached)
        self._spikes.add(columns[:, old:], t_ns, reached)
        self._exact.add(columns[:, old:], t_ns)
        self._unit_change.add(columns[:, old:], t_ns, reached)
        self._blocks.add(columns[:, old:], t_ns)
        self._last, self._last_ns = columns[:, -_OVERLAP:].copy(), every_ns[-_OVERLAP:]

    def _add_motion(self, columns: Float64) -> None:
        before, after = columns[:, :-1], columns[:, 1:]
        # einsum does not start threads, as dot would for so many.
        # Rates that are not finite, or whose squares overflow, are left out below.
        with np.errstate(invalid="ignore", over="ignore"):
            squares, products = (np.einsum("ij,ij->i", rows, after) for rows in (after, before))
            sums = np.stack([after.sum(axis=1), squares, products], axis=1)
        if (np.abs(sums) < LARGEST_SUM).all():
            self._sums += sums
            self._neighbours += after.shape[1]

    def _repeats(self, columns: Float64, begin: int) -> Bool | None:
        """Return which rows repeat the row before; None if hardly any does."""
        equal = columns[0, 1:] == columns[0, :-1]
        if np.count_nonzero(equal) <= MAYBE_HELD * len(equal):
            return None
        each = np.stack([equal, *(column[1:] == column[:-1] for column in columns[1:])])
        equal = np.logical_and.reduce(each)
        counted = np.abs(columns).max(axis=0) > TURNING
        # Clipped rates do not change, either.
        for limit in (self._highest, self._lowest):
            wide = np.abs(limit) >= SMALLEST_RANGE
            counted &= (columns[wide] != limit[wide, None]).all(axis=0)
        counted = counted[1:]
        new = slice(begin, None)
        self._repeated += int(np.count_nonzero((equal & counted)[new]))
        self._different += int(np.count_nonzero((~equal & counted)[new]))
        self._equal += np.count_nonzero((each & counted)[:, new], axis=1)
        if self._jumps.shape[1] < MOST_JUMPS:
            (after,) = np.nonzero((~equal & counted)[1:] & equal[:-1])
            after = after[after + 1 >= begin]
            jumps = columns[:, after + 2] - columns[:, after + 1]
            self._jumps = np.concatenate([self._jumps, jumps], axis=1)[:, :MOST_JUMPS]
        return np.concatenate([[False], equal])

    def remarks(self, counts: Counts) -> list[Remark]:
        """Return a sentence for each finding."""
        largest = float(np.max([self._highest, -self._lowest]))
        if not math.isfinite(largest):
            return []
        if largest == 0.0:
            return [Remark("zero-rates", "every rate is zero: is this the right topic?")]
        remarks: list[Remark] = []
        interval = _interval_s(counts)
        dropouts = [*self._dropouts.remarks(self._unit)]
        spikes = [] if dropouts else [*self._spikes.remarks(interval, self._unit)]
        # A few damaged samples say nothing of the unit, nor of the motion.
        if not (spikes and self._spikes.largest == largest):
            if largest > WIDEST_RANGE:
                remarks.append(Remark("beyond-range", self._beyond_range(largest)))
            elif interval is not None:
                remarks += self._slow(largest * interval, interval)
        if (self._highest == self._lowest).all():
            if self._samples >= FROZEN_SAMPLES:
                rate, still = (self._highest / self._unit[1]).tolist(), ""
                if largest < AT_REST:
                    still = ", or at rest with less noise than a step"
                text = (
                    f"every rate is the same, {rate} {self._unit[0]}: frozen, or simulated{still}?"
                )
                remarks.append(Remark("frozen", text))
            return remarks
        hold = self._hold()
        if hold > 1:
            remarks.append(
                Remark(
                    "held-samples",
                    f"{100 - 100 / hold:.2g} % of the rows repeat the row before while the body "
                    f"turns: the log repeats samples, with a new rate only every {hold:.2g} rows",
                )
            )
        moving = self._highest != self._lowest
        extremes = np.maximum(self._highest, -self._lowest)
        wrapped = self._wraps.remarks(interval, extremes, self._unit)
        frozen = [*self._freezes.remarks(self._samples, self._highest, self._lowest, self._unit)]
        known = "".join(one.split()[1] for one in frozen)
        return [
            *remarks,
            *(dropouts or spikes),
            *frozen,
            *self._exact.remarks(self._unit, known, has_dropouts=bool(dropouts)),
            *self._blocks.remarks(),
            *([*self._turns.remarks(self._unit)] or wrapped),
            *self._saturation.remarks(self._samples, moving, hold, interval, self._unit),
        ]

    def _beyond_range(self, largest: float) -> str:
        """Return the remark on rates that are too large, with advice on the unit."""
        name, factor = self._unit
        if change := self._unit_change.text(f"{largest / factor:.4g} {name}"):
            return change
        question = f", in {name} as given: is that right?"
        if not self._is_given:
            question = f"; if they are in deg/s, use {Setting('rate_unit', 'deg/s')}"
            if name == "deg/s":
                question = f": is {name} right?"
        return f"rates up to {largest / factor:.4g} {name} are beyond any gyroscope{question}"

    def _hold(self) -> float:
        """Return the mean number of rows for which a sample is held; 1 if none is."""
        hold = 1 + self._repeated / max(self._different, 1)
        enough = self._repeated >= MIN_HELD and 1 - 1 / hold >= HELD
        # Of a coarse sensor in steady rotation, each axis is often equal to the row before.
        chance = float(np.prod((self._equal - self._repeated) / max(self._different, 1)))
        enough &= hold - 1 > CHANCE * chance
        # Rounded rates are often equal, too, but have few distinct changes.
        sizes = np.abs(self._jumps)
        step = np.where(sizes > 0, sizes, np.inf).min(axis=1, initial=np.inf, keepdims=True)
        ways = len({*zip(*np.rint(2 * self._jumps / step).tolist(), strict=True)})
        enough &= ways > FEW_JUMPS + DISTINCT * self._jumps.shape[1]
        return hold if enough and hold <= LONGEST_HOLD else 1.0

    def _slow(self, largest_step: float, interval: float) -> Iterator[Remark]:
        """Yield a remark if the motion between samples is unknown."""
        if largest_step > STEP_LIMIT:
            yield Remark(
                "too-slow",
                f"the body rotates by up to {math.degrees(largest_step):.3g} deg between two "
                "samples: the sample rate is too low for this motion",
            )
            return
        if self._neighbours < MIN_NEIGHBOURS:
            return
        total, squares, products = self._sums.T
        variance = float((squares - total**2 / self._neighbours).sum())
        difference = 2 * float((squares - products).sum())
        step = math.sqrt(max(difference, 0.0) / self._neighbours) * interval
        if step > UNRESOLVED_STEP and difference > UNRESOLVED * 2 * variance:
            yield Remark(
                "too-slow",
                f"between two samples, the rate changes by {math.degrees(step / interval):.3g} "
                f"deg/s RMS, which is {math.degrees(step):.3g} deg in the time between them: the "
                "sample rate is too low for this motion",
            )


def _interval_s(counts: Counts) -> float | None:
    """Return the usual interval, s; the mean one if several samples share a timestamp."""
    if counts.median_dt_ns is None:
        return None
    return min(counts.median_dt_ns, counts.span_ns / max(counts.used - 1, 1)) / NS_PER_S


def other_unit(unit: str, *, are_too_large: bool) -> str:
    """Return the likely unit of rates that are too large or too small by 180/pi, as advice."""
    other, scale = ("deg/s", "180/pi") if are_too_large else ("rad/s", "pi/180")
    if other == unit:
        return f"were they scaled by {scale} once too often?"
    return f"if they are in {other}, use {Setting('rate_unit', other)}"
