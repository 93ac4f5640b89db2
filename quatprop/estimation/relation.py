"""The difference between two sources of rotation: one fit for rates, attitudes and mirrored axes.

The mean rates over windows of A and of B are related by

    y(t) = s R x(t + offset + clock (t - middle)) + bias + D(t) drift

with R orthogonal, of either hand, s a scale, and D the axes of B's reference in those of its body:
a bias of a gyroscope is constant in its own axes, a drift of an attitude in those of its reference.
If y is resolved in the reference of B, which is then misread, D is the inverse.
Gauss-Newton with weak priors, so that what the motion does not show stays free and has a wide
posterior instead of being held. Errors are not white: a jackknife over blocks of time gives their
scatter, and the larger of the two standard deviations counts.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.estimation.turning import BODY
from quatprop.kinematics.quaternion import conjugate, exp, rotation_matrix

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64
    from quatprop.estimation.turning import Turning

MAX_WINDOWS: Final = 3000
"""Maximum number of windows in a fit."""

MIN_WINDOWS: Final = 30
"""Minimum number of windows in a fit."""

RICH: Final = 150
"""Number of windows from which clock and drift are estimated too."""

BLOCKS: Final = 20
"""Blocks of the jackknife."""

STEPS: Final = 30
"""Maximum number of steps of Gauss-Newton."""

NEAR: Final = 0.02
"""Steps below this many standard deviations are the last."""

LOST: Final = 0.75
PROGRESS: Final = 0.99
"""Where more than this share of the motion is left, steps have to lessen the noise by this."""

VANISHED: Final = 0.3
"""The scale is on its way to zero below this share of the motion, if the noise is above it."""

OUTLIER: Final = 3.0
"""Residuals above this many usual ones count less."""

GOLDEN: Final = (math.sqrt(5) - 1) / 2
"""Multiples of it, less their whole part, are evenly spread and never repeat."""

EXACT: Final = 1e-6
"""Residuals below this share of the rates are rounding."""

RIDGE: Final = 1e-13
"""Added to a correlation matrix, so that exact recordings do not make it singular."""

SUMMED: Final = 0.25
"""Variance of a bias by noise that cancels in sums, as a share of that by white noise, at least."""

FLAT: Final = 0.02
"""Singular values below this share of the largest show no rotation."""

TURN, SCALE, BIAS, DRIFT, OFFSET, CLOCK = slice(0, 3), 3, slice(4, 7), slice(7, 10), 10, 11
"""Where the parameters are."""

PRIOR: Final = np.array([1.0] * 4 + [0.05] * 6 + [1.0, 2e-3])
"""Prior standard deviations: rad, ratio, rad/s, rad/s, s and s/s."""


class Relation(NamedTuple):
    """The fit of a source A to a source B.

    `axes_a`, `axes_b`: axes in which the rates are resolved: ``"body"`` or ``"reference"``
    `matrix`: R, A's axes to B's, shape ``(3, 3)``; of determinant -1 if they are mirrored
    `scale`: s
    `bias`: in B's axes, rad/s, shape ``(3,)``
    `drift`: in the other axes of B, those of its reference, rad/s, shape ``(3,)``
    `offset`, `clock`: time to add to B's in the middle, s, and more for each second after it
    `middle`: the middle of the windows, s
    `sigma`: standard deviations of the 12 parameters
    `covariance`: of the rotation about B's axes, rad^2, shape ``(3, 3)``
    `inflation`: jackknife over posterior variance of the rotation, median
    `noise`: RMS of the residuals, rad/s
    `motion`, `predicted`: RMS of the changing part of the rates of B, and of those by A, rad/s
    `windows`, `length`, `span`: number of windows, their length, s, and the time they cover, s
    `shown`: which of B's axes are compared
    `excited`: covariance of A's rates, (rad/s)^2, shape ``(3, 3)``
    `rank`: number of axes that the common motion has
    `is_flat`: whether the motion has fewer than three axes, so that mirrored axes cannot be
        distinguished
    `free`: which parameters were estimated
    """

    axes_a: str
    axes_b: str
    matrix: Float64
    scale: float
    bias: Float64
    drift: Float64
    offset: float
    clock: float
    middle: float
    sigma: Float64
    covariance: Float64
    inflation: float
    noise: float
    motion: float
    predicted: float
    windows: int
    length: float
    span: float
    shown: Bool
    excited: Float64
    rank: int
    is_flat: bool
    free: Bool

    @property
    def hand(self) -> int:
        """1, or -1 if the axes are mirrored."""
        return 1 if np.linalg.det(self.matrix) > 0 else -1

    @property
    def score(self) -> float:
        """The residual as a share of the motion."""
        return self.noise / max(min(self.motion, self.predicted), 1e-9)

    @property
    def is_plain(self) -> bool:
        """Whether both are resolved in body axes, as they should be."""
        return (self.axes_a, self.axes_b) == (BODY, BODY)


class PairWindows(NamedTuple):
    """Windows of two sources, and what of B does not depend on the parameters.

    `begin`: their beginnings in B's time, s, shape ``(M,)``
    `length`: s
    `rate_b`: mean rates of B, shape ``(M, 3)``, rad/s
    `slope_b`: their slopes, shape ``(M, 3)``, rad/s^2
    `reference`: the other axes of B, in which a drift is constant, ``(M, 3, 3)``; None of rates
    `shown_a`, `shown_b`: which axes are compared
    `interval`: of both sources, root of the sum of squares, s
    """

    begin: Float64
    length: float
    rate_b: Float64
    slope_b: Float64
    reference: Float64 | None
    shown_a: Bool
    shown_b: Bool
    span: float
    interval: float


def relate(  # noqa: PLR0913  # two sources in two kinds of axes, and where to begin
    a: Turning,
    b: Turning,
    axes: tuple[str, str],
    offset: float,
    length: float,
    *,
    hand: int | None = None,
    free: Bool | None = None,
    begin: tuple[Float64, float] | None = None,
) -> Relation | None:
    """Fit A to B; None if they have too little in common.

    `axes`: those of A and of B
    `offset`: where to begin, s
    `length`: of the windows, s
    `hand`: 1 for rotations, -1 for mirrors; None: what fits better
    `free`: which of the 12 parameters to estimate; None: all that can be
    `begin`: rotation matrix and scale to begin with, or to keep if they are not estimated
    """
    windows = windows_of(a, b, axes, offset, length)
    return None if windows is None else _Fit(a, windows, axes, hand, free).run(offset, begin)


def windows_of(
    a: Turning, b: Turning, axes: tuple[str, str], offset: float, length: float
) -> PairWindows | None:
    """Return the windows that both sources cover without a gap; None if there are too few."""
    begin = max(b.seconds[0], a.seconds[0] - offset) + length
    end = min(b.seconds[-1], a.seconds[-1] - offset) - 2 * length
    if end - begin < MIN_WINDOWS * length:
        return None
    starts = np.arange(begin, end, max(length, (end - begin) / MAX_WINDOWS))
    # Interpolated noise is least half way between samples, which must not attract the offset.
    starts += max(a.interval, b.interval) * (np.arange(len(starts)) * GOLDEN % 1.0)
    in_a = starts + offset
    clear = b.is_clear(starts, starts + length)
    clear &= a.is_clear(in_a - length / 4, in_a + 1.25 * length)
    starts = starts[clear]
    if len(starts) < MIN_WINDOWS:
        return None
    reference = _reference(b, axes[1], starts, length)
    rate_b, slope_b = b.mean_rate(axes[1], starts, length), _slope(b, axes[1], starts, length)
    return PairWindows(
        starts, length, rate_b, slope_b, reference,
        a.shown_in(axes[0]), b.shown_in(axes[1]), end - begin, math.hypot(a.interval, b.interval),
    )  # fmt: skip


def predicted(a: Turning, b: Turning, fit: Relation, begin: Float64) -> Float64:
    """Return the mean rates of B over windows that follow from those of A, ``(M, 3)``, rad/s.

    `begin`: beginnings of the windows in B's time, s
    """
    at = begin + fit.offset + fit.clock * (begin - fit.middle)
    rate = fit.scale * a.mean_rate(fit.axes_a, at, fit.length) @ fit.matrix.T + fit.bias
    reference = _reference(b, fit.axes_b, begin, fit.length)
    return rate if reference is None else rate + reference @ fit.drift


class _Fit:
    """One fit, while its parameters are found."""

    def __init__(
        self,
        a: Turning,
        windows: PairWindows,
        axes: tuple[str, str],
        hand: int | None,
        free: Bool | None,
    ) -> None:
        self._a = a
        self._windows = windows
        self._axes = axes
        self._hand = hand
        self._middle = float(windows.begin.mean())
        self._given = free
        self._free = np.ones(len(PRIOR), np.bool_)

    def run(self, offset: float, begin: tuple[Float64, float] | None) -> Relation:
        """Return the fit, begun at an offset, and at a rotation and a scale if they are given."""
        windows = self._windows
        self._offset, self._clock = offset, 0.0
        self._bias, self._drift = np.zeros(3), np.zeros(3)
        self._motion = _changing(windows.rate_b[:, windows.shown_b])
        self._begin(self._a.mean_rate(self._axes[0], windows.begin + offset, windows.length))
        if begin is not None:
            self._matrix, self._log_scale = begin[0], math.log(begin[1])
        self._free[DRIFT] = windows.reference is not None
        if self._given is not None:
            self._free &= self._given
        if self._rank < 2 or len(windows.begin) < RICH:  # noqa: PLR2004  # axes
            self._free[DRIFT] = False
        if len(windows.begin) < RICH:
            self._free[CLOCK] = False
        before = math.inf
        for step in range(STEPS):
            matrix, vector = self._equations(robust=step > 0)
            change = self._solved(matrix, vector)
            self._move(change)
            if abs(self._offset - offset) > 5 * windows.length + 1 or not self._free.any():
                break
            if self._is_lost(before):
                break
            before = self._noise
            sigma = np.sqrt(np.diag(self._inverse(matrix)))[self._free]
            if step > 0 and (np.abs(change[self._free]) < NEAR * sigma).all():
                break
        return self._relation(matrix)

    def _begin(self, rate_a: Float64) -> None:
        """Set rotation and scale by the covariance of both rates."""
        windows = self._windows
        x = (rate_a - np.median(rate_a, axis=0)) * windows.shown_a
        y = (windows.rate_b - np.median(windows.rate_b, axis=0)) * windows.shown_b
        left, sizes, right = np.linalg.svd(y.T @ x)
        self._rank = int((sizes > FLAT * sizes[0]).sum())
        self._is_flat = bool(sizes[2] <= FLAT * sizes[0])
        if windows.shown_a.sum() == 1 or windows.shown_b.sum() == 1:
            self._rank = min(self._rank, 1)
        hand = self._hand or int(np.sign(np.linalg.det(left @ right)) or 1)
        if self._rank <= 1:
            self._matrix = hand * _shortest_turn(right[0], left[:, 0] * hand)
        else:
            last = hand * np.linalg.det(left @ right)
            self._matrix = left @ np.diag([1.0, 1.0, last]) @ right
        explained = ((x @ self._matrix.T * windows.shown_b) ** 2).sum()
        self._log_scale = 0.5 * math.log(max((y**2).sum(), 1e-30) / max(explained, 1e-30))

    def _is_lost(self, before: float) -> bool:
        """Return whether steps lead from one relation that explains nothing to another, or to none.

        `before`: the noise before the last step
        """
        explained = _changing(self._predicted[:, self._windows.shown_b])
        if explained < min(self._noise, VANISHED * self._motion):
            return True
        return self._noise > max(LOST * self._motion, PROGRESS * before)

    def _rates_of_a(self) -> tuple[Float64, Float64]:
        """Return the mean rates of A in its axes, and their slopes."""
        begin, length = self._windows.begin, self._windows.length
        at = begin + self._offset + self._clock * (begin - self._middle)
        rate = self._a.mean_rate(self._axes[0], at, length)
        return rate, _slope(self._a, self._axes[0], at, length)

    def _equations(self, *, robust: bool) -> tuple[Float64, Float64]:
        """Return Newton's matrix and vector."""
        windows = self._windows
        rate, self._slope = self._rates_of_a()
        self._predicted = math.exp(self._log_scale) * rate @ self._matrix.T
        error = windows.rate_b - self._predicted - self._bias
        if windows.reference is not None:
            error = error - windows.reference @ self._drift
        error *= windows.shown_b
        size = np.linalg.norm(error, axis=1)
        usual = max(float(np.median(size)) / 1.5, 1e-7)
        weights = np.minimum(1.0, OUTLIER * usual / np.maximum(size, 1e-12))
        if not robust:
            weights = np.ones(len(size))
        slope_b = math.exp(self._log_scale) * self._slope @ self._matrix.T
        jacobian = np.zeros((len(size), 3, len(PRIOR)))
        jacobian[:, :, TURN] = -_skew(self._predicted)
        jacobian[:, :, SCALE] = self._predicted
        jacobian[:, :, BIAS] = np.eye(3)
        if windows.reference is not None:
            jacobian[:, :, DRIFT] = windows.reference
        jacobian[:, :, OFFSET] = slope_b
        jacobian[:, :, CLOCK] = slope_b * (windows.begin - self._middle)[:, None]
        jacobian *= windows.shown_b[None, :, None]
        count = windows.shown_b.sum() * weights.sum()
        square = float((weights[:, None] * error**2).sum() / count)
        self._noise = max(math.sqrt(square), EXACT * _size(windows.rate_b), 1e-8)
        root = np.sqrt(weights) / self._noise
        self._jacobian = jacobian * root[:, None, None]
        self._error = error * root[:, None]
        flat = self._jacobian.reshape(-1, len(PRIOR))
        return flat.T @ flat, flat.T @ self._error.ravel()

    def _now(self) -> Float64:
        return np.concatenate((np.zeros(4), self._bias, self._drift, [0.0, self._clock]))

    def _inverse(self, matrix: Float64) -> Float64:
        """Return posterior covariances, shape ``(..., 12, 12)``; 0 of what is not estimated."""
        information = matrix + np.diag(1 / PRIOR**2)
        fixed = ~self._free
        information[..., fixed, :] = information[..., :, fixed] = 0.0
        at = np.arange(len(PRIOR))
        information[..., at[fixed], at[fixed]] = 1.0
        size = np.sqrt(information[..., at, at])
        scale = size[..., :, None] * size[..., None, :]
        inverse = np.linalg.inv(information / scale + RIDGE * np.eye(len(PRIOR))) / scale
        inverse[..., at[fixed], at[fixed]] = 0.0
        return np.asarray(inverse)

    def _solved(self, matrix: Float64, vector: Float64) -> Float64:
        change = self._inverse(matrix) @ (vector - self._now() / PRIOR**2)
        length = self._windows.length
        change[: SCALE + 1] = np.clip(change[: SCALE + 1], -0.5, 0.5)
        change[OFFSET] = np.clip(change[OFFSET], -length, length)
        return np.asarray(change)

    def _move(self, change: Float64) -> None:
        self._matrix = rotation_matrix(exp(change[TURN])) @ self._matrix
        self._log_scale += float(change[SCALE])
        self._bias = self._bias + change[BIAS]
        self._drift = self._drift + change[DRIFT]
        self._offset += float(change[OFFSET])
        self._clock += float(change[CLOCK])

    def _scatter(self, matrix: Float64) -> Float64:
        """Return the variances of the parameters by the jackknife over blocks of time."""
        count = len(self._windows.begin)
        edges = np.arange(BLOCKS + 1) * count // BLOCKS
        blocks = [slice(*ends) for ends in pairwise(edges)]
        flat = [self._jacobian[each].reshape(-1, len(PRIOR)) for each in blocks]
        vectors = np.array(
            [one.T @ self._error[each].ravel() for one, each in zip(flat, blocks, strict=True)]
        )
        vectors -= vectors.mean(axis=0)
        without = self._inverse(matrix - np.array([one.T @ one for one in flat]))
        moved = np.einsum("bij,bj->bi", without, vectors)
        return np.asarray((BLOCKS - 1) / BLOCKS * (moved**2).sum(axis=0))

    def _noise_in_slope(self) -> float:
        """Return by how much noise exaggerates what the slopes of the rates show of the clock.

        Newton's matrix has the noise of A's slope; its product with B's slope has not.
        """
        windows = self._windows
        slope = math.exp(self._log_scale) * self._slope @ self._matrix.T * windows.shown_b
        own, common = float((slope**2).sum()), float((slope * windows.slope_b).sum())
        return max(1.0, own / max(common, 1e-3 * own, 1e-300))

    def _flattening(self) -> float:
        """Return by which share interpolation between samples may lessen the motion."""
        slope, rate = _size(self._slope), _changing(self._predicted) / math.exp(self._log_scale)
        return (self._windows.interval * slope / max(rate, 1e-9)) ** 2 / 12

    def _relation(self, matrix: Float64) -> Relation:
        windows, posterior = self._windows, self._inverse(matrix)
        scatter, variance = self._scatter(matrix), np.diag(posterior).copy()
        rate, _ = self._rates_of_a()
        certain = np.maximum(variance[TURN], 1e-30)
        # Noise of attitudes cancels in a sum of windows, and a bias is such a sum.
        variance[BIAS] *= SUMMED
        variance[DRIFT] *= SUMMED
        sigma = np.sqrt(np.maximum(scatter, variance))
        sigma[[OFFSET, CLOCK]] *= self._noise_in_slope()
        sigma[SCALE] = math.hypot(sigma[SCALE], self._flattening())
        return Relation(
            *self._axes,
            matrix=self._matrix,
            scale=math.exp(self._log_scale),
            bias=self._bias,
            drift=self._drift,
            offset=self._offset,
            clock=self._clock,
            middle=self._middle,
            sigma=sigma,
            covariance=posterior[TURN, TURN],
            inflation=float(np.median(scatter[TURN] / certain)),
            noise=self._noise,
            motion=self._motion,
            predicted=_changing(self._predicted[:, windows.shown_b]),
            windows=len(windows.begin),
            length=windows.length,
            span=windows.span,
            shown=windows.shown_b,
            excited=np.cov(rate.T),
            rank=self._rank,
            is_flat=self._is_flat,
            free=self._free.copy(),
        )


