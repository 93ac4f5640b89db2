"""Mistakes that rotations over windows show: each is undone, and what remains is compared."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.alignment import kabsch
from quatprop.comparison.statistics import NS_PER_S
from quatprop.comparison.windows import PER_WINDOW, centred
from quatprop.kinematics.quaternion import rotate

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.arrays import Float64, Intp
    from quatprop.comparison.windows import Angles, BodyAngle


SIGNED_AXES = sorted(
    (
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
        if (order, signs) not in (((0, 1, 2), (1.0,) * 3), ((0, 1, 2), (-1.0,) * 3))
    ),
    key=lambda matrix: -np.trace(matrix),
)
"""Matrices of all orders and signs of axes, those with the fewest changes first; without those
that change nothing, and reverse everything."""

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


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """An offset of B's clock.

    Parameters
    ----------
    seconds
        Positive where B has to be moved to a later time, s.
    std
        Its standard deviation, s.
    white_std
        What that would be if differences over windows that do not overlap were independent: by
        this, the length of windows is chosen, since choosing by `std` would favour low ones.
    """

    seconds: float
    std: float
    white_std: float

    def at(self, _seconds: Float64) -> float:
        """Return what is to be added to B's stamps at some times, s."""
        return self.seconds


@dataclass(frozen=True, slots=True)
class ClockDrift:
    """An offset of B's clock that changes steadily.

    Parameters
    ----------
    ratio
        What is to be added to B's stamps, as a share of the time that passes.
    std
        Its standard deviation.
    seconds
        What is to be added in the middle, s.
    middle
        When that is, s.
    span
        Time over which it was found, s.
    """

    ratio: float
    std: float
    seconds: float
    middle: float
    span: float

    def at(self, seconds: Float64) -> Float64:
        """Return what is to be added to B's stamps at some times, s."""
        return self.seconds + self.ratio * (seconds - self.middle)


@dataclass(frozen=True, slots=True)
class RateRatio:
    """A's rates over B's, and between what noise in either can place it."""

    value: float
    least: float
    most: float


@dataclass(frozen=True, slots=True)
class MethodPair:
    """The integration rules of A and B."""

    a: str
    b: str


@dataclass(frozen=True, slots=True)
class Trial:
    """What remains of the differences between A and B over windows when a mistake is undone.

    Parameters
    ----------
    name
        The mistake; empty where nothing was undone.
    remaining
        Remaining differences, shape ``(M, 3)``, rad.
    side
        In which series it was undone, ``"a"`` or ``"b"``, where that is known.
    value
        What was estimated: an offset, a ratio, a matrix or a quaternion.
    """

    name: str
    remaining: Float64
    side: str = ""
    value: TimeOffset | ClockDrift | RateRatio | MethodPair | Float64 | None = None

    @property
    def rms(self) -> float:
        """RMS of the remaining differences, rad."""
        return size(self.remaining)


def trials(angles: Sequence[Angles], starts: Float64, length: float) -> Iterator[Trial]:
    """Undo one mistake after the other.

    Parameters
    ----------
    angles
        Of :func:`quatprop.comparison.windows.undone_misreadings`.
    starts, length
        The windows, s.
    """
    for pair in angles:
        y, x = pair.over(starts, length)
        yield Trial(pair.name, y - x, pair.side)
    y, x = angles[0].over(starts, length)
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
    if SAME_TURN * size(turned) <= size(y + rotate(mirrored, x)):
        # Otherwise axes are reversed, about which the motion hardly turns.
        yield Trial("body frame", turned, value=turn)
    yield from clock_trials(angles[0], starts, length)


def _closest_axes(common: Float64, handed: float) -> Float64:
    """Return the order and signs of axes that fit best, of the two hands that is asked for."""
    kept = [matrix for matrix in SIGNED_AXES if np.linalg.det(matrix) * handed > 0]
    fits = np.array([float((matrix * common).sum()) for matrix in kept])
    return kept[int(np.argmax(fits >= fits.max() - SAME_FIT * abs(fits.max())))]


def clock_trials(pair: Angles, starts: Float64, length: float) -> Iterator[Trial]:
    """Move B by the offset at which it turns as A does, and by one that changes steadily."""
    y = centred(pair.a.over(starts, length))
    offset = time_offset(pair, starts, length)
    middle, span = float(starts.mean()), float(starts[-1] - starts[0])
    terms, begin = np.stack([np.ones_like(starts), starts - middle]), [offset.seconds, 0.0]
    (seconds, ratio), (_, std), _ = _fitted(pair, starts, length, terms, np.array(begin))
    drift = ClockDrift(float(ratio), float(std), float(seconds), middle, span)
    for name, value in (("time offset", offset), ("clock drift", drift)):
        moved = centred(pair.b.over(starts - value.at(starts), length))
        yield Trial(name, y - moved, value=value)


