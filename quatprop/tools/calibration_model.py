"""The model of a gyroscope and of two clocks, and its parameters.

Calibrated rates are w = R (I + U) (w_raw - b). The bias b is in the axes of the raw rates. U is
upper triangular: its diagonal corrects the scale, the elements above it the angles between the axes
of the sensor, whose z axis defines the frame. R is the mounting: sensor to the body of the
reference. Every matrix of positive determinant has exactly one such R and U.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.errors import ComparisonError
from quatprop.base.times import NS_PER_S
from quatprop.comparison.alignment import over_gap
from quatprop.kinematics.matrix_elements import rotation_elements
from quatprop.kinematics.propagate import Propagation
from quatprop.kinematics.quaternion import (
    IDENTITY,
    conjugate,
    exp,
    log,
    multiply,
    normalize,
    rotation_matrix,
    shorter,
)
from quatprop.kinematics.resample import Listed, at_times
from quatprop.kinematics.series import AttitudeSeries, GyroSeries, reblock
from quatprop.propagation.conditioning.corrections import corrected
from quatprop.settings.command_options import GROUPS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Bool, Float64, Int64


OF_GROUP: Final = np.array([name for name, group in GROUPS.items() for _ in group.axes])
"""The group of each of the 14 parameters."""

UPPER: Final = np.triu_indices(3, 1)
"""Rows and columns of the misalignment in U."""


class Model(NamedTuple):
    """Values of all parameters.

    `bias`: b, shape ``(3,)``, rad/s
    `shape`: I + U, shape ``(3, 3)``
    `mount`: R, sensor to body, wxyz, shape ``(4,)``
    `added_ns`: added to the timestamps of the reference, ns, before the offset
    `offset`: added to them in the middle, s
    `drift`: what more is added for each second after it, s
    `middle_ns`: the middle of the reference, in its own clock, ns
    """

    bias: Float64 = np.zeros(3)
    shape: Float64 = np.eye(3)
    mount: Float64 = IDENTITY
    added_ns: int = 0
    offset: float = 0.0
    drift: float = 0.0
    middle_ns: int = 0

    @property
    def matrix(self) -> Float64:
        """R (I + U), shape ``(3, 3)``."""
        return np.asarray(rotation_matrix(self.mount) @ self.shape)

    def moved(self, by: Float64) -> Model:
        """Return the model with increments of all parameters, ``(14,)``, in their order."""
        shape = self.shape + np.diag(by[OF_GROUP == "scale"])
        shape[UPPER] += by[OF_GROUP == "misalignment"]
        return self._replace(
            bias=self.bias + by[OF_GROUP == "bias"],
            shape=shape,
            mount=normalize(multiply(exp(by[OF_GROUP == "mount"]), self.mount)),
            offset=self.offset + float(by[OF_GROUP == "offset"][0]),
            drift=self.drift + float(by[OF_GROUP == "drift"][0]),
        )

    @property
    def values(self) -> Float64:
        """All parameters, ``(14,)``; the mounting as a rotation vector."""
        scale, turn = self.shape.diagonal() - 1, log(shorter(self.mount))
        clock = [self.offset, self.drift]
        return np.concatenate([self.bias, scale, self.shape[UPPER], turn, clock])

    def times_of(self, t_ns: Int64) -> Int64:
        """Return timestamps of the reference in the clock of the rates, int64 ns."""
        since = (t_ns - self.middle_ns) / NS_PER_S
        moved = np.rint((self.offset + self.drift * since) * NS_PER_S).astype(np.int64)
        return np.asarray(t_ns + self.added_ns + moved)

    def by_rate(self) -> Float64:
        """Return the derivatives of calibrated rates by the parameters; 0 for the clock.

        `Returns`: shape ``(14, 3, 4)``: times 1 and the three components of the rate
        """
        change = np.zeros((len(OF_GROUP), 3, 4))
        change[OF_GROUP == "bias", :, 0] = -self.matrix.T
        change[OF_GROUP == "mount", :, 1:] = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
        inverse = np.linalg.inv(self.matrix)
        of_shape = np.einsum("im,nj->mnij", rotation_matrix(self.mount), inverse)
        change[OF_GROUP == "scale", :, 1:] = of_shape[range(3), range(3)]
        change[OF_GROUP == "misalignment", :, 1:] = of_shape[UPPER]
        return change


# Rotations over windows, from rates and from a reference, and their derivatives.
#
# The rotation over a window does not depend on the reference frame. Windows end at samples of the
# reference and the next one begins at the sample after that, so that no two share its noise.


METHOD: Final = "cubic"
"""The rule by which rates are integrated."""

LONGEST: Final = 1.5
"""Windows longer than this many times the nominal length, because of gaps, are omitted."""

MAX_WINDOWS: Final = 200_000
"""Of more windows every second one is used, or fewer, which bounds memory."""

SPARE_NS: Final = 200_000_000
"""Margin around each window for a clock offset that is still unknown."""


class RotationWindows(NamedTuple):
    """Windows of a reference in order of time.

    `t_ns`: first and last time of each, in the clock of the reference, shape ``(M, 2)``, int64 ns
    `turn`: the rotation over each, in the body axes at its beginning, wxyz, shape ``(M, 4)``
    """

    t_ns: Int64
    turn: Float64

    def __len__(self) -> int:
        return len(self.t_ns)

    def where(self, chosen: Bool) -> RotationWindows:
        """Return some of the windows."""
        return RotationWindows(self.t_ns[chosen], self.turn[chosen])


def windows_of(
    rates: GyroSeries, reference: AttitudeSeries, model: Model, length_ns: int
) -> RotationWindows:
    """Return consecutive windows of about a length that rates cover without a gap."""
    t_ns = reference.t_ns
    edges = np.searchsorted(t_ns, np.arange(t_ns[0], t_ns[-1], length_ns))
    rows = np.stack([edges[:-1], edges[1:] - 1], axis=1)
    span_ns = np.diff(t_ns[rows])[:, 0]
    usual = (span_ns > 0) & (span_ns <= LONGEST * length_ns) & (2 * span_ns >= length_ns)
    need_ns = model.times_of(t_ns[rows]) + np.array([-SPARE_NS, SPARE_NS])
    inside = (need_ns[:, 0] >= rates.t_ns[0]) & (need_ns[:, 1] <= rates.t_ns[-1])
    rows = rows[usual & inside & ~over_gap(rates.t_ns, *need_ns.T)]
    begin, end = rows[:: len(rows) // MAX_WINDOWS + 1].T
    turn = multiply(conjugate(reference.wxyz[begin]), reference.wxyz[end])
    return RotationWindows(np.stack([t_ns[begin], t_ns[end]], axis=1), turn)


def errors_of(rates: GyroSeries, windows: RotationWindows, model: Model) -> tuple[Float64, Float64]:
    """Return the differences between the rotations of calibrated rates and of the reference.

    `rates`: raw rates in order of time
    `Returns`: rotation vectors from the rates' rotation to the reference's, in the body axes at the
        ends of windows, shape ``(M, 3)``, rad; and their derivatives with respect to each
        parameter, shape ``(M, 3, 14)``
    """
    calibrated = corrected(reblock([rates]), bias=model.bias, matrix=model.matrix)
    times = np.clip(model.times_of(windows.t_ns), rates.t_ns[0], rates.t_ns[-1])
    q, rate, sums = _reached(calibrated, times.ravel())
    begin, end = q[::2], q[1::2]
    turn = multiply(conjugate(begin), end)
    vectors = log(shorter(multiply(conjugate(turn), windows.turn)))
    by_rate = np.einsum("minj,pjn->mip", sums[1::2] - sums[::2], model.by_rate())
    slope = rotation_matrix(conjugate(end)) @ by_rate
    at_begin = np.einsum("mji,mj->mi", rotation_matrix(turn), rate[::2])
    since = (windows.t_ns - model.middle_ns)[..., None] / NS_PER_S
    slope[..., OF_GROUP == "offset"] = (rate[1::2] - at_begin)[..., None]
    drift = since[:, 1] * rate[1::2] - since[:, 0] * at_begin
    slope[..., OF_GROUP == "drift"] = drift[..., None]
    return vectors, -slope


def _reached(rates: Iterable[GyroSeries], t_ns: Int64) -> tuple[Float64, Float64, Float64]:
    """Return the attitudes and integrals that rates lead to at some times, from any initial one.

    `t_ns`: rising times within those of the rates, shape ``(K,)``
    `Returns`: attitudes, ``(K, 4)``; rates, ``(K, 3)``; and the integral of R times 1 and times
        each component of the rate, ``(K, 3, 4, 3)``
    """
    found = np.empty((39, len(t_ns)))

    def passing() -> Iterator[tuple[GyroSeries, AttitudeSeries]]:
        before, total, first = None, np.zeros((36, 1)), 0
        for block, attitudes in Propagation(IDENTITY, METHOD, "body").run(rates):
            yield block, attitudes
            samples, q = block, attitudes
            if before is not None:
                # The interval between blocks belongs to the later one.
                samples = GyroSeries.joined([before[0], block])
                q = AttitudeSeries.joined([before[1], attitudes])
            before = block[-1:], attitudes[-1:]
            turn = rotation_elements(q.wxyz)
            every = np.concatenate([np.ones((1, len(samples))), samples.rate.T])
            after = every[:, 1:]
            if not samples.is_integrated(METHOD):
                after = (after + every[:, :-1]) / 2
            since_s = (samples.t_ns - samples.t_ns[0]) / NS_PER_S
            middle = (turn[:, 1:] + turn[:, :-1]) / 2
            steps = (middle[:, None] * (after * np.diff(since_s))).reshape(36, -1)
            sums = np.cumsum(np.concatenate([total, steps], axis=1), axis=1)
            total = sums[:, -1:]
            last = int(np.searchsorted(t_ns, samples.t_ns[-1], side="right"))
            at_s = (t_ns[first:last] - samples.t_ns[0]) / NS_PER_S
            for row, values in zip(found, (*samples.rate.T, *sums), strict=True):
                row[first:last] = np.interp(at_s, since_s, values)
            first = last

    wanted = at_times(passing(), Listed(t_ns), method=METHOD, rates="body")
    q = AttitudeSeries.joined([*wanted]).wxyz
    # rows of R, factors, columns of R
    return q, found[:3].T, found[3:].T.reshape(-1, 3, 3, 4).swapaxes(2, 3)


# Robust least squares over windows: parameters, their observability and their covariance.


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

    `vectors`, `slope`: as :func:`quatprop.tools.calibration_model.errors_of` returns them

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
        by[free] = -np.linalg.lstsq(power[some], score[free], rcond=None)[0]
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
