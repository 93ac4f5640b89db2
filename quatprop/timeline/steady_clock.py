"""The steady clock that time stamps jitter about, as times of arrival and rounded stamps do.

The stamps of one stretch, without a pause in it, are numbered: late samples are told from missing
ones by the medians of short windows, since a late sample is followed by others in time. A line
through them, robust against late ones, is the clock. Whether there is one shows in what is left:
jitter comes and goes from sample to sample, neither drifts nor repeats, and the rates do not
follow it.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64, Int64

SHORTEST = 256
"""Fewer samples without a pause do not show a clock."""

PAUSE = 10
"""Intervals longer than so many usual ones are pauses: the clock may have been set anew."""

MOST_MISSING = 0.05
"""Share of the samples that may be missing of a steady clock."""

_STEADY = 2e-3
"""Neighbouring intervals that differ by less than this share need no clock."""

_WINDOW = 15
"""Samples, an odd number, whose median tells late samples from missing ones."""

_ENDS = 5
"""The same at the first and the last samples."""

_HELD_UP = 8
"""Samples are late, not missing before, where within so many windows others are in time again."""

_CLEAR = 0.3
"""Intervals that a median may be off a whole number of them."""

_SHARP = 0.35
"""Nothing arrives early: residuals end sharply below if the lowest tenth is this dense, which for
the lower half is 1."""

_PARTS = 16
_SLOW = 0.5
"""The medians of so many parts of the residuals scatter less than this share of the residuals."""

_SMOOTH = 0.2
"""Neighbouring residuals differ by at least this share of the variance that independent ones do."""

_PATTERN = 8
_REPEATED = 0.4
"""Residuals that repeat after so many samples or fewer have this share of the variance."""

_TONE = 0.8
"""Those that swing at one frequency have this share of it. A sawtooth, as of polling, has 0.61."""

_ROUNDED = 0.35
"""Ticks by which rounding errors scatter at most; 0.29 where they are evenly distributed."""

_FOLLOWED = 0.9
"""Rates that are this much closer to a straight line between their neighbours, by their squares,
were taken at their stamps."""

DRIFTS: Final = (
    "the deviations from the best one change slowly, as if a clock drifts or its rate changes"
)
REPEATS: Final = "the deviations repeat"
UNCLEAR: Final = "they are too irregular to distinguish late samples from missing ones"
MISSING: Final = f"more than {MOST_MISSING:.0%} of the samples would be missing"
REASONS: Final = ("", REPEATS, DRIFTS, MISSING, UNCLEAR)
"""Why there is no clock, the better estimates of the interval first."""

FOLLOWED: Final = (
    "the rates change in step with the timestamps: the samples were taken at those times"
)


class FittedClock(NamedTuple):
    """What the stamps of a stretch show.

    `period_ns`: interval of the steady clock, ns
    `t_ns`: the times of the samples by it, shape ``(N,)``, int64
    `missing`: intervals of it without a sample
    `why_not`: why there is no steady clock; ``""`` where there is
    `jitters`: whether the stamps need one
    """

    period_ns: float
    t_ns: Int64
    missing: int = 0
    why_not: str = ""
    jitters: bool = True


def is_regular(intervals: Int64) -> bool:
    """Tell whether all intervals are about the same."""
    return not len(intervals) or bool(np.ptp(intervals) <= _STEADY * intervals.min())


def stretches(t_ns: Int64) -> Iterator[slice]:
    """Yield the parts of stamps, in order, that no pause divides."""
    limit = PAUSE * max(_periods(t_ns), default=np.inf)
    edges = np.flatnonzero(np.diff(t_ns) > limit) + 1
    for start, stop in pairwise([0, *edges.tolist(), len(t_ns)]):
        yield slice(start, stop)


def clock_of(t_ns: Int64, rate: Float64) -> FittedClock:
    """Return the clock of a stretch of at least :data:`SHORTEST` samples.

    `t_ns`: stamps that do not go backwards, shape ``(N,)``, int64
    `rate`: shape ``(N, 3)``, any unit
    """
    periods = _periods(t_ns)
    if not periods:
        return FittedClock(0.0, t_ns, why_not=UNCLEAR)
    if np.quantile(np.abs(np.diff(t_ns, 2)), 0.9) <= _STEADY * periods[0]:
        return FittedClock(periods[0], t_ns, jitters=False)
    clocks = [_clock(t_ns, period) for period in periods]
    clock = min(clocks, key=lambda clock: REASONS.index(clock.why_not))
    if not clock.why_not and _follows(t_ns, clock.t_ns, rate):
        return clock._replace(why_not=FOLLOWED)
    return clock


def _periods(t_ns: Int64) -> list[float]:
    """Return estimates of the interval: without missing samples, and without bursts."""
    lag = min(64, len(t_ns) - 1)
    usual = [float(np.median(t_ns[n:] - t_ns[:-n])) / n for n in (1, lag) if n > 0]
    return [period for period in dict.fromkeys(usual) if period > 0]


def _clock(t_ns: Int64, period: float) -> FittedClock:
    t = (t_ns - t_ns[0]).astype(np.float64)
    missing = _missing(t, period)
    if isinstance(missing, str):
        return FittedClock(period, t_ns, why_not=missing)
    number = np.arange(len(t)) + missing
    slope, offset = _line(number, t)
    regular = t_ns[0] + np.rint(slope * number + offset).astype(np.int64)
    why_not = _judged(t - slope * number, float(np.gcd.reduce(t_ns - t_ns[0])))
    return FittedClock(slope, regular, int(missing[-1]), why_not)


def _missing(t: Float64, period: float) -> Int64 | str:
    """Return how many samples are missing before each, or why that cannot be told."""
    phase = t / period - np.arange(len(t))
    # Not the mean of the two in the middle: half of a missing sample.
    whole = np.sort(phase[: len(t) // _WINDOW * _WINDOW].reshape(-1, _WINDOW), axis=1)
    middles = whole[:, _WINDOW // 2]
    steps = np.diff(middles)
    drift = np.mean(steps - np.rint(steps)) / _WINDOW
    phase -= drift * np.arange(len(t))
    middles -= drift * _WINDOW * np.arange(len(middles))
    first, last = (np.sort(part)[_ENDS // 2] for part in (phase[:_ENDS], phase[-_ENDS:]))
    levels = np.concatenate([[first], middles, [last]])
    # Samples that were held up come in time again: what is missing stays so.
    ahead = np.concatenate([levels, np.full(_HELD_UP - 1, np.inf)])
    levels = np.lib.stride_tricks.sliding_window_view(ahead, _HELD_UP).min(axis=1)
    steps = np.diff(levels)
    before = np.concatenate([[0], np.cumsum(np.rint(steps))])
    if (np.abs(steps - np.rint(steps)) > _CLEAR).any() or (np.diff(before) < 0).any():
        return UNCLEAR
    if before[-1] > MOST_MISSING * len(t):
        return MISSING
    starts = np.concatenate([[0], np.arange(len(middles)) * _WINDOW, [len(t) - _ENDS]])
    stops = np.concatenate([[_ENDS], starts[1:-1] + _WINDOW, [len(t)]])
    gains = np.zeros(len(t), np.int64)
    for k in np.flatnonzero(np.diff(before)):
        part = slice(int(starts[k]), int(stops[k + 1]))
        part_phase = phase[part] - levels[k]
        for one in range(int(before[k + 1] - before[k])):
            gains[part.start + _split(part_phase - one)] += 1
    return np.cumsum(gains)


def _split(phase: Float64) -> int:
    """Return from which sample on phases are rather 1 than 0."""
    late = np.concatenate([[0.0], np.cumsum(np.clip(phase, 0, 1))])
    early = np.concatenate([[0.0], np.cumsum(np.clip(1 - phase, 0, 1))])
    return min(int(np.argmin(late - early)), len(phase) - 1)


def _line(number: Int64, t: Float64) -> tuple[float, float]:
    """Return interval and offset of the clock, ns.

    Where the residuals end sharply below, as those of arrivals and of rounding do, the line is laid
    against that end, which is known much better than the middle.
    """
    half = len(t) // 2
    slope = float(np.median((t[half:] - t[:-half]) / (number[half:] - number[:-half])))
    rest = t - slope * number
    low, middle, high = np.quantile(rest, (0.1, 0.5, 0.9))
    usual = np.abs(rest - middle) <= 3 * (high - low)
    tilt = np.polyfit(number[usual] - number.mean(), rest[usual], 1)[0]
    rest -= tilt * number
    slope += float(tilt)
    lowest, low, middle, high, highest = np.quantile(rest, (0.005, 0.1, 0.5, 0.9, 0.995))
    if low - lowest > _SHARP * (middle - low):
        return slope, float(np.mean(rest[usual]))
    usual = rest >= middle - 1.5 * (middle - low)
    tilt, bottom = _lower_edge(number[usual], rest[usual])
    if highest - high > _SHARP * (high - middle):
        return slope + tilt, bottom
    # Sharp on both sides: rounded.
    return slope + tilt, float(np.median(rest - tilt * number))


def _lower_edge(number: Int64, rest: Float64) -> tuple[float, float]:
    """Return slope and offset of the highest line below points: the edge of their convex hull."""
    size = -(-len(rest) // 2048)
    starts = np.arange(0, len(rest), size)
    lowest = [start + int(np.argmin(rest[start : start + size])) for start in starts]
    hull: list[tuple[float, float]] = []
    for x, y in zip(number[lowest].tolist(), rest[lowest].tolist(), strict=True):
        while len(hull) > 1 and (hull[-1][1] - hull[-2][1]) * (x - hull[-1][0]) >= (
            y - hull[-1][1]
        ) * (hull[-1][0] - hull[-2][0]):
            hull.pop()
        hull.append((x, y))
    centre = number.mean()
    begin, end = next(edge for edge in pairwise(hull) if edge[1][0] >= centre)
    slope = (end[1] - begin[1]) / (end[0] - begin[0])
    return slope, begin[1] - slope * begin[0]


def _judged(rest: Float64, tick: float) -> str:
    """Return why residuals are not those of a steady clock; ``""`` where they are.

    `tick`: ns, of which all stamps are multiples
    """
    rounded = 10.0 ** np.floor(np.log10(tick))
    if np.std(rest) < _ROUNDED * rounded and np.ptp(rest) < 1.1 * rounded:
        return ""
    low, middle, high = np.quantile(rest, (0.1, 0.5, 0.9))
    rest = np.clip(rest - middle, -2 * (high - low), 2 * (high - low))
    size = len(rest) // _PARTS
    parts = np.median(rest[: size * _PARTS].reshape(_PARTS, size), axis=1)
    rest = rest - rest.mean()
    variance = float(np.mean(rest**2))
    if np.var(parts) > _SLOW**2 * variance or np.mean(np.diff(rest) ** 2) < _SMOOTH * 2 * variance:
        return DRIFTS
    for count in range(2, _PATTERN + 1):
        pattern = rest[: len(rest) // count * count].reshape(-1, count).mean(axis=0)
        if np.mean(pattern**2) > _REPEATED * variance:
            return REPEATS
    power = np.abs(np.fft.rfft(rest * np.hanning(len(rest)))) ** 2
    peak = max(int(np.argmax(power)), 2)
    return REPEATS if power[peak - 2 : peak + 3].sum() > _TONE * power.sum() else ""


def _follows(t_ns: Int64, regular: Int64, rate: Float64) -> bool:
    """Tell whether rates change with their stamps rather than with regular times."""
    errors = []
    for stamps in (t_ns, regular):
        before, whole = stamps[1:-1] - stamps[:-2], stamps[2:] - stamps[:-2]
        share = np.divide(before, whole, out=np.full(len(whole), 0.5), where=whole > 0)[:, None]
        error = rate[1:-1] - rate[:-2] - share * (rate[2:] - rate[:-2])
        errors.append(float(np.mean(error**2)))
    return errors[0] < _FOLLOWED * errors[1]
