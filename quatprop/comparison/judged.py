"""The pairs to judge: those in time ranges, such as the phases in which a body moves."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.conditioning.time_range import Ends, absolute_ns
from quatprop.errors import ComparisonError, UsageError
from quatprop.text import Setting
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.arrays import Bool, Int64
    from quatprop.comparison.association import Pairs
    from quatprop.comparison.settings import InstantRange
    from quatprop.series import AttitudeSeries


class Judged(NamedTuple):
    """Which pairs were judged.

    `pairs`: how many
    `ranges_ns`: the first and the last time of each range, ns, in A's clock
    """

    pairs: int
    ranges_ns: tuple[tuple[int, int], ...]

    def contains(self, t_ns: Int64) -> Bool:
        """Tell of times whether they are in a range, ends included, ``(N,)``."""
        inside = [(t_ns >= first) & (t_ns <= last) for first, last in self.ranges_ns]
        return np.asarray(np.any(inside, axis=0))

    def part_of(self, series: AttitudeSeries) -> AttitudeSeries:
        """Return the samples of a series in the ranges."""
        return series[self.contains(series.t_ns)]


def judged(pairs: Pairs, ranges: Sequence[InstantRange]) -> tuple[Pairs, Judged]:
    """Return the pairs in time ranges; relative times count from the first and the last pair."""
    ends = Ends(int(pairs.t_ns[0]), int(pairs.t_ns[-1]))
    ranges_ns = tuple((absolute_ns(one.start, ends), absolute_ns(one.end, ends)) for one in ranges)
    for one, (first, last) in zip(ranges, ranges_ns, strict=True):
        if first > last:
            early = duration_text(first - last)
            raise UsageError(f"{Setting('judge', str(one))} ends {early} before it begins")
    inside = Judged(0, ranges_ns).contains(pairs.t_ns)
    if not inside.any():
        raise ComparisonError(
            f"no pair of attitudes is in the time ranges of {Setting('judge')}; the pairs are from "
            f"{ends.first_ns} to {ends.last_ns} ns"
        )
    columns = {name: getattr(pairs, name)[inside] for name in ("t_ns", "a", "b", "index")}
    return replace(pairs, **columns), Judged(int(inside.sum()), ranges_ns)
