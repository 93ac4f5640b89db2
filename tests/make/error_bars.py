"""Ensembles of logs with rests, for the uncertainty that is stated of them.

The truth is integrated by the oracle, all runs at once: nothing is shared with what is tested.
"""

import math
import warnings
from contextlib import suppress
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from make import oracle
from make.motion import simulated
from scipy.special import chdtri

from quatprop import GyroSeries, propagate
from quatprop.base.errors import UsageError
from quatprop.kinematics.quaternion import conjugate, log, multiply

HZ = 20
INTERVAL_NS = 10**9 // HZ
REST_S, MOTION_S = 3, 4
NOISE, JUMP, LITTLE_NOISE = 2e-3, 1e-3, 5e-6
"""rad/s/sqrt(Hz); rad/s; and the noise with which a jump shows."""
SIGMAS = {"scale_sigma": 3e-3, "misalignment_sigma": 5e-3, "q0_sigma": (4e-3, 6e-3, 1e-2)}
WAYS = ("static@+0s..+2950ms", "static:nearest", "static:interpolate")


def true_rates(motion):
    """Return stamps and true rates: rest, motion, rest, motion, rest."""
    _, moving = simulated(motion, "body", MOTION_S * HZ, INTERVAL_NS)
    rest = np.zeros((REST_S * HZ, 3))
    rate = np.concatenate([rest, moving, rest, moving[::-1], rest])
    return np.arange(len(rate)) * INTERVAL_NS, rate


def stated(rate, bias, **settings):
    """Return what is made of measured rates, remarks aside."""
    series = GyroSeries(np.arange(len(rate)) * INTERVAL_NS, rate)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return propagate(series, bias=bias, sigma=True, **settings)


