"""Decimate attitudes, or compute them at other times, exactly by the integration rule.

Attitudes are not interpolated. The rule defines the rotation between two samples, so the attitude
at a time in between is the previous one times the step over the elapsed part of the interval.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S, regular_count, regular_stamps
from quatprop.kinematics.increments import (
    AFTER,
    BEFORE,
    RULES,
    SAMPLES,
    Curvature,
    Quintic,
    curvature,
    curvature_of_averages,
    quintic,
    quintic_of_averages,
    windows_over,
)
from quatprop.kinematics.quaternion import (
    conjugate,
    exp,
    geodesic_angle,
    log,
    multiply,
    normalize,
    reference_covariance,
    rotate,
    shorter,
)
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.kinematics.time_series import blocks, with_next
from quatprop.settings.quantities import CORRECT_CONING, LOOK_AHEAD

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from fractions import Fraction

    from quatprop.base.arrays import Bool, Float64, Int64, Intp
    from quatprop.kinematics.increments import Windows

    Turn = Callable[[Float64, Float64], Float64]


PIECE = 1 << 17
"""Times in a batch: bounds memory, and keeps products with a regular period in 64 bits."""


def every(series: Iterable[AttitudeSeries], step: int) -> Iterator[AttitudeSeries]:
    """Yield every N-th attitude, beginning with the first."""
    count = 0
    for batch in series:
        chosen = batch[-count % step :: step]
        count += len(batch)
        if len(chosen):
            yield chosen


MAX_ROWS = 10_000_000
"""Maximum number of times between two samples; more are due to a wrong timestamp."""

MAX_PER_SAMPLE = 10_000
"""Maximum number of times per sample of a block; more are due to a wrong rate."""


class Steady:
    """Times at a fixed rate, from the first sample on.

    `rate`: times per second, Hz. The k-th time is k / rate, rounded to the nearest ns, without
        drift
    """

    def __init__(self, rate: Fraction) -> None:
        self._rate = rate
        self._origin: int | None = None
        self._next = 0

    def up_to(self, first_ns: int, last_ns: int) -> Iterator[Int64]:
        """Yield the times after the previous call's `last_ns`, up to and including this one."""
        if self._origin is None:
            self._origin = first_ns
        first = max(self._next, regular_count(first_ns - self._origin - 1, self._rate))
        self._next = stop = max(first, regular_count(last_ns - self._origin, self._rate))
        for start in range(first, stop, PIECE):
            yield self._origin + regular_stamps(start, min(start + PIECE, stop), self._rate)

    def refuse_excess(self, t_ns: Int64) -> None:
        """Refuse samples with too many times in between: a timestamp must be wrong."""
        if len(t_ns) < 2:  # noqa: PLR2004  # the ends of an interval
            return
        longest = int(np.argmax(np.diff(t_ns)))
        before, after = t_ns[longest : longest + 2].tolist()
        rows = (after - before) * self._rate / NS_PER_S
        if rows > MAX_ROWS:
            raise UsageError(
                f"between the samples at {before} and {after} ns there would be {int(rows):,} "
                f"attitudes at {float(self._rate):.6g} Hz; is a timestamp wrong? Choose "
                f"{Setting('on_gap', 'split')}, a lower {Setting('rate')}, or omit a part "
                f"with {Setting('start')} or {Setting('end')}"
            )
        rows = int(t_ns[-1] - t_ns[0]) * self._rate / NS_PER_S
        if rows > MAX_ROWS and rows > MAX_PER_SAMPLE * len(t_ns):
            raise UsageError(
                f"between {len(t_ns)} samples from {t_ns[0]} to {t_ns[-1]} ns there would be "
                f"{int(rows):,} attitudes at {float(self._rate):.6g} Hz; choose a lower "
                f"{Setting('rate')}",
            )


class Listed:
    """A list of times.

    `t_ns`: times in order, shape ``(N,)``, int64 ns
    """

    def __init__(self, t_ns: Int64) -> None:
        self._t_ns = t_ns
        self._next = 0

    def __len__(self) -> int:
        return len(self._t_ns)

    def count_outside(self, first_ns: int, last_ns: int) -> int:
        """Return the number of times before or after a range."""
        first = int(np.searchsorted(self._t_ns, first_ns))
        return len(self) - int(np.searchsorted(self._t_ns, last_ns, side="right")) + first

    def up_to(self, first_ns: int, last_ns: int) -> Iterator[Int64]:
        """Yield the next times, as :meth:`Steady.up_to`."""
        first = max(self._next, int(np.searchsorted(self._t_ns, first_ns)))
        self._next = stop = max(first, int(np.searchsorted(self._t_ns, last_ns, side="right")))
        for start in range(first, stop, PIECE):
            yield self._t_ns[start : min(start + PIECE, stop)]


