"""Robust least squares over windows: parameters, what the motion shows of them, and how well."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.calibration.model import LIMITS, OF_GROUP, PARAMETERS, Model
from quatprop.calibration.windows import Errors, Windows, errors_of
from quatprop.kinematics.quaternion import log, shorter

if TYPE_CHECKING:
    from quatprop.arrays import Bool, Float64
    from quatprop.series import GyroSeries

MAX_ROUNDS: Final = 20
"""Rounds of least squares at most."""

CONVERGED: Final = 1e-2
"""Change, in standard deviations, below which there are no more of them."""

LOOSE: Final = 3.0
"""Limits by which parameters may differ from where they begin until it is known what is shown."""

HUBER: Final = 2.0
"""Errors, in standard deviations, that count less and less until then."""

REJECTED: Final = 4.6
"""Errors, in standard deviations, that do not count afterwards: one in 10,000 of normal noise."""

BLOCKS: Final = 20
"""Parts of the recording from whose spread the covariance is estimated."""

ROUNDING: Final = 1e-12
"""Noise, rad, below which errors are those of rounding."""


class Fit(NamedTuple):
    """Parameters that fit windows best.

    `free`: which were estimated, shape ``(14,)``; the others are where they began
    `covariance`: of those, shape ``(F, F)``
    `noise`: variance of the errors over windows about each axis of the body, shape ``(3,)``, rad^2
    `used`: which windows are no outliers, shape ``(M,)``
    """

    model: Model
    free: Bool
    covariance: Float64
    noise: Float64
    used: Bool


def fit(rates: GyroSeries, windows: Windows, begin: Model, free: Bool) -> Fit:
    """Estimate parameters by Gauss-Newton on the errors over windows.

    `free`: which to estimate, where they are shown

    References
    ----------
    Huber's estimator first, then least squares without outliers: Rousseeuw and Leroy, "Robust
    regression and outlier detection", 1987.
    """
    while True:
        model, information = _robust_fit(rates, windows, begin, free)
        fewer = shown(information, free)
        if (fewer == free).all():
            break
        free = fewer  # once more from the beginning: what is not shown stays there
    used = np.ones(len(windows), np.bool_)
    for _ in range(MAX_ROUNDS):
        errors = errors_of(rates, windows, model)
        noise, used = _noise(errors.vectors, used, int(free.sum()))
        information, scores = normal_equations(errors, noise, used)
        power = information[np.ix_(free, free)]
        by = _step(power, scores.sum(axis=0), free)
        if by[free] @ power @ by[free] < CONVERGED**2:
            break
        model = model.moved(by)
    return Fit(model, free, _covariance(power, scores[:, free], free), noise, used)


def _robust_fit(
    rates: GyroSeries, windows: Windows, begin: Model, free: Bool
) -> tuple[Model, Float64]:
    """Return a model from any beginning, and what windows tell of each parameter."""
    prior = np.diag((LOOSE * LIMITS) ** -2.0)
    model, total = begin, np.zeros(len(PARAMETERS))
    for _ in range(MAX_ROUNDS):
        errors = errors_of(rates, windows, model)
        noise, weight = robust_noise(errors.vectors)
        information, scores = normal_equations(errors, noise, weight)
        power = (information + prior)[np.ix_(free, free)]
        by = _step(power, scores.sum(axis=0) + prior @ total, free)
        model, total = model.moved(by), total + by
        if by[free] @ power @ by[free] < CONVERGED**2:
            break
    return model, information


def normal_equations(
    errors: Errors, noise: Float64, weight: Float64 | Bool
) -> tuple[Float64, Float64]:
    """Return the information on all parameters, ``(14, 14)``, and scores of windows, ``(M, 14)``."""
    weighted = errors.slope * (weight[:, None] / noise)[..., None]
    flat = (-1, len(PARAMETERS))
    information = weighted.reshape(flat).T @ errors.slope.reshape(flat)
    return information, np.einsum("mip,mi->mp", weighted, errors.vectors)


def _step(power: Float64, score: Float64, free: Bool) -> Float64:
    by = np.zeros(len(PARAMETERS))
    by[free] = -np.linalg.solve(power, score[free])
    return by


def robust_noise(vectors: Float64) -> tuple[Float64, Float64]:
    """Return variances by medians, ``(3,)``, and the weights of Huber's estimator, ``(M,)``."""
    scale = np.maximum(np.median(np.abs(vectors), axis=0) / 0.6745, ROUNDING)
    size = np.linalg.norm(vectors / scale, axis=1)
    return scale**2, HUBER / np.maximum(size, HUBER)


def _noise(vectors: Float64, used: Bool, parameters: int) -> tuple[Float64, Bool]:
    """Return the variances of errors without outliers, and which are none."""
    noise, _ = robust_noise(vectors)
    for _ in range(MAX_ROUNDS):
        before, used = used, (vectors**2 / noise).sum(axis=1) < REJECTED**2
        degrees = max(used.sum() - parameters / 3, 1.0)
        noise = np.maximum((vectors[used] ** 2).sum(axis=0) / degrees, ROUNDING**2)
        if (before == used).all():
            break
    return noise, used


def shown(information: Float64, free: Bool) -> Bool:
    """Return which of the free parameters can be told better than their limits."""
    free = free.copy()
    while free.any():
        scaled = LIMITS[free, None] * information[np.ix_(free, free)] * LIMITS[free]
        values, vectors = np.linalg.eigh(scaled)
        variance = (vectors**2 / np.maximum(values, ROUNDING)).sum(axis=1)
        if variance.max() <= 1:
            break
        # Of those that are told equally badly, the last.
        free[np.flatnonzero(free)[variance > variance.max() / 2][-1]] = False
    return free


def _covariance(power: Float64, scores: Float64, free: Bool) -> Float64:
    """Return the covariance of parameters whatever the noise: from how blocks of windows differ.

    Each group of parameters has the correlations that white noise would give, and the variances of
    the blocks, as a factor: nine or more of their squares are too few for all covariances.

    `scores`: of windows, in the order of time, shape ``(M, F)``

    References
    ----------
    Cameron and Miller, "A practitioner's guide to cluster-robust inference", J. Human Resources
    50(2), 2015.
    """
    count = min(BLOCKS, len(scores))
    starts = -(-np.arange(count) * len(scores) // count)
    white = np.linalg.inv(power)
    moves = np.add.reduceat(scores, starts) @ white
    ratio = (moves**2).sum(axis=0) * count / (count - 1) / white.diagonal()
    groups = OF_GROUP[free]
    for group in np.unique(groups):
        degrees = (groups == group).sum() * (count - 1)
        # So is the mean square of a normal error over an estimated variance.
        ratio[groups == group] = ratio[groups == group].mean() * degrees / (degrees - 2)
    return np.asarray(np.sqrt(ratio[:, None] * ratio) * white)
