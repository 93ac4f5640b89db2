"""Fit the steady clock about which timestamps jitter, such as arrival times and rounded times."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.timeline.counts import MANY_REPEATS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Float64, Int64


# Fit the steady clock about which timestamps jitter, such as arrival times and rounded times.
#
# The samples of one stretch, without a pause, are numbered: medians of short windows distinguish
# late samples from missing ones, since a late sample is followed by punctual ones. A line through
# the timestamps, robust against late ones, is the clock. The residuals show whether there is one:
# jitter differs from sample to sample, neither drifts nor repeats, and the rates do not follow it.


SHORTEST = 256
"""Minimum number of samples without a pause for a fit."""

PAUSE = 10
"""Intervals longer than this many usual ones are pauses, in which the clock may have been set."""

MOST_MISSING = 0.05
"""Maximum share of missing samples of a steady clock."""

_STEADY = 2e-3
"""Timestamps are regular if neighbouring intervals differ by less than this share."""

_WINDOW = 15
"""Samples in a window, an odd number, whose median distinguishes late from missing samples."""

_ENDS = 5
"""The same at the first and last samples."""

_MAX_SCATTER = 0.6
"""Maximum scatter of all samples, in intervals, with which a single one shows missing ones."""

_DELAY_WINDOWS = 8
"""Samples are late, rather than missing, if within this many windows others are punctual again."""

_MAX_PHASE_ERROR = 0.3
"""Maximum deviation of a median from a whole number of intervals, in intervals."""

_SHARP_EDGE = 0.35
"""Residuals have a sharp lower edge, as of arrival times, if the lowest tenth is at most this wide,
relative to the rest of the lower half."""

_PARTS = 16
_DRIFT = 0.5
"""Medians of this many parts of the residuals scatter by less than this share of the residuals."""

_ROUGHNESS = 0.2
"""Minimum mean square of differences of neighbouring residuals, relative to independent ones."""

_PATTERN = 8
_REPEATED = 0.4
"""Residuals repeat if a pattern of up to this many samples has this share of the variance."""

_ONE_FREQUENCY = 0.8
"""Residuals repeat if one frequency has this share of it; a sawtooth, as of polling, has 0.61."""

_ROUNDED = 0.35
"""Maximum standard deviation of rounding errors, ticks; 0.29 for a uniform distribution."""

_FOLLOWED = 0.9
"""Rates were sampled at some times if, with these, their mean square deviation from a line between
their neighbours is below this share of that with other times, relative to that of white noise."""

DRIFTS: Final = (
    "the deviations from the best one change slowly, as if a clock drifts or its rate changes"
)
REPEATS: Final = "the deviations repeat"
UNCLEAR: Final = "they are too irregular to distinguish late samples from missing ones"
MISSING: Final = f"more than {MOST_MISSING:.0%} of the samples would be missing"
REASONS: Final = ("", REPEATS, DRIFTS, MISSING, UNCLEAR)
"""Reasons why there is no clock, those of better estimates of the interval first."""

FOLLOWED: Final = (
    "the rates change in step with the timestamps: the samples were taken at those times"
)


class FittedClock(NamedTuple):
    """The clock that is fitted to the timestamps of a stretch.

    `t_ns`: clock times of the samples, shape ``(N,)``, int64
    `period_ns`: interval of the clock, ns
    `missing`: number of its times without a sample
    `why_not`: the reason why there is no steady clock; ``""`` if there is one
    `jitters`: whether the timestamps are irregular
    `packet`: largest number of samples under one timestamp, if they are fitted as packets; else 1
    """

    t_ns: Int64
    period_ns: float = np.nan
    missing: int = 0
    why_not: str = ""
    jitters: bool = True
    packet: int = 1


def is_regular(intervals: Int64) -> bool:
    """Return whether neighbouring intervals are about equal."""
    if len(intervals):
        shortest, longest = int(intervals.min()), int(intervals.max())
        # Fast exit: all of them are.
        if longest - shortest <= _STEADY * shortest:
            return True
    return bool((np.abs(np.diff(intervals)) <= _STEADY * intervals[1:]).all())


def share_of_repeats(t_ns: Int64) -> float:
    """Return the share of intervals that are 0."""
    return float(np.count_nonzero(t_ns[1:] == t_ns[:-1])) / max(len(t_ns) - 1, 1)


def stretches(t_ns: Int64) -> Iterator[slice]:
    """Yield the stretches of timestamps between pauses, in order."""
    intervals = np.diff(t_ns)
    periods = _periods(t_ns)
    if MANY_REPEATS <= share_of_repeats(t_ns) < 1:
        # Of packets with one timestamp each, the interval between these.
        periods.append(float(np.median(intervals[intervals > 0])))
    limit = PAUSE * max(periods, default=np.inf)
    edges = np.flatnonzero(intervals > limit) + 1
    for start, stop in pairwise([0, *edges.tolist(), len(t_ns)]):
        yield slice(start, stop)


def clock_of(t_ns: Int64, rate: Float64) -> FittedClock:
    """Return the clock of a stretch of at least :data:`SHORTEST` samples.

    `t_ns`: non-decreasing timestamps, shape ``(N,)``, int64
    `rate`: shape ``(N, 3)``, any unit
    """
    periods = _periods(t_ns)
    if not periods:
        return FittedClock(t_ns, why_not=UNCLEAR)
    if np.quantile(np.abs(np.diff(t_ns, 2)), 0.9) <= _STEADY * periods[0]:
        return FittedClock(t_ns, jitters=False)
    clock = _best_clock(t_ns, periods)
    if not clock.why_not:
        return clock._replace(why_not=FOLLOWED) if follows(rate, t_ns, clock.t_ns) else clock
    # Samples may arrive several at a time, or be taken so: the rates decide.
    together = _clock_of_bursts(t_ns)
    return together if together and follows(rate, together.t_ns, t_ns) else clock


def _best_clock(t_ns: Int64, periods: list[float]) -> FittedClock:
    """Return the clock with one of several intervals, or why there is none."""
    clocks = [_clock(t_ns, period) for period in periods]
    return min(clocks, key=lambda clock: REASONS.index(clock.why_not))


def _clock_of_bursts(t_ns: Int64) -> FittedClock | None:
    """Return the clock of the last samples of bursts, all of as many samples; None for none."""
    steps = np.diff(t_ns).astype(np.float64)
    patterns = [
        steps[: len(steps) // count * count].reshape(-1, count).mean(axis=0)
        for count in range(2, PAUSE)
    ]
    pattern = max(patterns, key=lambda each: float(np.var(each)))
    count, last = len(pattern), int(np.argmax(pattern))
    ends = t_ns[last::count]
    if len(ends) < SHORTEST or np.var(pattern) <= _REPEATED * np.var(steps):
        return None
    clock = _best_clock(ends, _periods(ends))
    if clock.why_not or clock.missing:
        return None
    period = clock.period_ns / count
    times = clock.t_ns[0] + np.rint(period * (np.arange(len(t_ns)) - last)).astype(np.int64)
    if _missing_at_ends((t_ns - times) / period).any():
        return None
    return FittedClock(times, period)


def _periods(t_ns: Int64) -> list[float]:
    """Return estimates of the interval: without missing samples, and without bursts."""
    usual = [float(np.median(t_ns[n:] - t_ns[:-n])) / n for n in (1, 64) if n < len(t_ns)]
    return [period for period in dict.fromkeys(usual) if period > 0]


def _clock(t_ns: Int64, period: float) -> FittedClock:
    t = (t_ns - t_ns[0]).astype(np.float64)
    missing = _missing(t, period)
    if isinstance(missing, str):
        return FittedClock(t_ns, why_not=missing)
    number = np.arange(len(t)) + missing
    slope, offset = line_through(number, t)
    at_ends = _missing_at_ends((t - slope * number - offset) / slope)
    if at_ends.any():
        missing = missing + at_ends - at_ends[0]
        number = np.arange(len(t)) + missing
        slope, offset = line_through(number, t)
    regular = t_ns[0] + np.rint(slope * number + offset).astype(np.int64)
    why_not = _fault_of(t - slope * number, float(np.gcd.reduce(np.diff(t_ns))))
    return FittedClock(regular, slope, int(missing[-1]), why_not)


def _missing(t: Float64, period: float) -> Int64 | str:
    """Return the number of missing samples before each sample, or why it cannot be determined."""
    phase = t / period - np.arange(len(t))
    # The window is odd: a mean of two middle values could be half a missing sample.
    whole = np.sort(phase[: len(t) // _WINDOW * _WINDOW].reshape(-1, _WINDOW), axis=1)
    middles = whole[:, _WINDOW // 2]
    steps = np.diff(middles)
    drift = np.mean(steps - np.rint(steps)) / _WINDOW
    phase -= drift * np.arange(len(t))
    middles -= drift * _WINDOW * np.arange(len(middles))
    first, last = (np.sort(part)[_ENDS // 2] for part in (phase[:_ENDS], phase[-_ENDS:]))
    levels = np.concatenate([[first], middles, [last]])
    # The minimum of later windows: delayed samples become punctual again, missing ones do not.
    ahead = np.concatenate([levels, np.full(_DELAY_WINDOWS - 1, np.inf)])
    levels = np.lib.stride_tricks.sliding_window_view(ahead, _DELAY_WINDOWS).min(axis=1)
    steps = np.diff(levels)
    before = np.concatenate([[0], np.cumsum(np.rint(steps))])
    if (np.abs(steps - np.rint(steps)) > _MAX_PHASE_ERROR).any() or (np.diff(before) < 0).any():
        return UNCLEAR
    if before[-1] > MOST_MISSING * len(t):
        return MISSING
    whole_windows = np.arange(len(middles)) * _WINDOW
    starts, stops = np.append(0, whole_windows), np.append(whole_windows + _WINDOW, len(t))
    gains = np.zeros(len(t), np.int64)
    for k in np.flatnonzero(np.diff(before)):
        part_phase = phase[starts[k] : stops[k]] - levels[k]
        for one in range(int(before[k + 1] - before[k])):
            gains[starts[k] + change_point(part_phase - one)] += 1
    return np.cumsum(gains)


def _missing_at_ends(phase: Float64) -> Int64:
    """Return by how many intervals the first and the last few samples are away from the others.

    These are too few for a median; they are moved only if no other sample is as far away.
    """
    moved = np.zeros(len(phase), np.int64)
    low, high = np.quantile(phase[_ENDS:-_ENDS], (0.005, 0.995))
    if high - low > _MAX_SCATTER:
        return moved
    whole = np.rint(phase - (low + high) / 2).astype(np.int64)
    whole[_ENDS:-_ENDS] = 0
    rest = phase - whole
    margin = (1 - (high - low)) / 4
    whole[(rest < low - margin) | (rest > high + margin)] = 0
    # Samples missing before the last ones move all after them, and the reverse at the beginning.
    moved[-_ENDS:] = np.maximum.accumulate(np.maximum(whole[-_ENDS:], 0))
    moved[:_ENDS] = np.minimum.accumulate(np.minimum(whole[:_ENDS], 0)[::-1])[::-1]
    return moved


def change_point(phase: Float64) -> int:
    """Return the index from which on phases are nearer to 1 than to 0."""
    nearer = np.clip(2 * phase - 1, -1, 1)
    return int(np.argmin(np.cumsum(nearer) - nearer))


def line_through(number: Int64, t: Float64) -> tuple[float, float]:
    """Return the interval and the offset of the clock, ns.

    If the residuals have a sharp lower edge, as for arrival and rounded times, the line is fitted
    to that edge, which is known much better than the centre.
    """
    half = len(t) // 2
    slope = float(np.median((t[half:] - t[:-half]) / (number[half:] - number[:-half])))
    rest = t - slope * number
    low, middle, high = np.quantile(rest, (0.1, 0.5, 0.9))
    usual = np.abs(rest - middle) <= 3 * (high - low)
    tilt = np.polyfit(number[usual], rest[usual], 1)[0]
    rest -= tilt * number
    slope += float(tilt)
    lowest, low, middle, high, highest = np.quantile(rest, (0.005, 0.1, 0.5, 0.9, 0.995))
    if low - lowest > _SHARP_EDGE * (middle - low):
        return slope, float(np.mean(rest[usual]))
    usual = rest >= middle - 1.5 * (middle - low)
    tilt, bottom = _lower_edge(number[usual], rest[usual])
    if highest - high > _SHARP_EDGE * (high - middle):
        return slope + tilt, bottom
    # Sharp edges on both sides: rounded times.
    return slope + tilt, float(np.median(rest - tilt * number))


def _lower_edge(number: Int64, rest: Float64) -> tuple[float, float]:
    """Return slope and offset of the highest line below all points: an edge of their hull."""
    size = -(-len(rest) // 2048)
    starts = np.arange(0, len(rest), size)
    lowest = [start + int(np.argmin(rest[start : start + size])) for start in starts]
    hull: list[tuple[float, float]] = []
    for x, y in np.stack([number[lowest], rest[lowest]], axis=1).tolist():
        while len(hull) > 1 and (hull[-1][1] - hull[-2][1]) * (x - hull[-1][0]) >= (
            y - hull[-1][1]
        ) * (hull[-1][0] - hull[-2][0]):
            hull.pop()
        hull.append((x, y))
    centre = number.mean()
    begin, end = next(edge for edge in pairwise(hull) if edge[1][0] >= centre)
    slope = (end[1] - begin[1]) / (end[0] - begin[0])
    return slope, begin[1] - slope * begin[0]


def _fault_of(rest: Float64, tick: float) -> str:
    """Return why residuals are not those of a steady clock; ``""`` if they are.

    `tick`: greatest common divisor of the timestamps, ns
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
    if (
        np.var(parts) > _DRIFT**2 * variance
        or np.mean(np.diff(rest) ** 2) < _ROUGHNESS * 2 * variance
    ):
        return DRIFTS
    for count in range(2, _PATTERN + 1):
        pattern = rest[: len(rest) // count * count].reshape(-1, count).mean(axis=0)
        if np.mean(pattern**2) > _REPEATED * variance:
            return REPEATS
    power = np.abs(np.fft.rfft(rest * np.hanning(len(rest)))) ** 2
    peak = max(int(np.argmax(power)), 2)
    return REPEATS if power[peak - 2 : peak + 3].sum() > _ONE_FREQUENCY * power.sum() else ""


def follows(rate: Float64, t_ns: Int64, other_ns: Int64) -> bool:
    """Return whether rates follow some times rather than others."""
    errors = []
    for times in (t_ns, other_ns):
        before, whole = times[1:-1] - times[:-2], times[2:] - times[:-2]
        share = np.divide(before, whole, out=np.full(len(whole), 0.5), where=whole > 0)[:, None]
        error = rate[1:-1] - rate[:-2] - share * (rate[2:] - rate[:-2])
        by_noise = 1 + share**2 + (1 - share) ** 2
        errors.append(float(np.mean(error**2) / np.mean(by_noise)))
    return errors[0] < _FOLLOWED * errors[1]