def time_offset(
    pair: Angles, starts: Float64, length: float, begin: float | None = None
) -> TimeOffset:
    """Find the offset of B's clock at which B turns as A does: least squares over windows.

    What B changes by with the offset is multiplied by what A changes by: noise in B alone would
    look like motion, and the offset more certain than it is. The standard deviation is found by
    leaving out blocks of windows, so it holds for noise of any colour.

    Parameters
    ----------
    pair, starts, length
        The body angles and the windows.
    begin
        Where to begin, s; None: at the best of a grid.

    References
    ----------
    Efron and Stein, "The jackknife estimate of variance", Annals of Statistics 9(3), 1981.
    """
    offset = _on_grid(pair, starts, length) if begin is None else begin
    one = np.ones((1, len(starts)))
    (seconds,), (std,), white_std = _fitted(pair, starts, length, one, np.array([offset]))
    return TimeOffset(float(seconds), float(std), white_std)


def _fitted(
    pair: Angles, starts: Float64, length: float, terms: Float64, found: Float64
) -> tuple[Float64, Float64, float]:
    """Return the offset of B's clock as a sum of terms, by least squares.

    The terms, the first of them 1, are given at each window, ``(k, N)``, and so much of each to
    begin with, ``(k,)``. Returned are so much of each, and its standard deviation, infinite where
    windows do not show it; and `white_std`, as for :class:`TimeOffset`.
    """
    step = length / 8
    largest = np.abs(terms).max(axis=1)
    unknown = np.full(len(found), np.inf), float("inf")
    y, slope_a = centred(pair.a.over(starts, length)), _slope(pair.a, starts, length, step)
    for _ in range(MAX_ROUNDS):
        moved = starts - found @ terms
        error = y - centred(pair.b.over(moved, length))
        slope = _slope(pair.b, moved, length, step)
        scores = terms * (slope * error).sum(axis=1)
        powers = terms[:, None] * terms * (slope_a * slope).sum(axis=1)
        power = powers.sum(axis=2)
        if power[0, 0] <= 0 or np.linalg.det(power) <= 0:
            return found, *unknown
        move = np.linalg.solve(power, scores.sum(axis=1))
        found = found + np.clip(move, -step / largest, step / largest)
        if (np.abs(move * largest) * NS_PER_S < 1).all():
            break
    white_std = float(np.sqrt((error**2).mean() * PER_WINDOW / power[0, 0]))
    # How much the result changes when one block of windows after the other is left out.
    block = _blocks(starts, length)
    by_block = [
        np.stack([np.bincount(block, row) for row in rows], axis=1)
        for rows in (scores, powers.reshape(-1, len(starts)))
    ]
    left = power - by_block[1].reshape(-1, *power.shape)
    if (np.linalg.det(left) <= 0).any():
        return found, *unknown
    changes = np.linalg.solve(left, by_block[0][..., None])[..., 0]
    return found, np.sqrt((changes**2).sum(axis=0)), white_std


def _on_grid(pair: Angles, starts: Float64, length: float) -> float:
    few = starts[:: max(len(starts) // GRID_WINDOWS, 1)]
    free = float(few[0] - max(pair.a.seconds[0], pair.b.seconds[0]))
    reach = min(MAX_OFFSET_S, free)
    y = centred(pair.a.over(few, length))
    grid = np.linspace(-reach, reach, 2 * int(np.ceil(reach / (length / 8))) + 1)
    remaining = [((y - centred(pair.b.over(few - at, length))) ** 2).sum() for at in grid]
    return float(grid[int(np.argmin(remaining))])


def _slope(angle: BodyAngle, starts: Float64, length: float, step: float) -> Float64:
    """Return how angles over windows change when the series is moved to a later time."""
    later, earlier = angle.over(starts + step, length), angle.over(starts - step, length)
    return centred((earlier - later) / (2 * step))


def size(values: Float64) -> float:
    """Return the RMS length of vectors."""
    return float(np.sqrt((values**2).sum(axis=1).mean()))


def _blocks(starts: Float64, length: float) -> Intp:
    """Return the block of each window; windows of blocks that are not neighbours do not overlap."""
    span = float(starts[-1] - starts[0])
    block = max(length, min(BLOCK_S, span / MIN_BLOCKS))
    return np.asarray(((starts - starts[0]) // block).astype(np.intp))
