"""Two sources of rotation against each other: coarse offset, fit, and the class that explains."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.estimation.cells import Cells
from quatprop.estimation.relation import BIAS, CLOCK, DRIFT, OFFSET, PRIOR, TURN, relate, windows_of
from quatprop.estimation.search import agreement, search
from quatprop.estimation.turning import BODY
from quatprop.tools.crosscheck.changes import with_change
from quatprop.tools.crosscheck.pair import Pair
from quatprop.tools.crosscheck.simplest import simplest, tolerated

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.estimation.relation import Relation
    from quatprop.estimation.turning import Turning
    from quatprop.tools.crosscheck.pair import Tolerances
    from quatprop.tools.crosscheck.sources import Source

MIN_CELL: Final = 0.04
"""Length of the shortest cells of the search, s."""

MAX_CELLS: Final = 1 << 13
"""Maximum number of cells of the search."""

MIN_CELLS: Final = 40
"""Minimum number of cells of the search."""

ELSEWHERE: Final = 0.3
"""Offset above which a motion that repeats itself shows nothing, s."""

SO_CLEAR: Final = 0.95
"""Agreement above which time is not reversed."""

NEAR_ZERO: Final = 10.0
"""Maximum offset of sources on one clock, s."""

MOST: Final = 0.25
"""The same, as a share of the length of A."""

AT_REST: Final = np.radians(0.3)
"""Motion below this is rest, rad/s RMS."""

NOTHING: Final = 1e-5
"""Motion below this is rounding, rad/s RMS, and shows nothing about another device."""

SLOW: Final = np.radians(1.0), np.radians(5.0)
"""Sources with little in common, the one with less motion and the one with more, are at rest
below these, rad/s RMS."""

WEAK: Final = 0.33
UNRELATED: Final = 0.75
"""Share of the motion that is left, above which nothing is stated, and nothing is in common."""

NEARLY: Final = 0.4
"""Logarithm of the factor by which deviations may be larger than the least, for a better fit."""

DRIFTS: Final = 3.0
"""Standard deviations beyond which the clocks drift; else the offset is a constant."""

FASTEST_DRIFT: Final = 0.1
"""Drift of a reference, rad/s, above which it is the motion itself: that of a precession is one."""

LONGEST: Final = 4.0
"""Maximum length of windows, s."""


@dataclass(frozen=True, slots=True)
class _Coarse:
    """The search in one kind of axes.

    `offset`: where to begin the fit, s
    `agreement`, `backwards`: see :class:`Pair`
    """

    offset: float
    agreement: float
    backwards: float
    repeats: bool


def ordered(one: Source, other: Source, turning: dict[str, Turning]) -> tuple[Source, Source]:
    """Return two sources as A and B: the one with more axes, of rates and of shorter intervals."""

    def rank(source: Source) -> tuple[int, bool, float]:
        own = turning[source.name]
        return -int(own.shown.sum()), not source.is_rates, own.interval

    first, second = sorted((one, other), key=rank)
    return first, second


def compare_pair(a: Source, b: Source, of_a: Turning, of_b: Turning, limits: Tolerances) -> Pair:
    """Return how B follows from A, and whether that changes along the log."""
    compare = partial(_compared, a, b)
    return with_change(compare(of_a, of_b), of_a, of_b, compare, limits)


def _compared(a: Source, b: Source, of_a: Turning, of_b: Turning) -> Pair:
    """Return how B follows from A, by one relation."""
    overlap = min(of_a.seconds[-1], of_b.seconds[-1]) - max(of_a.seconds[0], of_b.seconds[0])
    shorter = min(of_a.seconds[-1] - of_a.seconds[0], of_b.seconds[-1] - of_b.seconds[0])
    is_far = bool(overlap < 0.3 * shorter)  # as of the search
    pair = Pair(a=a, b=b, status="too short", is_far=is_far)
    axes = [(x, y) for x, y in product(of_a.axes(), of_b.axes()) if BODY in (x, y)]
    shortest = max(0.05 if is_far else min(0.05, max(overlap, 2.0) / 150),
                   3 * of_a.interval, 3 * of_b.interval)  # fmt: skip
    coarse = {each: _coarse(of_a, of_b, each, shortest, is_far=is_far) for each in axes}
    searched = {each: found for each, found in coarse.items() if found is not None}
    if not searched:
        return pair
    best_axes = max(searched, key=lambda each: searched[each].agreement)
    length = _length(of_a, of_b, best_axes, searched[best_axes].offset, shortest)
    if length is None:
        return pair
    every = [
        fit
        for each, found in searched.items()
        for hand in (1, -1)
        if (fit := relate(of_a, of_b, each, found.offset, length, hand=hand)) is not None
    ]
    if not every:
        return pair
    fit, others = _simplest(every)
    is_flat = any(each.hand != fit.hand and _same_axes(each, fit) for each in others)
    fit = fit._replace(is_flat=is_flat)
    fit, steady = _steady(of_a, of_b, fit)
    fit = _without_drift(of_a, of_b, fit)
    plain = [each.score for each in every if each.is_plain and each.hand > 0]
    pair = replace(
        pair,
        fit=fit,
        stated=simplest(of_a, of_b, fit, is_far=is_far),
        others=tuple(others),
        before=_as_recorded(of_a, of_b, fit),
        steady=steady,
        as_read=min(plain, default=fit.score) / max(fit.score, 1e-9),
        agreement=max(found.agreement for found in searched.values()),
        backwards=max(found.backwards for found in searched.values()),
        repeats=searched[fit.axes_a, fit.axes_b].repeats,
    )
    return replace(pair, status=_status(pair, fit))


def _as_recorded(a: Turning, b: Turning, fit: Relation) -> float:
    """Return the RMS difference of the recorded rates, rad/s."""
    windows = windows_of(a, b, (BODY, BODY), fit.offset, fit.length)
    if windows is None:
        return fit.motion
    both = windows.shown_a & windows.shown_b
    difference = windows.rate_b - a.mean_rate(BODY, windows.begin, fit.length)
    return float(np.sqrt((difference[:, both if both.any() else windows.shown_b] ** 2).mean()))


def _same_axes(one: Relation, other: Relation) -> bool:
    return (one.axes_a, one.axes_b) == (other.axes_a, other.axes_b)


def _cells(turning: Turning, axes: str, length_ns: int, part: tuple[float, float]) -> Cells:
    """Return the mean rates of a source over cells, those beyond reason clipped.

    Cells begin at multiples of their length, so that those of two sources on one clock are the same

    `part`: the time that they cover, s
    """
    begin_s, end_s = max(part[0], turning.seconds[0]), min(part[1], turning.seconds[-1])
    first = -(-round(float(begin_s) * NS_PER_S) // length_ns)
    last = max(round(float(end_s) * NS_PER_S) // length_ns, first)
    length = length_ns / NS_PER_S
    begin = np.arange(first, last).astype(np.float64) * length
    rate = turning.mean_rate(axes, begin, length)
    known = turning.is_clear(begin, begin + length)
    rate = rate - np.median(rate[known], axis=0) if known.any() else rate
    size = np.linalg.norm(rate, axis=1)
    limit = 20 * np.median(size) + np.percentile(size, 99) if len(size) else 0.0
    rate = rate * np.minimum(1.0, limit / np.maximum(size, 1e-12))[:, None]
    rate[~known] = 0.0
    return Cells(first * length_ns, length_ns, rate, known)


def _coarse(
    a: Turning, b: Turning, axes: tuple[str, str], shortest: float, *, is_far: bool
) -> _Coarse | None:
    """Return the best offset over all rotations and mirrors; None if it cannot be searched."""
    spans = [each.seconds[-1] - each.seconds[0] for each in (a, b)]
    length = max(2 * a.interval, 2 * b.interval, MIN_CELL)
    part, around = (-math.inf, math.inf), (-math.inf, math.inf)
    if is_far:
        length = max(length, max(spans) / MAX_CELLS)
    else:
        part = most_active_part(a, b, length * MAX_CELLS)
        around = part[0] - NEAR_ZERO, part[1] + NEAR_ZERO
    cells_a = _cells(a, axes[0], round(length * NS_PER_S), around)
    cells_b = _cells(b, axes[1], round(length * NS_PER_S), part)
    if min(len(cells_a), len(cells_b)) < MIN_CELLS:
        return None
    # Whether peaks explain the motion equally must not depend on a unit.
    sizes = [float(np.sqrt((each.rate**2).mean())) for each in (cells_a, cells_b)]
    cells_a.rate[:] *= sizes[1] / max(sizes[0], 1e-300)
    found = search(cells_a, cells_b)
    if found is None:
        return None
    reach = NS_PER_S * min(NEAR_ZERO, MOST * spans[0])
    near = [
        one for one in (*found.rotated, *found.mirrored) if is_far or abs(one.offset_ns) <= reach
    ]
    at_zero = 0.0 if is_far else agreement(cells_a, cells_b)
    best = max(near, key=lambda one: one.score, default=None)
    offset, score = (0.0, at_zero) if best is None else (best.offset_ns / NS_PER_S, best.score)
    if at_zero >= 0.97 * score and (  # the simplest that explains
        abs(offset) < 3 * shortest or at_zero > 0.995 * score
    ):
        offset = 0.0
    backwards = 0.0
    if score < SO_CLEAR and (other := search(cells_a, _reversed(cells_b))) is not None:
        backwards = max(other.rotated[0].score, other.mirrored[0].score)
    return _Coarse(offset, score, backwards, found.is_repeating)


def most_active_part(a: Turning, b: Turning, length: float) -> tuple[float, float]:
    """Return the part of a length in which both sources change most, s."""
    begin, end = max(a.seconds[0], b.seconds[0]), min(a.seconds[-1], b.seconds[-1])
    if end - begin <= length:
        return -math.inf, math.inf
    starts = np.arange(begin, end - length, length / 2)
    inside = np.arange(0.0, length, length / 64)
    times = (starts[:, None] + inside).ravel()
    least = np.full(len(starts), np.inf)
    for each in (a, b):
        rate = each.mean_rate(BODY, times, 0.5).reshape(len(starts), len(inside), 3)
        least = np.minimum(least, (rate - rate.mean(axis=1, keepdims=True)).std(axis=(1, 2)))
    first = float(starts[int(np.argmax(least))])
    return first, first + length


def _reversed(cells: Cells) -> Cells:
    return Cells(cells.start_ns, cells.length_ns, cells.rate[::-1], cells.known[::-1])


def _length(
    a: Turning, b: Turning, axes: tuple[str, str], offset: float, shortest: float
) -> float | None:
    """Return the length of windows that shows rotation and offset best; None if too short."""
    tried: list[tuple[float, Relation]] = []
    for length in (shortest, 3 * shortest, 10 * shortest):
        fit = relate(a, b, axes, offset, length) if length <= LONGEST else None
        if fit is not None:
            certain = np.log(fit.sigma[TURN]).sum() / 3 + np.log(fit.sigma[OFFSET])
            tried.append((float(certain), fit))
    if not tried:
        return None
    explains = [certain for certain, fit in tried if fit.score <= 0.5]  # noqa: PLR2004  # half
    limit = min(explains or [certain for certain, _ in tried]) + NEARLY
    return min((fit for certain, fit in tried if certain < limit), key=lambda f: f.score).length


def _simplest(every: Sequence[Relation]) -> tuple[Relation, list[Relation]]:
    """Return the simplest relation among those that explain the motion, and the others."""
    best = min(every, key=lambda fit: fit.score)
    within = tolerated(best)
    equal = [
        fit for fit in every if fit.score <= (1 + within) * best.score + 1e-5 or _is_good(fit, best)
    ]

    def rank(fit: Relation) -> int:
        return (0 if fit.hand > 0 else 2) if fit.is_plain else (3 if fit.hand > 0 else 1)

    simplest = min(equal, key=rank)
    return simplest, [fit for fit in equal if fit is not simplest]


def _is_good(fit: Relation, best: Relation) -> bool:
    """Return whether a fit without any misreading explains nearly as much as the best one."""
    if not fit.is_plain or fit.hand < 0:
        return False
    loosely = best.score > 0.25 and fit.score < 3 * best.score  # noqa: PLR2004  # measured
    return loosely or fit.score < 1.6 * best.score + 0.02  # measured


def _steady(a: Turning, b: Turning, fit: Relation) -> tuple[Relation, str]:
    """Return the fit with a bias, a drift of the reference, or both, as the motion shows."""
    if not fit.free[DRIFT].all():
        return fit, "bias"
    every = np.ones(len(PRIOR), np.bool_)
    no_bias, no_drift = every.copy(), every.copy()
    no_bias[BIAS] = no_drift[DRIFT] = False
    axes, fits = (fit.axes_a, fit.axes_b), {}
    for name, free in (("bias", no_drift), ("drift", no_bias), ("both", every)):
        again = relate(a, b, axes, fit.offset, fit.length, hand=fit.hand, free=free)
        if again is not None and np.linalg.norm(again.drift) < FASTEST_DRIFT:
            fits[name] = again._replace(is_flat=fit.is_flat)
    if not fits or fit.rank < 1:
        return fit, "both"
    least = min(each.noise for each in fits.values())
    good = [name for name, each in fits.items() if each.noise <= 1.01 * least]
    steady = "bias or drift" if good[:2] == ["bias", "drift"] else good[0]
    return fits[good[0]], steady


def _without_drift(a: Turning, b: Turning, fit: Relation) -> Relation:
    """Return the fit with a constant offset, unless the clocks drift.

    Where most of the motion is in one part of a log, the offset in its middle depends on the drift.
    """
    if not fit.free[CLOCK] or abs(fit.clock) > DRIFTS * fit.sigma[CLOCK]:
        return fit
    free = fit.free.copy()
    free[CLOCK] = False
    axes = fit.axes_a, fit.axes_b
    again = relate(a, b, axes, fit.offset, fit.length, hand=fit.hand, free=free)
    return fit if again is None else again._replace(is_flat=fit.is_flat)


def _status(pair: Pair, fit: Relation) -> str:
    size_a = float(np.sqrt(np.trace(fit.excited) / 3))
    less, more = sorted((fit.motion, size_a))
    status = "related"
    is_nothing = less < NOTHING and pair.a.device != pair.b.device
    if is_nothing or more < AT_REST or (fit.score > 0.4 and less < SLOW[0] and more < SLOW[1]):  # noqa: PLR2004
        return "at rest"
    if fit.score > UNRELATED:
        status = "unrelated"
    elif fit.score > WEAK:
        status = "weak"
    is_better = 1 - pair.backwards**2 < 0.35 * (1 - pair.agreement**2)  # measured
    # Slow wandering has chance peaks, of which none explains the motion.
    if pair.repeats and abs(fit.offset) > ELSEWHERE and status != "unrelated":
        status = "repeating"
    if pair.backwards > 0.8 and is_better and fit.score > 0.25:  # noqa: PLR2004  # measured
        status = "reversed"
    return status