def rests_of(result):
    """Return the first and the last sample of each rest from which the bias was taken."""
    conditioning = result.report.correction
    return [
        (rest.first_ns // INTERVAL_NS, rest.last_ns // INTERVAL_NS)
        for rest in conditioning.rests or [conditioning.rest]
    ]


def biases(measured, rests, way):
    """Return the bias at every sample, ``(N, 3, runs)``, as the way says."""
    means = np.array([measured[first : last + 1].mean(axis=0) for first, last in rests])
    k = np.arange(len(measured))
    if "interpolate" in way:
        shares = [np.interp(k, np.ravel(rests), np.repeat(row, 2)) for row in np.eye(len(rests))]
        return np.einsum("rk,rij->kij", shares, means)
    far = [np.maximum(np.maximum(first - k, k - last), 0) for first, last in rests]
    return means[np.argmin(far, axis=0)]


def turns(rate, first):
    """Return the attitudes at the end, as four arrays, from the rates ``(N, 3, runs)``."""
    wxyz = first
    for row in rate[:-1]:
        wxyz = oracle.product(wxyz, oracle.increments(row.T / HZ))
    return wxyz


class Ensemble(NamedTuple):
    """The final errors of runs, and the errors stated for one of them.

    `errors`: about body axes, ``(3, runs)``, rad
    `covariance`: ``(3, 3)``, rad^2
    """

    errors: np.ndarray
    covariance: np.ndarray

    def is_exact(self, comparisons, fault=1.0):
        """Tell whether the sum of e' P^-1 e is in the 99.9 % band of so many comparisons.

        `fault`: what the standard deviations are multiplied by
        """
        e, p = self.errors, self.covariance * fault**2
        squares = np.einsum("in,ij,jn->", e, np.linalg.inv(p), e)
        tail = 0.001 / 2 / comparisons
        low, high = chdtri(e.size, [1 - tail, tail])
        return bool(low < squares < high)

    @property
    def ratio(self):
        """True standard deviation by the stated one, of the worst axis."""
        return float(np.sqrt((self.errors**2).mean(axis=1) / self.covariance.diagonal()).max())


def ensemble(motion, way, *, runs, jump=0.0, rotated=False, **sigmas):
    """Return an ensemble of logs whose gyroscope has some errors.

    `jump`: what the bias changes by, on every axis, at any moment between two rests, rad/s
    `rotated`: whether the misalignments are those of a sensor that is turned as a whole
    `sigmas`: other errors, as settings
    """
    _, true = true_rates(motion)
    random = np.random.default_rng([30, *map(ord, motion + way), int(jump * 1e6)])

    def normal(*shape):
        return random.standard_normal((*shape, runs))

    sizes = {name: sigmas.get(name, 0.0) for name in SIGMAS}
    off = np.eye(3)[..., None] * sizes["scale_sigma"] * normal(3, 3)
    leaning = normal(3, 3) * (1 - np.eye(3))[..., None]
    if rotated:
        leaning = np.triu(np.ones((3, 3)), 1)[..., None] * leaning
        leaning = leaning - leaning.swapaxes(0, 1)
    off += sizes["misalignment_sigma"] * leaning
    measured = true[:, :, None] + np.einsum("kj,ijn->kin", true, off)
    density = LITTLE_NOISE if jump else NOISE
    measured += 0.01 + density * math.sqrt(HZ) * normal(*true.shape)
    settings = {"noise_density": density, **sigmas}
    if jump:
        rests = rests_of(stated(measured[..., 0], "static:nearest"))
        for (_, begin), (end, _) in pairwise(rests):
            when = begin + (end - begin) * random.uniform(size=(3, runs))
            sign = random.choice([-1, 1], size=(3, runs))
            measured += jump * sign * (np.arange(len(true))[:, None, None] > when)
    result = stated(measured[..., 0], way, **settings)
    rests = rests_of(result)
    first = oracle.increments((np.reshape(sizes["q0_sigma"], (-1, 1)) * normal(3)).T)
    wrong = turns(measured - biases(measured, rests, way), first)
    truth = turns(true[:, :, None], (1.0, 0.0, 0.0, 0.0))
    apart = np.array(oracle.product((truth[0], *(-part for part in truth[1:])), wrong))
    return Ensemble(2 * apart[1:] * np.sign(apart[0]), result.covariance[-1])


def errors_of(true, measured, way, **settings):
    """Return errors ``(runs, 3)`` and stated standard deviations of logs of one motion.

    Those whose rest shows one value, and whose rates no step, are left out: their sigma is unknown.
    """
    truth = stated(true, (0, 0, 0), noise_density=NOISE).wxyz[-1]
    errors, sigmas = [], []
    for rate in measured:
        with suppress(UsageError):
            result = stated(rate, way, **settings)
            errors.append(log(multiply(conjugate(truth), result.wxyz[-1])))
            sigmas.append(result.sigma[-1])
    return np.array(errors), np.array(sigmas)


def quantised(motion, spread, *, runs):
    """Return errors and sigmas of logs with rates in whole deg/s, and noise of `spread` deg/s."""
    step = math.radians(1)
    _, true = true_rates(motion)
    random = np.random.default_rng([31, *map(ord, motion), int(100 * spread)])
    biases = random.uniform(-2, 2, (runs, 3))
    noise = (spread * random.normal(size=true.shape) for _ in range(runs))
    measured = (np.rint(true / step + b + n) * step for b, n in zip(biases, noise, strict=True))
    return errors_of(true, measured, WAYS[0])


def jumping(motion, way, jump, *, runs):
    """Return errors and sigmas of logs whose bias jumps twice.

    `jump`: in standard deviations of what the means of two rests differ by
    """
    _, true = true_rates(motion)
    random = np.random.default_rng([32, int(10 * jump)])
    size = jump * NOISE * math.sqrt(2 / REST_S)
    begins = np.array([REST_S, 2 * REST_S + MOTION_S]) * HZ

    def measured():
        rate = true + NOISE * math.sqrt(HZ) * random.normal(size=true.shape)
        when = begins + MOTION_S * HZ * random.uniform(size=(3, 2))
        after = np.arange(len(true))[:, None, None] > when
        return rate + size * (random.choice([-1, 1], size=(3, 2)) * after).sum(axis=2)

    return errors_of(true, (measured() for _ in range(runs)), way, noise_density=NOISE)
