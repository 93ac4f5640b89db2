"""A source is made of another only if a filter gives its numbers, to rounding."""

from dataclasses import replace

import numpy as np
import pytest
from make.rigs import DEG, GYRO, motion, ns
from scipy.signal import lfilter

from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, rotation_matrix
from quatprop.tools.crosscheck.analysis import crosscheck
from quatprop.tools.crosscheck.origin import is_made_of
from quatprop.tools.crosscheck.sources import Source

TURN = rotation_matrix(exp(np.array([0.3, -0.2, 0.5])))


def gyro(noise, seed=0, shaken=0.0):
    """Return a gyroscope of 100 Hz on a body that is shaken too; its noise is in deg/s."""
    t_s, rate, _ = motion(1)
    random = np.random.default_rng(7)
    shaken_rate = shaken * DEG * random.normal(size=rate.shape)
    rate = (rate + shaken_rate)[::5]
    rate = rate + noise * DEG * np.random.default_rng(seed).normal(size=rate.shape)
    return Source(name=GYRO, kind="rates", device=GYRO, t_ns=ns(t_s[::5]), values=rate)


@pytest.mark.parametrize(("noise", "shaken"), [(0.1, 0.0), (1e-2, 20.0), (1e-4, 0.0), (1e-4, 0.1)])
def test_quiet_sensors_are_two_measurements(noise, shaken):
    """However quiet two gyroscopes are, and whatever shakes both: they were taken for one."""
    one, other = gyro(noise, 1, shaken), replace(gyro(noise, 2, shaken), name="b", device="b")
    turned = replace(other, values=other.values @ TURN.T)
    for second in (other, turned):
        assert not is_made_of(one, second)
        assert not is_made_of(second, one)


CHANGES = {
    "scaled": lambda w: 1.7 * w,
    "turned": lambda w: w @ TURN.T,
    "with another bias": lambda w: w - np.array([0.1, 0.0, -0.2]),
    "as float32": lambda w: w.astype(np.float32).astype(np.float64),
    "with seven decimals": lambda w: np.round(w, 7),
    "late by a sample": lambda w: np.roll(w, 1, axis=0),
    "averaged": lambda w: lfilter(np.ones(20) / 20, [1.0], w, axis=0),
    "smoothed": lambda w: lfilter([0.2], [1.0, -0.8], w @ TURN.T, axis=0),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_made_of_another_is_no_second_measurement(name):
    """Copies that are scaled, turned, rounded, delayed or filtered follow from the original."""
    one = gyro(0.01)
    other = replace(one, name="b", device="b", values=CHANGES[name](one.values))
    assert is_made_of(one, other)
    half = replace(other, t_ns=other.t_ns[::2], values=other.values[::2])
    assert is_made_of(one, half) or name == "smoothed"  # its past is not recorded


def test_two_measurements_or_one():
    """What is not shown says that the second source is made of the first, or it says nothing."""
    one, quiet = gyro(1e-3, 1), gyro(1e-3, 2)
    said = {}
    for name, values in (("copy", one.values @ TURN.T), ("quiet", quiet.values)):
        other = replace(one, name=name, device=name, values=values)
        said[name] = [each for each in crosscheck([one, other]).not_shown if "second" in each]
    assert said == {
        "copy": [f"a second measurement (one is made of the other) of copy against {GYRO}"],
        "quiet": [],
    }


def test_an_integral_is_no_second_measurement():
    """Attitudes that were propagated from rates do not confirm them."""
    one = gyro(0.1)
    wxyz = attitudes(one.t_ns, one.values, method="mean")
    other = Source(
        name="b", kind="orientation", device="b", t_ns=one.t_ns, values=wxyz, layout="scalar-first"
    )
    assert is_made_of(one, other)
    assert not is_made_of(gyro(0.1, seed=5), other)
