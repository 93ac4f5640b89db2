"""Samples that arrive in packets with one timestamp each: the steady clock that they were taken by.

The samples are numbered, and a line is fitted through the timestamps at the last sample of each
packet, or at the first one where that is more regular, as for rounded times. Samples of equal time
cannot all be true, so that it needs less proof than the clock of single samples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.timeline.stamps import are_in_bursts
from quatprop.timeline.steady_clock import FittedClock, change_point, line_through

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64, Int64


FEWEST = 6
"""Minimum number of packets for a fit; the first and the last may be incomplete."""

_COPIES = 0.9
"""Samples are copies if this share of them has the rate of the one before in its packet."""

_FIRST = 0.7
"""The timestamps are those of first samples if these scatter by less than this share of the last.

Of packets of one size, both scatter alike."""

_MANY = 64
"""Number of packets from which the distribution of their delays is known."""

_NEAR = 9
"""Number of packets before and after a gap that show whether samples are missing in it."""

_STEP, _CLEAR = 0.6, 6
"""Minimum step of their phase: in intervals, and relative to its median scatter."""

_SHARP = 0.3
"""Residuals that differ by less than this many intervals have no late ones among them."""

_BETTER = 0.8
"""Samples are missing if with them the scatter is below this share of that without."""

_ROUNDED = 1.1
"""Timestamps within this many intervals of a clock without missing samples are rounded times."""

_PARTS = 8
_DRIFT = 0.5
"""The variance of medians of this many parts of the residuals is below this share of theirs."""

_ROUGHNESS = 0.2
"""Minimum mean square of differences of neighbouring residuals, relative to independent ones."""

_FROM_2000_NS = 946_684_800 * NS_PER_S
_UNPACKED_NS, _UNPACKING = 1_000_000, 0.2
"""Samples stamped within 1 ms of the one before are of one packet, if unpacking one takes less than
this share of the usual time between packets."""

_ROUND_DIGITS = {"1", "2", "5"}
"""What ticks of rounded times begin with; the other digits are 0."""

UNSTEADY: Final = "the samples that share timestamps were not taken at a steady rate"


def begins_of(t_ns: Int64) -> Int64:
    """Return the index of the first sample of each packet."""
    return np.flatnonzero(np.diff(t_ns, prepend=t_ns[0] - 1))


def of_packets(t_ns: Int64) -> Int64 | None:
    """Return timestamps with those of each burst equal to its first; None if there are none.

    The samples of a packet are often stamped one by one while they are unpacked.

    `t_ns`: non-decreasing timestamps, shape ``(N,)``
    """
    steps = np.diff(t_ns)
    if len(steps) < FEWEST or not are_in_bursts(steps):
        return None
    begins = np.flatnonzero(np.append(True, steps > _UNPACKED_NS))
    sizes = np.diff(begins, append=len(t_ns))
    between = np.diff(t_ns[begins])
    lasting = np.quantile(t_ns[begins + sizes - 1] - t_ns[begins], 0.9)
    is_short = len(begins) >= FEWEST and lasting < _UNPACKING * np.median(between)
    return np.repeat(t_ns[begins], sizes) if is_short else None


def are_copies(t_ns: Int64, rate: Float64) -> bool:
    """Return whether samples under one timestamp are one sample, recorded several times."""
    same = (rate[1:] == rate[:-1]).all(axis=1)
    inside = t_ns[1:] == t_ns[:-1]
    if not inside.any() or inside.all():
        return False
    return bool(same[inside].mean() >= _COPIES > same[~inside].mean())


def spread_evenly(t_ns: Int64) -> Int64:
    """Return times at which the samples of each packet end evenly at its timestamp.

    They begin after the timestamp before it; those of the first packet are as far apart as those of
    the second.
    """
    begins = begins_of(t_ns)
    sizes = np.diff(begins, append=len(t_ns))
    lengths = np.diff(t_ns[begins], prepend=t_ns[0])
    # A packet after a pause took no longer than others.
    usual = np.median(lengths[1:] / sizes[1:]) if len(begins) > 1 else 0.0
    step = np.minimum(lengths / sizes, 2 * usual)
    step[0] = usual
    to_end = np.repeat(begins + sizes, sizes) - 1 - np.arange(len(t_ns))
    spread: Int64 = t_ns - np.rint(np.repeat(step, sizes) * to_end).astype(np.int64)
    return spread


def packet_clock(t_ns: Int64, at_first: bool | None = None) -> tuple[FittedClock, bool]:
    """Return the clock of samples in packets, and whether timestamps are those of first samples.

    `t_ns`: non-decreasing timestamps of packets, shape ``(N,)``, int64
    `at_first`: the same of earlier samples of the log; None: unknown
    """
    begins = begins_of(t_ns)
    if len(begins) < FEWEST:
        return FittedClock(t_ns, why_not=UNSTEADY), False
    stamps = (t_ns[begins] - t_ns[0]).astype(np.float64)
    sizes = np.diff(begins, append=len(t_ns))
    fits = [_best_fit(stamps, begins, sizes, at_first=first) for first in (False, True)]
    if at_first is None:
        at_first = fits[True].scatter < _FIRST * fits[False].scatter
        # A clock that begins at 0 shows that the first sample was taken then.
        is_before_0 = t_ns[0] >= 0 > t_ns[0] + fits[False].time_of(0)
        at_first |= bool(is_before_0 and (sizes[1:-1] == sizes[1]).all())
        at_first |= _are_rounded_down(t_ns[begins])
    fit = fits[at_first]
    if fit.why_not:
        return FittedClock(t_ns, why_not=fit.why_not), at_first
    number = np.arange(len(t_ns)) + np.repeat(fit.missing, sizes)
    times = t_ns[0] + np.rint(fit.time_of(number)).astype(np.int64)
    missing = int(fit.missing[-1])
    return FittedClock(times, fit.period, missing, packet=int(sizes.max())), at_first


def _are_rounded_down(stamps: Int64) -> bool:
    """Return whether timestamps of packets are dates in whole ticks, one packet in each tick.

    The times of last samples would be whole ticks by chance only. Of a clock of its own, such as
    one that begins with the log, they may be.
    """
    tick = int(np.gcd.reduce(stamps))
    is_round = str(tick).rstrip("0") in _ROUND_DIGITS
    is_date = int(stamps[0]) > _FROM_2000_NS
    return is_round and is_date and tick == int(np.diff(stamps).min())


class _Fit(NamedTuple):
    """A line through the timestamps of packets.

    `missing`: number of missing samples before each packet
    `period`, `offset`: interval of the clock, and the time of sample 0, ns
    `scatter`, `extent`: standard deviation and range of the timestamps about it, ns
    """

    missing: Int64
    period: float
    offset: float
    scatter: float
    extent: float
    why_not: str

    def time_of(self, number: Int64 | int) -> Float64:
        """Return the time of a sample by its number, ns."""
        return np.asarray(self.period * number + self.offset)


def _best_fit(stamps: Float64, begins: Int64, sizes: Int64, *, at_first: bool) -> _Fit:
    """Return the line through the first samples of packets or the last, with missing samples.

    `stamps`: timestamps since the first, ns
    `begins`, `sizes`: first sample and number of samples of each packet
    """
    at = begins if at_first else begins + sizes - 1
    # Of packets of one size, whole ones are missing.
    unit = int(sizes[1]) if (sizes[1:-1] == sizes[1]).all() else 1
    fit = _fit(stamps, at, np.zeros(len(at), np.int64))
    if unit == 1 and fit.extent <= _ROUNDED * fit.period:
        return fit
    missing = _missing(stamps, sizes / unit, at / unit) * unit
    other = _fit(stamps, at + missing, missing) if missing.any() else fit
    return other if other.scatter < _BETTER * fit.scatter else fit


def _fit(stamps: Float64, number: Int64, missing: Int64) -> _Fit:
    # The first and the last packet may be incomplete.
    number, stamps = number[1:-1], stamps[1:-1]
    period, offset = _line(number, stamps)
    rest = stamps - period * number - offset
    is_steady = period > 0 and not _drifts(rest, period)
    why_not = "" if is_steady else UNSTEADY
    return _Fit(missing, period, offset, float(np.std(rest)), float(np.ptp(rest)), why_not)


def _missing(stamps: Float64, sizes: Float64, number: Float64) -> Int64:
    """Return the number of missing units before each packet.

    `sizes`, `number`: sizes of the packets and their numbers, without missing ones, in units
    """
    count = len(stamps)
    lag = max(1, min(_NEAR, count // 6))
    steps = (stamps[lag:] - stamps[:-lag])[1:-1] / (number[lag:] - number[:-lag])[1:-1]
    period = float(np.median(steps))
    if period <= 0:
        return np.zeros(count, np.int64)
    # The first and the last packet may be incomplete, and are judged by the longer of the two.
    lengths = np.diff(number)
    lengths[[0, -1]] = max(sizes[:2]), max(sizes[-2:])
    phase = stamps / period - np.append(0, np.cumsum(lengths))
    # Levels of the phase after and before each interval between packets.
    near = min(_NEAR, count // 3)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(phase, near, mode="edge"), near)
    middles = np.median(windows, axis=1)
    levels = middles[near + 1 : near + count] - middles[1:count]
    noise = float(np.median(np.abs(levels - np.median(levels))))
    jumps = np.diff(phase)
    if np.quantile(np.abs(jumps), 0.8) < _SHARP:
        return np.append(0, np.cumsum(np.where(jumps > _STEP, np.rint(jumps), 0))).astype(np.int64)
    found = np.flatnonzero((levels > max(_STEP, _CLEAR * noise)) & (jumps > _SHARP))
    missing = np.zeros(count, np.int64)
    for k in found[np.argsort(-(levels + jumps)[found], kind="stable")]:
        begin = max(k + 1 - near, 0)
        left = (phase - missing)[begin : k + 1 + near]
        before = float(np.median(left[: k + 1 - begin]))
        step = int(np.rint(np.median(left[k + 1 - begin :]) - before))
        if step > 0:
            missing[begin + change_point((left - before) / step) :] += step
    return missing


def _slope(number: Float64 | Int64, t: Float64) -> float:
    half = len(t) // 2
    return float(np.median((t[half:] - t[:-half]) / (number[half:] - number[:-half])))


def _line(number: Int64, t: Float64) -> tuple[float, float]:
    """Return the interval and the offset of the clock, ns."""
    slope = _slope(number, t)
    rest = t - slope * number
    if len(t) < _MANY or np.ptp(rest) < _SHARP * slope:
        return slope, float(np.median(rest))
    return line_through(number, t)


def _drifts(rest: Float64, period: float) -> bool:
    """Return whether residuals change slowly, as of samples that were taken at no steady rate."""
    if np.ptp(rest) <= _ROUNDED * period:
        return False
    variance = float(np.var(rest))
    is_smooth = np.mean(np.diff(rest) ** 2) < _ROUGHNESS * 2 * variance
    if is_smooth or len(rest) < _MANY:
        return bool(is_smooth)
    parts = [float(np.median(part)) for part in np.array_split(rest, _PARTS)]
    return float(np.var(parts)) > _DRIFT * variance
