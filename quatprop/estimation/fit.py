"""Robust least squares with priors: a gyroscope and two clocks, with their covariance.

A parameter that the motion does not determine keeps its prior, and the covariance of the others
includes its uncertainty. Noise of the rates is in the derivatives too, where it looks like motion:
the information that it adds is subtracted, and the bias of the scale that it causes is corrected.
Errors are not white: parts of the recording show how much more they scatter.

References
----------
Rousseeuw and Leroy, "Robust regression and outlier detection", 1987.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.estimation.followed import noise_density
from quatprop.estimation.model import (
    METHOD,
    OF_GROUP,
    FollowedMotion,
    Model,
    RotationWindows,
    errors_of,
    joined,
    turns_of,
)
from quatprop.kinematics.quaternion import conjugate, log, multiply, shorter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import AnyArray, Bool, Float64
    from quatprop.kinematics.series import GyroSeries

MAX_ROUNDS: Final = 20
"""Maximum number of iterations of Gauss-Newton."""

REWEIGHTED: Final = 3
"""Iterations of each kind of weights for one set of derivatives."""

CONVERGED: Final = 1e-2
"""Iterations end at a change below this, in standard deviations."""

STEP: Final = 0.3
"""Maximum change of the mounting, rad, and of the shape, in one iteration."""

HUBER: Final = 2.0
"""Threshold of Huber's weights, in standard deviations."""

REJECTED: Final = 4.6
"""Outliers of the final fit, in standard deviations: 1 in 10,000 of normal noise."""

BLOCKS: Final = 25
"""Number of parts of the recording whose scatter shows noise that is not white."""

BY_CHANCE: Final = 3.0
"""Standard deviations by which the parts scatter more before it counts."""

FINER: Final = "quintic"
"""A better rule than that by which rates are integrated: the difference is a part of the error."""

STAMP_S: Final = 1e-9
"""Timestamps are whole nanoseconds."""

BETWEEN: Final = 2 / 3
"""Mean variance of white noise that is interpolated, as a share of that of the samples."""

ROUNDING: Final = 1e-12
"""Minimum noise, rad: rounding errors."""


class Priors(NamedTuple):
    """The assumptions before the fit.

    `centre`: the values that are most likely
    `sigma`: standard deviations, SI units, shape ``(14,)``; 0 for what is not estimated
    `jump`: standard deviation of a jump of the bias, rad/s
    """

    centre: Model
    sigma: Float64
    jump: float

    def sigma_for(self, model: Model) -> Float64:
        """Return the standard deviations with those of the jumps, ``(14 + 3 J,)``."""
        return np.append(self.sigma, np.full(3 * len(model.jumps_ns), self.jump))


class Linear(NamedTuple):
    """The linear problem at one model, in units of the priors: P parameters that are estimated.

    `by`: increments, shape ``(P,)``
    `rows`: whitened derivatives, shape ``(M, S, P)``
    `left`: whitened errors that are left, shape ``(M, S)``
    `noise`: variance of the errors about each axis that counts, shape ``(S,)``, rad^2
    `used`: which windows are no outliers, shape ``(M,)``
    """

    by: Float64
    rows: Float64
    left: Float64
    noise: Float64
    used: Bool

    @property
    def information(self) -> Float64:
        """Of the windows that are used, without the priors, shape ``(P, P)``."""
        rows = self.rows[self.used]
        return np.asarray(np.tensordot(rows, rows, ((0, 1), (0, 1))))

    @property
    def scores(self) -> Float64:
        """The gradient that each window that is used adds, shape ``(U, P)``."""
        return np.asarray(np.einsum("mip,mi->mp", self.rows[self.used], self.left[self.used]))


class Estimate(NamedTuple):
    """Estimated parameters.

    `model`: their values
    `covariance`: of all, those not estimated have 0; SI units, shape ``(14 + 3 J, 14 + 3 J)``
    `linear`: the problem at the solution
    `free`: which parameters were estimated, shape ``(14 + 3 J,)``
    `excess`: by how much the variance of parts is above that of white noise, at least 1
    """

    model: Model
    covariance: Float64
    linear: Linear
    free: Bool
    excess: float