Times: TypeAlias = Steady | Listed
"""The times at which attitudes are wanted."""


def at_times(
    propagated: Iterable[tuple[GyroSeries, AttitudeSeries]],
    times: Times,
    *,
    method: str,
    rates: str,
    gap_limit_ns: int | None = None,
) -> Iterator[AttitudeSeries]:
    """Yield attitudes at the wanted times of one segment.

    `gap_limit_ns`: no rotation is assumed in longer intervals; None for no limit
    """
    first_ns = None
    last: tuple[GyroSeries, AttitudeSeries] | None = None
    pairs = with_next(propagated, look_ahead=method in LOOK_AHEAD)
    for (block, attitudes), following in pairs:
        first_ns = int(block.t_ns[0]) if first_ns is None else first_ns
        gyro, known = block, attitudes
        if last is not None:
            # The interval between blocks begins with the last sample of the previous block, and a
            # polynomial needs further samples of it.
            gyro = GyroSeries.joined([last[0], block])
            known = AttitudeSeries.joined([last[1], attitudes])
        wxyz = known.wxyz
        last = gyro[-BEFORE:], known[-BEFORE:]
        if isinstance(times, Steady):
            times.refuse_excess(gyro.t_ns)
        after = gyro[-1:] if following is None else following[0][:AFTER]
        if rates == "inertial":
            # The conjugates are propagated with the opposite rates on the right.
            gyro, after = gyro.with_rate(-gyro.rate), after.with_rate(-after.rate)
            wxyz = conjugate(wxyz)
        polynomials = _rate_polynomials(GyroSeries.joined([gyro, after]), method, gap_limit_ns)
        for wanted in times.up_to(first_ns, int(gyro.t_ns[-1])):
            between = _between(gyro, wxyz, wanted, method, polynomials)
            if gap_limit_ns is not None:
                at = np.searchsorted(gyro.t_ns, wanted, side="right") - 1
                inside = np.diff(gyro.t_ns, append=gyro.t_ns[-1])[at] > gap_limit_ns
                between = np.where(inside[:, None], wxyz[at], between)
            if rates == "inertial":
                between = conjugate(between)
            yield with_columns(known, wanted, between, rates)


def with_columns(known: AttitudeSeries, wanted: Int64, wxyz: Float64, rates: str) -> AttitudeSeries:
    """Return attitudes between known ones, with the other columns interpolated.

    Rates are linear in time in the axes in which they are resolved; covariances in the other axes,
    in which they are sums of integrals.
    """
    stated = known.read_layout, None, known.lag_ns, known.sensitivity
    others = known.covariance, known.rate, known.position
    if all(values is None for values in others):
        return AttitudeSeries(wanted, wxyz, None, None, None, *stated)
    before = np.searchsorted(known.t_ns, wanted, side="right") - 1
    after = np.minimum(before + 1, len(known) - 1)
    interval = known.t_ns[after] - known.t_ns[before]
    elapsed = wanted - known.t_ns[before]
    fraction = np.divide(elapsed, interval, out=np.zeros(len(wanted)), where=interval > 0)
    inertial = rates == "inertial"

    def between(values: Float64, turn: Turn | None) -> Float64:
        first, second = values[before], values[after]
        if turn is not None:
            first, second = turn(known.wxyz[before], first), turn(known.wxyz[after], second)
        part = fraction.reshape(-1, *[1] * (values.ndim - 1))
        result = first + part * (second - first)
        return result if turn is None else turn(conjugate(wxyz), result)

    position = None if known.position is None else between(known.position, None)
    covariance = rate = None
    if known.covariance is not None:
        covariance = between(known.covariance, None if inertial else reference_covariance)
    if known.rate is not None:
        rate = between(known.rate, rotate if inertial else None)
    return AttitudeSeries(wanted, wxyz, position, covariance, rate, *stated)


class _RatePolynomials(NamedTuple):
    """The polynomials of the rate between samples, for methods that have some."""

    curvature: Curvature | None
    quintic: Quintic | None


