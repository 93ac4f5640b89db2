"""Least squares estimate of the offset and drift between clocks, from windows of common motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.alignment import kabsch
from quatprop.comparison.association import shifted
from quatprop.comparison.windows import (
    MAX_EDGE_S,
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
    """Return the offset, s, of a grid with the smallest residual."""
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
