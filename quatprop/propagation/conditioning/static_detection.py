"""Static detection: find the periods of a log in which the sensor was at rest.

A log is divided into windows of equal duration, of which only sums are kept. The sensor is at rest
over neighbouring windows in which the rates and the specific force have little scatter and the same
mean, and the recorded orientation, if there is one, does not turn.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.text import Setting
from quatprop.base.times import duration_text
from quatprop.kinematics.propagate import rotation_vectors_between
from quatprop.propagation.conditioning.static_period import (
    AT_REST,
    COMPARED,
    WIDENS,
    OtherRest,
    StaticPeriod,
    StepFinder,
    aligned_window_sums,
    between,
    levels_of,
    mean_of,
    merged,
    outer_products,
    scatter_of,
    variances_of,
    window_sums,
)
from quatprop.timeline.time_range import absolute_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from quatprop.base.arrays import Bool, Float64, Int64, Intp
    from quatprop.kinematics.series import GyroSeries
    from quatprop.propagation.conditioning.correction_inputs import GyroCorrectionInputs
    from quatprop.propagation.conditioning.static_period import Rows, WindowSums
    from quatprop.settings.bias import StaticBias
    from quatprop.timeline.time_range import EndsFinder

    Turns: TypeAlias = Callable[[Intp, Float64], tuple[Float64, Float64]]


FORCE_AT_REST = 0.1
"""Maximum scatter of the specific force at rest, as a share of its magnitude."""

REST_FACTOR = 3.0
"""Maximum scatter at rest, relative to the quietest pair of neighbouring windows."""

QUIET, FORCE_QUIET = 1e-3, 0.01
"""Scatter that is always quiet: of rates, rad/s; of forces, as a share of the magnitude."""

AGREEMENT, FORCE_AGREEMENT = 3e-3, 0.01
"""Maximum difference of means in one period beyond noise: of rates, rad/s per axis; of forces, as a
share of the magnitude (direction, rad)."""

SHOWN = 8.0
"""How far, in terms of its noise, another signal has to turn to show a rotation."""

EASES = (1.0, 3.0, 9.0, 27.0)
"""Factors of these limits, the strictest first, until a rest lasts."""

LASTING, SHARE = (5, 20), 0.2
"""How long a mean must be steady, in all periods that agree on it: a share of the longest such
time, but at least and at most these numbers of windows, and half of that time at most."""

MOST_COMPARED = 1000
"""Number of periods, the longest ones, that others may agree with."""

NOISE = 4.0
"""Maximum difference of means in standard errors."""

LARGEST_BIAS = 0.2
"""Maximum plausible bias, rad/s. Data sheets of low-cost gyroscopes allow up to 20 deg/s (0.35
rad/s), but a car in a circle turns as fast, and common sensors are better than that."""

MIN_SAMPLES = 2
"""Minimum number of samples of a period, to estimate its scatter."""

TURNING = 5e-3
"""Rate of a signal, rad/s, below which it is constant."""


class NoRestError(UsageError):
    """The log has no stationary period, for the reason in the message."""


@np.errstate(over="ignore", invalid="ignore")  # of rates of a damaged log
def find_static_periods(
    rates: WindowSums, inputs: GyroCorrectionInputs, static: StaticBias, frame: str
) -> list[StaticPeriod]:
    """Return the stationary period for the bias, or all periods for a bias over time.

    A constant rotation is as quiet as rest. Of lasting periods with different means, the one with
    the smallest rate is therefore assumed to be at rest; of those that agree with it, the longest
    is returned.

    `frame`: ``"body"`` or ``"inertial"``
    """
    rests, unconfirmed, steady = _rests(rates, inputs, static.window_ns, frame)
    if static.between is not None:
        known = _comparable(rests, steady)
        rests, unconfirmed = rests[known], unconfirmed[known]
        each = enumerate(unconfirmed.tolist())
        return [_period(rests, taken, rates, steady, part) for taken, part in each]
    lengths = rests["last_ns"] - rests["first_ns"]
    longest = int(np.argmax(np.where(_agreeing(rests), lengths, -1)))
    return [_period(rests, longest, rates, steady, float(unconfirmed[longest]))]


@np.errstate(over="ignore", invalid="ignore")  # of rates of a damaged log
def static_period_between(
    rest: WindowSums,
    static: StaticBias,
    rates: WindowSums,
    inputs: GyroCorrectionInputs,
    frame: str,
) -> StaticPeriod:
    """Return a period given by the user, compared with the periods found.

    `rest`: sums over the given period
    `rates`: sums over the windows of the whole log
    """
    if not len(rest) or rest["count"][0] < MIN_SAMPLES:
        raise UsageError(
            f"{Setting('bias', str(static))} holds fewer than {MIN_SAMPLES} samples; info shows "
            "where the log begins and ends"
        )
    if (speed := float(np.linalg.norm(mean_of(rest)))) > LARGEST_BIAS:
        raise UsageError(
            f"{Setting('bias', str(static))} has a mean rate of {speed:.3g} rad/s, more than the "
            f"bias of a gyroscope: the body rotates; name a time at rest, or give "
            f"{Setting('bias', 'X,Y,Z')}"
        )
    try:
        found, _, steady = _rests(rates, inputs, static.window_ns, frame)
    except NoRestError:
        found, steady = rest[:0], ["rate"]
    return _period(np.concatenate([rest, found]), 0, rates, steady)


class _Signals(NamedTuple):
    """Sums over windows of the signals that may show rest, and what they are of.

    `frame`: ``"body"`` or ``"inertial"``: the frame in which the rates are resolved
    `shortest_ns`: the shortest rest, ns
    """

    rates: WindowSums
    forces: WindowSums | None
    orientations: WindowSums | None
    frame: str
    shortest_ns: int


def _rests(
    rates: WindowSums, inputs: GyroCorrectionInputs, shortest_ns: int, frame: str
) -> tuple[WindowSums, Float64, list[str]]:
    """Return the sums over each stationary period, and the signals that confirm them.

    In between, the part of the mean of each that these do not tell from a rotation, rad/s.
    """
    if not len(rates):
        raise _no_rest(": too few samples")
    window_ns = max(shortest_ns // 2, 1)
    forces = None if inputs.force is None else aligned_window_sums(rates, inputs.force(), window_ns)
    own = None if inputs.orientation is None else outer_products(inputs.orientation())
    orientations = None if own is None else aligned_window_sums(rates, own, window_ns, 16)
    signals = _Signals(rates, forces, orientations, frame, shortest_ns)
    periods, steady = _quiet_periods(signals)
    first = np.array([0])
    rests = np.concatenate([merged(rates[period], first) for period in periods])
    rests = rests[lasting := _lasting(rests, window_ns)]
    mean = mean_of(rests)
    unconfirmed = np.linalg.norm(mean, axis=1) * ("orientation" not in steady)
    if steady[-1] == "accelerometer" and forces is not None:
        sums = np.concatenate([merged(forces[period], first) for period in periods])
        unconfirmed = np.abs((_directions(sums)[lasting] * mean).sum(axis=1))
    return rests, unconfirmed, steady


def _quiet_periods(signals: _Signals) -> tuple[list[Intp], list[str]]:
    """Return the windows of each quiet period, and the signals that show them.

    What is quiet is by the quietest windows. Where these are of a filter that settles, or repeats a
    value, a rest that is much longer and has noise is beyond the limits: these are then larger.
    """
    found: list[tuple[int, list[Intp], list[str]]] = []
    refused: list[NoRestError] = []
    for ease in EASES:
        try:
            periods, steady = _periods_within(signals, ease)
        except NoRestError as error:
            refused.append(error)
            continue
        length = max(map(len, periods))
        # In a motion, rates may hardly change over a few windows.
        if ease == 1 or length >= LASTING[0]:
            found.append((length, periods, steady))
        if length >= LASTING[1]:
            break
    if not found:
        raise refused[0]
    wanted = min(SHARE * max(length for length, *_ in found), LASTING[1])
    return next((periods, steady) for length, periods, steady in found if length >= wanted)


def _periods_within(signals: _Signals, ease: float) -> tuple[list[Intp], list[str]]:
    """Return the same for limits that are larger by a factor."""
    rates, forces, orientations, frame, shortest_ns = signals
    quiet = _quiet_rates(rates, ease)
    constant, steady = [(rates, AGREEMENT)], ["rate"]
    size = 0.0 if forces is None else _gravity(forces[quiet])
    if forces is not None and size:
        quiet = _quiet_forces(forces, quiet, size, ease)
        if frame == "body":
            quiet = _without_turns(rates, quiet, "gravity in the sensor", _turns_of_gravity(forces))
        constant.append((forces, FORCE_AGREEMENT * size))
        steady.append("accelerometer")
    if orientations is not None:
        own = _turns_of_orientation(orientations, frame)
        quiet = _without_turns(rates, quiet, "the log's own orientation", own)
        steady.append("orientation")
    if not (periods := _periods(rates, quiet, constant)):
        raise _no_rest(f" that lasts {duration_text(shortest_ns)} (by {' and '.join(steady)})")
    return periods, steady


def _lasting(rests: WindowSums, window_ns: int) -> Bool:
    """Return which periods last, together with those of about the same mean.

    In the middle of a motion, rates may hardly change over two windows. A rotation, however long,
    does not make a rest too short.
    """
    lengths, means = rests["last_ns"] - rests["first_ns"], mean_of(rests)
    longest = np.argsort(-lengths, kind="stable")[:MOST_COMPARED]
    of_longest, totals = means[longest], np.zeros(len(rests))
    for period in range(len(rests)):
        apart = np.abs(of_longest - means[period]).max(axis=1)
        totals[period] = max(lengths[longest][apart <= AGREEMENT].sum(), lengths[period])
    least, enough = (number * window_ns for number in LASTING)
    speeds = np.linalg.norm(means, axis=1) + LARGEST_BIAS * (totals < min(least, totals.max()))
    near = np.abs(means - means[np.argmin(speeds)]).max(axis=1) <= COMPARED
    most = totals[near].max()
    return np.asarray(totals >= min(max(least, SHARE * most), enough, most / 2))


def _agreeing(rests: WindowSums, agreement: float = AGREEMENT) -> Bool:
    """Return which periods have about the mean of the slowest one."""
    mean = mean_of(rests)
    slowest = mean[np.argmin((mean**2).sum(axis=1))]
    return np.asarray(np.abs(mean - slowest).max(axis=1) <= agreement)


def _period(
    rests: WindowSums,
    taken: int,
    rates: WindowSums,
    confirmed: list[str],
    unconfirmed: float | None = None,
) -> StaticPeriod:
    """Return one of several stationary periods.

    `confirmed`: the signals that confirm the others
    `unconfirmed`: the part of its mean that these do not confirm, rad/s; None if the user gave it
    """
    rest = rests[taken]
    apart = np.abs(mean_of(rests) - mean_of(rests)[taken])
    apart[~_comparable(rests, confirmed)] = 0.0
    variances = variances_of(rests)
    by_noise = variances / rests["count"][:, None]
    errors = np.sqrt(by_noise + by_noise[taken])
    return StaticPeriod(
        first_ns=int(rest["first_ns"]),
        last_ns=int(rest["last_ns"]),
        samples=int(rest["count"]),
        mean_rad_s=mean_of(rests)[taken],
        scatter_rad_s=float(scatter_of(rests)[taken]),
        noisiest_rad_s=math.sqrt(variances[taken].max()),
        steady=() if unconfirmed is None else tuple(confirmed),
        unconfirmed_rad_s=unconfirmed or 0.0,
        searched_first_ns=int(rates["first_ns"].min()),
        searched_last_ns=int(rates["last_ns"].max()),
        other=_other(rests, np.where(apart > NOISE * errors, apart, 0.0).max(axis=1)),
        spread_rad_s=float(apart[apart > WIDENS * errors].max(initial=0.0)),
    )


def _comparable(rests: WindowSums, confirmed: list[str]) -> Bool:
    """Return which are comparable: without an orientation, one far off is a constant rotation."""
    return _agreeing(rests, math.inf if "orientation" in confirmed else COMPARED)


def _other(rests: WindowSums, apart: Float64) -> OtherRest | None:
    """Return the period that differs most, or None if none differs."""
    most = int(np.argmax(apart))
    ends = int(rests["first_ns"][most]), int(rests["last_ns"][most])
    return OtherRest(*ends, float(apart[most])) if apart[most] else None


def _quiet_rates(rates: WindowSums, ease: float) -> Intp:
    """Return the windows with rates that may be those of a gyroscope at rest."""
    # Windows with few samples are ignored.
    full = rates["count"] >= max(2.0, np.median(rates["count"]) / 2 if len(rates) else 0.0)
    windows = np.flatnonzero(full)
    if not len(windows):
        raise _no_rest(": too few samples")
    scatter, speed = scatter_of(rates[windows]), np.linalg.norm(mean_of(rates[windows]), axis=1)
    steady = scatter <= AT_REST
    if not steady.any():
        raise _no_rest(f" (the rates scatter by at least {scatter.min():.3g} rad/s)")
    slow = steady & (speed <= LARGEST_BIAS)
    if not slow.any():
        raise NoRestError(
            f"its steadiest period has a mean rate of {speed[steady].min():.3g} rad/s, "
            "more than the bias of a gyroscope: the body rotates"
        )
    # So are windows of zeros, of a sensor that has not started, unless there are no others.
    measured = slow & rates["squares"][windows].any(axis=1)
    slow = measured if measured.any() else slow
    windows = windows[slow]
    return np.asarray(windows[_quiet(rates[windows], scatter[slow], QUIET, ease)])


def _gravity(forces: WindowSums) -> float:
    """Return the magnitude of the specific force in windows; 0 if it holds no gravity.

    Phones and filters also give accelerations from which gravity was subtracted: at rest noise.
    """
    if not forces["count"].any():
        return 0.0
    size, scatter = np.linalg.norm(mean_of(forces), axis=1), scatter_of(forces)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_noise = WIDENS * scatter / np.sqrt(forces["count"])
    is_noise = (size < scatter) & (size < by_noise)
    usual = float(np.nanmedian(size))
    return 0.0 if is_noise.sum() > (forces["count"] > 0).sum() / 2 else usual


def _quiet_forces(forces: WindowSums, windows: Intp, size: float, ease: float) -> Intp:
    """Return those of the given windows in which the specific force is quiet."""
    scatter = scatter_of(forces[windows])
    steady = scatter <= FORCE_AT_REST * size
    if not steady.any():
        raise _no_rest(
            " (where the rates are quiet, the specific force scatters by at least "
            f"{np.nanmin(scatter) / size:.0%}: the body moves)"
        )
    windows = windows[steady]
    return np.asarray(windows[_quiet(forces[windows], scatter[steady], FORCE_QUIET * size, ease)])


def _quiet(windows: WindowSums, scatter: Float64, floor: float, ease: float) -> Bool:
    """Return which windows are about as quiet as the quietest pair of neighbours."""
    pairs = np.maximum(scatter[1:], scatter[:-1])[np.diff(windows["index"]) == 1]
    quietest = float(min(pairs, default=scatter.min()))
    # The scatter of few samples is uncertain.
    by_chance = 2 / np.sqrt(6 * (windows["count"] - 1))
    return np.asarray(scatter * (1 - by_chance) <= ease * max(floor, REST_FACTOR * quietest))


def _periods(rates: WindowSums, quiet: Intp, signals: list[tuple[WindowSums, float]]) -> list[Intp]:
    """Return runs of at least two neighbouring windows over which all means are constant.

    `signals`: sums of each signal, and the maximum difference of its means
    """
    apart = (np.diff(rates["index"][quiet]) != 1) | (np.diff(quiet) != 1)
    periods = []
    for run in np.split(quiet, np.flatnonzero(apart) + 1):
        start, stop = int(run[0]), int(run[-1]) + 1
        while start < stop:
            end = _end_of_agreement(signals, start, stop)
            if end - start > 1:
                periods.append(np.arange(start, end))
            start = end
    return periods


def _end_of_agreement(signals: list[tuple[WindowSums, float]], start: int, stop: int) -> int:
    """Return the first window after `start` that differs from those before it, or `stop`."""
    size = 16
    while True:
        end = min(start + size, stop)
        changed = np.logical_or.reduce(
            [_changes(windows[start:end], limit) for windows, limit in signals]
        )
        if changed.any():
            return start + 1 + int(np.argmax(changed))
        if end == stop:
            return stop
        size *= 4


def _changes(windows: WindowSums, agreement: float) -> Bool:
    """Return which windows, from the second on, differ from the mean of those before them."""
    before = windows.copy()
    for name in ("count", "total", "squares"):
        before[name] = np.cumsum(windows[name], axis=0)
    before, windows = before[:-1], windows[1:]
    apart = np.abs(mean_of(windows) - mean_of(before))
    # A window in which an axis shows one value does not show its noise.
    variances = np.maximum(variances_of(windows), variances_of(before))
    errors = np.sqrt(variances * (1 / windows["count"] + 1 / before["count"])[:, None])
    return np.asarray((apart > np.maximum(agreement, NOISE * errors)).any(axis=1))


def _without_turns(rates: WindowSums, quiet: Intp, name: str, turns: Turns) -> Intp:
    """Return the windows outside of steady rotations, in which a signal turns as the rates say.

    A signal that turns otherwise is drifting or settling.

    `turns`: returns how the signal turns from each window of a period to the next, and how it would
        by a rotation vector in each, both of shape ``(N, 3)``
    """
    middle = rates["first_ns"] + (rates["last_ns"] - rates["first_ns"]) // 2
    turning, speeds = np.zeros(len(rates), np.bool_), []
    for period in _periods(rates, quiet, [(rates, AGREEMENT)]):
        lapse = np.diff(middle[period])[:, None] * 1e-9
        moved, by_rates = turns(period, mean_of(merged(rates[period], np.array([0]))) * lapse)
        left, turned, size = (float((one**2).sum()) for one in (moved - by_rates, by_rates, moved))
        speed = math.sqrt(size / float((lapse**2).sum()))
        if speed > TURNING and left < size and len(moved) * turned > SHOWN * left:
            turning[period] = True
            speeds.append(math.degrees(speed))
    if speeds and turning[quiet].all():
        raise _no_rest(
            f" (where the rates are steady, {name} turns by {min(speeds):.3g} deg/s, as they do)"
        )
    return np.asarray(quiet[~turning[quiet]])


def _turns_of_gravity(forces: WindowSums) -> Turns:
    up = _directions(forces)

    def turns(period: Intp, rotvec: Float64) -> tuple[Float64, Float64]:
        before, after = up[period[:-1]], up[period[1:]]
        return after - before, np.cross((before + after) / 2, rotvec)

    return turns


def _turns_of_orientation(sums: WindowSums, frame: str) -> Turns:
    def turns(period: Intp, rotvec: Float64) -> tuple[Float64, Float64]:
        # The mean attitude, whatever the signs, is the principal axis of the sum of q q^T.
        wxyz = np.linalg.eigh(sums["total"][period].reshape(-1, 4, 4))[1][:, :, -1]
        known = sums["count"][period] > 0
        both = known[:-1] & known[1:]
        return rotation_vectors_between(wxyz, rates=frame)[both], rotvec[both]

    return turns


def _directions(forces: WindowSums) -> Float64:
    mean = mean_of(forces)
    return np.asarray(mean / np.linalg.norm(mean, axis=1)[:, None])


def _no_rest(why: str) -> NoRestError:
    return NoRestError(f"no stationary period{why}")


# Stationary periods from which the bias is estimated: one, or several over time.


def find_rests(
    read: Callable[[Callable[[Int64], object]], Iterable[GyroSeries]],
    finder: EndsFinder,
    static: StaticBias,
    inputs: GyroCorrectionInputs,
    frame: str,
) -> tuple[StaticPeriod, ...]:
    """Return the stationary periods from which the bias is estimated, in order of time.

    `read`: reads the samples, rad/s, sensor axes, and passes their timestamps to a function
    `finder`: finder of the ends of the log
    `frame`: frame in which the rates are resolved: ``"body"`` or ``"inertial"``
    """
    steps = StepFinder()
    rows = ((each.t_ns, steps.observe(each.rate)) for each in read(finder.add))
    sums = window_sums(rows, static.window_ns // 2 or 1)

    def again(first_ns: int, last_ns: int) -> Rows:
        samples = read(lambda _: None)
        return between(((each.t_ns, each.rate) for each in samples), first_ns, last_ns)

    if static.start is not None and static.end is not None:
        part = (absolute_ns(instant, finder.ends()) for instant in (static.start, static.end))
        named = window_sums(again(*part), 1 << 62)
        rests = [static_period_between(named, static, sums, inputs, frame)]
    else:
        rests = find_static_periods(sums, inputs, static, frame)
    coarse = steps.above([rest.scatter_rad_s for rest in rests])
    if np.any(coarse):
        ranges = [(rest.first_ns, rest.last_ns) for rest in rests]
        levels = levels_of(again(ranges[0][0], ranges[-1][1]), ranges, coarse)
        rests = [rest._replace(levels=each) for rest, each in zip(rests, levels, strict=True)]
    return tuple(rests)


def worst_of(rests: Sequence[StaticPeriod]) -> StaticPeriod:
    """Return the period with the largest spread, and then quantisation error, for remarks."""
    return max(rests, key=lambda rest: (rest.spread_rad_s, rest.quantisation_rad_s))


class RestBiases:
    """The bias over time, from several stationary periods.

    `rests`: the periods, in order of time
    `interpolated`: whether it is interpolated between them, instead of taking the nearest
    """

    def __init__(self, rests: Sequence[StaticPeriod], *, interpolated: bool) -> None:
        self._means = np.array([rest.mean_rad_s for rest in rests])
        ends = [(rest.first_ns, rest.last_ns) for rest in rests]
        self._ends_ns = np.array(ends).ravel() if interpolated else None
        self._middles_ns = np.array([(a[1] + b[0]) // 2 for a, b in pairwise(ends)], np.int64)

    def at(self, t_ns: Int64) -> Float64:
        """Return the bias at times, ``(N, 3)``, rad/s."""
        if self._ends_ns is None:
            nearest = np.searchsorted(self._middles_ns, t_ns, side="right")
            return np.asarray(self._means[nearest])
        wanted, known = t_ns - self._ends_ns[0], self._ends_ns - self._ends_ns[0]
        means = np.repeat(self._means, 2, axis=0)
        return np.stack([np.interp(wanted, known, axis) for axis in means.T], axis=1)
