"""A unit that changes within a log, as when a driver is started again without its setting."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Setting
from quatprop.propagation.checks.samples import Samples

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64, Int64


SCALE = 180 / math.pi
"""deg/s in rad/s."""

SIDE = 4
"""Samples on either side of a change, whose means differ by that factor in all axes."""

TOLERANCE = 0.25
"""Largest difference of the means, scaled, as a share: the body goes on to move."""

SMALLEST = 1.0
"""rad/s: the larger mean; of a smaller one noise may hide the factor."""

JUMP = 10.0
"""Blocks are looked at if the largest rate differs from that of the block before by this ratio."""


class UnitChange:
    """Finds the first sample from which rates are larger or smaller by 180/pi, in one direction.

    `first_ns`: its timestamp, ns; None: there is none
    `is_larger`: whether rates are larger from there on
    """

    def __init__(self) -> None:
        self.first_ns: int | None = None
        self.is_larger = True
        self._before = Samples()
        self._reached = 0.0

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of rates of a damaged log
    def add(self, samples: Samples, extremes: Float64) -> None:
        """Add new samples.

        `extremes`: largest magnitude of each axis in them, shape ``(3,)``
        """
        reached = float(extremes.max())
        if self.first_ns is None and not 1 / JUMP < reached / (self._reached or np.inf) < JUMP:
            self._look(*samples.after(self._before))
        self._before, self._reached = samples, reached

    def _look(self, rate: Float64, t_ns: Int64) -> None:
        sums = sum(rate[:, k : rate.shape[1] - SIDE + 1 + k] for k in range(SIDE))
        before, after = (np.asarray(sums)[:, part] for part in (slice(-SIDE), slice(SIDE, None)))
        for small, large in ((before, after), (after, before)):
            size = np.linalg.norm(large, axis=0)
            apart = np.linalg.norm(large - SCALE * small, axis=0)
            found = np.flatnonzero((apart < TOLERANCE * size) & (size > SIDE * SMALLEST))
            if len(found):
                first_ns = int(t_ns[found[0] + SIDE])
                if self.first_ns is None or first_ns < self.first_ns:
                    self.first_ns, self.is_larger = first_ns, large is after

    def text(self, largest: str) -> str:
        """Return the sentence on it, if it is found; else an empty one.

        `largest`: the largest rate, with its unit
        """
        if self.first_ns is None:
            return ""
        size = "larger" if self.is_larger else "smaller"
        first, second = Setting("end", f"{self.first_ns - 1}"), Setting("start", f"{self.first_ns}")
        in_degrees = f" and {Setting('rate_unit', 'deg/s')}"
        ways = (
            (first, f"{second}{in_degrees}") if self.is_larger else (f"{first}{in_degrees}", second)
        )
        return (
            f"rates up to {largest} are beyond any gyroscope, and they are 57.3 times {size} from "
            f"t = {self.first_ns} ns on, as if their unit changed there: propagate the parts by "
            f"themselves, with {ways[0]}, and with {ways[1]}"
        )
