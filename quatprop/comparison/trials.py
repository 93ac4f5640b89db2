"""Mistakes that rotations over windows show: each is undone, and what remains is compared."""

from __future__ import annotations

from itertools import permutations, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.alignment import kabsch
from quatprop.comparison.windows import PER_WINDOW, Angles, BodyAngle, centred
from quatprop.kinematics.quaternion import IDENTITY, geodesic_angle, rotate
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.arrays import Float64, Intp


SIGNED_AXES = sorted(
    (
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ),
    key=lambda matrix: -np.trace(matrix),
)[1:-1]
"""Matrices of all orders and signs of axes, those with the fewest changes first; without the one
that changes nothing, and the one that reverses everything."""

SAME_FIT = 1e-3
"""Orders and signs that fit as well, as a share: the motion does not show the axis of change."""

SAME_TURN = 0.99
"""A rotation that fits worse than its mirror image, by this factor, is none."""

MAX_OFFSET_S = 0.5
"""Time offsets are tried up to this; what is larger cannot be told from another motion, s."""

GRID_WINDOWS = 2000
"""Windows with which the first time offset is found."""

MAX_ROUNDS = 20
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
        """Return what is to be added to B's stamps at some times, s."""
        return self.seconds + self.ratio * (seconds - self.middle)


class RateRatio(NamedTuple):
    """The ratio of A's rates to B's, and its limits, as noise in either changes it."""

    value: float
    least: float
    most: float


class Trial(NamedTuple):
    """What remains of the differences between A and B over windows when a mistake is undone.

    `name`: the mistake; empty where nothing was undone
    `remaining`: remaining differences, shape ``(M, 3)``, rad
    `side`: in which series it was undone, ``"a"`` or ``"b"``, where that is known
    `value`: what was estimated: what a clock is off by, a ratio, a matrix of axes or an angle, rad;
        or the integration rules of A and B
    """

    name: str
    remaining: Float64
    side: str = ""
    value: ClockError | RateRatio | tuple[str, str] | Float64 | float | None = None

    @property
    def rms(self) -> float:
        """RMS of the remaining differences, rad."""
        return rms_length(self.remaining)


def trials(angles: Sequence[Angles], starts: Float64, length: float) -> Iterator[Trial]:
    """Yield a trial for each mistake: what remains when it is undone.

    `starts`, `length`: the windows, s
    """
    for name, side, a, b in angles:
        yield Trial(name, a.over(starts, length) - b.over(starts, length), side)
    y, x = (angle.over(starts, length) for angle in angles[0][2:])
    common = y.T @ x
    for handed in (1.0, -1.0):
        matrix = _closest_axes(common, handed)
        yield Trial("axes", y - x @ matrix.T, value=matrix)
    shared, power_x, power_y = (float(np.trace(m)) for m in (common, x.T @ x, y.T @ y))
    if shared > 0:
        # Noise in B lowers the slope of A over B, and noise in A raises the inverse of the other.
        ratio = np.sqrt(power_y / power_x)
        limits = RateRatio(ratio, shared / power_x, power_y / shared)
        yield Trial("scale", (y - ratio * x) / min(ratio, 1.0), value=limits)
    (turn, _), (mirrored, _) = kabsch(x, y), kabsch(-x, y)
    turned = y - rotate(turn, x)
    if SAME_TURN * rms_length(turned) <= rms_length(y + rotate(mirrored, x)):
        # Otherwise axes are reversed, about which the motion hardly turns.
        yield Trial("body frame", turned, value=float(geodesic_angle(IDENTITY, turn)))
    offset = clock_error(angles[0], starts, length)
    drift = clock_error(angles[0], starts, length, offset.seconds, drifts=True)
    for name, clock in (("time offset", offset), ("clock drift", drift)):
        moved = angles[0].b.over(starts - clock.at(starts), length)
        yield Trial(name, y - moved, value=clock)


def _closest_axes(common: Float64, handed: float) -> Float64:
    """Return the best order and signs of axes: right-handed for 1, left-handed for -1."""
    kept = [matrix for matrix in SIGNED_AXES if np.linalg.det(matrix) * handed > 0]
    fits = np.array([float((matrix * common).sum()) for matrix in kept])
    return kept[int(np.argmax(fits >= fits.max() - SAME_FIT * abs(fits.max())))]


def clock_error(
    pair: Angles,
    starts: Float64,
    length: float,
    begin: float | None = None,
    *,
    drifts: bool = False,
) -> ClockError:
    """Estimate the error of B's clock by least squares over windows.

    What B changes by with the offset is multiplied by what A changes by: noise in B alone would
    look like motion, and the offset more certain than it is. The standard deviation is found by
    leaving out blocks of windows, so it holds for noise of any colour; it is infinite where windows
    do not show the offset.

    `begin`: where to begin, s; None: at the best of a grid

    References
    ----------
    Efron and Stein, "The jackknife estimate of variance", Annals of Statistics 9(3), 1981.
    """
    middle, span = float(starts.mean()), float(starts[-1] - starts[0])
    # The offset is a sum of terms: found is so much of each.
    terms = np.stack([np.ones_like(starts), starts - middle][: 1 + drifts])
    found = np.zeros(len(terms))
    found[0] = _on_grid(pair, starts, length) if begin is None else begin

    def clock(std: float, white_std: float) -> ClockError:
        seconds, ratio = np.append(found, 0.0)[:2].tolist()
        return ClockError(seconds, ratio, std, white_std, middle, span)

    step = length / 8
    largest = np.abs(terms).max(axis=1)
    y, slope_a = pair.a.over(starts, length), _slope(pair.a, starts, length, step)
    for _ in range(MAX_ROUNDS):
        moved = starts - found @ terms
        error = y - pair.b.over(moved, length)
        slope = _slope(pair.b, moved, length, step)
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


def _on_grid(pair: Angles, starts: Float64, length: float) -> float:
    few = starts[:: max(len(starts) // GRID_WINDOWS, 1)]
    free = float(few[0] - max(pair.a.seconds[0], pair.b.seconds[0]))
    reach = min(MAX_OFFSET_S, free)
    y = pair.a.over(few, length)
    grid = np.linspace(-reach, reach, 2 * int(np.ceil(reach / (length / 8))) + 1)
    remaining = [((y - pair.b.over(few - at, length)) ** 2).sum() for at in grid]
    return float(grid[int(np.argmin(remaining))])


def _slope(angle: BodyAngle, starts: Float64, length: float, step: float) -> Float64:
    """Return the derivative of angles over windows with respect to a time offset."""
    earlier, later = (angle.between(at, at + length) for at in (starts - step, starts + step))
    return centred((earlier - later) / (2 * step))


def rms_length(values: Float64) -> float:
    """Return the RMS length of vectors."""
    return float(np.sqrt((values**2).sum(axis=1).mean()))


def _blocks(starts: Float64, length: float) -> Intp:
    """Return the block of each window; windows of blocks that are not neighbours do not overlap."""
    span = float(starts[-1] - starts[0])
    block = max(length, min(BLOCK_S, span / MIN_BLOCKS))
    return np.asarray(((starts - starts[0]) // block).astype(np.intp))
