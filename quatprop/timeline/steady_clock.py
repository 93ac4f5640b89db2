"""Detect jitter of timestamps about a steady clock, or replace them by its times.

The clock is fitted to each block of samples, so that memory use is constant and a clock that
drifts over hours is followed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.errors import TimelineError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, geodesic_angle, multiply
from quatprop.kinematics.series import GyroSeries
from quatprop.timeline.counts import SteadyClock

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

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
    """

    t_ns: Int64
    period_ns: float = np.nan
    missing: int = 0
    why_not: str = ""
    jitters: bool = True


def is_regular(intervals: Int64) -> bool:
    """Return whether neighbouring intervals are about equal."""
    return bool((np.abs(np.diff(intervals)) <= _STEADY * intervals[1:]).all())


def stretches(t_ns: Int64) -> Iterator[slice]:
    """Yield the stretches of timestamps between pauses, in order."""
    limit = PAUSE * max(_periods(t_ns), default=np.inf)
    edges = np.flatnonzero(np.diff(t_ns) > limit) + 1
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
        return clock._replace(why_not=FOLLOWED) if _follows(rate, t_ns, clock.t_ns) else clock
    # Samples may arrive several at a time, or be taken so: the rates decide.
    together = _clock_of_bursts(t_ns)
    return together if together and _follows(rate, together.t_ns, t_ns) else clock


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
    slope, offset = _line(number, t)
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
            gains[starts[k] + _change_point(part_phase - one)] += 1
    return np.cumsum(gains)


def _change_point(phase: Float64) -> int:
    """Return the index from which on phases are nearer to 1 than to 0."""
    nearer = np.clip(2 * phase - 1, -1, 1)
    return int(np.argmin(np.cumsum(nearer) - nearer))


def _line(number: Int64, t: Float64) -> tuple[float, float]:
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


def _follows(rate: Float64, t_ns: Int64, other_ns: Int64) -> bool:
    """Return whether rates follow some times rather than others."""
    errors = []
    for times in (t_ns, other_ns):
        before, whole = times[1:-1] - times[:-2], times[2:] - times[:-2]
        share = np.divide(before, whole, out=np.full(len(whole), 0.5), where=whole > 0)[:, None]
        error = rate[1:-1] - rate[:-2] - share * (rate[2:] - rate[:-2])
        by_noise = 1 + share**2 + (1 - share) ** 2
        errors.append(float(np.mean(error**2) / np.mean(by_noise)))
    return errors[0] < _FOLLOWED * errors[1]


_FASTEST = 1e4
"""rad/s: larger rates are damaged, and are excluded."""


@dataclass(slots=True)
class _Sums:
    """Sums over the stretches of a log so far; stretches are the parts between pauses.

    `fitted`: samples that jitter; `kept`: samples that do not, or are too few to decide
    `judged`: whether there were enough samples to decide
    `carried`: square of the attitude error that earlier stretches leave, rad^2
    """

    fitted: int = 0
    kept: int = 0
    judged: bool = False
    missing: int = 0
    offset_ns: int | None = None
    intervals: float = 0.0
    span_ns: float = 0.0
    squares: float = 0.0
    largest_ns: int = 0
    error_squares: float = 0.0
    carried: float = 0.0

    def keep(self, samples: int, *, judged: bool) -> None:
        """Add samples whose timestamps are not changed."""
        self.judged |= judged
        self.kept += samples
        self.error_squares += samples * self.carried

    def add(self, t_ns: Int64, clock: FittedClock, error: Float64) -> None:
        """Add timestamps that jitter about a clock, and the attitude errors by jitter, rad."""
        rest = t_ns - clock.t_ns
        self.offset_ns = int(clock.t_ns[0]) if self.offset_ns is None else self.offset_ns
        self.judged = True
        self.fitted += len(rest)
        self.missing += clock.missing
        span = int(clock.t_ns[-1] - clock.t_ns[0])
        self.span_ns += span
        self.intervals += span / clock.period_ns
        self.squares += float(np.var(rest)) * len(rest)
        self.largest_ns = max(self.largest_ns, int(np.abs(rest).max()))
        self.error_squares += len(rest) * self.carried + float((error**2).sum())
        self.carried += float(error[-1]) ** 2

    def clock(self) -> SteadyClock | None:
        """Return the clock; None if nothing jitters."""
        if self.offset_ns is None:
            return None
        return SteadyClock(
            rate_hz=self.intervals * NS_PER_S / self.span_ns,
            offset_ns=self.offset_ns,
            residual_rms_ns=(self.squares / self.fitted) ** 0.5,
            residual_max_ns=self.largest_ns,
            missing=self.missing,
            kept=self.kept,
            error_rad=(self.error_squares / (self.fitted + self.kept)) ** 0.5,
        )


