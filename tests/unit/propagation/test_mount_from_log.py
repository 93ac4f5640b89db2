"""``--mount tf:FRAME``: the mounting from the static transforms of the log, against SciPy."""

import numpy as np
import pytest
from make.commands import run
from make.mcap import Topic, write_topics
from make.ros import TF, imu_messages, write_messages
from make.tables import write_rates
from scipy.spatial.transform import Rotation

from quatprop import GyroSeries, propagate
from quatprop.base.errors import UsageError

T_NS = 10**9 + np.arange(100) * 10_000_000
RATE = np.sin(np.arange(100)[:, None] / 10 + np.arange(3))
ROTATIONS = {
    # Attitude of the child in its parent, as in /tf_static.
    ("base_link", "mast"): Rotation.from_euler("xyz", [0.1, 0.2, 1.5]),
    ("mast", "imu_link"): Rotation.from_euler("xyz", [3.1, -0.4, 0.3]),
    ("base_link", "lidar"): Rotation.from_euler("xyz", [-1.0, 0.7, 2.2]),
    ("elsewhere", "lost"): Rotation.identity(),
}
MAST = ROTATIONS["mast", "imu_link"]
BASE = ROTATIONS["base_link", "mast"] * MAST
EXPECTED = {
    "imu_link": (Rotation.identity(), "imu_link"),
    "mast": (MAST, "imu_link -> mast"),
    "base_link": (BASE, "imu_link -> mast -> base_link"),
    # Up to the base and down again.
    "lidar": (
        ROTATIONS["base_link", "lidar"].inv() * BASE,
        "imu_link -> mast -> base_link -> lidar",
    ),
}


def write(path, sensor="imu_link", slash="", **rotations):
    """Write transforms in three messages, the first of which is superseded, then rates."""

    def transform(parent, child, xyzw):
        moved = ([1, 2, 3], xyzw)
        return ([0, slash + parent], slash + child, moved)

    transforms = [transform("mast", "imu_link", [0, 0, 0, 1])]
    for (parent, child), rotation in ROTATIONS.items():
        transforms.append(transform(parent, child, rotations.get(child, rotation.as_quat())))
    parts = (transforms[:1], transforms[1:2], transforms[2:])
    messages = [("/tf_static", TF, 1, [part]) for part in parts]
    absent = np.full(9, -1.0)
    rates = imu_messages(T_NS, RATE, frame=slash + sensor, orientation_covariance=absent)
    return write_messages(path, [*messages, *rates])


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Write the log in three containers; the frames of ROS 1 begin with a slash."""
    folder = tmp_path_factory.mktemp("logs")
    slashes = {"log.mcap": "", "log.bag": "/", "log": ""}
    return {name: write(folder / name, slash=slash) for name, slash in slashes.items()}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("frame", EXPECTED)
@pytest.mark.parametrize("container", ["log.mcap", "log.bag", "log"])
def test_the_way_from_the_sensor_to_a_frame(container, frame, logs):
    """Up, and up and down again; in every container; rates are turned into the frame's axes."""
    series = propagate(logs[container], mount=f"tf:{frame}")
    turn, way = EXPECTED[frame]
    report = series.report.correction
    assert report.mount == pytest.approx(turn.as_matrix(), abs=1e-14)
    assert " -> ".join(report.mount_frames) == way
    expected = propagate(GyroSeries(T_NS, turn.apply(RATE)))
    assert series.wxyz == pytest.approx(expected.wxyz, abs=1e-13)


def test_the_summary_names_the_way(logs, tmp_path):
    """The summary reports the rotation."""
    options = ("-o", tmp_path / "out.csv", "--mount", "tf:base_link")
    said = run("propagate", logs["log.mcap"], *options, code=0).stderr
    assert "imu_link -> mast -> base_link, by the static transforms of the log" in said


@pytest.mark.parametrize(
    ("sensor", "frame", "said"),
    [
        ("imu_link", "lost", "to 'lost'; they lead from it to 'base_link', 'lidar', 'mast'"),
        ("gyro", "mast", "there are 'base_link', 'elsewhere', 'imu_link', 'lidar', 'lost', 'mast'"),
        ("", "mast", "the frame of their sensor; give mount='W,X,Y,Z' or 'x,-y,-z'"),
    ],
)
def test_a_frame_that_cannot_be_reached_is_refused(tmp_path, sensor, frame, said):
    """The frames there are on the way are named; of a sensor outside of the tree all are."""
    path = write(tmp_path / "log.mcap", sensor)
    with pytest.raises(UsageError, match=f"^{path}: .*{said}$"):
        propagate(path, mount=f"tf:{frame}")


def test_a_frame_that_is_no_text_is_none(tmp_path):
    """Messages in JSON may have a number there, if only in some."""
    messages = [
        {
            "header": {"stamp": {"sec": k, "nsec": 0}, "frame_id": frame},
            "angular_velocity": {"x": 0.0, "y": 0.0, "z": 1.0},
        }
        for k, frame in enumerate(("imu", 7), 1)
    ]
    path = write_topics(tmp_path / "log.mcap", {"/imu": Topic("imu", messages)})
    options = {"rate_field": "angular_velocity", "rate_unit": "rad/s"}
    with pytest.raises(UsageError, match="from the frame 'imu' of the sensor to 'base'; the log"):
        propagate(path, mount="tf:base", **options)


def test_logs_without_transforms_are_refused(tmp_path, shared_logs):
    """A table, rates in memory, and a recording whose transforms are all in motion."""
    table = write_rates(tmp_path / "log.csv", ["0,0,0,1", "10,0,0,1"])
    for log in (table, GyroSeries([0, 10], np.zeros((2, 3)))):
        with pytest.raises(UsageError, match="mount='tf:base' needs a log of messages with /tf_st"):
            propagate(log, mount="tf:base")
    with pytest.raises(UsageError, match="to 'laser'; the log has none"):
        propagate(shared_logs / "irregular" / "tilt_laser.bag", mount="tf:laser")


def test_what_is_no_rotation_is_refused(tmp_path):
    """A transform that was never set is named."""
    path = write(tmp_path / "log.mcap", mast=np.zeros(4))
    said = "the transform from 'mast' to 'base_link' on '/tf_static' is not a rot"
    with pytest.raises(UsageError, match=said):
        propagate(path, mount="tf:base_link")
