"""The rotation of the Earth against closed forms."""

import json
import math
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from make.commands import refused, run
from make.places import SAMPLE_LOGS

from quatprop import GyroSeries, propagate
from quatprop.base.errors import RemarkWarning, UsageError
from quatprop.kinematics.quaternion import conjugate, exp, geodesic_angle, multiply, rotate

RAD_S = 7.292115e-5
"""The Earth's rate, rad/s (WGS 84, NIMA TR8350.2)."""

AXES = {  # reference z, azimuth of x -> north, east and up in the reference's axes
    ("up", None): ([0, 1, 0], [1, 0, 0], [0, 0, 1]),
    ("down", None): ([1, 0, 0], [0, 1, 0], [0, 0, -1]),
    ("up", 0): ([1, 0, 0], [0, -1, 0], [0, 0, 1]),
    ("down", 90): ([0, -1, 0], [1, 0, 0], [0, 0, -1]),
}


def earth(latitude, north, up):
    """Return the Earth's rate in the axes of a reference, rad/s."""
    lat = math.radians(latitude)
    turn = math.cos(lat) * np.array(north) + math.sin(lat) * np.array(up)
    return turn * RAD_S


@pytest.mark.parametrize(("axes", "vectors"), AXES.items())
@pytest.mark.parametrize("latitude", [45, -33.5, 90])
def test_a_body_at_rest_does_not_turn(axes, vectors, latitude):
    """A perfect gyroscope at rest turned 15.04 deg an hour against the ground, unsaid."""
    (reference_z, azimuth), (north, east, up) = axes, vectors
    np.testing.assert_array_equal(np.cross(east, north), up)
    q0 = exp(np.array([0.7, -1.1, 0.4]))
    rate = rotate(conjugate(q0), earth(latitude, north, up))
    hour = np.tile(rate, (3601, 1))
    hour[1::2] += 1e-9  # rates that are all the same are remarked on
    hour[2::2] -= 1e-9
    rates = GyroSeries(np.arange(3601) * 1_000_000_000, hour)
    place = latitude if azimuth is None else (latitude, azimuth)
    still = propagate(rates, q0=q0, earth_rate=place, reference_z=reference_z)
    assert geodesic_angle(still.wxyz, q0).max() < 1e-8
    turned = np.degrees(geodesic_angle(propagate(rates, q0=q0).wxyz[-1], q0))
    assert turned == pytest.approx(15.041, abs=1e-4)
    assert still.report.result.net_rotation_rad < 1e-8
    np.testing.assert_array_equal(still.report.result.final_wxyz, still.wxyz[-1])


def test_the_earth_rate_of_inertial_rates_is_a_bias():
    """It was named in rad/s, which the option took for the unit of the log."""
    north, up = np.array([0.0, 1, 0]), np.array([0.0, 0, 1])
    rates = GyroSeries(np.arange(3601) * 10**9, np.tile(earth(45, north, up), (3601, 1)))
    with pytest.raises(UsageError, match="subtract the Earth rate with bias=") as said:
        propagate(rates, rates="inertial", earth_rate=45)
    named = re.search(r"bias='(.*)'", str(said.value))[1]
    assert named.endswith("rad/s")
    with pytest.warns(RemarkWarning):
        still = propagate(rates, rates="inertial", bias=named)
    assert still.report.result.net_rotation_rad < 1e-8


def test_a_turning_body_is_followed_against_the_ground():
    """Its rates are those against the ground, and the Earth's in its own axes."""
    s = np.arange(120_001) * 0.01
    truth = multiply(exp(np.array([0.3, 0.2, -0.5])), exp(np.outer(s, [0.02, -0.05, 0.1])))
    turning = np.array([0.02, -0.05, 0.1])
    rate = turning + rotate(conjugate(truth), earth(45, *AXES["up", None][::2]))
    rates = GyroSeries(np.rint(s * 1e9).astype(np.int64), rate)
    found = propagate(rates, q0=truth[0], earth_rate=45, method="quintic")
    assert geodesic_angle(found.wxyz, truth).max() < 1e-9
    at_times = propagate(rates, q0=truth[0], earth_rate=45, method="quintic", rate=0.5)
    at_s = (at_times.t_ns - rates.t_ns[0]) * 1e-9
    expected = multiply(truth[0], exp(np.outer(at_s, [0.02, -0.05, 0.1])))
    assert geodesic_angle(at_times.wxyz, expected).max() < 1e-9


def test_output_and_summary_state_it(tmp_path):
    """As every convention."""
    line = ("propagate", SAMPLE_LOGS / "spin.csv", "-o", tmp_path / "a.parquet", "--earth-rate")
    said = run(*line, "45", code=0)
    expected = "x +0  y +5.1563e-05  z +5.1563e-05 rad/s in reference axes, at 45: removed"
    assert f"earth rate  {expected}" in said.stderr
    told = json.loads(pq.read_metadata(tmp_path / "a.parquet").metadata[b"quatprop"])
    expected = earth(45, *AXES["up", None][::2])
    assert told["convention"]["earth_rate_rad_s"] == pytest.approx(expected.tolist())
    assert "not a latitude" in refused(*line, "100")
