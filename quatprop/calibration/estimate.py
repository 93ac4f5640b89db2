"""Robust least squares over windows: parameters, their observability and their covariance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.calibration.model import LIMITS, OF_GROUP, PARAMETERS, Model
from quatprop.calibration.windows import Errors, RotationWindows, errors_of
from quatprop.errors import ComparisonError
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Bool, Float64
    from quatprop.series import GyroSeries

MAX_ROUNDS: Final = 20
"""Maximum number of iterations."""

CONVERGED: Final = 1e-2
"""Iterations end at a change below this, in standard deviations."""

LOOSE: Final = 3.0
"""Width of the prior that keeps unobservable parameters bounded, in multiples of their limits."""

HUBER: Final = 2.0
"""Threshold of Huber's weights, in standard deviations."""

REJECTED: Final = 4.6
"""Outliers of the final fit, in standard deviations: 1 in 10,000 of normal noise."""

BLOCKS: Final = 20
"""Number of parts of the recording whose scatter shows noise that is not white."""

MAX_LOOKED_AT: Final = 100_000
"""Samples, from the start, from which the noise of the rates is estimated."""

SIGNIFICANT: Final = 3.0
"""Noise is not white if the blocks scatter by this many standard deviations more."""

ROUNDING: Final = 1e-12
"""Minimum noise, rad: rounding errors."""


class Estimate(NamedTuple):
    """A least squares estimate of the parameters.

    `free`: which were estimated, shape ``(14,)``; the others keep their initial values
    `covariance`: of the estimated ones, shape ``(F, F)``
    `noise`: variance of the errors over windows about each axis of the body, shape ``(3,)``, rad^2
    `used`: which windows are no outliers, shape ``(M,)``
    """

    model: Model
    free: Bool
    covariance: Float64
    noise: Float64
    used: Bool


def fit(rates: GyroSeries, windows: RotationWindows, begin: Model, free: Bool) -> Estimate:
    """Estimate parameters by Gauss-Newton on the errors over windows.

    Unobservable parameters are held at their initial values, and the others estimated again.

    `free`: which to estimate

    References
    ----------
    Huber's estimator first, then least squares without outliers: Rousseeuw and Leroy, "Robust
    regression and outlier detection", 1987.
    """
    blind = _blind(rates, windows, begin)
    while True:
        if not free.any():
            raise ComparisonError(
                "the log shows nothing of what was to be estimated: its motion is too small for "
                "the noise, or the clocks differ; record for longer, or estimate less"
            )
        model, information, noise = _robust_fit(rates, windows, begin, free)
        fewer = observable(information - np.diag(blind * (1 / noise).sum()), free)
        if (fewer == free).all():
            found = _final_fit(rates, windows, model, free)
            # Without outliers, or with noise that is not white, fewer may be observable.
            information = np.zeros_like(information)
            information[np.ix_(free, free)] = np.linalg.inv(found.covariance)
            fewer = observable(information, free)
            if (fewer == free).all():
                return found
        free = fewer


def _final_fit(rates: GyroSeries, windows: RotationWindows, model: Model, free: Bool) -> Estimate:
    """Return the least squares estimate without outliers, starting close to it."""
    used = np.ones(len(windows), np.bool_)
    for _ in range(MAX_ROUNDS):
        errors = errors_of(rates, windows, model)
        noise, used = _noise(errors.vectors, used, int(free.sum()))
        information, scores = normal_equations(errors, noise, used)
        power = information.sum(axis=0)[np.ix_(free, free)]
        by = _step(power, scores.sum(axis=0), free)
        if by[free] @ power @ by[free] < CONVERGED**2:
            break
        model = model.moved(by)
    parts = information[:, free][..., free], scores[:, free]
    degrees = float(used.sum() - free.sum() / 3)
    return Estimate(model, free, _covariance(*parts, degrees), noise, used)


def _robust_fit(
    rates: GyroSeries, windows: RotationWindows, begin: Model, free: Bool
) -> tuple[Model, Float64, Float64]:
    """Return Huber's estimate, the information matrix, and the variances of the errors."""
    prior = np.diag((LOOSE * LIMITS) ** -2.0)
    model, total = begin, np.zeros(len(PARAMETERS))
    for _ in range(MAX_ROUNDS):
        errors = errors_of(rates, windows, model)
        noise, weight = robust_noise(errors.vectors)
        blocks, scores = normal_equations(errors, noise, weight)
        information = blocks.sum(axis=0)
        power = (information + prior)[np.ix_(free, free)]
        by = _step(power, scores.sum(axis=0) + prior @ total, free)
        model, total = model.moved(by), total + by
        if by[free] @ power @ by[free] < CONVERGED**2:
            break
    return model, information, noise


