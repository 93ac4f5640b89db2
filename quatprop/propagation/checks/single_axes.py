"""Plausibility of single axes: frozen and wrapped rates, and spikes.

No sample is changed here; each finding is one sentence with its place.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.text import Remark
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
    from collections.abc import Iterator

    from quatprop.base.arrays import Float64, Int64, Intp
    from quatprop.propagation.checks.samples import Unit


SAMPLED = 8
"""Every so many pairs of neighbours are counted, to learn how often an axis changes."""


class _Stay(NamedTuple):
    """Successive equal rates of an axis.

    `samples`: their number; 0 before the first
    `others`: number of changes of the axis among the others that changes most
    """

    begin_ns: int = 0
    end_ns: int = 0
    samples: int = 0
    others: int = 0
    rate: float = math.nan


class Freezes:
    """Finds axes that do not change while others, which have noise, do."""

    def __init__(self) -> None:
        self._open = [_Stay()] * 3
        self._longest = [_Stay()] * 3
        self._changes, self._pairs = np.zeros(3), 0
        self._noisy = np.zeros(3, np.bool_)

    def add(self, samples: Samples) -> None:
        """Add samples; the first was seen before, but for those of the first call."""
        columns = samples.columns
        before, after = columns[:, :-1:SAMPLED], columns[:, 1::SAMPLED]
        self._changes += np.count_nonzero(before != after, axis=1)
        self._pairs += before.shape[1]
        if columns.shape[1] >= NEIGHBOURS and not self._noisy.all():
            self._noisy |= has_noise(columns[:, :NEIGHBOURS]) | has_noise(columns[:, -NEIGHBOURS:])
        # A long stay has two of these samples.
        few = columns[:, :: FROZEN_SAMPLES // 2]
        may_stay = (few[:, 1:] == few[:, :-1]).any(axis=1)
        for axis in range(3):
            begun = self._open[axis].samples >= FROZEN_SAMPLES // 2
            if may_stay[axis] or begun:
                self._add_stays(samples, axis)
            else:
                self._open[axis] = _Stay()
                if columns[axis, -1] == columns[axis, -2:][0]:
                    self._add_stays(samples.part(-FROZEN_SAMPLES), axis)

    def _add_stays(self, samples: Samples, axis: int) -> None:
        """Add the stays of one axis; the first may go on from before."""
        columns, t_ns = samples
        own, others = columns[axis], [k for k in range(3) if k != axis]
        begins = np.flatnonzero(np.append(True, own[1:] != own[:-1]))
        ends = np.append(begins[1:], len(own))
        is_long = ends - begins >= FROZEN_SAMPLES // 2
        is_long[[0, -1]] = True
        changed = np.cumsum(columns[others, 1:] != columns[others, :-1], axis=1)
        changed = np.concatenate([[[0], [0]], changed], axis=1)
        for begin, end in zip(begins[is_long].tolist(), ends[is_long].tolist(), strict=True):
            stay = _Stay(
                int(t_ns[begin]),
                int(t_ns[end - 1]),
                end - begin,
                int((changed[:, end - 1] - changed[:, begin]).max()),
                float(own[begin]),
            )
            before = self._open[axis]
            if begin == 0 and before.samples and before.rate == stay.rate:
                # The first sample is the last of before.
                stay = stay._replace(
                    begin_ns=before.begin_ns,
                    samples=before.samples + stay.samples - 1,
                    others=before.others + stay.others,
                )
            self._open[axis] = stay
            if (
                stay.others >= CHANGING * stay.samples
                and stay.samples > self._longest[axis].samples
            ):
                self._longest[axis] = stay

    def findings(self, samples: int, highest: Float64, lowest: Float64) -> dict[str, Stretch]:
        """Return by axis where it never changes, or freezes.

        `highest`, `lowest`: of each axis, rad/s, shape ``(3,)``
        """
        share = self._changes / max(self._pairs, 1)
        are_still = highest == lowest
        # A gyroscope of one axis has zeros on the others.
        is_of_one_axis = np.count_nonzero(are_still & (highest == 0)) > 1
        found: dict[str, Stretch] = {}
        for axis, letter in enumerate("xyz"):
            stay = self._longest[axis]
            if not np.delete(self._noisy, axis).any():
                continue
            if are_still[axis]:
                if samples >= FROZEN_SAMPLES and not is_of_one_axis:
                    found[letter] = Stretch(0, 0, samples, value=float(highest[axis]))
                continue
            # At the end of the range of the axis, it may be saturated.
            is_at_end = stay.rate in (highest[axis], lowest[axis])
            may_be_clipped = is_at_end and abs(stay.rate) >= SMALLEST_RANGE
            if stay.samples >= FROZEN_SAMPLES and not (
                2 * stay.samples < samples and may_be_clipped
            ):
                is_whole = stay.samples > samples - NEIGHBOURS
                outside = share[axis] / max(1 - stay.samples / samples, 1 / samples)
                if is_whole or (self._noisy[axis] and outside >= CHANGING):
                    found[letter] = Stretch(
                        stay.begin_ns, stay.end_ns, stay.samples, value=stay.rate
                    )
        return found


NEAR = 0.3
"""Share of the extreme that all samples next to a wrap exceed, and their other changes do not."""

SMALLEST_WRAP = math.radians(120.0)
"""rad/s: the last samples before a wrap are somewhat below the end of the range."""

FARTHEST = 1.8
"""Smallest jump, in units of the extreme: a rate that wraps jumps by twice the range."""

SIDES = (8, 32)
"""Samples on either side of a jump that show whether the rate goes on: if it changes quickly, and
if it hardly changes."""

MOST_JUMPS = 0.25
"""Largest share of jumps: samples of several sensors jump more often."""

CERTAIN = 6.0
"""The larger of their slopes, in standard errors, that shows that it does."""


class Wraps:
    """Finds rates that jump from one end of the range to the other while they go on rising."""

    def __init__(self) -> None:
        self._kept = Samples()
        self._reached = np.full(3, -np.inf), np.full(3, -np.inf)
        self._counts = [0] * 3
        self._firsts: list[tuple[int, float, float]] = [(0, 0.0, 0.0)] * 3

    def add(self, samples: Samples, extremes: Float64, reached: tuple[Float64, Float64]) -> None:
        """Add new samples.

        `extremes`: largest magnitude of each axis so far, shape ``(3,)``
        `reached`: the maxima of these samples, and of the negated ones
        """
        with np.errstate(invalid="ignore", over="ignore"):
            spread = sum(map(np.fmax, reached, self._reached))
            wide = (extremes >= SMALLEST_WRAP) & (spread >= FARTHEST * extremes)
        if wide.any():
            seen = self._kept.size
            every, every_ns = samples.after(self._kept)
            for axis in np.flatnonzero(wide).tolist():
                rate, extreme = every[axis], float(extremes[axis])
                with np.errstate(invalid="ignore", over="ignore"):
                    jumps = np.flatnonzero(np.abs(np.diff(rate)) > FARTHEST * extreme)
                if len(jumps) > MOST_JUMPS * len(rate):
                    continue
                jumps = jumps[jumps >= max(seen - SIDES[-1], SIDES[0] - 1)]
                for jump in jumps[jumps < len(rate) - SIDES[-1]].tolist():
                    parts = (rate[max(jump - n + 1, 0) : jump + n + 1] for n in SIDES)
                    if any(_goes_on(part, extreme) for part in parts):
                        if not self._counts[axis]:
                            at = int(every_ns[jump + 1])
                            self._firsts[axis] = at, float(rate[jump]), float(rate[jump + 1])
                        self._counts[axis] += 1
        self._kept = samples.kept(-2 * SIDES[-1])
        last = self._kept.columns
        self._reached = last.max(axis=1), (-last).max(axis=1)

    def remarks(self, interval: float | None, extremes: Float64, unit: Unit) -> Iterator[Remark]:
        """Yield a sentence for each axis that wraps; `interval`: between samples, s."""
        name, scale = unit
        for axis, letter in enumerate("xyz"):
            if not (count := self._counts[axis]):
                continue
            at_ns, before, after = self._firsts[axis]
            off = 2 * float(extremes[axis])
            times = f" ({count} times, first at t = {at_ns} ns)"
            if count == 1:
                times = f" at t = {at_ns} ns"
            each = f", {math.degrees(off * interval):.3g} deg a sample" if interval else ""
            yield Remark(
                "wrapped",
                f"axis {letter} jumps from {before / scale:.4g} to {after / scale:.4g} {name} and "
                f"goes on as before{times}: its range has wrapped around, and until it jumps back "
                f"every rate is off by {off / scale:.4g} {name}{each}",
            )


def _goes_on(rate: Float64, extreme: float) -> bool:
    """Return whether rates next to a jump in the middle have slopes against it."""
    side = len(rate) // 2
    if side not in SIDES or not np.abs(rate).min() > NEAR * extreme:
        return False
    if np.count_nonzero(np.abs(np.diff(rate)) > FARTHEST * extreme) > MOST_JUMPS * len(rate):
        return False
    sign = math.copysign(1.0, rate[side - 1])
    # Noise may take it back and forth.
    unwrapped = np.unwrap(rate, period=2 * extreme)
    if np.abs(np.diff(unwrapped)).max() > NEAR * extreme:
        return False
    before, after = np.split(unwrapped, 2)
    half = side // 2
    slopes = [sign * float(part[half:].mean() - part[:half].mean()) for part in (before, after)]
    second = np.concatenate([np.diff(part, 2) for part in (before, after)])
    noise = float(np.sqrt((second**2).mean() / 6))
    return sum(slopes) > 0 and max(slopes) > CERTAIN * noise * math.sqrt(2 / half)


CONTEXT = 6
"""Samples on either side of a spike that show how much the rate changes; a body that is hit goes on
to swing."""

SMALLEST_JUMP = math.radians(60.0)
"""rad/s: a smaller spike does not matter."""

ALONE = 20.0
"""Ratio of the jumps to a spike and back to the largest change of the rate around it."""

NEAR_EXTREME = 0.3
"""Samples above this share of the extreme of a block are looked at, if the extreme is a spike."""

MOST = 256
"""More samples near the extreme of a block are a motion."""

LONGEST_INTERVAL_S = 0.0125
"""A body can turn away and stop again between samples that are farther apart."""


class Spikes:
    """Finds spikes at the extremes of blocks of samples; smaller ones are not looked for."""

    def __init__(self) -> None:
        self._kept = Samples()
        self._samples, self._first_ns = [0] * 3, [0] * 3
        self._firsts = [(0.0, 0.0)] * 3
        self.largest = 0.0

    @np.errstate(over="ignore", invalid="ignore")  # of rates of a damaged log
    def add(self, samples: Samples, extremes: Float64) -> None:
        """Add new samples.

        `extremes`: largest magnitude of each axis in them, shape ``(3,)``
        """
        edge = samples.part(0, 2 * CONTEXT).after(self._kept)
        edge_extremes = np.abs(edge.columns).max(axis=1)
        for each, reached in ((samples, extremes), (edge, edge_extremes)):
            for axis in np.flatnonzero(reached > SMALLEST_JUMP / 2).tolist():
                self._look(each.columns[axis], each.t_ns, axis)
        self._kept = samples.kept(-2 * CONTEXT)

    def _look(self, rate: Float64, t_ns: Int64, axis: int) -> None:
        """Look at the extreme of samples that have others on either side."""
        inside = rate[CONTEXT:-CONTEXT]
        if not len(inside):
            return
        place = int(max(inside.argmax(), inside.argmin(), key=lambda k: abs(inside[k])))
        middle = place + CONTEXT
        earlier, before, value, after, later = rate[middle - 2 : middle + 3].tolist()
        size, jump = abs(value), min(abs(value - before), abs(value - after))
        # Fast exit of most blocks: what changes next to it is not much smaller.
        others = max(abs(before - earlier), abs(later - after), abs(after - before))
        if math.isinf(size) or not jump > max(SMALLEST_JUMP, ALONE * others):
            return
        if not len(_alone(rate, np.array([middle]))):
            return
        near = np.flatnonzero(np.abs(inside) > NEAR_EXTREME * size) + CONTEXT
        if len(near) > MOST:
            return
        found = _alone(rate, near)
        if not self._samples[axis]:
            first = int(found[0])
            self._first_ns[axis] = int(t_ns[first])
            self._firsts[axis] = float(rate[first]), abs(float(rate[first] - rate[first - 1]))
        self._samples[axis] += len(found)
        self.largest = max(self.largest, size)

    def remarks(self, interval: float | None, unit: Unit) -> Iterator[Remark]:
        """Yield a sentence for each axis with spikes; `interval`: between samples, s."""
        if interval is None or interval > LONGEST_INTERVAL_S:
            return
        name, scale = unit
        for axis, letter in enumerate("xyz"):
            if not (count := self._samples[axis]):
                continue
            value, jump = self._firsts[axis]
            cost = f"{math.degrees(jump * interval):.3g} deg"
            times = f"{count} times, first " if count > 1 else ""
            yield Remark(
                "spikes",
                f"axis {letter} jumps to {value / scale:.4g} {name} for one sample, and back to "
                f"where it was, {times}at t = {self._first_ns[axis]} ns, which is {cost} of "
                "rotation: is it damaged?",
            )


def _alone(rate: Float64, places: Intp) -> Intp:
    """Return the places of samples that differ from all around them, which hardly change."""
    around = np.lib.stride_tricks.sliding_window_view(rate, 2 * CONTEXT + 1)[places - CONTEXT]
    changes = np.abs(np.diff(around, axis=1))
    jump = np.minimum(changes[:, CONTEXT - 1], changes[:, CONTEXT])
    across = np.abs(around[:, CONTEXT + 1] - around[:, CONTEXT - 1])
    others = np.delete(changes, [CONTEXT - 1, CONTEXT], axis=1).max(axis=1)
    alone: Intp = places[(jump > SMALLEST_JUMP) & (jump > ALONE * np.maximum(others, across))]
    return alone
