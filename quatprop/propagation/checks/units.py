"""Units of rates that are not the stated one, throughout or from a sample on.

No sample is changed here; each finding is one sentence.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark, Setting
from quatprop.propagation.checks.samples import Samples
from quatprop.propagation.conditioning.static_period import step_of
from quatprop.settings.quantities import RATES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Float64, Int64
    from quatprop.kinematics.series import GyroSeries


SENSITIVITIES = (
    *(range_deg_s / 32768 for range_deg_s in (125, 245, 250, 300, 450, 500, 1000, 2000, 4000)),
    *(1 / per_deg_s for per_deg_s in (131, 131.2, 65.5, 65.6, 32.8, 16.4)),
    *(0.004375, 0.00875, 0.0175, 0.035, 0.07),
)
"""Steps of common gyroscopes, deg/s: a range in 16 bits, then those of InvenSense and of ST."""

SMALLEST_CUT, CUT = math.radians(2.0), 0.2
"""Smallest step of rates without their decimals, rad/s, and relative to their deviation."""

FINER, MANY_VALUES = 0.01, 200
"""The other axes then have smaller steps by this ratio, and more values than this."""

SAME_STEP = 2e-4
"""Largest relative difference of equal steps: data sheets give few digits."""

STEPPED = 10_000
"""Number of samples whose step is determined."""

_SCALE = 180 / math.pi
"""deg/s in rad/s."""

SIDE = 4
"""Samples on either side of a change, whose means differ by that factor in all axes."""

TOLERANCE = 0.25
"""Largest difference of the means, scaled, as a share: the body goes on to move."""

SMALLEST = 1.0
"""rad/s: the larger mean; of a smaller one noise may hide the factor."""

NOISY, NOISE_RATIO = 32, 2.5
"""Samples on either side whose noise is compared, and by how much less or more it may change."""

JUMP = 10.0
"""Blocks are looked at if the largest rate differs from that of the block before by this ratio."""


class UnitChecks:
    """Finds the steps of a gyroscope in another unit, and the first sample in another unit.

    From there on rates are larger or smaller by 180/pi, in one direction, as when a driver is
    started again without its setting.

    `unit`: name of the unit of the rates in the log and in remarks, and its size, rad/s
    `is_given`: whether the user gave the unit
    """

    def __init__(self, unit: str, *, is_given: bool) -> None:
        self.unit, self._is_given = (unit, RATES[unit]), is_given
        self._stored = np.empty((3, 0))
        self._first_ns: int | None = None
        self._is_larger, self._is_noisier = True, False
        self._before, self._reached = Samples(), 0.0

    def inspect_raw(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the samples of the log, and keep the first, whose steps are determined."""
        for batch in batches:
            if (room := STEPPED - self._stored.shape[1]) > 0:
                self._stored = np.concatenate([self._stored, batch.rate[:room].T], axis=1)
            yield batch

    def step_remarks(self) -> list[Remark]:
        """Return a remark on rates in the steps of a gyroscope in another unit, or cut decimals."""
        unit, scale = self.unit
        each = np.array([step_of(rate) for rate in self._stored])
        for axis, step in enumerate(each):
            if step <= SMALLEST_CUT or step <= CUT * float(self._stored[axis].std()):
                continue
            others = ((each[k], {*self._stored[k].tolist()}) for k in range(3) if k != axis)
            if all(own < FINER * step and len(values) > MANY_VALUES for own, values in others):
                said = (
                    f"axis {'xyz'[axis]} comes in steps of {step / scale:.6g} {unit}, and the "
                    "others in much smaller ones: was it written without its decimals? write it "
                    "with them"
                )
                return [Remark("cut-decimals", said)]
        if self._first_ns is not None and self._is_noisier:
            said = "the rates and their noise"
            return [Remark("unit-changes", self._change_text(said, self._first_ns))]
        steps = [*filter(None, each.tolist())]
        larger, smaller = "57.3 times as large as", "57.3 times smaller than"
        for factor, than in ((1.0, larger), (_SCALE**-2, smaller)):
            known = [factor * sensitivity for sensitivity in SENSITIVITIES]
            for step in steps:
                if any(abs(step - one) < SAME_STEP * one for one in known):
                    said = (
                        f"the rates come in steps of {step / scale:.6g} {unit}, {than} those of a "
                        f"common gyroscope: {other_unit(unit, are_too_large=factor == 1.0)}"
                    )
                    return [Remark("unit-by-steps", said)]
        return []

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of rates of a damaged log
    def add(self, samples: Samples, extremes: Float64) -> None:
        """Add new samples.

        `extremes`: largest magnitude of each axis in them, shape ``(3,)``
        """
        reached = float(extremes.max())
        if self._first_ns is None and not 1 / JUMP < reached / (self._reached or np.inf) < JUMP:
            self._look(*samples.after(self._before))
        self._before, self._reached = samples, reached

    def _look(self, rate: Float64, t_ns: Int64) -> None:
        sums = sum(rate[:, k : rate.shape[1] - SIDE + 1 + k] for k in range(SIDE))
        before, after = (np.asarray(sums)[:, part] for part in (slice(-SIDE), slice(SIDE, None)))
        for small, large in ((before, after), (after, before)):
            size = np.linalg.norm(large, axis=0)
            apart = np.linalg.norm(large - _SCALE * small, axis=0)
            found = np.flatnonzero((apart < TOLERANCE * size) & (size > SIDE * SMALLEST))
            if len(found):
                first_ns = int(t_ns[found[0] + SIDE])
                if self._first_ns is None or first_ns < self._first_ns:
                    self._first_ns, self._is_larger = first_ns, large is after
                    self._is_noisier = _is_noisier(rate, int(found[0]) + SIDE, large is after)

    def beyond_range(self, largest: float) -> str:
        """Return the remark on rates that are too large, with advice on the unit."""
        name, factor = self.unit
        if self._first_ns is not None and name == "rad/s":
            self._is_noisier = False  # it is said once
            said = f"rates up to {largest / factor:.4g} {name} are beyond any gyroscope, and they"
            return self._change_text(said, self._first_ns)
        question = f", in {name} as given: is that right?"
        if not self._is_given:
            question = f"; if they are in deg/s, use {Setting('rate_unit', 'deg/s')}"
            if name == "deg/s":
                question = f": is {name} right?"
        return f"rates up to {largest / factor:.4g} {name} are beyond any gyroscope{question}"

    def _change_text(self, what: str, first_ns: int) -> str:
        """Return the sentence on a unit that changes; `what`: what is larger or smaller."""
        size = "larger" if self._is_larger else "smaller"
        first, second = str(Setting("end", f"{first_ns - 1}")), str(Setting("start", f"{first_ns}"))
        is_radian = self.unit[0] == "rad/s"
        other = f" and {Setting('rate_unit', 'deg/s' if is_radian else 'rad/s')}"
        if self._is_larger == is_radian:
            second += other
        else:
            first += other
        return (
            f"{what} are 57.3 times {size} from t = {first_ns} ns on, as if their unit changed "
            f"there: propagate the parts by themselves, with {first}, and with {second}"
        )


def _is_noisier(rate: Float64, first: int, is_larger: bool) -> bool:
    """Return whether the noise of rates, ``(3, N)``, changes at a place as their size does."""
    sides = rate[:, max(first - NOISY, 0) : first], rate[:, first : first + NOISY]
    if min(side.shape[1] for side in sides) < NOISY:
        return False
    before, after = (float(np.sqrt((np.diff(side, 4) ** 2).mean())) for side in sides)
    ratio = (after / before if is_larger else before / after) / _SCALE
    return 1 / NOISE_RATIO < ratio < NOISE_RATIO


def other_unit(unit: str, *, are_too_large: bool) -> str:
    """Return the likely unit of rates that are too large or too small by 180/pi, as advice."""
    other, scale = ("deg/s", "180/pi") if are_too_large else ("rad/s", "pi/180")
    if other == unit:
        return f"were they scaled by {scale} once too often?"
    return f"if they are in {other}, use {Setting('rate_unit', other)}"
