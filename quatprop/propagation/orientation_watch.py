"""The orientation in the messages of the rates, against them from the first sample to the last.

The beginning is compared by :mod:`.orientation_check`; here, what changes later: the axes or the
unit of a driver that was configured anew. Memory is constant, and the cost small: most blocks are
passed by one coarse comparison.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark, Setting
from quatprop.base.times import NS_PER_S, open_range
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
from quatprop.timeline.stamps import spread

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64, Int64


SPAN_NS = 100_000_000
"""Rotations of a block are compared over this time, in which a body hardly turns far."""

FEWEST_STEPS = 4
"""Fewest samples in that time."""

CHUNK = 8 * AGREEING_SAMPLES
"""Samples that are looked at together."""

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
        self._range = open_range(start_ns, end_ns)
        self._have_agreed = False
        self._waiting: list[tuple[Int64, Float64, Float64]] = []
        self._held: list[tuple[Int64, Float64, Float64]] = []
        self._count = self._skip = 0
        self._remark: Remark | None = None

    def add(self, t_ns: Int64, rate: Float64, wxyz: Float64) -> None:
        """Add samples, rad/s, and the orientation beside each, wxyz."""
        if self._remark is not None:
            return
        start, end = self._range
        inside = (t_ns >= start) & (t_ns <= end)
        part = slice(None) if inside.all() else inside
        # Copied, since rates are corrected in place.
        self._waiting.append((t_ns[part], rate[part].copy(), wxyz[part]))
        self._count += len(self._waiting[-1][0])
        if self._count >= CHUNK:
            self._look(at_end=False)

    def remarks(self) -> list[Remark]:
        """Return the remark on samples that contradict the orientation, after the last batch."""
        if self._remark is None and self._waiting:
            self._look(at_end=True)
            self._judge()
        self._waiting, self._held, self._count = [], [], 0
        return [] if self._remark is None else [self._remark]

    def _look(self, *, at_end: bool) -> None:
        """Look at whole blocks of what is waiting, or at all of it."""
        t_ns, rate, wxyz = map(np.concatenate, zip(*self._waiting, strict=True))
        whole = len(t_ns) if at_end else len(t_ns) - len(t_ns) % AGREEING_SAMPLES
        self._waiting = [(t_ns[whole:], rate[whole:], wxyz[whole:])]
        self._count = len(t_ns) - whole
        agree, contradict = self._compare(t_ns[:whole], rate[:whole], wxyz[:whole])
        for k, begin in enumerate(range(0, whole, AGREEING_SAMPLES)):
            if self._skip:
                self._skip -= 1
            elif self._remark is None and (self._held or contradict[k]):
                part = slice(begin, min(begin + AGREEING_SAMPLES, whole))
                self._held.append((t_ns[part], rate[part], wxyz[part]))
                if sum(len(t_ns) for t_ns, _, _ in self._held) >= COMPARED_SAMPLES:
                    self._judge()
            else:
                self._have_agreed |= bool(agree[k])

    def _compare(self, t_ns: Int64, rate: Float64, wxyz: Float64) -> tuple[Bool, Bool]:
        """Return which blocks of some samples agree, and which contradict each other."""
        agree, contradict = np.zeros((2, -(-len(t_ns) // AGREEING_SAMPLES)), np.bool_)
        turns = self._turns(t_ns, rate, wxyz)
        if turns is None:
            return agree, contradict
        by_rates, by_orientation, step, span_s = turns
        block = np.arange(len(by_rates)) * step // AGREEING_SAMPLES
        count = np.maximum(np.bincount(block), 1)
        sizes = [
            np.sqrt(np.bincount(block, (one**2).sum(axis=1)) / count)
            for one in (by_rates, by_orientation)
        ]
        product = np.bincount(block, (by_rates * by_orientation).sum(axis=1)) / count
        is_alike = product > SAME_AXES * sizes[0] * sizes[1]
        is_alike &= (sizes[0] < sizes[1] * SAME_SCALE) & (sizes[1] < sizes[0] * SAME_SCALE)
        moves = np.maximum(*sizes) > MOVING * span_s
        agree[: len(count)] = moves & is_alike
        contradict[: len(count)] = moves & ~is_alike
        return agree, contradict

    def _turns(
        self, t_ns: Int64, rate: Float64, wxyz: Float64
    ) -> tuple[Float64, Float64, int, float] | None:
        """Return rotation vectors by rates and by orientation, samples in each, and its time, s.

        None if there are too few samples. Vectors that are not known are zero.
        """
        steps = np.diff(t_ns)
        if len(steps) < 2 * FEWEST_STEPS or (usual := spread(steps)[1]) <= 0:
            return None
        step = max(round(SPAN_NS / usual), FEWEST_STEPS)
        count = len(steps) // step
        if not count:
            return None
        whole = count * step
        own = wxyz[: whole + 1 : step]
        turned = (steps[:whole] / NS_PER_S).reshape(count, step)
        by_rates = np.einsum("ks,ksi->ki", turned, rate[:whole].reshape(count, step, 3))
        first, last = own[:-1], own[1:]
        if self._rates == "inertial":
            between = multiply(last, conjugate(first))
        else:
            between = multiply(conjugate(first), last)
        is_unit = np.abs((own**2).sum(axis=1) - 1) < 2 * UNIT
        known = is_unit[:-1] & is_unit[1:] & np.isfinite(by_rates).all(axis=1)
        if (is_back := steps[:whole] <= 0).any():
            known[np.flatnonzero(is_back) // step] = False
        by_orientation = log(shorter(between))
        by_rates[~known] = by_orientation[~known] = 0.0
        return by_rates, by_orientation, step, step * usual / NS_PER_S

    def _judge(self) -> None:
        """Compare what is held as the beginning is compared."""
        if not self._held:
            return
        t_ns, rate, wxyz = map(np.concatenate, zip(*self._held, strict=True))
        good = np.abs((wxyz**2).sum(axis=1) - 1) < 2 * UNIT
        good[1:] &= np.diff(t_ns) > 0
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

    def _begin(self, t_ns: Int64, rate: Float64, wxyz: Float64) -> int:
        """Return from which row on most rotations differ, and before which few do."""
        turns = self._turns(t_ns, rate, wxyz)
        if turns is None:
            return 0
        by_rates, by_orientation, step, _ = turns
        apart = np.linalg.norm(by_rates - by_orientation, axis=1)
        size = np.maximum(*(np.linalg.norm(one, axis=1) for one in turns[:2]))
        differ = np.where(apart > size / 2, 1, -1)
        before = int(np.argmin(np.append(0, np.cumsum(differ))))
        return before * step if before < len(apart) else 0
