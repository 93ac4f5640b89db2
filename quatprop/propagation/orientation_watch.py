"""The orientation in the messages of the rates, against them from the first sample to the last.

The beginning is compared by :mod:`.orientation_check`; here, what changes later: the axes or the
unit of a driver that was configured anew. Memory is constant, and the cost small: most blocks are
passed by one coarse comparison.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark, Setting
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.quaternion import conjugate, log, multiply, shorter
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.propagation.orientation_check import (
    AGREEING_SAMPLES,
    COMPARED_SAMPLES,
    MOVING,
    SAME_AXES,
    SAME_SCALE,
    against_orientation,
)

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64, Int64


SPAN_NS = 100_000_000
"""Rotations of a block are compared over this time, in which a body hardly turns far."""

FEWEST_STEPS = 4
"""Fewest samples in that time."""

UNIT = 1e-3
"""Largest error of the norm of a quaternion that is compared."""

SKIPPED = 9
"""So many times as many samples are skipped after a disagreement with an excuse."""


class OrientationWatch:
    """Compares rates with the orientation beside them, batch by batch.

    `rates`: ``"body"`` or ``"inertial"``: the frame in which the rates are resolved
    `unit`: their unit in the log
    `start_ns`, `end_ns`: the range that is compared, ns; None: open
    """

    def __init__(self, rates: str, unit: str, start_ns: int | None, end_ns: int | None) -> None:
        self._rates, self._unit = rates, unit
        self._range = start_ns, end_ns
        self._have_agreed = False
        self._waiting: list[tuple[Int64, Float64, Float64]] = []
        self._held: list[tuple[Int64, Float64, Float64]] = []
        self._count = self._skip = 0
        self._remark: Remark | None = None

    def add(self, t_ns: Int64, rate: Float64, wxyz: Float64) -> None:
        """Add samples, rad/s, and the orientation beside each, wxyz."""
        if self._remark is not None:
            return
        inside = np.ones(len(t_ns), np.bool_)
        for limit, is_beyond in zip(self._range, (np.less, np.greater), strict=True):
            if limit is not None:
                inside &= ~is_beyond(t_ns, limit)
        # Copied, since rates are corrected in place.
        self._waiting.append((t_ns[inside], rate[inside], wxyz[inside]))
        self._count += int(inside.sum())
        if self._count >= AGREEING_SAMPLES:
            t_ns, rate, wxyz = map(np.concatenate, zip(*self._waiting, strict=True))
            whole = len(t_ns) - len(t_ns) % AGREEING_SAMPLES
            for begin in range(0, whole, AGREEING_SAMPLES):
                part = slice(begin, begin + AGREEING_SAMPLES)
                self._add_block(t_ns[part], rate[part], wxyz[part])
            self._waiting = [(t_ns[whole:], rate[whole:], wxyz[whole:])]
            self._count = len(t_ns) - whole

    def remarks(self) -> list[Remark]:
        """Return the remark on samples that contradict the orientation, after the last batch."""
        if self._remark is None and self._waiting and not self._skip:
            t_ns, rate, wxyz = map(np.concatenate, zip(*self._waiting, strict=True))
            self._add_block(t_ns, rate, wxyz)
            self._judge()
        self._waiting, self._held, self._count = [], [], 0
        return [] if self._remark is None else [self._remark]

    def _add_block(self, t_ns: Int64, rate: Float64, wxyz: Float64) -> None:
        if self._remark is not None:
            return
        if self._skip:
            self._skip -= 1
        elif self._held or not self._may_agree(t_ns, rate, wxyz):
            self._held.append((t_ns, rate, wxyz))
            if sum(len(t_ns) for t_ns, _, _ in self._held) >= COMPARED_SAMPLES:
                self._judge()

    def _may_agree(self, t_ns: Int64, rate: Float64, wxyz: Float64) -> bool:
        """Return whether a block agrees, or cannot be compared."""
        turns = self._turns(t_ns, rate, wxyz)
        if turns is None:
            return True
        by_rates, by_orientation, span_s = turns
        sizes = [math.sqrt(float((one**2).sum(axis=1).mean())) for one in turns[:2]]
        if max(sizes) <= MOVING * span_s:
            return True
        product = float((by_rates * by_orientation).sum(axis=1).mean())
        is_alike = product > SAME_AXES * sizes[0] * sizes[1]
        is_alike &= sizes[0] / SAME_SCALE < sizes[1] < sizes[0] * SAME_SCALE
        self._have_agreed |= is_alike
        return is_alike

    def _turns(
        self, t_ns: Int64, rate: Float64, wxyz: Float64
    ) -> tuple[Float64, Float64, float] | None:
        """Return rotation vectors by rates and by orientation; None if they are not known."""
        steps = np.diff(t_ns)
        if len(steps) < 2 * FEWEST_STEPS or not (steps > 0).all() or not np.isfinite(rate).all():
            return None
        step = max(round(SPAN_NS / float(np.median(steps))), FEWEST_STEPS)
        at = np.arange(0, len(t_ns), step)
        if len(at) < 2:  # noqa: PLR2004  # no rotation
            return None
        own = wxyz[at]
        if not (np.abs((own**2).sum(axis=1) - 1) < 2 * UNIT).all():
            return None
        turned = rate[:-1] * (steps / NS_PER_S)[:, None]
        by_rates = np.add.reduceat(turned[: at[-1]], at[:-1])
        first, last = own[:-1], own[1:]
        if self._rates == "inertial":
            between = multiply(last, conjugate(first))
        else:
            between = multiply(conjugate(first), last)
        span_s = float(np.median(np.diff(t_ns[at]))) / NS_PER_S
        return by_rates, log(shorter(between)), span_s

    def _judge(self) -> None:
        """Compare what is held as the beginning is compared."""
        if not self._held:
            return
        t_ns, rate, wxyz = map(np.concatenate, zip(*self._held, strict=True))
        good = self._good(t_ns, wxyz)
        self._skip = SKIPPED * len(self._held)
        self._held = []
        if good.all():
            first = self._begin(t_ns, rate, wxyz)
            gyro, own = GyroSeries(t_ns, rate)[first:], AttitudeSeries(t_ns, wxyz)[first:]
            found = against_orientation([gyro], [own], self._rates, self._unit)
            if found is not None:
                begin = int(t_ns[first])
                if self._have_agreed or first:
                    parts = f"{Setting('end', str(begin))} and {Setting('start', str(begin))}"
                    text = (
                        f"rates and orientation agree until about {begin} ns only: propagate both "
                        f"parts by themselves, with {parts}; after that, {found}"
                    )
                    found = Remark("contradicts-later", text)
                self._remark = found

    def _good(self, t_ns: Int64, wxyz: Float64) -> Bool:
        good: Bool = np.abs((wxyz**2).sum(axis=1) - 1) < 2 * UNIT
        good[1:] &= np.diff(t_ns) > 0
        return good

    def _begin(self, t_ns: Int64, rate: Float64, wxyz: Float64) -> int:
        """Return from which row on most rotations differ, and before which few do."""
        turns = self._turns(t_ns, rate, wxyz)
        if turns is None:
            return 0
        by_rates, by_orientation, _ = turns
        apart = np.linalg.norm(by_rates - by_orientation, axis=1)
        size = np.maximum(*(np.linalg.norm(one, axis=1) for one in turns[:2]))
        differ = np.where(apart > size / 2, 1, -1)
        before = int(np.argmin(np.append(0, np.cumsum(differ))))
        return before * (len(t_ns) // len(apart)) if before < len(apart) else 0
