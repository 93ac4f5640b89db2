"""Plausibility of rates: units, frozen, held or saturated samples, and a low sample rate.

Rates in the wrong unit, frozen, or clipped by the sensor's range give attitudes that look right.
No sample is changed here; each finding is one sentence.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.time_series import reblock
from quatprop.propagation.checks.dropouts import Dropouts
from quatprop.propagation.checks.exact_stretches import ExactStretches, stretch_remarks
from quatprop.propagation.checks.interleaved import Turns, may_take_turns
from quatprop.propagation.checks.missing_samples import MissingSamples
from quatprop.propagation.checks.repeated_blocks import RepeatedBlocks
from quatprop.propagation.checks.samples import FROZEN_SAMPLES, SMALLEST_RANGE, Samples
from quatprop.propagation.checks.saturation import MIN_RUN_LENGTH, Saturation
from quatprop.propagation.checks.single_axes import Freezes, Spikes, Wraps
from quatprop.propagation.checks.units import UnitChecks

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Bool, Float64
    from quatprop.kinematics.series import GyroSeries
    from quatprop.timeline.counts import Counts


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


class RateChecks:
    """Checks rates while they are read.

    The findings do not depend on where batches end.

    `units`: checks of their unit, of which some are on rates as they are stored
    """

    def __init__(self, unit: str = "rad/s", *, is_given: bool = False) -> None:
        self.units = UnitChecks(unit, is_given=is_given)
        self._highest = np.full(3, -np.inf)
        self._lowest = np.full(3, np.inf)
        self._saturation = Saturation()
        self._samples = 0
        self._last = Samples()
        self._freezes, self._wraps, self._turns = Freezes(), Wraps(), Turns()
        self._dropouts, self._spikes, self._exact = Dropouts(), Spikes(), ExactStretches()
        self._blocks, self._missing = RepeatedBlocks(), MissingSamples()
        # Sums over neighbouring samples, per axis: rate, square, product; and their number.
        self._sums, self._neighbours = np.zeros((3, 3)), 0
        self._repeated = self._different = 0
        # Rows of which one axis is equal to the row before.
        self._equal = np.zeros(3)
        self._jumps = np.empty((3, 0))

    def observe(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the samples in blocks, and check them."""
        for block in reblock(batches):
            self._samples += len(block)
            for start in range(0, len(block), _COLUMN):
                part = slice(start, start + _COLUMN)
                self._check(Samples(block.rate[part].T, block.t_ns[part]))
            yield block

    def _check(self, samples: Samples) -> None:
        # A run may continue from the samples before.
        old = self._last.size
        every = samples.after(self._last)
        new, overlapping = every.part(old), every.part(max(old - 1, 0))
        columns = every.columns
        highest, lowest = np.fmax.reduce(columns, axis=1), np.fmin.reduce(columns, axis=1)
        self._highest = np.fmax(self._highest, highest)
        self._lowest = np.fmin(self._lowest, lowest)
        repeats = self._repeats(columns, max(old - 1, 0))
        self._saturation.add(every, old, (highest, -lowest), repeats)
        motion = self._add_motion(overlapping.columns)
        self._freezes.add(overlapping)
        extremes = np.maximum(self._highest, -self._lowest)
        self._wraps.add(new, extremes, (highest, -lowest))
        if may_take_turns(overlapping.columns, motion):
            self._turns.add(new)
        with np.errstate(invalid="ignore", over="ignore"):
            reached = np.maximum(highest, -lowest)
        self._dropouts.add(new, reached)
        self._spikes.add(new, reached)
        self._exact.add(new)
        self.units.add(new, reached)
        self._blocks.add(new)
        self._missing.add(new)
        self._last = every.kept(-_OVERLAP)

    def _add_motion(self, columns: Float64) -> Float64:
        """Add neighbours, and return the sums over them: rates, squares, products; ``(3, 3)``."""
        before, after = columns[:, :-1], columns[:, 1:]
        # einsum does not start threads, as dot would for so many.
        # Rates that are not finite, or whose squares overflow, are left out below.
        with np.errstate(invalid="ignore", over="ignore"):
            squares, products = (np.einsum("ij,ij->i", rows, after) for rows in (after, before))
            sums = np.stack([after.sum(axis=1), squares, products], axis=1)
        if (np.abs(sums) < LARGEST_SUM).all():
            self._sums += sums
            self._neighbours += after.shape[1]
        return sums

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
        missing = self._missing.remarks(counts)
        return [*self._remarks(counts), *missing, *self.units.step_remarks()]

    def _remarks(self, counts: Counts) -> list[Remark]:
        largest = float(np.max([self._highest, -self._lowest]))
        if not math.isfinite(largest):
            return []
        if largest == 0.0:
            return [Remark("zero-rates", "every rate is zero: is this the right topic?")]
        remarks: list[Remark] = []
        unit = self.units.unit
        interval = _interval_s(counts)
        dropouts = [*self._dropouts.remarks(unit)]
        if self._dropouts.are_filled:
            return dropouts
        spikes = [*self._spikes.remarks(interval, unit)]
        # A few damaged samples say nothing of the unit, nor of the motion.
        if not (spikes and self._spikes.largest == largest):
            if largest > WIDEST_RANGE:
                remarks.append(Remark("beyond-range", self.units.beyond_range(largest)))
            elif interval is not None:
                remarks += self._slow(largest * interval, interval)
        if (self._highest == self._lowest).all():
            if self._samples >= FROZEN_SAMPLES:
                rate, still = (self._highest / unit[1]).tolist(), ""
                if largest < AT_REST:
                    still = ", or at rest with less noise than a step"
                text = f"every rate is the same, {rate} {unit[0]}: frozen, or simulated{still}?"
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
        wrapped = self._wraps.remarks(interval, extremes, unit)
        # An axis that is frozen for long may be so for a short time as well.
        stretches = self._exact.findings() | self._freezes.findings(
            self._samples, self._highest, self._lowest
        )
        if dropouts:
            stretches.pop("held", None)
        return [
            *remarks,
            *dropouts,
            *([] if self._dropouts.are_at_an_end else spikes),
            *stretch_remarks(stretches, self._samples, unit),
            *self._blocks.remarks(),
            *([*self._turns.remarks(unit)] or wrapped),
            *self._saturation.remarks(self._samples, moving, hold, interval, unit),
        ]

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
    return min(counts.median_dt_ns, counts.span_ns / max(counts.samples_used - 1, 1)) / NS_PER_S
