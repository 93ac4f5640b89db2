"""A unit that changes within a log."""

import re

import numpy as np
import pytest
from make.commands import run
from make.ros import imu_messages, write_messages

import quatprop
from quatprop import read_attitudes
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import geodesic_angle

COUNT, STEP = 3000, 10_000_000
T_NS = 1_760_000_000_000_000_000 + np.arange(COUNT) * STEP
T_S = np.arange(COUNT)[:, None] * STEP * 1e-9


def rates(seed):
    """Return the rates of a body that moves, rad/s."""
    rng = np.random.default_rng(seed)
    hz, phase = rng.uniform(0.15, 0.9, (2, 1, 3)) * [[[1.0]], [[7.0]]]
    return 2 * np.sin(2 * np.pi * hz * T_S + phase) + rng.normal(0, 2e-3, (COUNT, 3))


@pytest.mark.parametrize("at", [300, 1600])
@pytest.mark.parametrize("is_larger", [True, False])
@pytest.mark.parametrize("size", [1.0, 0.3])
def test_a_unit_that_changes_is_named_with_its_place(tmp_path, at, is_larger, size):
    """--rate-unit was named for all of the log, which made the other part 57 times too small.

    Of a slower body, whose rates are within the range of a gyroscope in either unit, nothing was
    said; its noise changes as well.
    """
    rate = size * rates(at)
    while not np.linalg.norm(rate[at]) > 0.1:
        at += 1
    in_degrees = (np.arange(COUNT) >= at) == is_larger
    stored = np.where(in_degrees[:, None], np.degrees(rate), rate)
    path = write_messages(tmp_path / "log.mcap", imu_messages(T_NS, stored))
    said = run("propagate", path, "-o", "-", code=0).stderr
    assert f"57.3 times {'larger' if is_larger else 'smaller'} from t = {T_NS[at]} ns on" in said
    ways = re.search(r"by themselves, with (.*), and with (.*)\n", said).groups()
    parts = []
    for number, way in enumerate(ways):
        out = tmp_path / f"{number}.csv"
        run("propagate", path, *way.replace(" and ", " ").split(), "-o", out, code=0)
        parts.append(read_attitudes(out))
    for part, rows in zip(parts, (slice(at), slice(at, None)), strict=True):
        np.testing.assert_array_equal(part.t_ns, T_NS[rows])
        expected = attitudes(T_NS[rows], rate[rows])
        np.testing.assert_allclose(geodesic_angle(part.wxyz, expected), 0, atol=1e-6)


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("seed", range(6))
def test_a_motion_that_begins_within_a_sample_is_no_other_unit(seed):
    """Its noise is as before, whatever the rates."""
    rate = 0.05 + np.random.default_rng(seed).normal(0, 2e-3, (COUNT, 3))
    rate[1500:] += 0.05 * 56.3
    said = quatprop.propagate(quatprop.GyroSeries(T_NS, rate)).report.remarks
    assert "unit-changes" not in {one.code for one in said}


@pytest.mark.parametrize("seed", range(3))
def test_a_log_in_another_unit_does_not_change_it(tmp_path, seed):
    """Also where it is at rest at first, and where its motion begins within a sample."""
    rate = np.degrees(rates(seed))
    rate[:1000] /= 1000
    path = write_messages(tmp_path / "log.mcap", imu_messages(T_NS, rate))
    said = run("propagate", path, "-o", "-", code=0).stderr
    assert "if they are in deg/s, use --rate-unit deg/s" in said
    assert "unit changed" not in said


def test_of_a_unit_that_changes_and_changes_back_the_first_place_is_named(tmp_path):
    """A part had both units."""
    rate = rates(3)
    stored = rate.copy()
    stored[1200:1400] = np.degrees(rate[1200:1400])
    path = write_messages(tmp_path / "log.mcap", imu_messages(T_NS, stored))
    said = run("propagate", path, "-o", "-", code=0).stderr
    assert f"57.3 times larger from t = {T_NS[1200]} ns on" in said


def test_no_unit_is_advised_that_is_given_already(tmp_path):
    """The way out for a part was the option that was used."""
    rate = np.degrees(rates(4))
    rate[1500:] = np.degrees(rate[1500:])
    path = write_messages(tmp_path / "log.mcap", imu_messages(T_NS, rate))
    said = run("propagate", path, "--rate-unit", "deg/s", "-o", "-", code=0).stderr
    assert "unit changed" not in said
    assert "deg/s as given: is that right?" in said
