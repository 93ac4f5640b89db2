"""q0 of another frame, static transforms that contradict each other, mounted orientations."""

import re

import numpy as np
import pytest
from make.ros import TF, imu_messages, write_messages
from scipy.spatial.transform import Rotation

from quatprop import GyroSeries, RemarkWarning, propagate
from quatprop.base.errors import QuatpropError
from quatprop.kinematics.conventions import mounting
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import (
    conjugate,
    exp,
    from_matrix,
    geodesic_angle,
    multiply,
    rotate,
)

ODOMETRY = "nav_msgs/msg/Odometry"
COUNT = 1000
T_NS = 10**18 + np.arange(COUNT) * 10_000_000
RATE = 1.5 * np.sin(np.arange(COUNT)[:, None] / 40 * [1.0, 1.3, 0.7] + np.arange(3))
START = exp([0.4, -0.3, 1.1])
SENSOR = attitudes(T_NS, RATE, q0=START, method="mean")
MOUNT = Rotation.from_euler("xyz", [170, 20, 65], degrees=True)
"""Rotation from the axes of the sensor to those of the body."""


def scalar_first(rotation):
    """Return a rotation as wxyz."""
    return rotation.as_quat()[..., [3, 0, 1, 2]]


BODY = multiply(SENSOR, scalar_first(MOUNT.inv()))


def transform(parent, child, rotation):
    """Return a message of static transforms."""
    made = [[0, parent], child, ([1, 2, 3], rotation.as_quat())]
    return "/tf_static", TF, int(T_NS[0]) - 10, [[made]]


def odometry(wxyz, frame):
    """Yield messages with the attitudes of a frame."""
    for t, (w, *xyz) in zip(T_NS.tolist(), wxyz, strict=True):
        values = {"header": {"stamp": t, "frame_id": "odom"}, "child_frame_id": frame}
        yield "/odom", ODOMETRY, t, values | {"pose": {"pose": {"orientation": [*xyz, w]}}}


def write(path, transforms=(), frame="base_link", wxyz=BODY, sensor="imu_link"):
    """Write a log of the rates of a sensor and the attitudes of another frame."""
    messages = [*imu_messages(T_NS, RATE, frame=sensor), *odometry(wxyz, frame)]
    return write_messages(path, [*transforms, *sorted(messages, key=lambda one: one[2])])


def told(path, **options):
    """Return the attitudes and the remarks of a propagation."""
    with pytest.warns(RemarkWarning) as caught:
        series = propagate(path, topic="/imu", **options)
    texts = (f"{one.message}".removeprefix(f"{path}: ") for one in caught)
    codes = {remark: remark.code for remark in series.report.remarks}
    return series, {codes[text]: text for text in texts if text in codes}


KNOWN = [transform("base_link", "mast", Rotation.from_euler("z", 0.3))]
KNOWN.append(transform("mast", "imu_link", Rotation.from_euler("z", -0.3) * MOUNT))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_the_attitude_of_another_frame_is_turned_by_the_static_transforms(tmp_path, suffix):
    """It was taken as that of the sensor, 170 deg off; with the mounting it is that of the body."""
    path = write(tmp_path / f"log.{suffix}", KNOWN)
    series, said = told(path, q0="/odom", method="mean")
    assert geodesic_angle(series.wxyz, SENSOR).max() < 1e-9
    angle = f"{np.degrees(MOUNT.magnitude()):.3g}"
    assert said["q0-turned"] == (
        "the initial attitude is that of 'base_link', and the rates are about axes of 'imu_link': "
        f"it is turned by {angle} deg, by the static transforms of the log; for the attitudes of "
        "'base_link' use mount='tf:base_link'"
    )
    settings = dict(re.findall(r"(\w+)='(.+?)'$", said["q0-turned"]))
    mounted = propagate(path, topic="/imu", q0="/odom", method="mean", **settings)
    assert geodesic_angle(mounted.wxyz, BODY).max() < 1e-9
    assert not [one for one in mounted.report.remarks if one.code.startswith("q0")]


