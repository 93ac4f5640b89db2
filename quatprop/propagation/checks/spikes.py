"""Spikes: single samples of an axis that jump away from those around them, and back.

No sample is changed here; each finding is one sentence with its place.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark
from quatprop.propagation.checks.samples import Samples

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Float64, Int64, Intp
    from quatprop.propagation.checks.samples import Unit


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