def _rate_polynomials(gyro: GyroSeries, method: str, gap_ns: int | None) -> _RatePolynomials:
    """Return the polynomials of the rate between samples."""
    t_ns, rate, integration_time_ns = gyro.t_ns, gyro.rate.T, gyro.integration_time_ns
    if gyro.is_integrated(method) and method in CORRECT_CONING:
        causal = method == "coning"
        curved = curvature_of_averages(
            t_ns, rate, integration_time_ns, gap_ns=gap_ns, causal=causal
        )
        if method != "quintic":
            return _RatePolynomials(curved, None)
        return _RatePolynomials(
            curved, quintic_of_averages(t_ns, rate, integration_time_ns, gap_ns)
        )
    return _RatePolynomials(
        curvature(t_ns, rate, gap_ns) if method in LOOK_AHEAD else None,
        quintic(t_ns, rate, gap_ns) if method == "quintic" else None,
    )


def _between(
    gyro: GyroSeries, wxyz: Float64, wanted: Int64, method: str, polynomials: _RatePolynomials
) -> Float64:
    """Return the attitudes at some times within the samples, ``(M, 4)``."""
    before = np.searchsorted(gyro.t_ns, wanted, side="right") - 1
    after = np.minimum(before + 1, len(gyro) - 1)
    elapsed = (wanted - gyro.t_ns[before]) / NS_PER_S
    interval = (gyro.t_ns[after] - gyro.t_ns[before]) / NS_PER_S
    fraction = np.divide(elapsed, interval, out=np.zeros_like(interval), where=interval > 0)
    first, second = gyro.rate[before].T, gyro.rate[after].T
    curvature = None if polynomials.curvature is None else polynomials.curvature.at(before)
    if gyro.is_integrated(method):
        # The integration time of an increment may differ from the interval between timestamps.
        if gyro.integration_time_ns is not None:
            elapsed = fraction * (gyro.integration_time_ns[after] / NS_PER_S)
        rotvec = RULES["end"](first, second, elapsed)
        if curvature is not None:
            rotvec += curvature.rotation_of_averages(second, elapsed)
    else:
        if method != "end":
            # The rate is linear between the samples.
            second = first + fraction * (second - first)
        if curvature is not None:
            second += curvature.rate(elapsed)
        rotvec = RULES[method](first, second, elapsed)
        if curvature is not None:
            rotvec += curvature.rotation(elapsed)
    if polynomials.quintic is not None:
        polynomials.quintic.at(before).replace(rotvec, elapsed)
    attitudes = multiply(wxyz[before], exp(rotvec.T))
    # At a sample the attitude is that of the sample, to the bit.
    return np.asarray(np.where((fraction == 0)[:, None], wxyz[before], attitudes))


# Interpolation between the attitudes of a series, with a polynomial through the neighbours.
#
# The rotation at the constant rate from sample k to sample k + 1 is extrapolated to the
# neighbouring samples. The deviations of their attitudes from it, as rotation vectors, are zero at
# k and k + 1; a polynomial through all of them is added to the rotation at the constant rate. So
# the polynomial is of small rotations, whatever the rate, and without neighbours the result is
# slerp.


MAX_DEVIATION: Final = 1.0
"""Larger deviations, rad, are not of smooth motion: the rate is then held constant."""

MAX_SPEED_RATIO: Final = 4.0
"""An interval in which the motion is faster than in its neighbours by a larger factor is a jump.
Smooth motion had up to 2.7, with frequencies up to a third of the sample rate."""

FAR_NS: Final = np.iinfo(np.int64).max


class Interpolated(NamedTuple):
    """Attitudes between samples.

    `wxyz`: unit quaternions, shape ``(N, 4)``
    `interpolation_error_rad`: estimate of the largest error: the difference from two neighbours
        fewer or, if the rate is held constant, the effect of a steady change of the rate
    """

    wxyz: Float64
    interpolation_error_rad: float


def interpolate(series: AttitudeSeries, t_ns: Int64) -> Interpolated:
    """Return the attitudes of a series at times within it.

    `t_ns`: times, shape ``(N,)``, int64 ns; outside the series the nearest interval is continued
    `Returns`: the attitudes; at a timestamp exactly that of the sample
    """
    wxyz, floor = np.empty((len(t_ns), 4)), 0.0
    steps = np.diff(series.t_ns)
    # For the polynomials a jump is a gap: they end on both sides of it.
    windows = windows_over(np.where(_jumps(series, steps), FAR_NS, steps), steps, FAR_NS - 1)
    for rows in blocks(len(t_ns)):
        wxyz[rows], part = _interpolated(series, windows, t_ns[rows])
        floor = max(floor, part)
    return Interpolated(wxyz, floor)


def _jumps(series: AttitudeSeries, steps: Int64) -> Bool:
    """Return the intervals that are far faster than the two on either side."""
    speed = geodesic_angle(series.wxyz[:-1], series.wxyz[1:]) / steps
    near = np.pad(speed, 2)
    neighbours = np.max([near[k : k + len(speed)] for k in (0, 1, 3, 4)], axis=0)
    return np.asarray(speed > MAX_SPEED_RATIO * neighbours)


