"""Robust least squares over windows: parameters, their observability and their covariance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.calibration.model import OF_GROUP, Model
from quatprop.calibration.settings import GROUPS
from quatprop.calibration.windows import RotationWindows, errors_of
from quatprop.errors import ComparisonError
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Bool, Float64
    from quatprop.series import GyroSeries

MAX_ROUNDS: Final = 20
"""Maximum number of iterations of Gauss-Newton."""

REWEIGHTED: Final = 3
"""Iterations of each kind of weights for one set of derivatives."""

CONVERGED: Final = 1e-2
"""Iterations end at a change below this, in standard deviations."""

LIMITS: Final = np.array([GROUPS[name].limit for name in OF_GROUP])
"""The units of parameters here: standard deviations of observable ones are below 1."""

RANKS: Final = np.array([GROUPS[name].rank for name in OF_GROUP])

DAMPING: Final = np.eye(len(LIMITS)) / 9
"""Information that bounds the steps of parameters that are not observable."""

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

ALIKE: Final = 1e-4
"""Minimum variance about an axis, relative to the largest: of exact data, one axis would decide."""

TOGETHER: Final = 1e3
"""Parameters cannot be separated if their variances differ by less than this factor."""

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


class Solution(NamedTuple):
    """The solution of the linear equations for one set of derivatives, in units of the limits.

    `by`: increments of all parameters, shape ``(14,)``
    `blocks`: information of each part of the recording about each axis, ``(B, 3, 14, 14)``
    `scores`: gradients of the parts at the solution, shape ``(B, 14)``
    `noise`, `used`: as in :class:`Estimate`
    """

    by: Float64
    blocks: Float64
    scores: Float64
    noise: Float64
    used: Bool


def fit(rates: GyroSeries, windows: RotationWindows, begin: Model, free: Bool) -> Estimate:
    """Estimate parameters by Gauss-Newton on the errors over windows.

    Unobservable parameters are held at their initial values, and the others estimated again.

    `free`: which to estimate
    """
    blind = _blind(rates, windows, begin)
    found = solve(*errors_of(rates, windows, begin), free)
    # What only noise of the rates shows would be estimated so that nothing is left of the rates.
    power = found.blocks.sum(axis=(0, 1))[np.ix_(free, free)]
    alone = 1 / np.linalg.inv(power + ROUNDING * np.trace(power) * np.eye(len(power))).diagonal()
    free = free.copy()
    free[free] = alone > blind[free] * (1 / found.noise).sum()
    while free.any():
        model = begin
        for _ in range(MAX_ROUNDS):
            found = solve(*errors_of(rates, windows, model), free)
            model, information = model.moved(LIMITS * found.by), found.blocks.sum(axis=(0, 1))
            if found.by @ (information + DAMPING) @ found.by < CONVERGED**2:
                break
        excess = _excess(found, free)
        seen = observable(information / excess - np.diag(blind * (1 / found.noise).sum()), free)
        if (seen == free).all():
            covariance = excess * np.outer(LIMITS[free], LIMITS[free]) * _covariance(found, free)
            return Estimate(model, free, covariance, found.noise, found.used)
        free = seen
    raise ComparisonError(
        "the log shows nothing of what was to be estimated: its motion is too small for the noise, "
        "or the clocks differ; record for longer, or estimate less"
    )


def solve(vectors: Float64, slope: Float64, free: Bool) -> Solution:
    """Solve the linear equations: Huber's estimator first, then least squares without outliers.

    `vectors`, `slope`: as :func:`quatprop.calibration.windows.errors_of` returns them

    References
    ----------
    Rousseeuw and Leroy, "Robust regression and outlier detection", 1987.
    """
    slope = LIMITS * slope
    by, left, some = np.zeros(len(free)), vectors, np.ix_(free, free)
    used = np.ones(len(left), np.bool_)
    cuts = np.linspace(0, len(left), min(BLOCKS, len(left)) + 1).astype(int)[1:-1]
    for number in range(2 * REWEIGHTED):
        if number <= REWEIGHTED:
            noise = (np.median(np.abs(left), axis=0) / 0.6745) ** 2
        else:
            noise = (left[used] ** 2).sum(axis=0) / max(_degrees(used, free), 1.0)
        noise = np.maximum(noise, max(ALIKE * noise.max(), ROUNDING**2))
        size = np.sqrt((left**2 / noise).sum(axis=1))
        used = size < REJECTED
        weight = HUBER / np.maximum(size, HUBER) if number < REWEIGHTED else used
        whitener = np.sqrt(weight[:, None] / noise)
        rows, whole = slope * whitener[..., None], vectors * whitener
        parts = [*zip(np.split(rows, cuts), np.split(whole, cuts), strict=True)]
        blocks = np.stack([x.transpose(1, 2, 0) @ x.swapaxes(0, 1) for x, _ in parts])
        scores = np.stack([np.tensordot(y, x) for x, y in parts])
        power, score = blocks.sum(axis=(0, 1)) + DAMPING, scores.sum(axis=0)
        by[free] = -np.linalg.lstsq(power[some], score[free])[0]
        left = vectors + slope @ by
    return Solution(by, blocks, scores + blocks.sum(axis=1) @ by, noise, used)


def _blind(rates: GyroSeries, windows: RotationWindows, model: Model) -> Float64:
    """Return the spurious information that noise of the rates contributes, doubled.

    The rates at the ends of a window tell of the clock, and their integral of all that multiplies
    them; both contain noise.
    """
    changes = np.diff(rates.rate[:MAX_LOOKED_AT], n=2, axis=0)
    variance = (np.median(np.abs(changes)) / 0.6745) ** 2 / 6
    since = (windows.t_ns - model.middle_ns) / NS_PER_S
    interval_s = np.median(np.diff(rates.t_ns)) / NS_PER_S
    of_integrals = interval_s * float(np.diff(since).sum())
    of_group = {"bias": 0.0, "offset": since.size, "drift": float((since**2).sum())}
    blind = [2 * variance * of_group.get(name, of_integrals) for name in OF_GROUP]
    return np.asarray(blind * LIMITS**2)


def observable(information: Float64, free: Bool) -> Bool:
    """Return which of the free parameters have standard deviations below their limits."""
    free = free.copy()
    while free.any():
        values, vectors = np.linalg.eigh(information[np.ix_(free, free)])
        values[values < ROUNDING * values[-1]] = ROUNDING
        variance = (vectors**2 / np.maximum(values, ROUNDING)).sum(axis=1)
        if variance.max() <= 1:
            break
        # Of all that may stand for one another, whatever the units.
        worst = np.flatnonzero(free)[variance > max(variance.max() / TOGETHER, 1.0)]
        free[worst[np.lexsort((worst, RANKS[worst]))[-1]]] = False
    return free


def _excess(found: Solution, free: Bool) -> float:
    """Return how much more than white noise the blocks scatter; 1 if that is by chance.

    References
    ----------
    Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage
    samples", Survey Methodology 28(2), 2002: what the spread of blocks is by white noise, and its
    degrees of freedom.
    """
    information = found.blocks.sum(axis=1)[:, free][..., free]
    white = np.linalg.pinv(information.sum(axis=0), hermitian=True)
    shares, scores = information @ white, found.scores[:, free]
    adds, takes = np.trace(shares, axis1=1, axis2=2), np.einsum("bij,bji->b", shares, shares)
    spread = float(np.einsum("bi,ij,bj->", scores, white, scores) / (adds - takes).sum())
    by_chance = SIGNIFICANT * np.sqrt(2 * takes.sum()) / adds.sum()
    return spread if spread > 1 + by_chance else 1.0


def _covariance(found: Solution, free: Bool) -> Float64:
    """Return the covariance for white noise, whose variance about each axis is estimated.

    References
    ----------
    Kenward and Roger, "Small sample inference for fixed effects from restricted maximum
    likelihood", Biometrics 53(3), 1997: estimated weights add to the covariance, and errors over
    estimated standard deviations follow a t distribution.
    """
    of_axes = found.blocks.sum(axis=0)[:, free][..., free]
    white = np.linalg.inv(of_axes.sum(axis=0))
    twice = (white @ of_axes @ white @ of_axes @ white).sum(axis=0)
    return np.asarray(white + 2 / max(_degrees(found.used, free), 2.0) * (2 * white - twice))


def _degrees(used: Bool, free: Bool) -> float:
    """Return the degrees of freedom of the noise about each axis."""
    return float(used.sum() - free.sum() / 3)