class RegularTime:
    """Compares timestamps with a steady clock, or replaces them by its times.

    `method`, `rates`: those of the propagation, to estimate the attitude error by jitter
    `first_ns`: the first timestamp before it was replaced, ns; None if it was not
    """

    def __init__(self, path: Path | str, method: str, rates: str) -> None:
        self._path, self._rates = path, rates
        self._propagated = partial(attitudes, method=method, rates=rates)
        self.first_ns: int | None = None
        self._sums: _Sums | None = _Sums()

    @property
    def clock(self) -> SteadyClock | None:
        """The clock about which all timestamps jitter; None if there is none."""
        return self._sums.clock() if self._sums is not None else None

    def observed(self, blocks: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield blocks unchanged, and fit the clock as long as there may be one."""
        for block in blocks:
            # Increments do not depend on their timestamps.
            if self._sums is not None and block.integration_time_ns is None:
                try:
                    self._times(block, self._sums)
                except TimelineError:
                    self._sums = None
            yield block

    def replaced(self, blocks: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield blocks at the times of their clocks; refuse timestamps without a steady clock."""
        sums = self._sums = _Sums()
        for block in _with_long_end(blocks):
            self.first_ns = int(block.t_ns[0]) if self.first_ns is None else self.first_ns
            yield replace(block, t_ns=self._times(block, sums))
        if not sums.judged:
            raise self._refusal("of this log", f"no {SHORTEST} of them are without a pause")

    def _times(self, block: GyroSeries, sums: _Sums) -> Int64:
        """Return the clock times of a block, and add it to the sums."""
        times = block.t_ns.copy()
        for samples, part, clock in _clocks(block):
            if clock is None or not clock.jitters:
                sums.keep(len(samples), judged=clock is not None)
            elif clock.why_not:
                which = f"from {samples.t_ns[0]} to {samples.t_ns[-1]} ns"
                raise self._refusal(which, clock.why_not)
            else:
                sums.add(samples.t_ns, clock, self._error_rad(samples, clock))
                times[part] = clock.t_ns
        return times

    def _error_rad(self, samples: GyroSeries, clock: FittedClock) -> Float64:
        """Return the angles between attitudes by the timestamps and by the clock, rad."""
        rate = _without_damaged(samples.rate)
        by_stamps, by_clock = (self._propagated(t_ns, rate) for t_ns in (samples.t_ns, clock.t_ns))
        since = exp(rate * ((samples.t_ns - clock.t_ns) * 1e-9)[:, None])
        factors = (by_clock, since) if self._rates == "body" else (since, by_clock)
        return geodesic_angle(by_stamps, multiply(*factors))

    def _refusal(self, which: str, why: str) -> TimelineError:
        return TimelineError(
            self._path,
            f"the timestamps {which} do not jitter about a steady clock: {why}; omit "
            f"{Setting('regular_time')}",
        )


def _clocks(block: GyroSeries) -> Iterator[tuple[GyroSeries, slice, FittedClock | None]]:
    """Yield the stretches of a block with their clocks; None for too few samples."""
    intervals = np.diff(block.t_ns)
    if (intervals < 0).any():
        yield block, slice(None), FittedClock(block.t_ns, why_not="they step back")
    elif is_regular(intervals):
        yield block, slice(None), FittedClock(block.t_ns, jitters=False)
    else:
        for part in stretches(block.t_ns):
            samples = block[part]
            enough = len(samples) >= SHORTEST
            rate = _without_damaged(samples.rate)
            yield samples, part, clock_of(samples.t_ns, rate) if enough else None


def _without_damaged(rate: Float64) -> Float64:
    """Return rates with zeros in place of damaged ones."""
    return np.where(np.abs(rate) < _FASTEST, rate, 0.0)


def _with_long_end(blocks: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
    """Yield blocks; a short last one is joined to the previous, as few samples show no clock."""
    held: GyroSeries | None = None
    for block in blocks:
        if held is not None and len(block) < len(held) // 2:
            block = GyroSeries.joined([held, block])  # noqa: PLW2901
        elif held is not None:
            yield held
        held = block
    if held is not None:
        yield held
