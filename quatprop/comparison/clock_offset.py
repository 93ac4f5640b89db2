"""The offset between the clocks of two series, from the motion that both recorded.

The angular speed of a rigid body is the same in every frame, so it can be correlated before the
frames are aligned. The normalised cross-correlation of both series, interpolated at regular times,
gives a coarse offset; least squares over windows, with the body frames aligned, refines it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.association import interval_ns
from quatprop.comparison.clock_error import clock_errors
from quatprop.errors import ComparisonError
from quatprop.kinematics.interpolation import interpolate
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.text import Setting
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.series import AttitudeSeries


MIN_POINTS = 16
"""Minimum number of samples from which an offset is estimated."""

MAX_POINTS = 1 << 20
"""Maximum number of samples; longer series are sampled more coarsely."""

SMOOTH_NS = 50_000_000
"""Speeds are averages over this time, ns: over shorter ones, noise looks like motion."""

MIN_SMOOTH_POINTS = 200
"""The time is shortened if fewer points than this would remain."""

MIN_CORRELATION = 0.5
"""Minimum correlation; below it, the motions are considered different."""

MAX_RUNNER_UP = 0.98
"""Maximum second peak, as a share of the first: above it, the motion is periodic."""

MIN_VARIATION = 1e-6
"""Minimum relative variation of a speed; rounding errors of a constant one are below it."""

GIVE_OFFSET = f"give the offset with {Setting('time_offset', 'DUR')}"
"""Advice if no offset can be estimated."""


class ClockOffset(NamedTuple):
    """The estimated offset between two clocks.

    `ns`: offset to be added to B's timestamps, ns
    `correlation`: correlation of the angular speeds at this offset, at most 1
    `runner_up`: highest correlation outside the peak: near `correlation`, the offset is ambiguous
    `std_ns`: standard deviation of the offset, ns, by a block jackknife
    """

    ns: int
    correlation: float
    runner_up: float
    std_ns: float


def find_offset(a: AttitudeSeries, b: AttitudeSeries) -> ClockOffset:
    """Estimate the offset that must be added to B's timestamps.

    The clocks may have different epochs: every lag is tried with which at least half of the shorter
    series overlaps.

    References
    ----------
    Knapp and Carter, "The generalized correlation method for estimation of time delay", IEEE
    Trans. ASSP 24(4), 1976. See also :func:`quatprop.comparison.clock_error.clock_error`.
    """
    coarse, runner_up = coarse_offset(a, b)
    found = clock_errors(a, b, coarse)
    if found is None:
        raise ComparisonError(
            "A and B have too few windows of common motion to estimate a time offset; "
            f"{GIVE_OFFSET}"
        )
    refined, _, _ = found
    offset = coarse + round(refined.seconds * NS_PER_S)
    std_ns = refined.std * NS_PER_S
    return ClockOffset(offset, _correlation_at(a, b, offset), runner_up, std_ns)


def coarse_offset(a: AttitudeSeries, b: AttitudeSeries) -> tuple[int, float]:
    """Return the offset, ns, with the best correlation of angular speeds, and the runner-up.

    Angular speeds depend neither on frames nor on the direction of the attitudes.
    """
    step = _step_ns(a, b)
    speed_a, speed_b = (_angles(one, int(one.t_ns[0]), int(one.t_ns[-1]), step) for one in (a, b))
    for name, speed in (("A", speed_a), ("B", speed_b)):
        if speed.std() <= MIN_VARIATION * speed.mean():
            raise ComparisonError(
                f"the speed of {name} is constant, which shows no time offset; {GIVE_OFFSET}"
            )
    correlation = _correlations(speed_a, speed_b)
    peak = int(np.argmax(correlation))
    best = float(correlation[peak])
    if best < MIN_CORRELATION:
        raise ComparisonError(
            f"the angular speeds of A and B correlate at no time offset (at best {best:.2f}); "
            f"unless the motions differ, {GIVE_OFFSET}"
        )
    runner_up = _runner_up(correlation, peak)
    if runner_up > MAX_RUNNER_UP * best:
        raise ComparisonError(
            f"the motion repeats itself: its angular speed correlates {best:.4f} at one time "
            f"offset and {runner_up:.4f} at another; {GIVE_OFFSET}"
        )
    lag = peak - (len(speed_b) - 1)
    coarse = int(a.t_ns[0]) - int(b.t_ns[0]) + lag * step
    return coarse, runner_up


def _step_ns(a: AttitudeSeries, b: AttitudeSeries) -> int:
    spans = [int(series.t_ns[-1]) - int(series.t_ns[0]) for series in (a, b)]
    interval = max(interval_ns(a), interval_ns(b), max(spans) // MAX_POINTS)
    step = max(interval, min(SMOOTH_NS, min(spans) // MIN_SMOOTH_POINTS))
    if min(spans) < MIN_POINTS * step:
        raise ComparisonError(
            f"a time offset can be estimated from {MIN_POINTS} intervals or more, and one of the "
            f"series is shorter; {GIVE_OFFSET}"
        )
    return step


def _angles(series: AttitudeSeries, start: int, stop: int, step: int) -> Float64:
    """Return the rotation angles over steps from start to stop, rad."""
    regular, _ = interpolate(series, np.arange(start, stop + 1, step, dtype=np.int64))
    return geodesic_angle(regular[:-1], regular[1:])


def _correlations(x: Float64, y: Float64) -> Float64:
    """Return Pearson's correlation over the overlap at lags from -(len(y) - 1) to len(x) - 1.

    It is 0 where the overlap is too short, or x or y does not vary in it. A positive lag moves y to
    later times.
    """
    x, y = x - x.mean(), y - y.mean()
    lags = np.arange(-(len(y) - 1), len(x))
    x_slice = np.maximum(lags, 0), np.minimum(len(x), lags + len(y))
    y_slice = x_slice[0] - lags, x_slice[1] - lags
    count = x_slice[1] - x_slice[0]
    size = 1 << int(len(x) + len(y) - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(x, size) * np.fft.rfft(y[::-1], size), size)
    products = product[: len(lags)]
    sum_x, sum_y = _sums(x, x_slice), _sums(y, y_slice)
    power_x = _sums(x**2, x_slice) - sum_x**2 / count
    power_y = _sums(y**2, y_slice) - sum_y**2 / count
    enough = count >= max(MIN_POINTS, min(len(x), len(y)) // 2)
    # Below this, the variation is only rounding.
    varies_x = power_x > MIN_VARIATION * float((x**2).sum())
    varies_y = power_y > MIN_VARIATION * float((y**2).sum())
    correlation = np.zeros(len(lags))
    np.divide(
        products - sum_x * sum_y / count,
        np.sqrt(np.maximum(power_x, 0) * np.maximum(power_y, 0)),
        out=correlation,
        where=enough & varies_x & varies_y,
    )
    return correlation


def _sums(values: Float64, span: tuple[Int64, Int64]) -> Float64:
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[span[1]] - total[span[0]])


def _runner_up(correlation: Float64, peak: int) -> float:
    """Return the highest correlation outside the peak, which ends at the nearest minima."""
    slopes = np.diff(correlation)
    left = np.append(0, np.flatnonzero(slopes[:peak] <= 0) + 1)[-1]
    right = peak + np.append(np.flatnonzero(slopes[peak:] >= 0), len(slopes) - peak)[0]
    outside = np.concatenate([correlation[:left], correlation[right + 1 :]])
    return float(outside.max(initial=0.0))


def _correlation_at(a: AttitudeSeries, b: AttitudeSeries, offset: int) -> float:
    step = _step_ns(a, b)
    start = max(int(a.t_ns[0]), int(b.t_ns[0]) + offset)
    stop = min(int(a.t_ns[-1]), int(b.t_ns[-1]) + offset, start + MAX_POINTS * step)
    speed_a = _angles(a, start, stop, step)
    speed_b = _angles(b, start - offset, stop - offset, step)
    return float(np.corrcoef(speed_a, speed_b)[0, 1])
