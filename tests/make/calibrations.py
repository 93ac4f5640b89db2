"""Simulated gyroscopes with planted errors, and a reference with noise, for calibrations."""

import functools
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from quatprop import AttitudeSeries, GyroSeries
from quatprop.estimation.fit import Data, Priors, fit, rule_errors
from quatprop.estimation.model import ALL, OF_GROUP, Model, windows_of
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, log, multiply, shorter

HZ, FINER, SECONDS = 100, 20, 20
GYRO, REFERENCE = 1e-3, 1e-3
"""Noise: rad/s/sqrt(Hz), and rad about each axis."""
EVERYTHING = ("bias", "scale", "misalignment", "mount", "offset", "drift")
MODELS = (
    ("bias",),
    ("bias", "mount"),
    ("scale", "misalignment"),
    ("offset", "drift"),
    EVERYTHING,
)
SIZES = {"bias": 0.02, "scale": 0.01, "misalignment": 0.01, "offset": 0.02, "drift": 3e-5}
PRIORS = {
    "bias": 0.2,
    "scale": 0.1,
    "misalignment": 0.1,
    "mount": 1.0,
    "offset": 0.2,
    "drift": 1e-3,
}
"""Wide, so that what is planted decides."""
LENGTH_NS = 250_000_000


@functools.cache
def motion(axes=(1.0, 1.0, 1.0)):
    """Return times, s, rates and attitudes of a smooth motion: 20 times for each sample."""
    t_s = np.arange(SECONDS * HZ * FINER + 1) / (HZ * FINER)
    random = np.random.default_rng(5)
    rate = np.zeros((len(t_s), 3))
    for _ in range(12):
        phase = 2 * np.pi * random.uniform(0.1, 0.8) * t_s[:, None] + random.uniform(0, 6, 3)
        rate += 0.6 * random.normal(size=3) * axes * np.sin(phase)
    return t_s, rate, attitudes(np.rint(t_s * 1e9).astype(np.int64), rate, method="cubic")


def planted(random, names):
    """Return a model with errors of some kinds."""
    by = {name: SIZES[name] * random.normal(size=(name == OF_GROUP).sum()) for name in SIZES}
    by["mount"] = 0.2 * random.normal(size=3)
    values = np.zeros(len(OF_GROUP))
    for name in names:
        values[name == OF_GROUP] = by[name]
    return Model().with_increment(values)


def recorded(random, truth, axes=(1.0, 1.0, 1.0), *, gyro=GYRO, reference=REFERENCE):
    """Return the rates that a gyroscope with these errors measures, and the reference.

    The reference is relative to another frame, and a second shorter on either side.
    """
    t_s, rate, wxyz = motion(axes)
    at = np.arange(0, len(t_s), FINER)
    raw = rate[at] @ np.linalg.inv(truth.matrix).T + truth.bias
    raw += gyro * np.sqrt(HZ) * random.normal(size=raw.shape)
    rates = GyroSeries(np.rint(t_s[at] * 1e9).astype(np.int64), raw)
    at = at[HZ:-HZ]
    q = multiply(wxyz[at], exp(reference * random.normal(size=(len(at), 3))))
    since = t_s[at] - t_s[at].mean()
    t_ns = np.rint((t_s[at] - truth.offset - truth.drift * since) * 1e9).astype(np.int64)
    return rates, AttitudeSeries(t_ns, multiply(exp([0.3, 0.2, 1.0]), q))


def begun(rates, reference, names=EVERYTHING):
    """Return the data of windows, and priors about a model in which nothing is known."""
    middle_ns = (int(reference.t_ns[0]) + int(reference.t_ns[-1])) // 2
    model = Model(middle_ns=middle_ns)
    windows = windows_of(rates, reference, model, LENGTH_NS)
    data = Data(rates, windows, ALL, rule_errors(rates, windows, model))
    sigma = np.array([PRIORS[name] if name in names else 0.0 for name in OF_GROUP])
    return data, Priors(model, sigma, 0.2)


def error_of(found, truth):
    """Return the errors of all parameters, ``(14,)``."""
    error = found.values - truth.values
    turn = log(shorter(multiply(found.mount, conjugate(truth.mount))))
    error[OF_GROUP == "mount"] = turn
    return error


class Ensemble(NamedTuple):
    """The sum of normalised squared errors of runs, and how many parameters those had."""

    squares: float
    count: int

    def is_exact(self, comparisons, fault=1.0):
        """Tell whether the sum is in the 99.9 % band; `fault`: factor of standard deviations."""
        tail = 0.001 / 2 / comparisons
        low, high = chdtri(self.count, [1 - tail, tail])
        return bool(low < self.squares / fault**2 < high)


def ensemble(names, runs):
    """Return an ensemble of estimates."""
    random, squares, count = np.random.default_rng([32, *map(len, names)]), 0.0, 0
    for _ in range(runs):
        truth = planted(random, names)
        rates, reference = recorded(random, truth)
        data, priors = begun(rates, reference, names)
        found = fit(data, priors, priors.centre)
        assert found.free.sum() == np.isin(OF_GROUP, names).sum()
        error = error_of(found.model, truth)[found.free]
        covariance = found.covariance[np.ix_(found.free, found.free)]
        squares += error @ np.linalg.solve(covariance, error)
        count += len(error)
    return Ensemble(squares, count)