def test_without_a_transform_the_frames_are_named(tmp_path):
    """A mounting that is given is believed, whatever the names of the frames."""
    path = write(tmp_path / "log.bag")
    series, said = told(path, q0="/odom")
    assert geodesic_angle(series.wxyz[0], BODY[0]) < 1e-9
    assert said["q0-of-other-frame"] == (
        "the initial attitude is that of 'base_link', and the rates are about axes of 'imu_link': "
        "if these differ, give mount"
    )
    given = ",".join(map(str, scalar_first(MOUNT)))
    mounted = propagate(path, topic="/imu", q0="/odom", mount=given, method="mean")
    assert geodesic_angle(mounted.wxyz, BODY).max() < 1e-9
    assert mounted.report.remarks == ()


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("mount", ["tf:base_link", "tf:mast"])
@pytest.mark.parametrize("frame", ["imu_link", "mast", "base_link"])
def test_whatever_the_frames_of_q0_and_of_the_body_the_attitude_is_that_of_the_body(
    tmp_path, frame, mount
):
    """Also where q0 is that of the sensor, which the mounting turns."""
    to_frame = {
        "imu_link": Rotation.identity(),
        "base_link": MOUNT,
        "mast": Rotation.from_euler("z", -0.3) * MOUNT,
    }
    wxyz = multiply(SENSOR, scalar_first(to_frame[frame].inv()))
    path = write(tmp_path / "log.mcap", KNOWN, frame, wxyz)
    found = propagate(path, topic="/imu", q0="/odom", mount=mount, method="mean")
    body = multiply(SENSOR, scalar_first(to_frame[mount[3:]].inv()))
    assert geodesic_angle(found.wxyz, body).max() < 1e-9


@pytest.mark.parametrize(
    ("transforms", "frame", "sensor"),
    [
        ((), "imu", "/imu"),
        ([transform("base_link", "imu_link", Rotation.identity())], "base_link", "imu_link"),
        ((), "", "imu_link"),
        ((), "base_link", ""),
    ],
)
def test_frames_that_are_equal_parallel_or_unknown_are_not_remarked_on(
    tmp_path, transforms, frame, sensor
):
    """A slash is none of the name, as in tf2."""
    path = write(tmp_path / "log.mcap", transforms, frame, SENSOR, sensor)
    series = propagate(path, topic="/imu", q0="/odom", method="mean")
    assert geodesic_angle(series.wxyz, SENSOR).max() < 1e-12
    assert not [one for one in series.report.remarks if one.code.startswith("q0")]


# --- transforms that contradict each other

FIRST, LAST = Rotation.from_euler("z", 90, degrees=True), Rotation.from_euler("x", 1.0)


@pytest.mark.thorough
@pytest.mark.parametrize("repeated", [False, True])
@pytest.mark.parametrize("is_child", [False, True])
def test_static_transforms_that_contradict_each_other_are_remarked_on(tmp_path, repeated, is_child):
    """The last one counted without a word; what is named is the other, whichever way it leads."""
    both = [
        transform("base_link", "mast", one) if is_child else transform("mast", "base_link", one)
        for one in (FIRST, LAST)
    ]
    both = both * 2 if repeated else both
    path = write(tmp_path / "log.bag", [transform("mast", "imu_link", MOUNT), *both])
    series, said = told(path, mount="tf:base_link")
    apart = f"{np.degrees((FIRST.inv() * LAST).magnitude()):.3g} deg"
    pair = "'mast' to 'base_link'" if is_child else "'base_link' to 'mast'"
    assert said["transforms-differ"].startswith(
        f"messages on '/tf_static' contain 2 rotations from {pair}, "
    )
    assert f"up to {apart} apart; the last one is used" in said["transforms-differ"]
    (mount,) = re.findall(r"mount='(.+)'$", said["transforms-differ"])
    first, last = (one * MOUNT if is_child else one.inv() * MOUNT for one in (FIRST, LAST))
    assert series.report.correction.mount == pytest.approx(last.as_matrix(), abs=1e-12)
    assert mounting(mount) == pytest.approx(first.as_matrix(), abs=1e-11)


