"""Samples that are missing, a few at a time, in intervals too short to count as gaps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark, Setting
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.timeline.stamps import spread

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.propagation.checks.samples import Samples
    from quatprop.timeline.counts import Counts


LEAST_SHARE, MOST = 0.03, 0.5
"""Smallest and largest share of missing samples: of more, the samples come in bursts."""

FEWEST_PLACES = 5
"""Fewest places where samples are missing."""

LEAST_TURN = math.radians(5.0)
"""rad: a body that turns less in all of many places, or in each of a few, is known well enough."""

SHORTEST = 4
"""Shortest interval, in usual ones, in which samples are missing: rounded times have shorter."""

LONGEST = 63
"""Longest one that is counted."""

WHOLE = 0.25
"""Largest deviation of intervals from a whole number of usual ones."""

USUAL, REGULAR = 0.75, 0.95
"""Least shares of usual intervals, and of whole numbers of these, where there is a steady clock."""


class MissingSamples:
    """Counts intervals by their length in usual ones."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._period_ns = 0.0
        self._counts = np.zeros(LONGEST + 1, np.int64)
        self._turns = np.zeros(LONGEST + 1)
        self._largest = np.zeros(LONGEST + 1)
        self._intervals = 0

    def add(self, samples: Samples) -> None:
        """Add samples that follow the ones before."""
        t_ns, columns = samples.t_ns, samples.columns
        if not len(t_ns):
            return
        intervals = np.diff(t_ns) if self._last_ns is None else np.diff(t_ns, prepend=self._last_ns)
        self._last_ns = int(t_ns[-1])
        if not len(intervals):
            return
        if not self._period_ns:
            self._period_ns = spread(intervals)[1]
        if self._period_ns <= 0:
            return
        self._intervals += len(intervals)
        # Fast exit: nearly all blocks have usual intervals only.
        extremes = np.array([intervals.min(), intervals.max()]) / self._period_ns
        if (np.abs(extremes - 1) < WHOLE).all():
            self._counts[1] += len(intervals)
            return
        ratio = intervals / self._period_ns
        number = np.rint(ratio)
        good = (np.abs(ratio - number) < WHOLE) & (number >= 1) & (number <= LONGEST)
        which = number[good].astype(np.int64)
        self._counts += np.bincount(which, minlength=LONGEST + 1)
        places = np.flatnonzero(good & (number >= SHORTEST))
        if len(places):
            # The rate at the end of each, which is in the same samples.
            speed = np.linalg.norm(columns[:, places + len(t_ns) - len(intervals)], axis=0)
            turns = np.nan_to_num(speed) * intervals[places] / NS_PER_S
            np.add.at(self._turns, number[places].astype(np.int64), turns)
            np.maximum.at(self._largest, number[places].astype(np.int64), turns)

    def remarks(self, counts: Counts) -> Iterator[Remark]:
        """Yield a remark on samples that are missing in intervals that are no gaps."""
        limit_ns = counts.gap_limit_ns
        if limit_ns is None or not self._period_ns:
            return
        numbers = np.arange(LONGEST + 1)
        are_short = (numbers >= SHORTEST) & (numbers * self._period_ns <= limit_ns)
        places = int(self._counts[are_short].sum())
        missing = int(((numbers - 1) * self._counts)[are_short].sum())
        turn = float(self._turns[are_short].sum())
        is_regular = self._counts.sum() >= REGULAR * self._intervals
        is_usual = self._counts[1] > USUAL * self._intervals
        share = missing / max(missing + counts.samples_used, 1)
        are_many = places >= FEWEST_PLACES and turn >= LEAST_TURN and share >= LEAST_SHARE
        # In a log without any smaller irregularity, the clock may have been set.
        is_large = float(self._largest[are_short].max(initial=0.0)) >= LEAST_TURN
        is_large &= not self._counts[2:SHORTEST].any()
        if is_regular and is_usual and (are_many or is_large) and share <= MOST:
            most = int(numbers[are_short & (self._counts > 0)].max()) - 1
            limit = f"{(SHORTEST - 0.5) * self._period_ns / NS_PER_S:.3g}"
            yield Remark(
                "missing-samples",
                f"about {100 * share:.2g} % of the samples are missing: {missing} in {places} "
                f"place{'s' * (places > 1)}, up to {most} in a row, in which the body turns by "
                f"about {math.degrees(turn):.3g} deg if it went on as before, and not at all if "
                "only the clock was set there; no interval up to "
                f"{duration_text(limit_ns)} counts as a gap: to have these counted, use "
                f"{Setting('max_gap', limit)}",
            )
