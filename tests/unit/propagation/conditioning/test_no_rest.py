"""Why a log shows no stationary period, and accelerations that cannot show one."""

import numpy as np
import pytest
from make.commands import refused, run
from make.ros import imu_messages, write_messages

START, STEP, COUNT = 1_760_000_000_000_000_000, 10_000_000, 2000
T_NS = START + np.arange(COUNT) * STEP
T_S = np.arange(COUNT)[:, None] * 0.01
RNG = np.random.default_rng(9)
BIAS = np.array([0.02, -0.01, 0.015])
MOVES = (T_S > 5) & (T_S < 15)
RATE = MOVES * 2 * np.sin(T_S * [1.1, 1.7, 0.9] + [0, 1, 2]) + BIAS
RATE += RNG.normal(0, 1e-3, RATE.shape)
FORCE = [0, 0, 9.81] + MOVES * np.sin(3 * T_S * [1, 2, 3]) + RNG.normal(0, 0.02, RATE.shape)


def written(folder, rate, force):
    """Write a log of messages; return its path."""
    count = len(rate)
    stamps = START + np.arange(count) * (STEP * COUNT // count)
    vectors = np.asarray(force).tolist()
    return write_messages(
        folder / "log.mcap", imu_messages(stamps, rate, linear_acceleration=vectors)
    )


def two_sensors():
    """Return the samples of two sensors that take turns, mounted otherwise."""
    turned = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    pairs = ((each, each @ turned.T + [0.3, 0.2, -0.4]) for each in (RATE, FORCE))
    return [np.stack(pair, axis=1).reshape(-1, 3) for pair in pairs]


def with_zeros():
    """Return samples of which every twentieth is zero, also its acceleration."""
    kept = (np.arange(COUNT) % 20 != 7)[:, None]
    return RATE * kept, FORCE * kept


@pytest.mark.parametrize(
    ("samples", "cause"),
    [
        (two_sensors(), "a vibration at half the sample rate? write each to its own log"),
        (with_zeros(), "did the sensor drop out?"),
        ((np.degrees(10 * RATE), FORCE), "if they are in deg/s, use --rate-unit deg/s"),
    ],
)
def test_a_log_without_rest_has_the_likely_cause_named(tmp_path, samples, cause):
    """It was "the body moves", and what info says of the rates was not reached."""
    path = written(tmp_path, *samples)
    said = refused("propagate", path, "--bias", "static", "-o", "-")
    assert f"{path}: no stationary period" in said
    assert "perhaps this is why: " in said
    assert f"{cause}; otherwise give --bias X,Y,Z" in said


def test_a_log_that_moves_throughout_has_no_other_cause(tmp_path):
    """Nothing is odd in its rates."""
    rate = np.sin(T_S * [1.1, 1.7, 0.9]) + RNG.normal(0, 1e-3, RATE.shape)
    said = refused("propagate", written(tmp_path, rate, FORCE), "--bias", "static", "-o", "-")
    assert "perhaps" not in said
    assert ";" in said


@pytest.mark.parametrize("sigma", [1e-3, 0.02, 0.3])
def test_accelerations_without_gravity_confirm_no_rest(tmp_path, sigma):
    """They scattered by 821 % of about nothing, and the log was refused."""
    force = MOVES * np.sin(3 * T_S * [1, 2, 3]) + np.random.default_rng(2).normal(
        0, sigma, RATE.shape
    )
    path = written(tmp_path, RATE, force)
    said = run("propagate", path, "--bias", "static", "-o", "-", code=0).stderr
    assert "steady by rate; the whole log was searched" in said
    assert "no accelerometer and no orientation confirms the stationary period" in said


@pytest.mark.thorough
@pytest.mark.parametrize("sigma", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("offset", [0.05, 1, 9.81])
def test_accelerations_with_gravity_in_any_unit_confirm_rest(tmp_path, sigma, offset):
    """Also small numbers, as in g or in units of the sensor."""
    force = np.array(FORCE) / 9.81 + np.random.default_rng(2).normal(0, sigma, RATE.shape)
    path = written(tmp_path, RATE, force * offset)
    said = run("propagate", path, "--bias", "static", "-o", "-").stderr
    assert "steady by rate, accelerometer" in said or "specific force scatters" in said