@pytest.mark.filterwarnings("ignore")
def test_transforms_that_are_repeated_or_not_used_are_not_remarked_on(tmp_path):
    """Each part of a recording repeats them, rounded or with the other sign."""
    rounded = Rotation.from_quat(-MOUNT.as_quat().round(6))
    same = [transform("base_link", "imu_link", one) for one in (MOUNT, rounded, MOUNT)]
    others = [transform("base_link", "lidar", one) for one in (FIRST, LAST)]
    path = write(tmp_path / "log.bag", [*same, *others])
    report = propagate(path, topic="/imu", mount="tf:base_link").report
    assert "transforms-differ" not in {one.code for one in report.remarks}


# --- an orientation that is that of the body already


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(12))
def test_with_a_mounting_the_log_s_own_orientation_is_turned_only_if_it_is_the_sensor_s(
    tmp_path, seed
):
    """What a remark advised was 180 deg wrong with the log's own orientation as q0."""
    rng = np.random.default_rng(seed)
    noisy = RATE + rng.normal(0, 0.02, RATE.shape) + rng.normal(0, 0.01, 3)
    mount = "x,-y,-z" if seed < 6 else ",".join(map(str, scalar_first(Rotation.random(rng=rng))))
    turn = mounting(mount)
    body = attitudes(T_NS, RATE @ turn.T, q0=START, method="mean")
    own = body if seed % 2 else multiply(body, scalar_first(Rotation.from_matrix(turn)))
    path = write_messages(tmp_path / "log.bag", imu_messages(T_NS, noisy, own))
    found = propagate(path, q0="log", mount=mount)
    assert geodesic_angle(found.wxyz[0], START) < 1e-12
    assert ("q0-of-body" in {one.code for one in found.report.remarks}) == bool(seed % 2)


def test_the_mounting_that_a_remark_names_begins_at_the_log_s_own_orientation(tmp_path):
    """Applied literally, with the q0 that was asked for."""
    own = attitudes(T_NS, RATE * [1, -1, -1], q0=START, method="mean")
    path = write_messages(tmp_path / "log.bag", imu_messages(T_NS, RATE, own))
    _, said = told(path, q0="log")
    settings = dict(re.findall(r"(\w+)='(.+?)'$", said["other-axes"]))
    series, said = told(path, q0="log", method="mean", **settings)
    assert said == {
        "q0-of-body": (
            "the log's own orientation agrees with the rates only once these are turned into the "
            "axes of the body: it is taken as that of the body, and not turned"
        )
    }
    assert geodesic_angle(series.wxyz, own).max() < 1e-9


@pytest.mark.filterwarnings("ignore")
def test_where_nothing_moves_the_orientation_is_that_of_the_sensor(tmp_path):
    """As it is by convention; noise tells nothing."""
    noise = np.random.default_rng(1).normal(0, 1e-3, RATE.shape)
    path = write_messages(tmp_path / "log.bag", imu_messages(T_NS, noise, [START] * COUNT))
    found = propagate(path, q0="log", mount="x,-y,-z")
    assert geodesic_angle(found.wxyz[0], multiply(START, [0, -1, 0, 0])) < 1e-12
    rates = GyroSeries(T_NS, noise * [1, -1, -1])
    assert geodesic_angle(found.wxyz, propagate(rates, q0=found.wxyz[0]).wxyz).max() < 1e-12


# --- an accelerometer with a frame of its own


