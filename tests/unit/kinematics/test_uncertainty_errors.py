"""Predicted covariances against the errors of attitudes: finite differences, and Monte Carlo.

Every error of the gyroscope, rates in body axes and in reference axes, every motion that can be
simulated. Each comparison is also made with a planted fault, which it has to find.
"""

from functools import cache
from itertools import product

import numpy as np
import pytest
from make import oracle
from make.motion import FRAMES, simulated
from scipy.stats import chi2

from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, log, multiply
from quatprop.kinematics.uncertainty import ErrorGrowth, SensorErrors
from quatprop.series import GyroSeries
from quatprop.simulation.motion import MOTIONS

EACH = {
    "noise_density": SensorErrors(noise_density=2e-4),
    "bias_sigma": SensorErrors(bias_sigma=3e-4),
    "random_walk": SensorErrors(random_walk=3e-4),
    "scale_sigma": SensorErrors(scale_sigma=3e-4),
    "misalignment_sigma": SensorErrors(misalignment_sigma=3e-4),
    "q0_sigma": SensorErrors(),
    "together": SensorErrors(2e-4, 3e-4, 3e-4, 3e-4, 3e-4),
}
Q0_SIGMA = dict.fromkeys(("q0_sigma", "together"), np.array([1e-4, 2e-4, 4e-4]))
"""Standard deviations of the first attitude, whose body axes are those of the reference."""
IN_PROPORTION = ("scale_sigma", "misalignment_sigma")
"""Errors that a sensor at rest does not show."""
CASES = list(product(MOTIONS, FRAMES))


def predicted(t_ns, rate, errors, frame, *, method="start", q0=0.0):  # noqa: PLR0913  # all of them
    """Return the covariances of the attitudes, ``(N, 3, 3)``."""
    wxyz = attitudes(t_ns, rate, method=method, rates=frame)
    growth = ErrorGrowth(errors, frame, method, q0=q0**2 * np.eye(3))
    return growth.advance(GyroSeries(t_ns, rate), wxyz)


def times(factor, errors):
    """Return errors that are so many times as large."""
    return SensorErrors(*(factor * size for size in errors))


# --- finite differences

COUNT, INTERVAL_NS, CHANGE = 81, 25_000_000, 1e-6


@cache
def differences(motion, frame, method):
    """Return the samples, and how each attitude changes with each rate, ``(N, 3, N, 3)``, s.

    All series of which one number is changed are propagated as one, one after the other.
    """
    t_ns, rate = simulated(motion, frame, COUNT, INTERVAL_NS)
    copies = np.tile(rate, (1 + rate.size, 1, 1))
    for copy, number in enumerate(np.ndindex(rate.shape), 1):
        copies[copy][number] += CHANGE
    stamps = np.arange(len(copies) * COUNT) * INTERVAL_NS
    wxyz = attitudes(stamps, copies.reshape(-1, 3), method=method, rates=frame)
    wxyz = wxyz.reshape(-1, COUNT, 4)
    begins = conjugate(wxyz[:, :1])
    wxyz = multiply(begins, wxyz) if frame == "body" else multiply(wxyz, begins)
    change = log(multiply(conjugate(wxyz[0]), wxyz[1:])) / CHANGE
    return t_ns, rate, np.moveaxis(change.reshape(COUNT, 3, COUNT, 3), (2, 3), (0, 1))


def by_differences(errors, motion, frame, method):
    """Return the samples, and the covariances of the attitudes of which the rates have errors."""
    t_ns, rate, change = differences(motion, frame, method)
    bias = change.sum(axis=2)
    by_rate = np.einsum("nikl,km->nilm", change, rate)  # of the axis l, by the rate about m
    scale = np.einsum("nill->nil", by_rate)
    leaning = by_rate[:, :, ~np.eye(3, dtype=bool)]
    # Under the method start, the mean of the walk in an interval is that in its middle.
    t_s = (t_ns + (INTERVAL_NS / 2 if method == "start" else 0)) / 1e9
    walk = np.einsum("nikl,km,njml->nij", change, np.minimum.outer(t_s, t_s), change, optimize=True)
    noise = np.einsum("nikl,njkl->nij", change, change) * 1e9 / INTERVAL_NS
    bias, scale, leaning = (each @ each.swapaxes(1, 2) for each in (bias, scale, leaning))
    parts = (noise, bias, walk, scale, leaning)
    total = sum(size**2 * part for size, part in zip(errors, parts, strict=True))
    return t_ns, rate, total


def are_close(errors, motion, frame, method="start", told=None):
    """Tell whether predictions agree to 1 % of the largest number of each covariance.

    To plant a fault, other errors or another frame are what the prediction is told.
    """
    t_ns, rate, expected = by_differences(errors, motion, frame, method)
    told = {"errors": errors, "frame": frame} | (told or {})
    found = predicted(t_ns, rate, method=method, **told)
    apart, size = (np.abs(each[20::20]).max(axis=(1, 2)) for each in (found - expected, expected))
    return bool((apart <= 0.01 * size).all())


