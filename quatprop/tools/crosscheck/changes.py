"""Where along a log the relation of two sources changes: a scale, axes, an offset that jump.

The place is that at which two linear relations, before and after it, explain most; whether there is
a change is decided by comparing both sources in each part as if it were a log of its own.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.estimation.relation import MIN_WINDOWS, OFFSET, OUTLIER, SCALE, predicted, windows_of
from quatprop.kinematics.quaternion import from_matrix, log
from quatprop.tools.crosscheck.pair import DEG, SIGNIFICANT, Change

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from quatprop.base.arrays import Float64
    from quatprop.estimation.relation import Relation
    from quatprop.estimation.turning import Turning
    from quatprop.tools.crosscheck.pair import Pair, Tolerances

    Compare = Callable[[Turning, Turning], Pair]
    """Compares two sources in parts of their time."""

GAIN: Final = 0.1
"""Share of the residuals that a change must explain before the parts are compared."""

EXPLAINED: Final = 0.64
"""Largest squared residual with a change, as a share of that without one."""

DEEPEST: Final = 3
"""How often parts are divided again."""

TOLERATED: Final = 2.0
"""How many tolerances parts may differ by: each may be off by one."""

PARTS: Final = 40
"""Parts of a log whose offsets are compared."""

BETTER: Final = 0.4
"""What a step of the offset leaves of the scatter about a line, at most."""

MOVING: Final = 5 * DEG
"""Minimum motion of a source that must be followed, rad/s RMS."""


def with_change(pair: Pair, a: Turning, b: Turning, compare: Compare, limits: Tolerances) -> Pair:
    """Return a pair with the first change of its relation along the log, if there is one."""
    if pair.status not in {"related", "weak", "unrelated", "repeating"}:
        return pair
    interval, step = max(a.interval, b.interval), None
    if pair.status == "related" and pair.fit is not None:
        step = likely_step(a, b, pair.fit)
        pair = replace(pair, is_stepping=step is not None)
    # Sources without anything in common are compared in quarters only: that takes long.
    depth = DEEPEST - (pair.status in {"unrelated", "repeating"})
    for (_, one), (at, other) in pairwise(_parts(pair, a, b, compare, depth, step=step)):
        if one.fit is None or other.fit is None:
            continue
        if one.status == other.status == "related":
            change = _change(at, one.fit, other.fit, interval, limits)
        else:
            change = _end(at, one, other)
        if change is not None:
            change = change._replace(at=_switch(a, b, one.fit, other.fit) or at)
            return replace(pair, status="changing", change=change)
    return pair


def _parts(  # noqa: PLR0913  # both sources, and how to divide them
    pair: Pair, a: Turning, b: Turning, compare: Compare, depth: int, *, step: float | None = None
) -> Iterator[tuple[float, Pair]]:
    """Yield the parts of a log between changes: their beginning, s, and what they show.

    `step`: when the clock offset jumps, s
    """
    begin, end = float(b.seconds[0]), float(b.seconds[-1]) + 1
    at = step
    if at is None and depth and pair.fit is not None:
        at = likely_change(a, b, pair.fit)
    if at is None and depth and pair.status in {"unrelated", "repeating"}:
        at = (begin + end) / 2  # two offsets explain a half each
    if pair.fit is None or at is None:
        yield begin, pair
        return
    parts = [_part(b, begin, at), _part(b, at, end)]
    found = [compare(a, each) for each in parts]
    fits = [each.fit for each in found if each.fit is not None]
    squares = sum(each.windows * each.noise**2 for each in fits)
    most = EXPLAINED * sum(each.windows for each in fits) * pair.fit.noise**2
    if len(fits) < len(parts) or (step is None and pair.status == "related" and squares > most):
        yield begin, pair
        return
    for each, part in zip(found, parts, strict=True):
        if each.status == "related":
            yield float(part.seconds[0]), each
        else:
            yield from _parts(each, a, part, compare, depth - 1)


def _part(turning: Turning, begin: float, end: float) -> Turning:
    """Return a source in a part of its time, s."""
    rows = slice(*np.searchsorted(turning.seconds, (begin, end)).tolist())
    reference, wxyz = turning.reference, turning.wxyz
    return turning._replace(
        seconds=turning.seconds[rows],
        body=turning.body[rows],
        reference=None if reference is None else reference[rows],
        wxyz=None if wxyz is None else wxyz[rows],
    )


def likely_change(a: Turning, b: Turning, fit: Relation) -> float | None:
    """Return when the relation of B to A seems to change, s; None if it does not.

    `fit`: the relation of the whole
    """
    axes, length = (fit.axes_a, fit.axes_b), fit.length
    windows = windows_of(a, b, axes, fit.offset, length)
    if windows is None or len(windows.begin) < 2 * MIN_WINDOWS:
        return None
    begin = windows.begin + fit.offset
    rate = a.mean_rate(axes[0], begin, length)
    later, earlier = (a.mean_rate(axes[0], begin + by, length) for by in (length / 4, -length / 4))
    of = np.column_stack((np.ones(len(rate)), rate, later - earlier))
    of /= np.maximum(np.sqrt((of**2).mean(axis=0)), 1e-12)
    seen = windows.rate_b * windows.shown_b
    own, common = (np.cumsum(of[:, :, None] * each[:, None], axis=0) for each in (of, seen))
    power = np.cumsum((seen**2).sum(axis=1))
    at = np.arange(MIN_WINDOWS, len(of) - MIN_WINDOWS + 1) - 1
    left = _left(own[at], common[at], power[at])
    left += _left(own[-1] - own[at], common[-1] - common[at], power[-1] - power[at])
    best = int(np.argmin(left))
    if left[best] > (1 - GAIN) * _left(own[-1:], common[-1:], power[-1:])[0]:
        return None
    return float(windows.begin[at[best] + 1])


def likely_step(a: Turning, b: Turning, fit: Relation) -> float | None:
    """Return when the clock offset seems to jump, s; None if a drift explains as much.

    By the likelihood ratio of a step against a line, both fitted to the offsets of parts of the log
    """
    windows = windows_of(a, b, (fit.axes_a, fit.axes_b), fit.offset, fit.length)
    if windows is None or len(windows.begin) < 2 * MIN_WINDOWS:
        return None
    begin, by = windows.begin, fit.length / 8
    later, earlier = (
        predicted(a, b, fit._replace(offset=fit.offset + change), begin) for change in (by, -by)
    )
    slope = (later - earlier) / (2 * by) * windows.shown_b
    error = (windows.rate_b - predicted(a, b, fit, begin)) * windows.shown_b
    size = np.linalg.norm(error, axis=1)
    weights = np.minimum(1.0, OUTLIER * np.median(size) / np.maximum(size, 1e-12))[:, None] * slope
    count = min(PARTS, len(begin) // 4)
    starts = np.arange(count) * len(begin) // count
    known, seen, times = (
        np.add.reduceat((weights * each).sum(axis=1), starts)
        for each in (slope, error, slope * (begin - fit.middle)[:, None])
    )
    times /= np.maximum(known, 1e-300)
    offset = seen / np.maximum(known, 1e-300) + fit.clock * times
    steps = [(np.arange(count) >= k).astype(np.float64) for k in range(1, count)]
    line, *by_steps = (_unexplained(offset, each, known) for each in (times, *steps))
    best = int(np.argmin(by_steps))
    noise = max(fit.inflation, 1.0) * fit.noise**2
    if by_steps[best] > min(BETTER * line, line - SIGNIFICANT**2 * noise):
        return None
    return float(begin[starts[best + 1]])


def _unexplained(values: Float64, by: Float64, weights: Float64) -> float:
    """Return the squares that a constant and a multiple of `by` leave of values."""
    root = np.sqrt(weights)
    columns = np.stack((root, root * by), axis=1)
    left = root * values - columns @ np.linalg.lstsq(columns, root * values, rcond=None)[0]
    return float(left @ left)


def _left(own: Float64, common: Float64, power: Float64) -> Float64:
    """Return the squares that linear relations leave, ``(K,)``.

    `own`, `common`: sums of products of A's columns, ``(K, 7, 7)``, and with B's, ``(K, 7, 3)``
    `power`: sums of B's squares, ``(K,)``
    """
    trace = np.trace(own, axis1=1, axis2=2)[:, None, None]
    by = np.linalg.solve(own + 1e-9 * trace * np.eye(own.shape[1]), common)
    return np.asarray(power - (by * common).sum(axis=(1, 2)))


def _change(
    at: float, one: Relation, other: Relation, interval: float, limits: Tolerances
) -> Change | None:
    """Return what differs between the relations of two parts, beyond doubt; None if nothing.

    `interval`: the longer one of both sources, s
    """
    if (one.axes_a, one.axes_b) != (other.axes_a, other.axes_b):
        text = "it has another direction or layout"
        return Change(at, text, text)
    if one.hand != other.hand and not (one.is_flat or other.is_flat):
        text = "its axes are mirrored"
        return Change(at, text, text)
    sigma = np.hypot(one.sigma, other.sigma)
    texts: list[tuple[str, str]] = []
    size = abs(math.log(other.scale / one.scale))
    if size > max(TOLERATED * math.log1p(limits.scale), SIGNIFICANT * sigma[SCALE]):
        factor = other.scale / one.scale
        texts.append(
            (f"it turns {1 / factor:.4g} times as far", f"it turns {factor:.4g} times as far")
        )
    turned = other.matrix @ one.matrix.T
    turn = log(from_matrix(turned))
    angle = float(np.linalg.norm(turn))
    covariance = sum(each.covariance * max(each.inflation, 1.0) for each in (one, other))
    certain = math.sqrt(max(float(turn @ np.linalg.solve(covariance, turn)), 0.0))
    # A turn about the axis of all motion shows nothing.
    seen = _share(other.matrix - one.matrix, one.excited + other.excited)
    if certain > SIGNIFICANT and min(angle, seen) > TOLERATED * limits.mount:
        text = f"its axes are turned by {angle / DEG:.3g} deg"
        texts.append((text, text))
    later = other.offset - one.offset
    if abs(later) > max(TOLERATED * limits.offset, interval, SIGNIFICANT * sigma[OFFSET]):
        words = ("late", "early") if later > 0 else ("early", "late")
        about_a, about_b = (f"it is {word} by another {abs(later) * 1e3:.4g} ms" for word in words)
        texts.append((about_a, about_b))
    if not texts:
        return None
    return Change(at, *(", ".join(each) for each in zip(*texts, strict=True)))


def _switch(a: Turning, b: Turning, one: Relation, other: Relation) -> float | None:
    """Return from when on another relation explains more, s; None if neither explains all."""
    windows = windows_of(a, b, (one.axes_a, one.axes_b), one.offset, one.length)
    if windows is None:
        return None
    begin, length, errors = windows.begin, windows.length, []
    for fit in (one, other):
        left = b.mean_rate(fit.axes_b, begin, fit.length) - predicted(a, b, fit, begin)
        errors.append(((left * fit.shown) ** 2).sum(axis=1))
    before, after = np.cumsum(errors[0]), np.cumsum(errors[1])
    at = int(np.argmin(before + after[-1] - after))
    return float(begin[at] + length) if at < len(begin) - 1 else None


def _share(change: Float64, excited: Float64) -> float:
    """Return the RMS change of rates, as a share of them."""
    changed = float(np.trace(change @ excited @ change.T))
    return math.sqrt(changed / max(float(np.trace(excited)), 1e-30))


def _end(at: float, one: Pair, other: Pair) -> Change | None:
    """Return that B follows A only before or after a time; None if it may follow."""
    if {one.status, other.status} != {"related", "unrelated"}:
        return None
    fit = (one if one.status == "unrelated" else other).fit
    if fit is None or fit.motion < MOVING or fit.windows < 2 * MIN_WINDOWS:
        return None
    text = "before that" if one.status == "unrelated" else "after that"
    text = f"the rates of both have nothing in common {text}"
    return Change(at, text, text)