def apart(path, frames, transforms=(), names=("/imu/accel",)):
    """Write a log of a gyroscope at rest, and of accelerometers in frames; the first feels g."""
    quiet = np.random.default_rng(2).normal(0, 1e-4, (300, 3))
    messages = [("/imu/gyro", *one) for _, *one in imu_messages(T_NS[:300], quiet, frame="gyro")]
    felt = MOUNT.inv().apply([0.6, 0.0, 0.8]) * 9.81, [9.81, 0.0, 0.0]
    for name, frame, force in zip(names, frames, felt, strict=False):
        rows = {"linear_acceleration": [list(map(float, force))] * 300}
        absent = np.array([-1.0, *[0.0] * 8])
        rows["angular_velocity_covariance"] = absent
        own = imu_messages(T_NS[:300] + 500, frame=frame, **rows)
        messages += [(name, *one) for _, *one in own]
    return write_messages(path, [*transforms, *sorted(messages, key=lambda one: one[2])])


ACCELEROMETER = {
    "gyro": ("whose axes are assumed to be those of '/imu/gyro'", MOUNT.inv()),
    "accel": ("and the axes of 'accel' are assumed to be those of 'gyro'", MOUNT.inv()),
    "turned": (
        "turned from the axes of 'accel' into those of 'gyro' by /tf_static",
        Rotation.identity(),
    ),
}


@pytest.mark.parametrize("case", ACCELEROMETER)
def test_accelerations_of_another_frame_are_turned_or_the_frames_are_named(tmp_path, case):
    """They were read in axes of the gyroscope whatever their frame."""
    transforms = [transform("gyro", "accel", MOUNT)] if case == "turned" else ()
    path = apart(tmp_path / "log.bag", ["gyro" if case == "gyro" else "accel"], transforms)
    with pytest.warns(RemarkWarning):
        found = propagate(path, topic="/imu/gyro", q0="level")
    phrase, turn = ACCELEROMETER[case]
    (said,) = [one for one in found.report.remarks if one.code == "other-accelerometer"]
    assert said == f"accelerations are those of '/imu/accel', {phrase}"
    up = rotate(conjugate(found.wxyz[0]), [0, 0, 1])
    np.testing.assert_allclose(up, turn.apply([0.6, 0.0, 0.8]), atol=1e-9)


@pytest.mark.filterwarnings("ignore")
def test_of_several_accelerometers_that_in_the_frame_of_the_rates_is_used(tmp_path):
    """Of two names that are as near none was used; of other frames none is."""
    names = ("/imu/a", "/imu/b")
    path = apart(tmp_path / "log.bag", ["gyro", "lidar"], names=names)
    found = propagate(path, topic="/imu/gyro", q0="level")
    up = rotate(conjugate(found.wxyz[0]), [0, 0, 1])
    np.testing.assert_allclose(up, MOUNT.inv().apply([0.6, 0.0, 0.8]), atol=1e-9)
    path = apart(tmp_path / "two.bag", ["camera", "lidar"], names=names)
    with pytest.raises(QuatpropError, match="accelerations"):
        propagate(path, topic="/imu/gyro", q0="level")


def test_of_transforms_of_q0_that_contradict_each_other_no_mounting_is_named(tmp_path):
    """It was a rotation from the body to the frame of q0, which no option takes."""
    both = [transform("base_link", "imu_link", one) for one in (FIRST, LAST)]
    _, said = told(write(tmp_path / "log.mcap", both), q0="/odom")
    assert said["transforms-differ"].endswith(" apart; the last one is used")


@pytest.mark.filterwarnings("ignore")
def test_on_another_clock_the_orientation_is_compared_too(tmp_path):
    """It was looked for on the clock of the headers, and q0 was turned by 180 deg."""
    stored = multiply(SENSOR, conjugate(from_matrix(mounting("x,-y,-z"))))
    messages = imu_messages(T_NS, RATE, stored, recorded=T_NS + 5_000_000)
    path = write_messages(tmp_path / "log.mcap", messages)
    for clock in ("header", "log"):
        series = propagate(path, mount="x,-y,-z", q0="log", clock=clock)
        assert "q0-of-body" in {one.code for one in series.report.remarks}
        assert geodesic_angle(series.wxyz[0], stored[0]) < 1e-9