@pytest.mark.parametrize(("motion", "frame"), CASES)
def test_finite_differences(motion, frame):
    """Of rates in reference axes, the errors of biases and scale factors were those at rest."""
    for name, errors in EACH.items():
        assert are_close(errors, motion, frame), name
        if not (motion == "rest" and name in IN_PROPORTION) and any(errors):
            for fault in (0.95, 1.05):
                told = {"errors": times(fault, errors)}
                assert not are_close(errors, motion, frame, told=told), name


@pytest.mark.parametrize(("motion", "frame"), CASES)
def test_finite_differences_under_other_methods(motion, frame):
    """Biases and scale factors act on the rate that the method takes for that of an interval."""
    for method, name in product(("mean", "coning", "end"), ("bias_sigma", *IN_PROPORTION)):
        assert are_close(EACH[name], motion, frame, method), (method, name)


@pytest.mark.parametrize(("motion", "frame"), CASES)
@pytest.mark.parametrize("name", ["bias_sigma", "random_walk", *IN_PROPORTION])
def test_finite_differences_tell_the_axes(motion, frame, name):
    """Unless the axis is fixed, errors in body axes and in reference axes grow differently."""
    (other,) = set(FRAMES) - {frame}
    told_apart = not are_close(EACH[name], motion, frame, told={"frame": other})
    assert told_apart == (motion not in {"rest", "spin"})


# --- Monte Carlo

RUNS, STEPS = 5000, 30
SEEN = (STEPS // 2, STEPS)
TOLD = [
    (name, *case)
    for name in EACH
    for case in CASES
    if not (name in IN_PROPORTION and case[0] == "rest")
]


@cache
def ensemble(motion, frame):
    """Return the samples of 2 s, and the errors of all runs at two of them, by what is wrong.

    By the oracle: nothing is shared with the propagation or the prediction.
    """
    interval_ns = 2 * 10**9 // STEPS
    t_ns, rate = simulated(motion, frame, STEPS + 1, interval_ns)
    h = interval_ns / 1e9
    random = np.random.default_rng([20, *map(ord, motion + frame)])
    density, bias, walk, scale, leaning = (
        np.repeat([getattr(errors, name) for errors in EACH.values()], RUNS)
        for name in SensorErrors._fields
    )
    q0 = np.repeat([Q0_SIGMA.get(name, np.zeros(3)) for name in EACH], RUNS, axis=0).T

    def normal():
        return random.standard_normal((3, len(density)))

    bias = bias * normal() + walk * np.sqrt(h / 2) * normal()  # that in the middle of an interval
    scale = 1 + scale * normal()
    further = (leaning * normal(), leaning * normal())
    truth, wrong = (1.0, 0.0, 0.0, 0.0), oracle.increments((q0 * normal()).T)
    errors = []
    for k in range(STEPS):
        true = rate[k, :, None]
        measured = true * scale + bias + density / np.sqrt(h) * normal()
        measured += sum(part * np.roll(true, -n, axis=0) for n, part in enumerate(further, 1))
        bias += walk * np.sqrt(h) * normal()
        pairs = (truth, oracle.increments(true.T * h)), (wrong, oracle.increments(measured.T * h))
        truth, wrong = (
            oracle.product(*(pair if frame == "body" else pair[::-1])) for pair in pairs
        )
        if k + 1 in SEEN:
            apart = np.array(oracle.product((truth[0], *(-part for part in truth[1:])), wrong))
            errors.append(2 * apart[1:] * np.sign(apart[0]))
    by_name = np.reshape(errors, (len(SEEN), 3, len(EACH), RUNS))
    return t_ns, rate, dict(zip(EACH, np.moveaxis(by_name, 2, 0), strict=True))


def all_as_predicted(name, motion, frame, fault=1.0):
    """Tell whether the means of e' P^-1 e are in the 99.9 % band of all comparisons together."""
    t_ns, rate, found = ensemble(motion, frame)
    q0 = fault * Q0_SIGMA.get(name, np.zeros(3))
    covariance = predicted(t_ns, rate, times(fault, EACH[name]), frame, q0=q0)[[*SEEN]]
    squares = np.einsum("sin,sij,sjn->s", found[name], np.linalg.inv(covariance), found[name])
    tail = 0.001 / 2 / (len(TOLD) * len(SEEN))
    low, high = chi2.ppf([tail, 1 - tail], 3 * RUNS)
    return bool(((low < squares) & (squares < high)).all())


@pytest.mark.parametrize(("name", "motion", "frame"), TOLD)
def test_simulated_errors_are_as_large_as_predicted(name, motion, frame):
    """5,000 runs each; a prediction that is off by 5 % is found."""
    assert all_as_predicted(name, motion, frame)
    for fault in (0.95, 1.05):
        assert not all_as_predicted(name, motion, frame, fault)
