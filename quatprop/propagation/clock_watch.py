"""Header timestamps against the times of recording, from the first sample to the last.

A delay of messages varies, but the times of recording show it then. Where these are steady, what
the timestamps do otherwise is wrong: they go at another speed, or step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark, Setting, quoted
from quatprop.base.times import duration_text, open_range
from quatprop.readers.clock_difference import unlike_speed, unsteady_text
from quatprop.timeline.stamps import spread

if TYPE_CHECKING:
    from quatprop.base.arrays import Int64
    from quatprop.readers.tables.model import RowBatch


CHUNK = 32_768
"""Samples that are looked at together, wherever batches end."""

BLOCK = 16
"""Of so many samples, the one with the least delay is kept."""

MOST_KEPT = 8192
"""Samples that are kept; of more, one of two."""

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
    `start_ns`, `end_ns`: the range in which steps are said, ns; None: open
    """

    def __init__(self, topic: str, start_ns: int | None = None, end_ns: int | None = None) -> None:
        self._topic = topic
        self._range = open_range(start_ns, end_ns)
        self._waiting: list[tuple[Int64, Int64]] = []
        self._count = 0
        self._tail = (np.empty(0, np.int64),) * 2
        self._kept: list[tuple[Int64, Int64]] = []
        self._usual = 0.0
        self._steps, self._largest = 0, (0, 0)
        self._is_over = False

    def add_rows(self, rows: RowBatch) -> None:
        """Add rows whose first values are timestamps."""
        self.add(rows.values[0], rows.log_ns)

    def add(self, t_ns: Int64, log_ns: Int64) -> None:
        """Add timestamps and times of recording, ns."""
        if not t_ns.all():
            t_ns, log_ns = t_ns[t_ns != 0], log_ns[t_ns != 0]  # unset
        if self._is_over or not len(t_ns):
            return
        # Differences of other times may not fit 64 bits.
        if int(min(t_ns.min(), log_ns.min())) < 0:
            self._is_over = True
            return
        self._waiting.append((t_ns, log_ns))
        self._count += len(t_ns)
        if self._count >= CHUNK:
            t_ns, log_ns = map(np.concatenate, zip(*self._waiting, strict=True))
            while len(t_ns) >= CHUNK:
                self._look(t_ns[:CHUNK], log_ns[:CHUNK], BLOCK)
                t_ns, log_ns = t_ns[CHUNK:], log_ns[CHUNK:]
            self._waiting, self._count = [(t_ns, log_ns)], len(t_ns)

    def _look(self, t_ns: Int64, log_ns: Int64, block: int) -> None:
        """Look for steps, and keep the samples with the least delays."""
        self._add_steps(*map(np.concatenate, zip(self._tail, (t_ns, log_ns), strict=True)))
        self._keep(t_ns, log_ns, block)
        if sum(len(t_ns) for t_ns, _ in self._kept) > MOST_KEPT:
            t_ns, log_ns = map(np.concatenate, zip(*self._kept, strict=True))
            self._kept = []
            self._keep(t_ns, log_ns, 2)

    def _keep(self, t_ns: Int64, log_ns: Int64, block: int) -> None:
        starts = np.arange(0, len(t_ns) - block + 1, block)
        delays = (log_ns - t_ns)[: len(starts) * block].reshape(-1, block)
        least = starts + delays.argmin(axis=1)
        self._kept.append((t_ns[least], log_ns[least]))

    def _add_steps(self, t_ns: Int64, log_ns: Int64) -> None:
        """Count the places where timestamps step while times of recording go on."""
        self._tail = t_ns[-2 * SIDE :].copy(), log_ns[-2 * SIDE :].copy()
        if len(t_ns) <= 2 * SIDE:
            return
        usual = self._usual = self._usual or spread(np.diff(log_ns))[1]
        least = max(LEAST_STEP * usual, LEAST_STEP_NS)
        jumps = np.diff(t_ns - log_ns)
        for k in (np.flatnonzero(np.abs(jumps) > least) + 1).tolist():
            is_sudden = abs(int(log_ns[k] - log_ns[k - 1]) - usual) < usual / 2
            is_inside = SIDE < k <= len(t_ns) - SIDE
            is_inside &= self._range[0] < int(t_ns[k]) <= self._range[1]
            if is_inside and is_sudden and self._is_step(k, t_ns, log_ns, usual):
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

    def remarks(self, *, of_all: bool = True) -> list[Remark]:
        """Return what is found, after the last batch.

        `of_all`: whether all of the log was seen, which tells of speeds
        """
        if self._is_over:
            return []
        if self._count:
            t_ns, log_ns = map(np.concatenate, zip(*self._waiting, strict=True))
            # Of a short log, most samples are compared.
            self._look(t_ns, log_ns, BLOCK if self._kept else 1 + len(t_ns) // (CHUNK // BLOCK))
            self._waiting, self._count = [], 0
        way = f"use {Setting('clock', 'log')}"
        stamps = f"the header timestamps of topic {quoted(self._topic)}"
        if self._steps:
            jump, at_ns = self._largest
            side = "ahead" if jump > 0 else "back"
            often = f" (the largest of {self._steps} times)" if self._steps > 1 else ""
            text = (
                f"{stamps} step {side} by {duration_text(abs(jump))} before {at_ns} ns{often}, "
                f"while its log times go on steadily: was the clock set? then {way}"
            )
            return [Remark("clock-step", text)]
        if not (self._kept and of_all):
            return []
        found = unlike_speed(*map(np.concatenate, zip(*self._kept, strict=True)))
        if found is None:
            return []
        text = f"{unsteady_text(found, stamps, 'its log times')}, {way}"
        return [Remark("unlike-log-times", text)]
