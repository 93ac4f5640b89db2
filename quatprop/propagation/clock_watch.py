"""Header timestamps against steady times of recording, from the first sample to the last.

A delay of messages varies, but the times of recording show it then. Where these are steady, what
the timestamps do otherwise is wrong: they go at another speed, or step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark, Setting, quoted
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.readers.clock_difference import Unsteady, unsteady_text
from quatprop.timeline.stamps import are_steady, spread

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64, Int64


BLOCK = 256
"""Samples whose median difference is kept."""

MOST_BLOCKS = 2048
"""Blocks that are kept; of more, every second one."""

FEWEST_BLOCKS = 8

SPEED = 1e-3
"""Smallest difference of speeds: quartz has a tenth of it, a gyroscope's own clock ten times."""

SIGNIFICANT = 10.0
"""Clocks of unequal speed part by so many times as much as their difference scatters."""

STEADY_SHARE = 0.9
"""Share of blocks with steady times of recording."""

SIDE = 20
"""Samples on each side of a step."""

LEAST_STEP, LEAST_STEP_NS = 2.5, 5_000_000
"""Smallest step, in intervals and ns."""

PART = 0.25
"""Largest deviation from a step, as a share of it, of the samples on its sides."""

SHORT, LONG = 0.3, 3.0
"""Intervals between times of recording, in usual ones, around a step."""


class ClockWatch:
    """Compares header timestamps with the times of recording, batch by batch.

    `topic`: of the messages
    """

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._tail = (np.empty(0, np.int64),) * 2
        self._block = (np.empty(0, np.int64),) * 2
        self._blocks: list[tuple[int, int, bool]] = []
        self._stride, self._turn = 1, 0
        self._interval_ns = 0.0
        self._steps, self._largest = 0, (0, 0)
        self._is_over = False

    def add(self, t_ns: Int64, log_ns: Int64) -> None:
        """Add timestamps and times of recording, ns."""
        if self._is_over or not len(t_ns):
            return
        # Relative or unset times have other remarks; differences of these may not fit 64 bits.
        if int(min(t_ns.min(), log_ns.min())) <= 0:
            self._is_over = True
            return
        self._add_steps(*map(np.concatenate, zip(self._tail, (t_ns, log_ns), strict=True)))
        t_ns, log_ns = map(np.concatenate, zip(self._block, (t_ns, log_ns), strict=True))
        whole = len(t_ns) - len(t_ns) % BLOCK
        for begin in range(0, whole, BLOCK):
            part = slice(begin, begin + BLOCK)
            if self._turn % self._stride == 0:
                self._add_block(t_ns[part], log_ns[part])
            self._turn += 1
        self._block = t_ns[whole:], log_ns[whole:]

    def _add_block(self, t_ns: Int64, log_ns: Int64) -> None:
        apart = int(np.sort(t_ns - log_ns)[BLOCK // 2])
        self._blocks.append((int(log_ns[BLOCK // 2]), apart, are_steady(log_ns)))
        if not self._interval_ns:
            self._interval_ns = spread(np.diff(log_ns))[1]
        if len(self._blocks) == 2 * MOST_BLOCKS:
            self._blocks = self._blocks[::2]
            self._stride *= 2

    def _add_steps(self, t_ns: Int64, log_ns: Int64) -> None:
        """Count the places where timestamps step while times of recording go on."""
        self._tail = t_ns[-2 * SIDE :].copy(), log_ns[-2 * SIDE :].copy()
        if len(t_ns) <= 2 * SIDE:
            return
        usual = spread(np.diff(log_ns))[1]
        steps, lapses = np.diff(t_ns), np.diff(log_ns)
        jumps = steps - lapses
        least = max(LEAST_STEP * usual, LEAST_STEP_NS)
        are_sudden = (np.abs(jumps) > least) & (np.abs(lapses - usual) < usual / 2)
        for k in (np.flatnonzero(are_sudden) + 1).tolist():
            if SIDE < k <= len(t_ns) - SIDE and self._is_step(k, t_ns, log_ns, usual):
                self._steps += 1
                if abs(jumps[k - 1]) > abs(self._largest[0]):
                    self._largest = int(jumps[k - 1]), int(t_ns[k])

    def _is_step(self, k: int, t_ns: Int64, log_ns: Int64, usual: float) -> bool:
        around = slice(k - SIDE, k + SIDE)
        lapses = np.diff(log_ns[around])
        if not (SHORT * usual < lapses.min() and lapses.max() < LONG * usual):
            return False
        apart = (t_ns[around] - log_ns[around]).astype(np.float64)
        apart -= apart[SIDE - 1]
        jump = apart[SIDE]
        sides = apart[:SIDE], apart[SIDE:] - jump
        return all(float(np.abs(side).max()) < PART * abs(jump) for side in sides)

    def remarks(self) -> list[Remark]:
        """Return what is found, after the last batch."""
        way = f"use {Setting('clock', 'log')}"
        if self._steps:
            jump, at_ns = self._largest
            side = "ahead" if jump > 0 else "back"
            often = f" (the largest of {self._steps} times)" if self._steps > 1 else ""
            text = (
                f"the header timestamps of topic {quoted(self._topic)} step {side} by "
                f"{duration_text(abs(jump))} before {at_ns} ns{often}, while its log times go on "
                f"steadily: was the clock set? then {way}"
            )
            return [Remark("clock-step", text)]
        speed = self._speed()
        if speed == 1:
            return []
        found = Unsteady(round(self._interval_ns), speed=speed)
        stamps = f"the header timestamps of topic {quoted(self._topic)}"
        return [
            Remark("unlike-log-times", f"{unsteady_text(found, stamps, 'its log times')}, {way}")
        ]

    def _speed(self) -> float:
        """Return how fast timestamps go relative to the times of recording; 1 if as fast."""
        count = len(self._blocks)
        if self._is_over or count < FEWEST_BLOCKS:
            return 1.0
        log_ns, apart, steady = (np.array(each) for each in zip(*self._blocks, strict=True))
        if steady.mean() < STEADY_SHARE or (np.diff(log_ns) <= 0).any():
            return 1.0
        x: Float64 = (log_ns - log_ns[0]) / NS_PER_S
        y: Float64 = (apart - apart[0]) / NS_PER_S
        half = count // 2
        slope = spread((y[half:] - y[: count - half]) / (x[half:] - x[: count - half]))[1]
        rest = y - slope * x
        scatter = float(np.ptp(rest))
        is_other = abs(slope) > SPEED and abs(slope) * x[-1] > SIGNIFICANT * scatter
        return 1.0 + slope if is_other else 1.0
