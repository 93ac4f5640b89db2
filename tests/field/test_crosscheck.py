"""Statements on real recordings, each checked by other means."""

import re

import pytest
from make.commands import run
from make.documents import GUIDES
from make.places import SHARED_LOGS

import quatprop

HEALTHY = {
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
    names = "csv/euroc_v102/imu0_data.csv", "csv/euroc_v102/state_groundtruth_data.csv"
    result = quatprop.crosscheck(*logs(*names))
    assert result.exit_code == 0
    (numbers,) = (one.numbers for one in result.findings if one.code == "bias")
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
    """One driver without rates, an IMU upside down, a late stereo odometry, wheels that slip.

    The guide shows it, as slow/test_examples.py proves; here is what it has to be.
    """
    guide = (GUIDES / "crosscheck.md").read_text()
    shown = guide.split("$ quatprop crosscheck rover.bag  # exit code 1\n")[1].split("```")[0]
    for finding in (
        r"fault    /my_odometry2imu/imu_data rates  dead: every rate is zero",
        r"differs  /xsens/imu_data  .*   --mount=x,-y,-z",
        r"differs  /wheel_odometry  +its rates times 0\.79",
        r"remark   /xsens/imu_data orientation  +turns 3\.6.* away from the rates next to it",
        r"warning: /my_odometry2imu/imu_data: 31 non-monotonic timestamps",
        r"lost: /my_odometry2imu/imu_data rates: 31 of ",
    ):
        assert re.search(f"(?m)^{finding}", shown), finding
    # compare --time-offset auto, by angular speeds: 71.0 +- 1.1 ms.
    late = r"differs  /stereo_odometer/odometry  +is late by ([\d.]+) \+- ([\d.]+) ms"
    ms, sigma = map(float, re.search(late, shown).groups())
    assert abs(ms - 71.0) < 3 * (sigma + 1.1)
