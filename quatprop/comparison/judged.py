"""What is compared: a part of both series, at a rate, and the pairs in given time ranges."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.conditioning import GyroCorrection
from quatprop.conditioning.time_range import (
    Ends,
    EndsFinder,
    absolute_ns,
    absolute_range,
    clipped,
    idle_remarks,
    pause_remarks,
)
from quatprop.errors import ComparisonError, UsageError
from quatprop.logs.resampling import Resampling
from quatprop.series import AttitudeSeries
from quatprop.text import Setting
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from fractions import Fraction

    from quatprop.arrays import Bool, Int64
    from quatprop.comparison.association import Pairs
    from quatprop.comparison.settings import ComparisonSettings, InstantRange
    from quatprop.text import Remark


class Judged(NamedTuple):
    """The pairs that were judged.

    `pairs`: number of pairs
    `ranges_ns`: start and end of each time range, ns, in A's clock
    """

    pairs: int
    ranges_ns: tuple[tuple[int, int], ...]

    def contains(self, t_ns: Int64) -> Bool:
        """Return which times are in a range, ends included, shape ``(N,)``."""
        inside = [(t_ns >= first) & (t_ns <= last) for first, last in self.ranges_ns]
        return np.asarray(np.any(inside, axis=0))

    def part_of(self, series: AttitudeSeries) -> AttitudeSeries:
        """Return the samples of a series in the ranges."""
        return series[self.contains(series.t_ns)]


def judged(pairs: Pairs, ranges: Sequence[InstantRange]) -> tuple[Pairs, Judged]:
    """Return the pairs in time ranges; relative times count from the first or last pair."""
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


class ComparedRange:
    """The part of both series that is compared; relative times count from the ends of A.

    `left_out`: number of attitudes before and after it so far
    """

    def __init__(self, settings: ComparisonSettings, a: AttitudeSeries) -> None:
        self._part = GyroCorrection(start=settings.start, end=settings.end)
        finder = EndsFinder()
        finder.add(a.t_ns)
        self._ends = finder.ends()
        self._range_ns = absolute_range(self._part, self._ends)
        self.left_out = [0, 0]

    def of(self, series: AttitudeSeries, name: str) -> AttitudeSeries:
        """Return the part of a series with timestamps in A's clock; `name`: for errors."""
        numbered = [(series, series.t_ns)]
        for part, _ in clipped(numbered, self._part, *self._range_ns, self.left_out):
            return part
        raise ComparisonError(
            f"{name} has no attitude in the time range; it is from {series.t_ns[0]} to "
            f"{series.t_ns[-1]} ns in A's clock"
        )

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks, once both series were cut."""
        yield from pause_remarks(self._part, self._ends)
        yield from idle_remarks(self._part, *self.left_out)


def resampled(
    a: AttitudeSeries, rate: Fraction, remarks: list[Remark]
) -> tuple[AttitudeSeries, float]:
    """Return A interpolated at a rate, Hz, and its interpolation error, rad; add remarks."""
    resampling = Resampling("A", rate)
    interpolated = AttitudeSeries.joined(list(resampling.applied([a])))
    remarks += resampling.remarks()
    return interpolated, resampling.floor_rad
