"""Pairs of attitudes at equal times: association, and the ranges that are evaluated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from quatprop.base.errors import ComparisonError, UsageError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_UNIT, duration_text
from quatprop.kinematics.resample import interpolate
from quatprop.kinematics.series import AttitudeSeries
from quatprop.propagation.attitude_input import Resampling
from quatprop.settings.reading import GyroCorrection
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.timeline.time_range import Ends, EndsFinder, TimeRange, absolute_ns

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from quatprop.base.arrays import Bool, Float64, Int64, Intp
    from quatprop.base.text import Remark
    from quatprop.settings.command_options import ComparisonSettings, InstantRange


MIN_PAIRS = 2
"""Minimum number of pairs, unless both series have one attitude."""

FAR = np.iinfo(np.int64).max
"""The median interval of a series with one sample, ns."""


@dataclass(frozen=True, slots=True)
class Pairs:
    """Attitudes of A and B at the same times.

    `t_ns`: shape ``(N,)``, int64 ns, in A's clock
    `a`, `b`: attitudes body -> reference, wxyz, shape ``(N, 4)``
    `index`: indices of the samples with these timestamps, shape ``(N,)``, int64
    `at`: the series of these samples: ``"A"`` or ``"B"``
    `match`: one of :data:`quatprop.settings.command_options.MATCHES`
    `max_dt_ns`: maximum distance of a sample from its partner, ns; 0 for equal timestamps
    `candidates`: maximum possible number of pairs: samples in the common time of the series that
        has fewer there
    `interpolation_error_rad`: error that may come from interpolation between samples, rad
    """

    t_ns: Int64
    a: Float64
    b: Float64
    index: Int64
    at: str
    match: str
    max_dt_ns: int
    candidates: int
    interpolation_error_rad: float = 0.0

    def __len__(self) -> int:
        return len(self.t_ns)


class Matching(NamedTuple):
    """How the attitudes were matched in time.

    `match`: ``"exact"`` for equal timestamps, ``"nearest"`` or ``"interpolate"``
    `at`: the series whose timestamps the pairs have: ``"A"`` or ``"B"``
    `max_dt_ns`: maximum distance of a sample from its partner, ns; 0 for equal timestamps
    `matched`: number of matched pairs
    `candidates`: maximum possible number of pairs: samples in the common time of the series that
        has fewer there
    `first_ns`: time of the first pair, ns; 0 without pairs
    `last_ns`: time of the last pair, ns; 0 without pairs
    `rate_hz`: the rate to which A was interpolated, Hz; None if it was not
    """

    match: str
    at: str
    max_dt_ns: int
    matched: int
    candidates: int
    first_ns: int
    last_ns: int
    rate_hz: float | None = None

    @classmethod
    def from_pairs(cls, pairs: Pairs) -> Self:
        """Return the facts about pairs."""
        ends = (int(pairs.t_ns[0]), int(pairs.t_ns[-1])) if len(pairs) else (0, 0)
        return cls(pairs.match, pairs.at, pairs.max_dt_ns, len(pairs), pairs.candidates, *ends)


def associate(a: AttitudeSeries, b: AttitudeSeries, settings: ComparisonSettings) -> Pairs:
    """Match two series in time.

    The pairs have the timestamps of the series with the longer intervals; the other one is looked
    up or interpolated there.
    """
    match = settings.match if settings.rate is None else "interpolate"
    if match in {None, "exact"}:
        pairs = _exact(a, b)
        if match is None and not is_mostly_exact(len(pairs), pairs.candidates):
            match = "interpolate" if settings.max_dt is None else "nearest"
    if match not in {None, "exact"}:
        pairs = _near(a, b, str(match), settings)
    spans = [(int(series.t_ns[0]), int(series.t_ns[-1])) for series in (a, b)]
    require_enough(Matching.from_pairs(pairs), spans, settings)
    return pairs


def is_mostly_exact(matched: int, candidates: int) -> bool:
    """Return whether at least half of the candidates have equal timestamps."""
    return 2 * matched >= max(candidates, 1)


def _near(a: AttitudeSeries, b: AttitudeSeries, match: str, settings: ComparisonSettings) -> Pairs:
    # With a rate, A is resampled already.
    at = "B" if settings.rate is None and interval_ns(b) > interval_ns(a) else "A"
    max_dt_ns = settings.max_dt
    sparse, dense = (b, a) if at == "B" else (a, b)
    if max_dt_ns is None:
        interval = interval_ns(dense)
        reach = GAP_FACTOR * interval if match == "interpolate" else (interval + 1) // 2
        max_dt_ns = 0 if interval == FAR else reach
    interpolation_error_rad = 0.0
    if match == "nearest":
        index, looked_up = _nearest(dense, sparse.t_ns, max_dt_ns)
    else:
        index = _surrounded(dense, sparse.t_ns, max_dt_ns)
        looked_up, interpolation_error_rad = interpolate(dense, sparse.t_ns[index])
    kept = sparse.wxyz[index]
    both = (kept, looked_up) if at == "A" else (looked_up, kept)
    # A sample just outside the common time can have a partner, too.
    candidates = max(_candidates(a, b), len(index))
    return Pairs(
        sparse.t_ns[index], *both, index, at, match, max_dt_ns, candidates, interpolation_error_rad
    )


def interval_ns(series: AttitudeSeries) -> int:
    """Return the median interval of a series, ns; :data:`FAR` if it has one sample."""
    if len(series) < MIN_PAIRS:
        return FAR
    return int(np.median(np.diff(series.t_ns)))


def shifted(series: AttitudeSeries, offset_ns: int | Int64) -> AttitudeSeries:
    """Return the series with an offset added to its timestamps, ns."""
    return replace(series, t_ns=series.t_ns + offset_ns)


def _exact(a: AttitudeSeries, b: AttitudeSeries) -> Pairs:
    in_a, in_b = equal_stamps(a.t_ns, b.t_ns)
    pairs = a.t_ns[in_a], a.wxyz[in_a], b.wxyz[in_b], np.arange(len(a))[in_a]
    return Pairs(*pairs, "A", "exact", 0, _candidates(a, b))


def equal_stamps(a: Int64, b: Int64) -> tuple[Intp | slice, Intp | slice]:
    """Return the indices of equal timestamps in each of two rising series."""
    if np.array_equal(a, b):
        return slice(None), slice(None)  # the common case, without a search or a copy
    place = np.minimum(np.searchsorted(b, a), len(b) - 1)
    (in_a,) = np.nonzero(b[place] == a)
    return in_a, place[in_a]


def _candidates(a: AttitudeSeries, b: AttitudeSeries) -> int:
    """Return the number of samples in the common time, of the series with fewer of them."""
    start, stop = max(a.t_ns[0], b.t_ns[0]), min(a.t_ns[-1], b.t_ns[-1])
    return min(
        int(np.searchsorted(s.t_ns, stop, "right") - np.searchsorted(s.t_ns, start)) for s in (a, b)
    )


def _nearest(dense: AttitudeSeries, t_ns: Int64, max_dt_ns: int) -> tuple[Int64, Float64]:
    """Return the indices of times with a sample within reach, and these samples."""
    after = np.clip(np.searchsorted(dense.t_ns, t_ns), 0, len(dense) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(dense.t_ns[before] - t_ns) <= np.abs(dense.t_ns[after] - t_ns)
    nearest = np.where(nearer, before, after)
    (index,) = np.nonzero(np.abs(dense.t_ns[nearest] - t_ns) <= max_dt_ns)
    return index, dense.wxyz[nearest[index]]


def _surrounded(dense: AttitudeSeries, t_ns: Int64, max_dt_ns: int) -> Intp:
    """Return the indices of times with samples within reach on both sides."""
    if len(dense) < MIN_PAIRS:
        return np.empty(0, np.intp)
    before = np.clip(np.searchsorted(dense.t_ns, t_ns, side="right") - 1, 0, len(dense) - 1)
    after = np.minimum(np.searchsorted(dense.t_ns, t_ns, side="left"), len(dense) - 1)
    behind, ahead = t_ns - dense.t_ns[before], dense.t_ns[after] - t_ns
    inside = (behind >= 0) & (ahead >= 0)
    (index,) = np.nonzero(inside & (behind <= max_dt_ns) & (ahead <= max_dt_ns))
    return index


UNIT_RATIOS = (10**3, 10**6, 10**9)
"""Ratios of the units of times."""

SAME_SPAN = 2.0
"""Maximum ratio of the lengths of series that differ only in the unit of their times."""

FAR_AWAY = 10
"""Times that are larger than this many lengths of the series count from another event."""


class OtherUnitError(ComparisonError):
    """The times of A and B do not meet, but would in another unit.

    `before`: the sentence so far
    `smaller`: the series with the smaller numbers: ``"a"`` or ``"b"``
    `ratio`: by which they are smaller
    """

    def __init__(self, before: str, smaller: str, ratio: int) -> None:
        self.smaller, self.ratio = smaller, ratio
        self.larger = "ab".replace(smaller, "")
        self._before = (
            f"{before}: the times of {smaller.upper()} are {ratio:,} times smaller than those of "
            f"{self.larger.upper()}, so the unit of one of them seems to be wrong"
        )
        super().__init__(f"{self._before}; multiply or divide its times by {ratio:,}")

    def for_files(self, units: Mapping[str, str]) -> ComparisonError:
        """Return the error with the settings that mend it.

        `units`: the units in which the times of A and of B were read; empty if they have their own
        """
        ways = []
        for side, factor in ((self.smaller, self.ratio), (self.larger, Fraction(1, self.ratio))):
            wanted = factor * NS_PER_UNIT.get(units[side], 0)
            ways += [
                f"if {side.upper()} has times in {unit}, read it with "
                f"{Setting('time_unit', unit, side)}"
                for unit in ("ns", "us", "ms", "s")
                if NS_PER_UNIT[unit] == wanted
            ]
        return ComparisonError(f"{self._before}; {'; '.join(ways)}") if ways else self


def refuse_other_unit(before: str, a: tuple[int, int], b: tuple[int, int]) -> None:
    """Raise an error if series would have about the same times in another unit.

    `before`: the beginning of the sentence, on their times
    `a`, `b`: first and last timestamp of A, and of B, ns
    """
    for smaller, small, large in (("a", a, b), ("b", b, a)):
        for ratio in UNIT_RATIOS:
            first, last = (ratio * time for time in small)
            spans = last - first, large[1] - large[0]
            common = min(last, large[1]) - max(first, large[0])
            # Times that count from far away do not meet by chance; others begin near to zero.
            are_dates = min(first, large[0]) > FAR_AWAY * max(spans)
            if common > 0 and (are_dates or max(spans) <= SAME_SPAN * min(spans)):
                raise OtherUnitError(before, smaller, ratio)


def require_enough(
    matching: Matching, spans_ns: Sequence[tuple[int, int]], settings: ComparisonSettings
) -> None:
    """Raise an error if there are too few pairs.

    `spans_ns`: first and last timestamp of A, and of B, ns
    """
    single = all(first == last for first, last in spans_ns) and settings.align == "none"
    least = 1 if single else MIN_PAIRS
    needed = max(least, int(np.ceil(settings.min_matched / 100 * matching.candidates)))
    if matching.matched >= needed:
        return
    a, b = (f"{first} to {last} ns" for first, last in spans_ns)
    spans, way = f"(A: {a}, B: {b})", f"see {Setting('time_offset')}"
    common = "hardly any" if matching.candidates else "no"
    refuse_other_unit(f"A and B have {common} time in common {spans}", spans_ns[0], spans_ns[1])
    if not matching.candidates and max(spans_ns)[0] <= min(last for _, last in spans_ns):
        raise ComparisonError(
            f"one of them has no sample in the time that both cover {spans}; {way}"
        )
    if not matching.candidates:
        if settings.time_offset != "auto":
            apart_ns = int(settings.time_offset) + spans_ns[0][0] - spans_ns[1][0]
            offset = Setting("time_offset", f"{apart_ns}ns")
            way = f"if they begin at the same moment, give {offset}"
        raise ComparisonError(f"A and B have no time in common {spans}; {way}")
    within = f" within {duration_text(matching.max_dt_ns)}" if matching.max_dt_ns else ""
    raise ComparisonError(
        f"only {matching.matched} of {matching.candidates} samples in the common time have a "
        f"partner ({matching.match}{within}) and at least {needed} must {spans}; {way}, "
        f"{Setting('match')}, {Setting('max_dt')} and {Setting('min_matched')}"
    )


# The compared samples: a part of both series, at a rate, and the pairs in given time ranges.


class JudgedPairs(NamedTuple):
    """The pairs that were judged.

    `pairs`: number of judged pairs
    `ranges_ns`: start and end of each time range, ns, in A's clock
    """

    pairs: int
    ranges_ns: tuple[tuple[int, int], ...]

    def contains(self, t_ns: Int64) -> Bool:
        """Return which times are in a range, ends included, shape ``(N,)``."""
        inside = [(t_ns >= first) & (t_ns <= last) for first, last in self.ranges_ns]
        return np.asarray(np.any(inside, axis=0))

    def judged_samples(self, series: AttitudeSeries) -> AttitudeSeries:
        """Return the samples of a series in the ranges."""
        return series[self.contains(series.t_ns)]


def judged_pairs(pairs: Pairs, ranges: Sequence[InstantRange]) -> tuple[Pairs, JudgedPairs]:
    """Return the pairs in time ranges; relative times count from the first or last pair."""
    ends = Ends(int(pairs.t_ns[0]), int(pairs.t_ns[-1]))
    ranges_ns = tuple((absolute_ns(one.start, ends), absolute_ns(one.end, ends)) for one in ranges)
    for one, (first, last) in zip(ranges, ranges_ns, strict=True):
        if first > last:
            early = duration_text(first - last)
            raise UsageError(f"{Setting('judge', str(one))} ends {early} before it begins")
    inside = JudgedPairs(0, ranges_ns).contains(pairs.t_ns)
    if not inside.any():
        raise ComparisonError(
            f"no pair of attitudes is in the time ranges of {Setting('judge')}; the pairs are from "
            f"{ends.first_ns} to {ends.last_ns} ns"
        )
    columns = {name: getattr(pairs, name)[inside] for name in ("t_ns", "a", "b", "index")}
    return replace(pairs, **columns), JudgedPairs(int(inside.sum()), ranges_ns)


class ComparedRange:
    """The part of both series that is compared; relative times count from the ends of A."""

    def __init__(self, settings: ComparisonSettings, a: AttitudeSeries) -> None:
        finder = EndsFinder()
        finder.add(a.t_ns)
        self._range = TimeRange(
            GyroCorrection(start=settings.start, end=settings.end), finder.ends()
        )

    def cut(self, series: AttitudeSeries, name: str) -> AttitudeSeries:
        """Return the part of a series with timestamps in A's clock; `name`: for errors."""
        numbered = [(series, series.t_ns)]
        for part, _ in self._range.apply(numbered):
            return part
        raise ComparisonError(
            f"{name} has no attitude in the time range; it is from {series.t_ns[0]} to "
            f"{series.t_ns[-1]} ns in A's clock"
        )

    @property
    def outside_range(self) -> int:
        """Number of attitudes outside of it, once both series were cut."""
        return sum(self._range.outside)

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks, once both series were cut."""
        return self._range.remarks()


def resampled(
    a: AttitudeSeries, rate: Fraction, remarks: list[Remark]
) -> tuple[AttitudeSeries, float]:
    """Return A interpolated at a rate, Hz, and its interpolation error, rad; add remarks."""
    resampling = Resampling("A", rate)
    interpolated = AttitudeSeries.joined(list(resampling.applied([a])))
    remarks += resampling.remarks()
    return interpolated, resampling.interpolation_error_rad
