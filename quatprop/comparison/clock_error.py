"""What one clock is off against another, by least squares over windows of common motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.alignment import kabsch
from quatprop.comparison.association import shifted
from quatprop.comparison.windows import (
    PER_WINDOW,
    BodyAngle,
    body_angle,
    centred,
    common_beginning,
    window_grids,
)
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Intp
    from quatprop.series import AttitudeSeries


MAX_OFFSET_S = 0.5
"""Time offsets are tried up to this; what is larger cannot be told from another motion, s."""

GRID_WINDOWS = 200
"""Windows with which the first time offset is found."""

MAX_ROUNDS = 30
"""Rounds of least squares at most; each is closer to the best time offset."""

MIN_BLOCKS = 10
"""Blocks of windows at least, from whose spread an uncertainty is estimated."""

BLOCK_S = 2.0
"""Length of such a block, s: errors further apart are taken to be independent."""


class ClockError(NamedTuple):
    """The error of B's clock: a time offset, which may change steadily.

    `seconds`: the offset in the middle, s: positive where B has to be moved to a later time
    `ratio`: what the offset grows by, as a share of the time that passes
    `std`: standard deviation of the ratio, or, where the offset does not change, of the offset, s
    `white_std`: what that of the offset would be, s, if differences over windows that do not
        overlap were independent: by this, the length of windows is chosen, since choosing by `std`
        would favour low ones
    `middle`: the middle of the time over which it was found, s
    `span`: length of that time, s
    """

    seconds: float
    ratio: float
    std: float
    white_std: float
    middle: float
    span: float

    def at(self, seconds: Float64) -> Float64:
        """Return what is to be added to B's timestamps at some times, s."""
        return self.seconds + self.ratio * (seconds - self.middle)


def clock_errors(
    a: AttitudeSeries, b: AttitudeSeries, offset_ns: int, *, turned: bool = True
) -> tuple[ClockError, ClockError, int] | None:
    """Return what is left of an offset, constant and changing steadily, if windows show any.

    It is estimated from windows of the length that shows it best. The last value is when the times
    of the second begin, ns.

    `turned`: whether the bodies may be turned against each other
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

    What B changes by with the offset is multiplied by what A changes by: noise in B alone would
    look like motion, and the offset more certain than it is. The standard deviation is found by
    leaving out blocks of windows, so it holds for noise of any colour; it is infinite where windows
    do not show the offset.

    `begin`: where to begin, s; None: at the best of a grid
    `turned`: whether the bodies may be turned against each other

    References
    ----------
    Efron and Stein, "The jackknife estimate of variance", Annals of Statistics 9(3), 1981.
    """
    middle, span = float(starts.mean()), float(starts[-1] - starts[0])
    # The offset is a sum of terms: found is so much of each.
    terms = np.stack([np.ones_like(starts), starts - middle][: 1 + drifts])
    found = np.zeros(len(terms))
    found[0] = _on_grid(a, b, length, starts, turned) if begin is None else begin

    def clock(std: float, white_std: float) -> ClockError:
        seconds, ratio = np.append(found, 0.0)[:2].tolist()
        return ClockError(seconds, ratio, std, white_std, middle, span)

    step = length / 8
    largest = np.abs(terms).max(axis=1)
    y, slope_a = a.over(starts, length), _slope(a, starts, length, step)
    for _ in range(MAX_ROUNDS):
        moved = starts - found @ terms
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
        found = found + np.clip(move, -step / largest, step / largest)
        if (np.abs(move * largest) * NS_PER_S < 1).all():
            break
    # How much the result changes when one block of windows after the other is left out.
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
    """Return about the offset, s, of a grid the one at which windows have most in common."""
    few = starts[:: max(len(starts) // GRID_WINDOWS, 1)]
    reach = min(MAX_OFFSET_S, float(few[0] - max(a.seconds[0], b.seconds[0])))
    y = a.over(few, length)
    grid = np.linspace(-reach, reach, 2 * int(np.ceil(reach / (length / 4))) + 1)

    def remaining(at: float) -> float:
        x = b.over(few - at, length)
        x = x @ kabsch(x, y)[0].T if turned else x
        return float(((y - x) ** 2).sum())

    return float(min(grid, key=remaining))


def _slope(angle: BodyAngle, starts: Float64, length: float, step: float) -> Float64:
    """Return the derivative of angles over windows with respect to a time offset."""
    earlier, later = (angle.between(at, at + length) for at in (starts - step, starts + step))
    return centred((earlier - later) / (2 * step))


def _blocks(starts: Float64, length: float) -> Intp:
    """Return the block of each window; windows of blocks that are not neighbours do not overlap."""
    span = float(starts[-1] - starts[0])
    block = max(length, min(BLOCK_S, span / MIN_BLOCKS))
    return np.asarray(((starts - starts[0]) // block).astype(np.intp))
