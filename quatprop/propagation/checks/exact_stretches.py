"""Stretches of rates that the samples before predict exactly, unlike all others around them.

An axis that freezes repeats its last rate; rows that were filled in across a gap are on straight
lines. Noise does neither for long, nor does a motion. No sample is changed here.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark
from quatprop.base.times import duration_text
from quatprop.propagation.checks.dropouts import AT_REST, JUMP, SMALLEST_JUMP
from quatprop.propagation.checks.samples import (
    CHANGING,
    FROZEN_SAMPLES,
    NEIGHBOURS,
    SMALLEST_RANGE,
    Samples,
    Stretch,
    has_noise,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from quatprop.base.arrays import Bool, Float64
    from quatprop.propagation.checks.samples import Unit


STRIDE = 4
"""Every so many samples are looked at first."""

SHORTEST = 2 * STRIDE, 3 * STRIDE
"""Fewest equal rates, and rows on straight lines, so that two or three of these samples are."""

MOST = 0.2
"""Share of these samples above which rates repeat, or are on straight lines, by chance."""

FEW_RUNS = 4
"""Unless they do so in as few runs."""

UNLIKELY = 1e-12
"""Largest probability of as many exact predictions in a row, from the share of them elsewhere."""

LEAST_SHARE = 1 / (2 * NEIGHBOURS)
"""Smallest such share that can be known from the samples beside."""

FEWEST_NEIGHBOURS = NEIGHBOURS // 2
"""Fewest samples on either side of a stretch."""

TOP = 0.95
"""Rates above this share of the largest beside may be clipped, if they are that large."""

ROUNDING = 1e-9
"""Rounding of rates, relative to the largest."""

LEAST_SLOPE = 8
"""Smallest change along a straight line, in steps of the rates."""

KINK = 3.0
"""Smallest change of the slope at both ends of a straight line, in units of the usual one."""

LONGEST_KEPT = 1 << 16
"""Rows of a stretch that goes on that are kept."""


class ExactStretches:
    """Finds axes that freeze for a short time, and rows that were filled in on straight lines."""

    def __init__(self) -> None:
        self._kept = Samples()
        self._few = np.empty((3, 0))
        # Up to where the rows kept are decided, and whether a stretch may begin in them.
        self._decided, self._is_open = 0, False
        self._tolerance = np.zeros((3, 1))
        self._found: dict[str, Stretch] = {}

    @np.errstate(over="ignore", invalid="ignore")  # of rates of a damaged log
    def add(self, samples: Samples) -> None:
        """Add new samples."""
        if not self._few.size:
            self._tolerance = _tolerance(samples.columns)
        begin = samples.size
        if self._may_begin(samples.columns) or self._is_open or begin < 2 * NEIGHBOURS:
            samples = samples.after(self._kept)
            begin = self._look(samples, is_end=False)
        count = samples.size
        self._is_open = begin < count
        begin = max(min(begin, count - NEIGHBOURS) - NEIGHBOURS, count - LONGEST_KEPT, 0)
        self._decided = max(count - NEIGHBOURS - begin, 0)
        self._kept = samples.kept(begin)

    def _may_begin(self, columns: Float64) -> bool:
        """Return whether a few of the samples repeat, or are on straight lines; unless many do."""
        few = np.concatenate([self._few, columns[:, ::STRIDE]], axis=1)
        self._few = few[:, -2:]
        if any(map(_are_few, few[:, 1:] == few[:, :-1])):
            return True
        tolerance = 2 * self._tolerance
        if not (np.abs(np.diff(few[0], 2)) <= tolerance[0]).any():
            return False
        return _are_few(np.logical_and.reduce(np.abs(np.diff(few, 2)) <= tolerance))

    @np.errstate(over="ignore", invalid="ignore")
    def _look(self, samples: Samples, *, is_end: bool) -> int:
        """Decide on the stretches, and return where one that may go on begins."""
        every, count = samples.columns, samples.size
        open_from = count
        last = count if is_end else count - NEIGHBOURS
        tolerance = _tolerance(every)
        is_line = np.logical_and.reduce(np.abs(np.diff(every, 2)) <= 2 * tolerance)
        filled = []
        for begin, end in _runs(is_line, SHORTEST[1] - 2):
            if end + 2 > last:
                open_from = min(open_from, begin)
            elif end + 2 > self._decided and _is_filled(every, begin, end + 2, tolerance):
                self._note("filled", samples, begin, end + 2)
                filled.append((begin, end + 2))
        equal = every[:, 1:] == every[:, :-1]
        for begin, end in _runs(np.logical_and.reduce(equal), SHORTEST[0] - 1):
            if end + 1 > last:
                open_from = min(open_from, begin)
            elif end + 1 > self._decided and _is_held(every, begin, end + 1):
                self._note("held", samples, begin, end + 1)
                filled.append((begin, end + 1))
        for axis, own in enumerate(every):
            for begin, end in _runs(equal[axis], SHORTEST[0] - 1):
                if end + 1 > last:
                    open_from = min(open_from, begin)
                elif (
                    end + 1 > self._decided
                    and not any(begin < stop and end > start for start, stop in filled)
                    and self._is_frozen(every, axis, begin, end + 1)
                ):
                    self._note("xyz"[axis], samples, begin, end + 1, float(own[begin]))
        return open_from

    def _note(self, kind: str, samples: Samples, begin: int, end: int, value: float = 0.0) -> None:
        first_ns, last_ns = samples.t_ns[[begin, end - 1]].tolist()
        found = Stretch(first_ns, last_ns, end - begin, value=value)
        self._found[kind] = found.after(self._found.get(kind))

    @staticmethod
    def _is_frozen(every: Float64, axis: int, begin: int, end: int) -> bool:
        """Return whether equal rates of an axis, ``[begin, end)``, are those of a frozen one."""
        sides = _beside(every, begin, end)
        if sides is None or end - begin >= FROZEN_SAMPLES:
            return False
        before, after = sides
        own = before[axis], after[axis]
        value = float(every[axis, begin])
        share = np.mean([*(own[0][1:] == own[0][:-1]), *(own[1][1:] == own[1][:-1])])
        if not _is_unlikely(float(share), end - begin - 1):
            return False
        changes = (np.diff(np.delete(every[:, begin:end], axis, 0)) != 0).mean(axis=1).max()
        # At the end of its range a rate is clipped; a calibration spreads the end.
        top = TOP if abs(value) >= SMALLEST_RANGE else 1.0
        is_largest = value > 0 and value >= top * max(map(np.max, own))
        is_largest |= value < 0 and value <= top * min(map(np.min, own))
        if changes < CHANGING or is_largest:
            return False
        usual = float(np.median(np.abs(np.concatenate([*map(np.diff, own)]))))
        # A driver may set what is small to zero, so that no small rates are left.
        sizes = np.abs(every[axis])
        smallest = float(sizes[sizes > 0].min(initial=np.inf)) if value == 0 else 0.0
        if smallest < usual / 2 and all(map(has_noise, own)):
            return True
        jump = max(abs(own[0][-1] - value), abs(own[1][0] - value))
        return bool(jump > max(JUMP * usual, SMALLEST_JUMP, 2 * smallest))

    def findings(self) -> dict[str, Stretch]:
        """Return what is found, by axis, or as ``"held"`` or ``"filled"``: of all axes.

        There are no more samples.
        """
        if self._kept.size:
            self._look(self._kept, is_end=True)
            self._kept = Samples()
        return self._found


def stretch_remarks(found: Mapping[str, Stretch], samples: int, unit: Unit) -> Iterator[Remark]:
    """Yield a sentence for each axis that freezes, and for rows that are held or were filled in.

    `found`: the findings of :class:`ExactStretches` and of :class:`.Freezes`
    `samples`: number of samples of the log
    """
    name, scale = unit
    for axis in sorted(found.keys() & set("xyz")):
        value = f"{found[axis].value / scale:.6g} {name}"
        if found[axis].samples == samples:
            text = (
                f"never changes, it is {value} in all {samples} samples: frozen, or not measured?"
            )
        else:
            text = f"stays at {value} for {_where(found[axis])}, while the others change: frozen?"
        yield Remark("frozen-axis", f"axis {axis} {text}")
    if "held" in found:
        yield Remark(
            "dropout",
            f"all three rates stay the same for {_where(found['held'])}, without the noise of "
            "those before and after: did the sensor drop out?",
        )
    if "filled" in found:
        yield Remark(
            "filled-in",
            f"all three rates are on straight lines for {_where(found['filled'])}, unlike before "
            "and after: were rows filled in across a gap? without them, it would be seen",
        )


def _are_few(hits: Bool) -> bool:
    """Return whether there are hits, and no more than chance would leave unnoticed."""
    count = np.count_nonzero(hits)
    if not count:
        return False
    runs = np.count_nonzero(hits[1:] & ~hits[:-1])
    return bool(count <= MOST * len(hits) or runs <= FEW_RUNS)


def _where(found: Stretch) -> str:
    lasted = duration_text(found.end_ns - found.begin_ns)
    return f"{found.samples} samples, {lasted} from t = {found.begin_ns} ns on{found.often}"


def _runs(hits: Bool, shortest: int) -> Iterator[tuple[int, int]]:
    """Yield the begin and end of runs that are longer than those of chance would be."""
    share = float(np.count_nonzero(hits)) / max(len(hits), 1)
    changes = np.flatnonzero(np.diff(hits, prepend=False, append=False))
    begins, ends = changes[::2], changes[1::2]
    lengths = ends - begins
    chosen = lengths >= shortest
    # A run has its own share.
    without = np.maximum(share - lengths / max(len(hits), 1), LEAST_SHARE)
    chosen &= lengths * np.log(np.minimum(without, 1 - LEAST_SHARE)) < math.log(UNLIKELY)
    yield from zip(begins[chosen].tolist(), ends[chosen].tolist(), strict=True)


def _is_unlikely(share: float, times: int) -> bool:
    """Return whether exact predictions in a row are unlikely, by their share elsewhere."""
    return times * math.log(max(share, LEAST_SHARE)) < math.log(UNLIKELY)


def _beside(every: Float64, begin: int, end: int) -> tuple[Float64, Float64] | None:
    """Return the rates on either side; None if there are too few."""
    before, after = every[:, max(begin - NEIGHBOURS, 0) : begin], every[:, end : end + NEIGHBOURS]
    return (before, after) if min(before.shape[1], after.shape[1]) >= FEWEST_NEIGHBOURS else None


def _is_held(every: Float64, begin: int, end: int) -> bool:
    """Return whether equal rows, ``[begin, end)``, repeat one of a body that turns.

    A coarse sensor at rest, or in steady rotation, has no noise beside, on two axes.
    """
    sides = every[:, max(begin - NEIGHBOURS, 0) : begin], every[:, end : end + NEIGHBOURS]
    known = [side for side in sides if side.shape[1] >= FEWEST_NEIGHBOURS]
    if not known or (len(known) == 1 and end - begin < FROZEN_SAMPLES):
        return False
    is_noisy = np.logical_and.reduce([has_noise(side) for side in known])
    sizes = np.sort(np.abs(every[:, begin]))
    is_clipped = sizes[1] > TOP * sizes[2]
    return bool(np.count_nonzero(is_noisy) > 1 and sizes[1] > AT_REST and not is_clipped)


def _tolerance(every: Float64) -> Float64:
    """Return how far rates of each axis are from a straight line by rounding, ``(3, 1)``."""
    steps, sizes = (np.where(np.isfinite(one), one, 0) for one in (np.diff(every), every))
    smallest = np.where(steps != 0, np.abs(steps), np.inf).min(1, keepdims=True, initial=np.inf)
    rounding = ROUNDING * np.abs(sizes).max(axis=1, keepdims=True, initial=0)
    tolerance: Float64 = np.maximum(np.where(np.isfinite(smallest), smallest, 0), rounding)
    return tolerance


def _is_filled(every: Float64, begin: int, end: int, tolerance: Float64) -> bool:
    """Return whether rows ``[begin, end)`` are on straight lines, unlike those beside."""
    sides = _beside(every, begin, end)
    if sides is None:
        return False
    # A sample beside may be near the line by chance.
    parts = [slice(begin + k, end - n) for k, n in ((0, 0), (0, 1), (1, 0), (1, 1))]
    part = next((one for one in parts if _is_straight(every[:, one], tolerance)), None)
    if part is None:
        return False
    rates = every[:, part]
    slopes = np.abs(rates[:, -1] - rates[:, 0]) >= LEAST_SLOPE * tolerance[:, 0]
    if not slopes.any():
        return False
    curves = np.abs(np.concatenate([np.diff(side, 2) for side in sides], axis=1))
    # A rate about one axis alone, such as that of wheels, is often a ramp.
    axes = np.count_nonzero(curves.any(axis=1))
    share = float((curves <= 2 * tolerance).all(axis=0).mean())
    if axes < 2 or not _is_unlikely(share, end - begin - 2):  # noqa: PLR2004
        return False
    if any(map(bool, np.logical_and(*map(has_noise, sides)))):
        return True
    usual = np.maximum(np.median(curves, axis=1), tolerance[:, 0])
    ends = (part.start, part.stop - 1)
    kinks = (np.abs(np.diff(every[:, end - 1 : end + 2], 2))[:, 0] for end in ends)
    return all(bool((kink > KINK * usual).any()) for kink in kinks)


def _is_straight(rates: Float64, tolerance: Float64) -> bool:
    """Return whether rates are on straight lines from the first to the last."""
    line = np.linspace(rates[:, 0], rates[:, -1], rates.shape[1], axis=1)
    return bool((np.abs(rates - line) <= 1.01 * tolerance).all())