class Data(NamedTuple):
    """What parameters are estimated from.

    `rates`: in order of time, finite
    `windows`: M windows of the reference
    `seen`: the motion that the reference follows
    `by_rule`: differences of their rotations by a better rule of integration, ``(M, 3)``, rad
    """

    rates: GyroSeries
    windows: RotationWindows
    seen: FollowedMotion
    by_rule: Float64

    def where(self, chosen: Bool) -> Data:
        """Return the data of some windows."""
        return self._replace(windows=self.windows.where(chosen), by_rule=self.by_rule[chosen])

    @property
    def floor(self) -> float:
        """Minimum standard deviation of the errors, rad: of the integration, and of timestamps."""
        by_rule = np.sqrt((self.by_rule**2).mean(axis=0)).max(initial=0.0)
        speed = np.sqrt((self.rates.rate**2).sum(axis=1).mean())
        return float(np.hypot(by_rule, speed * STAMP_S) + ROUNDING)


def rule_errors(rates: GyroSeries, windows: RotationWindows, model: Model) -> Float64:
    """Return the differences of rotations by a better rule of integration, ``(M, 3)``, rad."""
    first, better = (turns_of(rates, windows, model, rule) for rule in (METHOD, FINER))
    return log(shorter(multiply(conjugate(better), first)))


def fit(data: Data, priors: Priors, begin: Model) -> Estimate:
    """Estimate parameters by Gauss-Newton on the errors over windows.

    `begin`: where the iterations begin
    """
    sigma = priors.sigma_for(begin)
    free, model = sigma > 0, begin
    unit = sigma[free]
    for _ in range(MAX_ROUNDS):
        vectors, slope = errors_of(data.rates, data.windows, model, data.seen)
        off = deviation(model, priors.centre)[free] / unit
        found = solve(vectors, slope[..., free] * unit, off, data.floor)
        by = np.zeros(len(sigma))
        by[free] = unit * found.by
        largest = np.abs(by[: len(OF_GROUP)][_OF_MATRIX]).max() / STEP
        model = model.with_increment(by / max(largest, 1.0))
        change = found.information + np.eye(len(unit))
        if found.by @ change @ found.by < CONVERGED**2:
            break
    return _certain(_Solution(data, priors, model, free), found)


def informations(lengths: list[Data], priors: Priors, model: Model) -> Iterator[Float64]:
    """Yield the information of windows of each length at one model, ``(P, P)``, in prior units.

    `lengths`: windows of the same series
    """
    sigma = priors.sigma_for(model)
    free = sigma > 0
    off = deviation(model, priors.centre)[free] / sigma[free]
    every = joined([data.windows for data in lengths])
    vectors, slope = errors_of(lengths[0].rates, every, model, lengths[0].seen)
    cuts = np.cumsum([len(data.windows) for data in lengths])[:-1]
    for data, part, by in zip(lengths, np.split(vectors, cuts), np.split(slope, cuts), strict=True):
        yield solve(part, by[..., free] * sigma[free], off, data.floor).information


def _eigen(information: Float64) -> tuple[Float64, Float64]:
    """Return the eigenvalues, 0 for those that are rounding errors, and the eigenvectors."""
    values, basis = np.linalg.eigh(information)
    rounding = 10 * len(values) * np.finfo(float).eps * values[-1]
    return np.where(values > max(rounding, 0.0), values, 0.0), basis


class _Solution(NamedTuple):
    """Where the iterations ended, and of what."""

    data: Data
    priors: Priors
    model: Model
    free: Bool


_OF_MATRIX: Final = np.isin(OF_GROUP, ("scale", "misalignment", "mount"))


def deviation(model: Model, centre: Model) -> Float64:
    """Return the parameters less those of another model, ``(14 + 3 J,)``; its jumps are 0."""
    values = model.values - centre.values
    values[OF_GROUP == "mount"] = log(shorter(multiply(model.mount, conjugate(centre.mount))))
    values[OF_GROUP == "offset"] += (model.added_ns - centre.added_ns) / NS_PER_S
    return np.append(values, model.jumps.ravel())