def _reference(b: Turning, axes: str, begin: Float64, length: float) -> Float64 | None:
    """Return the axes of B in which a drift is constant, ``(M, 3, 3)``; None of rates."""
    near = b.attitude_near(begin + length / 2)
    return None if near is None else rotation_matrix(conjugate(near) if axes == BODY else near)


def _slope(source: Turning, axes: str, begin: Float64, length: float) -> Float64:
    """Return how the mean rates over windows change with their beginning, rad/s^2."""
    eighth = length / 8
    later = source.mean_rate(axes, begin + eighth, length)
    return (later - source.mean_rate(axes, begin - eighth, length)) / (2 * eighth)


def _size(rate: Float64) -> float:
    return float(np.sqrt((rate**2).mean()))


def _changing(rate: Float64) -> float:
    """Return the RMS of rates about their mean."""
    return float(np.sqrt(((rate - rate.mean(axis=0)) ** 2).mean()))


def _shortest_turn(before: Float64, after: Float64) -> Float64:
    """Return the rotation matrix of the smallest turn that takes one direction to another."""
    cosine, axis = float(before @ after), np.cross(before, after)
    if cosine > -0.9999:  # noqa: PLR2004  # else half a turn about any axis across
        turn = _skew(axis[None])[0]
        return np.asarray(np.eye(3) + turn + turn @ turn / (1 + cosine))
    across = np.eye(3)[int(np.argmin(np.abs(before)))]
    across = across - before * (across @ before)
    across /= np.linalg.norm(across)
    return np.asarray(2 * np.outer(across, across) - np.eye(3))


def _skew(vectors: Float64) -> Float64:
    """Return the matrices of cross products, shape ``(N, 3, 3)``."""
    matrices = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = z, -y, x
    return matrices
