"""`calibrate` and `compare` estimate the same errors by different formulas: the results agree."""

import re

import numpy as np
import pytest

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.kinematics.quaternion import exp, multiply

RANDOM = np.random.default_rng(8)
T_NS = np.arange(4000) * 10**7
PHASES = T_NS[:, None] * 1e-9 * [1.3, 2.1, 0.7] + [0.0, 1.0, 2.0]
RATES = np.sin(PHASES) + 0.4 * np.sin(3.3 * PHASES + 1)
TRUTH = quatprop.propagate(GyroSeries(T_NS, RATES), method="quintic").wxyz
REFERENCE = AttitudeSeries(T_NS, multiply(TRUTH, exp(5e-4 * RANDOM.normal(size=RATES.shape))))
NOISE = 2e-3 * RANDOM.normal(size=RATES.shape)


def both(rates, reference, **options):
    """Return the comparison of propagated rates with a reference, and the calibration by it."""
    log = GyroSeries(T_NS, rates + NOISE)
    a = quatprop.propagate(log, method="cubic", q0=reference.wxyz[0])
    calibration = quatprop.calibrate(
        log, reference, estimate="bias,scale,offset,drift", window="500ms"
    )
    return quatprop.compare(a, reference, **options), calibration


def agreed(calibration, group, values, sigma=0.0):
    """Assert that values are those of the calibration, within four standard deviations."""
    found = [one for one in calibration.parameters if one.group == group]
    for one, value in zip(found, values, strict=True):
        assert abs(one.value - value) <= 4 * np.hypot(one.sigma, sigma)


def test_a_bias_is_that_of_the_cause():
    """The remedy of a constant rate is the bias that is subtracted."""
    found, calibration = both(RATES + np.array([0.01, -0.02, 0.005]), REFERENCE)
    assert found.likely_cause.name == "rate bias"
    remedy = re.search(r"propagate it with bias='([^']*)'", found.likely_cause.remedy)[1]
    # The attitudes at both ends show it to within their noise over the time.
    numbers = remedy.removesuffix("rad/s").split(",")
    agreed(calibration, "bias", list(map(float, numbers)), 5e-4 / 20)


def test_a_factor_is_that_of_the_cause():
    """The factor of the cause is one more than the scale correction of each axis."""
    found, calibration = both(RATES / 1.02, REFERENCE)
    assert found.likely_cause.name == "scale"
    factor = float(re.search(r"multiply its rates by ([\d.]+)", found.likely_cause.remedy)[1])
    agreed(calibration, "scale", [factor - 1] * 3, 2e-5)


@pytest.mark.parametrize("ratio", [0.0, 8e-4])
def test_a_time_offset_is_that_of_the_comparison(ratio):
    """Both are what is to be added to the timestamps of the reference, in its middle."""
    moved = np.round(0.04e9 + ratio * (T_NS - T_NS[2000])).astype(np.int64)
    reference = AttitudeSeries(T_NS - moved, REFERENCE.wxyz)
    found, calibration = both(RATES, reference, time_offset="auto")
    if not ratio:
        offset = found.time_offset.found
        agreed(calibration, "offset", [offset.ns / 1e9], offset.std_ns / 1e9)
        return
    added = re.search(r"and ([-\d.e]+) ppm", found.likely_cause.remedy)
    std = re.search(r"\+- ([\d.]+) ppm", found.likely_cause.sentence)
    agreed(calibration, "drift", [float(added[1]) / 1e6], float(std[1]) / 1e6)