def solve(vectors: Float64, rows: Float64, off: Float64, floor: float) -> Linear:
    """Solve the linear problem: Huber's estimator first, then least squares without outliers.

    `vectors`, `rows`: errors, ``(M, S)``, and their derivatives by parameters in units of the
        priors, ``(M, S, P)``
    `off`: by how much the parameters differ from the prior's, in its units, ``(P,)``
    `floor`: minimum standard deviation of the errors, rad
    """
    by, left, taken = np.zeros(len(off)), vectors, 0.0
    used = np.ones(len(left), np.bool_)
    for number in range(2 * REWEIGHTED):
        if number <= REWEIGHTED:
            noise = (np.median(np.abs(left), axis=0) / 0.6745) ** 2
        else:
            each = max(used.sum() - taken / left.shape[1], 1.0)
            noise = (left[used] ** 2).sum(axis=0) / each
        noise = np.maximum(noise, floor**2)
        size = np.sqrt((left**2 / noise).sum(axis=1))
        used = size < REJECTED
        weight = HUBER / np.maximum(size, HUBER) if number < REWEIGHTED else used
        whitener = np.sqrt(weight[:, None] / noise)
        whole = rows * whitener[..., None]
        power = np.tensordot(whole, whole, ((0, 1), (0, 1)))
        score = np.tensordot(whole, vectors * whitener, ((0, 1), (0, 1)))
        shown, basis = _eigen(power)
        by = -basis @ ((score + off) @ basis / (shown + 1))
        taken = float((shown / (shown + 1)).sum())
        left = vectors + rows @ by
    deviations = np.sqrt(noise)
    return Linear(by, rows / deviations[:, None], left / deviations, noise, used)


def _certain(at: _Solution, found: Linear) -> Estimate:
    """Return the estimate with its covariance."""
    priors, model, free = at.priors, at.model, at.free
    unit = priors.sigma_for(model)[free]
    spurious = _spurious(at, found)[free] * unit**2
    values, basis = _eigen(found.information - np.diag(spurious))
    scores = _scores(found) @ basis
    scatter = (scores**2 / (values + 1)).sum() / max((values / (values + 1)).sum(), 1.0)
    excess = max(float(scatter), 1.0) if scatter > 1 + BY_CHANCE * _spread(values) else 1.0
    values, scores = values / excess, scores / np.sqrt(excess)
    posterior = basis / (values + 1) @ basis.T
    if excess > 1:  # less certain data, and the same priors
        off = deviation(model, priors.centre)[free] / unit
        score = found.scores.sum(axis=0)
        by = np.zeros(len(free))
        by[free] = -unit * (posterior @ (score / excess + off))
        model = model.with_increment(np.clip(by, -STEP, STEP))
    white = _of_estimated_noise(basis * values / (values + 1) ** 2 @ basis.T, found, excess)
    by_parts = ((scores / (values + 1) @ basis.T) ** 2).sum(axis=0)
    more = by_parts / np.maximum(white.diagonal(), 1e-12)
    more = np.sqrt(np.where(more > 1 + BY_CHANCE * np.sqrt(2 / BLOCKS), more, 1.0))
    covariance = more[:, None] * white * more + basis / (values + 1) ** 2 @ basis.T
    lost = spurious / unit * _share_alone(at, found) * (groups_of(free) == "scale")
    with_noise = found.information / excess + np.eye(len(unit))
    more_scale = np.linalg.solve(with_noise, lost) / excess
    by_rule = posterior @ _of_rule(at, found) / excess
    by = np.zeros(len(free))
    by[free] = unit * more_scale
    model = model.with_increment(np.clip(by, -STEP, STEP))
    for half_known in (more_scale / 2, by_rule):
        covariance += np.outer(half_known, half_known)
    whole = np.zeros((len(free), len(free)))
    whole[np.ix_(free, free)] = covariance * np.outer(unit, unit)
    return Estimate(model, whole, found, free, excess)


