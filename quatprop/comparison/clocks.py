"""The offset between the clocks of two series, from the motion that both recorded.

The angular speed of a rigid body is the same in every frame, so it can be correlated before
anything is aligned. Both series are interpolated at regular times; a normalised
cross-correlation over all lags gives the offset roughly. The rotations over windows, with the
bodies turned to agree, give it by least squares.
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
"""Least samples from which a delay is estimated."""

MAX_POINTS = 1 << 20
"""Longer series are sampled more coarsely."""

SMOOTH_NS = 50_000_000
"""Speeds are taken over this time at least: over shorter ones, noise looks like motion."""

MIN_SMOOTH_POINTS = 200
"""Unless fewer points than this would remain."""

MIN_CORRELATION = 0.5
"""Below this the two motions are taken to be different."""

MAX_RUNNER_UP = 0.98
"""A second peak above this share of the first is as good: the motion repeats itself."""

MIN_VARIATION = 1e-6
"""Least relative spread of a varying speed; the rounding of constant spins is below it."""

GIVE_OFFSET = f"give the offset with {Setting('time_offset', 'DUR')}"
"""What to do where no offset can be estimated."""


class ClockOffset(NamedTuple):
    """The estimated offset between two clocks.

    `ns`: what must be added to B's timestamps, ns
    `correlation`: of the angular speeds at that offset, 1 at best
    `runner_up`: the next best correlation outside the peak: how easily it could be another offset
    `std_ns`: standard deviation of the offset, ns, whatever the noise: from the spread over time
    """

    ns: int
    correlation: float
    runner_up: float
    std_ns: float


def find_offset(a: AttitudeSeries, b: AttitudeSeries) -> ClockOffset:
    """Estimate the time offset of B: what must be added to its stamps.

    The clocks may have different epochs: every lag is tried at which the shorter series overlaps
    by half.

    References
    ----------
    Knapp and Carter, "The generalized correlation method for estimation of time delay", IEEE
    Trans. ASSP 24(4), 1976. The rest as :func:`quatprop.comparison.clock_error.clock_error`.
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
    """Return the offset, ns, at which angular speeds correlate best, and the next best correlation.

    The speeds are the same however attitudes were read, aligned and mounted.
    """
    step = _step_ns(a, b)
    speed_a, speed_b = (_angles(one, int(one.t_ns[0]), int(one.t_ns[-1]), step) for one in (a, b))
    for name, speed in (("A", speed_a), ("B", speed_b)):
        if speed.std() <= MIN_VARIATION * speed.mean():
            raise ComparisonError(
                f"{name} turns at a constant speed, which shows no time offset; {GIVE_OFFSET}"
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
    """Return the angle of each step from start to stop, rad."""
    regular, _ = interpolate(series, np.arange(start, stop + 1, step, dtype=np.int64))
    return geodesic_angle(regular[:-1], regular[1:])


def _correlations(x: Float64, y: Float64) -> Float64:
    """Return Pearson's correlation at every lag from -(len(y) - 1) to len(x) - 1.

    It is taken over the overlap; where that is too short, or one of the two does not vary there,
    it is 0. A positive lag means that y has to come later.
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
    # Below that nothing but rounding is left.
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
    """Return the highest correlation outside the peak, whose feet are the nearest minima."""
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
