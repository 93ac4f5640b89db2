"""Predicted covariances against finite differences: how attitudes change with each rate.

Every error of the gyroscope, rates in body axes and in reference axes, every motion that can be
simulated. Each comparison is also made with a planted fault, which it has to find. Of whole runs,
``propagation/test_error_bars.py`` compares them with the errors of ensembles.
"""

from functools import cache
from itertools import product

import numpy as np
import pytest
from make.motion import FRAMES, simulated

from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, log, multiply, rotation_matrix
from quatprop.kinematics.series import GyroSeries
from quatprop.kinematics.uncertainty import ErrorGrowth, SensorErrors
from quatprop.tools.simulation import MOTIONS

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


COUNT, INTERVAL_NS, CHANGE = 81, 25_000_000, 1e-6


@cache
def differences(motion, frame, method):
    """Return the samples, and how each attitude changes with each rate, ``(N, 3, N, 3)``, s."""
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


@cache
def by_differences(name, motion, frame, method):
    """Return the covariances of the attitudes of which the rates, or the first, have errors."""
    t_ns, rate, change = differences(motion, frame, method)
    bias = change.sum(axis=2)
    by_rate = np.einsum("nikl,km->nilm", change, rate)  # of the axis l, by the rate about m
    scale = np.einsum("nill->nil", by_rate)
    leaning = by_rate[:, :, ~np.eye(3, dtype=bool)]
    # Under the method start, the mean of the walk in an interval is that in its middle.
    t_s = (t_ns + (INTERVAL_NS / 2 if method == "start" else 0)) / 1e9
    walk = np.einsum("nikl,km,njml->nij", change, np.minimum.outer(t_s, t_s), change, optimize=True)
    noise = np.einsum("nikl,njkl->nij", change, change) * 1e9 / INTERVAL_NS
    # An error about the first body axes, which are those of the reference, is one about the last.
    turn = rotation_matrix(attitudes(t_ns, rate, method=method, rates=frame)).swapaxes(1, 2)
    first = (turn if frame == "body" else np.eye(3)) * Q0_SIGMA.get(name, 0.0)
    total = first @ np.swapaxes(first, -1, -2)
    bias, scale, leaning = (each @ each.swapaxes(1, 2) for each in (bias, scale, leaning))
    for size, part in zip(EACH[name], (noise, bias, walk, scale, leaning), strict=True):
        total = total + size**2 * part
    return total


def are_close(name, motion, frame, method="start", *, fault=1.0):
    """Tell whether predictions agree to 1 % of the largest number of each covariance.

    `fault`: what the predicted errors are multiplied by
    """
    t_ns, rate, _ = differences(motion, frame, method)
    errors = SensorErrors(*(fault * size for size in EACH[name]))
    q0 = (fault * Q0_SIGMA.get(name, 0.0)) ** 2 * np.eye(3)
    wxyz = attitudes(t_ns, rate, method=method, rates=frame)
    found = ErrorGrowth(errors, frame, method, q0=q0).advance(GyroSeries(t_ns, rate), wxyz)
    expected = by_differences(name, motion, frame, method)
    apart, size = (np.abs(each[20::20]).max(axis=(1, 2)) for each in (found - expected, expected))
    return bool((apart <= 0.01 * size).all())


@pytest.mark.parametrize(("motion", "frame"), CASES)
def test_finite_differences(motion, frame):
    """Of rates in reference axes, the errors of biases and scale factors were those at rest."""
    for name in EACH:
        assert are_close(name, motion, frame), name
        if motion != "rest" or name not in IN_PROPORTION:
            for fault in (0.95, 1.05):
                assert not are_close(name, motion, frame, fault=fault), name


@pytest.mark.parametrize(("motion", "frame"), CASES)
def test_other_methods(motion, frame):
    """Biases and scale factors act on the rate that the method takes for that of an interval."""
    for method, name in product(("mean", "coning", "end"), ("bias_sigma", *IN_PROPORTION)):
        assert are_close(name, motion, frame, method), (method, name)
