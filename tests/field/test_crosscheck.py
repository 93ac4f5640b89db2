"""Statements on real recordings, each checked by other means."""

import pytest
from make.commands import run
from make.places import SHARED_LOGS

import quatprop

HEALTHY = {
    "EuRoC": ["csv/euroc_v102/imu0_data.csv", "csv/euroc_v102/state_groundtruth_data.csv"],
    "x-io": ["csv/xio3/Inertial.csv", "csv/xio3/Quaternion.csv"],
    "Xsens": ["csv/data_xsens.txt"],
    "rostopic": ["csv/rostopic_echo.csv"],
    "drone": ["irregular/test3_2014_ardrone.bag"],
    "PX4": ["ulog/sample.ulg"],
    "BROAD": ["broad/18_undisturbed_fast_translation_with_breaks_B.hdf5"],
}
"""Recordings in which nothing is wrong that a rotation shows."""


def logs(*names):
    """Return the paths of recordings; skip the test if they are absent."""
    paths = [SHARED_LOGS / name for name in names]
    if not all(path.exists() for path in paths):
        pytest.skip(f"{SHARED_LOGS} lacks {names[0]}")
    return paths


def facts(*names):
    """Return the findings on recordings: level and source by code."""
    found = quatprop.crosscheck(*logs(*names)).findings
    return {one.code: one for one in found}


@pytest.mark.parametrize("name", HEALTHY)
def test_a_healthy_recording_is_consistent(name):
    """Biases are remarks, and a topic that nobody fills in is no fault."""
    # The optical attitudes of BROAD are absent where markers were hidden, and PX4 dropped messages.
    run("crosscheck", *logs(*HEALTHY[name]), code=3 if name in {"BROAD", "PX4"} else 0)


def test_the_bias_of_euroc_is_that_of_its_ground_truth():
    """The ground truth of the dataset has columns of the gyroscope's bias."""
    names = HEALTHY["EuRoC"]
    numbers = facts(*names)["bias"].numbers
    stated = [-0.1236, 1.1905, 4.3438]  # deg/s: the mean of b_w_RS_S
    sigma = numbers["sigma_deg_s"]
    for found, true, certain in zip(numbers["bias_deg_s"], stated, sigma, strict=True):
        assert abs(found - true) < 4 * certain < 0.06


def test_rates_that_a_driver_scaled_twice():
    """The VectorNav driver multiplied rad/s by pi/180: rates and orientation disagree."""
    found = facts("nested_imu/kiran_11sec_motion")
    assert (found["unit"].level, found["unit"].source) == ("fault", "/imu rates")
    assert "once too often" in found["unit"].text


def test_an_imu_that_lies_on_its_side():
    """The husky's IMU feels gravity along y, about which the odometry's z turns."""
    finding = facts("husky/test1_husky.bag")["axes"]
    assert "turns about its z as /imu/data" in finding.text
    assert "about y" in finding.text


def test_a_robot_with_two_imus():
    """One driver without rates, an IMU upside down, a late stereo odometry, wheels that slip."""
    names = logs("two_imus/test1_2014_xsens.bag")
    with (
        pytest.warns(quatprop.DataLossWarning, match="31 timestamps out of order"),
        pytest.warns(quatprop.RemarkWarning, match="31 non-monotonic timestamps"),
    ):
        result = quatprop.crosscheck(*names)
    found = {(one.code, one.source) for one in result.findings}
    assert {
        ("dead", "/my_odometry2imu/imu_data rates"),
        ("axes", "/xsens/imu_data"),
        ("offset", "/stereo_odometer/odometry"),
        ("scale", "/wheel_odometry"),
        ("drift", "/xsens/imu_data orientation"),
    } <= found
    (axes,) = (one for one in result.findings if one.code == "axes")
    assert axes.settings == {"mount": "x,-y,-z"}
    # compare --time-offset auto, by angular speeds: 71.0 +- 1.1 ms.
    (offset,) = (one.numbers for one in result.findings if one.code == "offset")
    assert abs(offset["ms"] + 71.0) < 3 * (offset["sigma_ms"] + 1.1)
