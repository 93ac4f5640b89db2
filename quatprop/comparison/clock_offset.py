"""The offset between the clocks of two series, from the motion that both recorded.

The angular speed of a rigid body is the same in every frame, so it can be correlated before the
frames are aligned. The normalised cross-correlation of both series, interpolated at regular times,
gives a coarse offset; least squares over windows, with the body frames aligned, refines it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import ComparisonError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S
from quatprop.comparison.alignment import (
    MAX_EDGE_S,
    PER_WINDOW,
    BodyAngle,
    body_angle,
    centred,
    common_beginning,
    kabsch,
    window_grids,
)
from quatprop.comparison.association import interval_ns, shifted
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.kinematics.resample import interpolate

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64, Int64, Intp
    from quatprop.kinematics.series import AttitudeSeries


# Least squares estimate of the offset and drift between clocks, from windows of common motion.


GRID_WINDOWS = 200
"""Approximate number of windows of the initial grid search."""

MAX_ROUNDS = 30
"""Maximum number of least squares iterations."""

MIN_BLOCKS = 10
"""Minimum number of blocks of windows for the jackknife."""

BLOCK_S = 2.0
"""Maximum length of such a block, s: errors further apart are assumed independent."""


class ClockError(NamedTuple):
    """The error of B's clock: an offset, and possibly a constant drift.

    `seconds`: offset at `middle`, s, to be added to B's timestamps
    `ratio`: drift of the offset, s/s
    `std`: standard deviation of the drift, s/s, or without a drift, of the offset, s
    `white_std`: standard deviation of the offset for white noise, s. It selects the length of
        windows: selecting by `std`, itself an estimate, would favour accidentally low ones
    `middle`: middle of the time from which it was estimated, s
    `span`: length of this time, s
    """

    seconds: float
    ratio: float
    std: float
    white_std: float
    middle: float
    span: float

    def at(self, seconds: Float64) -> Float64:
        """Return the offset at given times, s."""
        return self.seconds + self.ratio * (seconds - self.middle)


def clock_errors(
    a: AttitudeSeries, b: AttitudeSeries, offset_ns: int, *, turned: bool = True
) -> tuple[ClockError, ClockError, int] | None:
    """Return the clock error without and with drift, and the origin of their times, ns.

    None if there are too few windows. Of all lengths of windows, the most certain one is used.

    `offset_ns`: offset that is added to B's timestamps first, ns
    `turned`: whether the body frames may differ
    """
    a, b = common_beginning(a, shifted(b, offset_ns))
    first_ns = min(int(a.t_ns[0]), int(b.t_ns[0]))
    of_a, of_b = body_angle(a, first_ns), body_angle(b, first_ns)
    found = [
        (clock_error(of_a, of_b, *grid, turned=turned), grid)
        for grid in window_grids(of_a.seconds, of_b.seconds)
    ]
    if not found:
        return None
    clock, grid = min(found, key=lambda one: one[0].white_std)
    changing = clock_error(of_a, of_b, *grid, clock.seconds, turned=turned, drifts=True)
    return clock, changing, first_ns


def clock_error(  # noqa: PLR0913  # two angles, and windows of them
    a: BodyAngle,
    b: BodyAngle,
    length: float,
    starts: Float64,
    begin: float | None = None,
    *,
    turned: bool = True,
    drifts: bool = False,
) -> ClockError:
    """Estimate the error of B's clock by least squares over windows.

    The information is the product of the slopes of A and B: the square of B's alone would include
    its noise, and overstate the certainty. The standard deviation is a block jackknife, so it holds
    for coloured noise; it is infinite if the windows do not show the offset.

    `begin`: initial offset, s; None: from a grid search
    `turned`: whether the body frames may differ

    References
    ----------
    Efron and Stein, "The jackknife estimate of variance", Annals of Statistics 9(3), 1981.
    """
    middle, span = float(starts.mean()), float(starts[-1] - starts[0])
    # The offset is a sum of terms with coefficients.
    terms = np.stack([np.ones_like(starts), starts - middle][: 1 + drifts])
    coefficients = np.zeros(len(terms))
    coefficients[0] = _on_grid(a, b, length, starts, turned) if begin is None else begin

    def clock(std: float, white_std: float) -> ClockError:
        seconds, ratio = np.append(coefficients, 0.0)[:2].tolist()
        return ClockError(seconds, ratio, std, white_std, middle, span)

    step = length / 8
    largest = np.abs(terms).max(axis=1)
    y, slope_a = a.over(starts, length), _slope(a, starts, length, step)
    for _ in range(MAX_ROUNDS):
        moved = starts - coefficients @ terms
        x, slope = b.over(moved, length), _slope(b, moved, length, step)
        if turned:
            turn, _ = kabsch(x, y)
            x, slope = x @ turn.T, slope @ turn.T
        error = y - x
        scores = terms * (slope * error).sum(axis=1)
        powers = terms[:, None] * terms * (slope_a * slope).sum(axis=1)
        power = powers.sum(axis=2)
        if power[0, 0] <= 0 or np.linalg.det(power) <= 0:
            return clock(np.inf, np.inf)
        move = np.linalg.solve(power, scores.sum(axis=1))
        coefficients += np.clip(move, -step / largest, step / largest)
        if (np.abs(move * largest) * NS_PER_S < 1).all():
            break
    # The change of the result when one block of windows is left out.
    block = _blocks(starts, length)
    score_of, power_of = (
        np.stack([np.bincount(block, row) for row in rows], axis=1)
        for rows in (scores, powers.reshape(-1, len(starts)))
    )
    left = power - power_of.reshape(-1, *power.shape)
    if (np.linalg.det(left) <= 0).any():
        return clock(np.inf, np.inf)
    changes = np.linalg.solve(left, score_of[..., None])[..., 0]
    white_std = np.sqrt((error**2).mean() * PER_WINDOW / power[0, 0])
    return clock(float(np.sqrt((changes**2).sum(axis=0))[-1]), float(white_std))


def _on_grid(a: BodyAngle, b: BodyAngle, length: float, starts: Float64, turned: bool) -> float:
    """Return the offset with the smallest residual on a grid, s."""
    few = starts[:: max(len(starts) // GRID_WINDOWS, 1)]
    reach = min(MAX_EDGE_S, float(few[0] - max(a.seconds[0], b.seconds[0])))
    y = a.over(few, length)
    grid = np.linspace(-reach, reach, 2 * int(np.ceil(reach / (length / 4))) + 1)

    def remaining(at: float) -> float:
        x = b.over(few - at, length)
        x = x @ kabsch(x, y)[0].T if turned else x
        return float(((y - x) ** 2).sum())

    return float(min(grid, key=remaining))


def _slope(angle: BodyAngle, starts: Float64, length: float, step: float) -> Float64:
    """Return the derivative of rotations over windows with respect to a time offset."""
    earlier, later = (angle.between(at, at + length) for at in (starts - step, starts + step))
    return centred((earlier - later) / (2 * step))


def _blocks(starts: Float64, length: float) -> Intp:
    """Return the block of each window; only windows of neighbouring blocks overlap."""
    span = float(starts[-1] - starts[0])
    block = max(length, min(BLOCK_S, span / MIN_BLOCKS))
    return np.asarray(((starts - starts[0]) // block).astype(np.intp))


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
    Trans. ASSP 24(4), 1976. See also :func:`quatprop.comparison.clock_offset.clock_error`.
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