def _interpolated(series: AttitudeSeries, windows: Windows, t_ns: Int64) -> Interpolated:
    before = np.clip(np.searchsorted(series.t_ns, t_ns, side="right") - 1, 0, len(series) - 2)
    start, stop = series.t_ns[before], series.t_ns[before + 1]
    fraction = (t_ns - start) / (stop - start)
    rotvec = _vectors_between(series.wxyz[before], series.wxyz[before + 1])
    inside = (fraction > 0) & (fraction < 1)
    chosen = np.flatnonzero(inside & windows.usable[before])
    six, four, smooth = _corrections(
        series, before[chosen], windows.start[before[chosen]], fraction[chosen], rotvec[chosen]
    )
    correction = np.zeros((len(t_ns), 3))
    correction[chosen] = six
    left = np.linalg.norm(six - four, axis=1).max(initial=0.0)
    inside[chosen[smooth]] = False
    held = np.flatnonzero(inside)
    held_error = _constant_rate_error(series, before[held], fraction[held], rotvec[held])
    step = multiply(exp(fraction[:, None] * rotvec), exp(correction))
    wxyz = normalize(multiply(series.wxyz[before], step))
    wxyz[t_ns == stop] = normalize(series.wxyz[before + 1][t_ns == stop])
    return Interpolated(wxyz, max(left, float(held_error.max(initial=0.0))))


def _constant_rate_error(
    series: AttitudeSeries, before: Intp, fraction: Float64, rotvec: Float64
) -> Float64:
    """Return the error of a constant rate, estimated from both neighbouring samples, rad, (N,).

    With a steadily changing rate, deviations are proportional to the product of the times since
    both ends of the interval.
    """
    begin, length = series.t_ns[before], series.t_ns[before + 1] - series.t_ns[before]
    error = np.zeros(len(before))
    for neighbour in (-1, 2):
        node = np.clip(before + neighbour, 0, len(series) - 1)
        at = (series.t_ns[node] - begin) / length
        held = multiply(series.wxyz[before], exp(at[:, None] * rotvec))
        size = np.linalg.norm(_vectors_between(held, series.wxyz[node]), axis=1)
        # At the ends of the series the node is an end of the interval itself.
        apart = np.where((at < 0) | (at > 1), at * (at - 1), np.inf)
        error = np.maximum(error, size * fraction * (1 - fraction) / apart)
    return error


def _corrections(
    series: AttitudeSeries, before: Intp, start: Intp, fraction: Float64, rotvec: Float64
) -> tuple[Float64, Float64, Bool]:
    """Return corrections of attitudes at a constant rate, as rotation vectors ``(N, 3)``.

    `before`, `fraction`: indices of the samples before the wanted times, and the elapsed fractions
        of the intervals, ``(N,)``
    `start`: index of the first of the six samples, ``(N,)``
    `rotvec`: the rotation vectors of the intervals, ``(N, 3)``
    `Returns`: by all six samples, by the nearest four, and whether the motion is smooth, ``(N,)``;
        otherwise both corrections are zero
    """
    begin, length = series.t_ns[before], series.t_ns[before + 1] - series.t_ns[before]
    at = [(series.t_ns[start + node] - begin) / length for node in range(SAMPLES)]
    inner = np.clip(before - 1, start, start + 2) - start
    near = [(inner <= node) & (node < inner + 4) for node in range(SAMPLES)]
    (six, four), smooth = np.zeros((2, *rotvec.shape)), np.ones(len(rotvec), np.bool_)
    for node in range(SAMPLES):
        held = multiply(series.wxyz[before], exp(at[node][:, None] * rotvec))
        deviation = _vectors_between(held, series.wxyz[start + node])
        smooth &= np.linalg.norm(deviation, axis=1) <= MAX_DEVIATION
        weights = np.ones(len(rotvec)), near[node].astype(float)
        for other in set(range(SAMPLES)) - {node}:
            factor = (fraction - at[other]) / (at[node] - at[other])
            weights[0][:] *= factor
            weights[1][near[other]] *= factor[near[other]]
        six += weights[0][:, None] * deviation
        four += weights[1][:, None] * deviation
    six[~smooth] = four[~smooth] = 0.0
    return six, four, smooth


def _vectors_between(p: Float64, q: Float64) -> Float64:
    """Return the rotation vectors of the shorter rotations from p to q, ``(N, 3)``, rad."""
    return log(shorter(multiply(conjugate(p), q)))