def _blind(rates: GyroSeries, windows: RotationWindows, model: Model) -> Float64:
    """Return the spurious information on the clock that noise of the rates contributes, doubled.

    A clock offset changes the rotation over a window by the rates at its ends, including their
    noise.
    """
    changes = np.diff(rates.rate[:MAX_LOOKED_AT], n=2, axis=0)
    variance = (np.median(np.abs(changes)) / 0.6745) ** 2 / 6
    since = (windows.t_ns - model.middle_ns) / NS_PER_S
    blind = np.zeros(len(PARAMETERS))
    blind[OF_GROUP == "offset"] = 2 * variance * since.size
    blind[OF_GROUP == "drift"] = 2 * variance * (since**2).sum()
    return blind


def normal_equations(
    errors: Errors, noise: Float64, weight: Float64 | Bool
) -> tuple[Float64, Float64]:
    """Return the information matrices and the scores of blocks of windows, for all parameters.

    `Returns`: shapes ``(B, 14, 14)`` and ``(B, 14)``
    """
    # Whitened errors: one row for each axis of a window.
    whitener = np.sqrt(weight[:, None] / noise)
    rows = (errors.slope * whitener[..., None]).reshape(-1, len(PARAMETERS))
    left = (errors.vectors * whitener).ravel()
    cuts = np.linspace(0, len(weight), min(BLOCKS, len(weight)) + 1).astype(int)[1:-1] * 3
    blocks = [*zip(np.split(rows, cuts), np.split(left, cuts), strict=True)]
    return np.stack([x.T @ x for x, _ in blocks]), np.stack([x.T @ y for x, y in blocks])


def _step(power: Float64, score: Float64, free: Bool) -> Float64:
    by = np.zeros(len(PARAMETERS))
    by[free] = -np.linalg.solve(power, score[free])
    return by


def robust_noise(vectors: Float64) -> tuple[Float64, Float64]:
    """Return variances from medians, ``(3,)``, and Huber's weights, ``(M,)``."""
    scale = np.maximum(np.median(np.abs(vectors), axis=0) / 0.6745, ROUNDING)
    size = np.linalg.norm(vectors / scale, axis=1)
    return scale**2, HUBER / np.maximum(size, HUBER)


def _noise(vectors: Float64, used: Bool, parameters: int) -> tuple[Float64, Bool]:
    """Return the variances of errors without outliers, and which windows are not outliers."""
    noise, _ = robust_noise(vectors)
    for _ in range(MAX_ROUNDS):
        before, used = used, (vectors**2 / noise).sum(axis=1) < REJECTED**2
        degrees = max(used.sum() - parameters / 3, 1.0)
        noise = np.maximum((vectors[used] ** 2).sum(axis=0) / degrees, ROUNDING**2)
        if (before == used).all():
            break
    return noise, used


def observable(information: Float64, free: Bool) -> Bool:
    """Return which of the free parameters have standard deviations below their limits."""
    free = free.copy()
    while free.any():
        scaled = LIMITS[free, None] * information[np.ix_(free, free)] * LIMITS[free]
        values, vectors = np.linalg.eigh(scaled)
        variance = (vectors**2 / np.maximum(values, ROUNDING)).sum(axis=1)
        if variance.max() <= 1:
            break
        # Of those that are about equally uncertain, the last in order.
        free[np.flatnonzero(free)[variance > variance.max() / 2][-1]] = False
    return free


def _covariance(information: Float64, scores: Float64, degrees: float) -> Float64:
    """Return the covariance for white noise, enlarged if the blocks scatter more than that.

    `information`, `scores`: of blocks, shapes ``(B, F, F)`` and ``(B, F)``
    `degrees`: degrees of freedom of the noise about each axis

    References
    ----------
    Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage
    samples", Survey Methodology 28(2), 2002: what the spread of blocks is by white noise, and its
    degrees of freedom.
    """
    white = np.linalg.inv(information.sum(axis=0))
    shares = information @ white  # of each block in the information
    adds, takes = np.trace(shares, axis1=1, axis2=2), np.einsum("bij,bji->b", shares, shares)
    spread = np.einsum("bi,ij,bj->", scores, white, scores) / (adds - takes).sum()
    by_chance = SIGNIFICANT * np.sqrt(2 * takes.sum()) / adds.sum()
    # A normal error over an estimated variance has this mean square.
    white *= degrees / max(degrees - 2, 1.0)
    return np.asarray(white * spread if spread > 1 + by_chance else white)
