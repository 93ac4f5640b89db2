"""Least squares over windows: the calibration, and what the motion shows of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.calibration.model import LIMITS, PARAMETERS, Model
from quatprop.calibration.windows import Errors, Windows, errors_of

if TYPE_CHECKING:
    from quatprop.arrays import Bool, Float64
    from quatprop.series import GyroSeries

MAX_ROUNDS: Final = 20
LOOSE: Final = 30.0
"""Limits by which parameters are held near where they begin until it is known what is shown."""
REJECTED: Final = 4.6
"""Errors, in standard deviations, beyond which a window is left out: one of 10,000 is."""
HUBER: Final = 2.0
CONVERGED: Final = 1e-2
"""Change, in standard deviations, below which there are no more rounds."""
HELD_FIRST: Final = ("misalignment", "scale", "drift", "mount", "offset", "bias")


class Fit(NamedTuple):
    """Parameters that fit windows best.

    `free`: which were estimated, shape ``(14,)``; the others are where they began
    `covariance`: of those, shape ``(F, F)``
    `noise`: covariance of the errors over windows, shape ``(3, 3)``, rad^2
    `used`: which windows are no outliers, shape ``(M,)``
    """

    model: Model
    free: Bool
    covariance: Float64
    noise: Float64
    used: Bool


def fit(rates: GyroSeries, windows: Windows, begin: Model, free: Bool) -> Fit:
    """Estimate parameters by least squares.

    `free`: which to estimate, where they are shown
    """
    while True:
        model, information = _nearly(rates, windows, begin, free)
        fewer = shown(information, free)
        if (fewer == free).all():
            break
        free = fewer  # from the beginning: what is not shown stays there
    used = np.ones(len(windows), np.bool_)
    for _ in range(MAX_ROUNDS):
        errors = errors_of(rates, windows, model)
        noise, used = _noise(errors.vectors, used, int(free.sum()))
        power = _information(errors, noise, used)[np.ix_(free, free)]
        by = _step(errors, noise, used, power, free)
        if _is_small(by[free], power):
            break
        model = model.moved(by)
    return Fit(model, free, np.linalg.inv(power), noise, used)


def _nearly(
    rates: GyroSeries, windows: Windows, model: Model, free: Bool
) -> tuple[Model, Float64]:
    """Estimate parameters from any beginning, and return what windows tell of all."""
    loose = np.diag((LOOSE * LIMITS[free]) ** -2.0)
    for _ in range(MAX_ROUNDS):
        errors = errors_of(rates, windows, model)
        noise, weight = _robust(errors.vectors)
        information = _information(errors, noise, weight)
        power = information[np.ix_(free, free)] + loose
        by = _step(errors, noise, weight, power, free)
        model = model.moved(by)
        if _is_small(by[free], power):
            break
    return model, information


def _information(errors: Errors, noise: Float64, weight: Float64 | Bool) -> Float64:
    inverse = np.linalg.inv(noise)
    return np.einsum("mip,ij,mjq,m->pq", errors.slope, inverse, errors.slope, weight, optimize=True)


def _step(
    errors: Errors, noise: Float64, weight: Float64 | Bool, power: Float64, free: Bool
) -> Float64:
    score = np.einsum(
        "mip,ij,mj,m->p", errors.slope, np.linalg.inv(noise), errors.vectors, weight, optimize=True
    )
    by = np.zeros(len(PARAMETERS))
    by[free] = -np.linalg.solve(power, score[free])
    return by


def _is_small(by: Float64, power: Float64) -> bool:
    return bool(by @ power @ by < CONVERGED**2)


def _robust(vectors: Float64) -> tuple[Float64, Float64]:
    """Return a diagonal covariance by medians, and the weights of Huber's estimator."""
    scale = np.maximum(np.median(np.abs(vectors), axis=0) / 0.6745, 1e-9)
    size = np.linalg.norm(vectors / scale, axis=1)
    return np.diag(scale**2), np.minimum(1.0, HUBER / np.maximum(size, 1e-9))


def _noise(vectors: Float64, used: Bool, parameters: int) -> tuple[Float64, Bool]:
    noise, _ = _robust(vectors)
    for _ in range(MAX_ROUNDS):
        size = np.einsum("mi,ij,mj->m", vectors, np.linalg.inv(noise), vectors)
        before, used = used, size < REJECTED**2
        chosen = vectors[used]
        noise = chosen.T @ chosen / (len(chosen) - parameters / 3)
        if (before == used).all():
            break
    return noise, used


def shown(information: Float64, free: Bool) -> Bool:
    """Return which of the free parameters can be told better than their limits."""
    free = free.copy()
    order = np.array([HELD_FIRST.index(parameter.group) for parameter in PARAMETERS])
    while free.any():
        scaled = LIMITS[free, None] * information[np.ix_(free, free)] * LIMITS[free]
        values, vectors = np.linalg.eigh(scaled)
        variance = (vectors**2 / np.maximum(values, 1e-12)).sum(axis=1)
        if variance.max() <= 1:
            break
        # Of those that are told equally badly, the one that is named first.
        worst = np.flatnonzero(free)[variance > variance.max() / 2]
        free[worst[np.argmin(order[worst])]] = False
    return free