def _of_estimated_noise(white: Float64, found: Linear, excess: float) -> Float64:
    """Return the covariance by white noise whose variance about each axis was estimated.

    References
    ----------
    Kenward and Roger, "Small sample inference for fixed effects from restricted maximum
    likelihood", Biometrics 53(3), 1997: estimated weights add to the covariance, and errors over
    estimated standard deviations follow a t distribution.
    """
    rows = found.rows[found.used]
    axes = range(rows.shape[1])
    shares = np.stack([white @ (rows[:, k].T @ rows[:, k]) / excess for k in axes])
    degrees = max(float(found.used.sum()) - float(np.trace(shares.sum(axis=0))) / len(axes), 2.0)
    twice = (shares @ shares).sum(axis=0) @ white
    return np.asarray(white + 2 / degrees * (2 * white - twice))


def _spread(values: Float64) -> float:
    """Return the standard deviation of the scatter of parts of white noise."""
    share = values / (values + 1)
    return float(np.sqrt(2 / BLOCKS * (share**2).sum()) / max(share.sum(), 1.0))


def _scores(found: Linear) -> Float64:
    """Return the gradients of parts of the recording about their mean, ``(B, P)``."""
    each = found.scores
    cuts = np.linspace(0, len(each), BLOCKS + 1).astype(int)[:-1]
    parts = np.add.reduceat(each, cuts)
    return np.asarray((parts - parts.mean(axis=0)) * np.sqrt(BLOCKS / (BLOCKS - 1)))


def _spurious(at: _Solution, found: Linear) -> Float64:
    """Return the information that noise of the rates seems to give, SI units, ``(14 + 3 J,)``.

    The rates at the ends of a window tell of the clock, and their integral of all that multiplies
    them; both contain noise.
    """
    spans = at.data.windows.t_ns[found.used]
    seen, variance = at.data.seen, noise_density(at.data.rates) ** 2
    interval_s = float(np.median(np.diff(at.data.rates.t_ns))) / NS_PER_S
    since = (spans - at.model.middle_ns) / NS_PER_S

    def power(by: Float64) -> Float64:
        # of derivatives by the rates, shape (..., 3, 3), times white noise
        return np.asarray(
            (((seen.errors @ by @ seen.motion) ** 2).sum(axis=-1)) @ (1 / found.noise)
        )

    each = power(at.model.by_rate()[..., 1:]) * float(np.diff(since).sum())
    at_ends = float(power(np.eye(3))) * BETWEEN / interval_s
    each[OF_GROUP == "offset"] = at_ends * since.size
    each[OF_GROUP == "drift"] = at_ends * float((since**2).sum())
    return np.append(variance * each, np.zeros(3 * len(at.model.jumps_ns)))


def _share_alone(at: _Solution, found: Linear) -> float:
    """Return how much of the noise of the rates the errors have: a reference may be made of them.

    None, where all of it may be the motion and the integration.
    """
    length_s = at.data.windows.length_ns / NS_PER_S
    noise = noise_density(at.data.rates) ** 2 * length_s
    seen = max(float(found.noise.mean()) - at.data.floor**2, 0.0)
    return min(1.0, seen / max(noise, ROUNDING**2))


def _of_rule(at: _Solution, found: Linear) -> Float64:
    """Return the gradient of the errors of the integration rule, in units of the priors, ``(P,)``.

    They do not average out.
    """
    by_rule = at.data.by_rule[found.used] @ at.data.seen.errors.T / np.sqrt(found.noise)
    return np.asarray(np.tensordot(found.rows[found.used], by_rule, ((0, 1), (0, 1))))


def groups_of(free: Bool) -> AnyArray:
    """Return the group of each estimated parameter, ``(P,)``; ``"jump"`` for those of jumps."""
    return np.append(OF_GROUP, ["jump"] * (len(free) - len(OF_GROUP)))[free]
