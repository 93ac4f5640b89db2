"""``--mount tf:FRAME``: the mounting from the static transforms of the log, against SciPy."""

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from quatprop import GyroSeries, propagate
from quatprop.cli.commands import cli
from quatprop.errors import UsageError

N = 100
RATE = np.sin(np.arange(N)[:, None] / 10 + np.arange(3))
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
IMU, TF = "sensor_msgs/msg/Imu", "tf2_msgs/msg/TFMessage"


def messages(store, sensor="imu_link", *, slash=""):
    """Yield topic, type, time and message: transforms in two messages, then rates."""
    types = store.types
    stamp, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    ros1 = "seq" in header.__dataclass_fields__

    def at(t, frame):
        time = stamp(*divmod(t, 10**9))
        return header(seq=0, stamp=time, frame_id=frame) if ros1 else header(time, frame)

    def transform(parent, child, rotation):
        x, y, z, w = rotation.as_quat().tolist()
        turn = types["geometry_msgs/msg/Transform"](vector(1, 2, 3), quaternion(x, y, z, w))
        named = at(0, slash + parent), slash + child
        return types["geometry_msgs/msg/TransformStamped"](*named, turn)

    transforms = [transform(*frames, rotation) for frames, rotation in ROTATIONS.items()]
    # A frame that is given again counts as it is given last.
    wrong = transform("mast", "imu_link", Rotation.from_euler("x", 1))
    for part in ([wrong], transforms[:1], transforms[1:]):
        yield "/tf_static", TF, 1, types[TF](part)
    for k, rate in enumerate(RATE.tolist()):
        t = 10**9 + k * 10_000_000
        yield (
            "/imu",
            IMU,
            t,
            types[IMU](
                header=at(t, slash + sensor),
                orientation=quaternion(0, 0, 0, 1),
                orientation_covariance=np.full(9, -1.0),
                angular_velocity=vector(*rate),
                angular_velocity_covariance=np.zeros(9),
                linear_acceleration=vector(0, 0, 0),
                linear_acceleration_covariance=np.zeros(9),
            ),
        )


def mcap(path, **options):
    """Write the log as MCAP."""
    store, channels = get_typestore(Stores.ROS2_HUMBLE), {}
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        for topic, kind, t, message in messages(store, **options):
            if topic not in channels:
                text, _ = store.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_time=t, publish_time=t, data=data)
        writer.finish()
    return path


def bag(path):
    """Write the log as a ROS 1 bag, whose frames begin with a slash."""
    store, connections = get_typestore(Stores.ROS1_NOETIC), {}
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    with Rosbag1Writer(path) as writer:
        for topic, kind, t, message in messages(store, slash="/"):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], t, store.serialize_ros1(message, kind))
    return path


def db3(path):
    """Write the log as a ROS 2 bag in SQLite."""
    store, connections = get_typestore(Stores.ROS2_HUMBLE), {}
    with Rosbag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        for topic, kind, t, message in messages(store):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], t, store.serialize_cdr(message, kind))
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Write the log in three containers; return their paths."""
    folder = tmp_path_factory.mktemp("logs")
    return {
        "mcap": mcap(folder / "log.mcap"),
        "bag": bag(folder / "log.bag"),
        "db3": db3(folder / "log"),
    }


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("frame", EXPECTED)
@pytest.mark.parametrize("container", ["mcap", "bag", "db3"])
def test_the_way_from_the_sensor_to_a_frame(container, frame, logs):
    """Up, and up and down again; in every container; rates are turned into the frame's axes."""
    series = propagate(logs[container], mount=f"tf:{frame}")
    turn, way = EXPECTED[frame]
    report = series.report.conditioning
    assert report.mount == pytest.approx(turn.as_matrix(), abs=1e-14)
    assert " -> ".join(report.mount_frames) == way
    t_ns = 10**9 + np.arange(N) * 10_000_000
    expected = propagate(GyroSeries(t_ns, turn.apply(RATE)))
    assert series.wxyz == pytest.approx(expected.wxyz, abs=1e-13)


def test_the_summary_names_the_way(logs, tmp_path):
    """What was done is said."""
    arguments = [str(logs["mcap"]), "-o", str(tmp_path / "out.csv"), "--mount", "tf:base_link"]
    result = CliRunner().invoke(cli, ["propagate", *arguments])
    assert result.exit_code == 0, result.output
    assert "imu_link -> mast -> base_link, by the static transforms of the log" in result.stderr


def test_a_frame_that_cannot_be_reached_is_refused(logs):
    """The frames there are on the way are named."""
    for frame in ("lost", "nowhere"):
        with pytest.raises(UsageError) as refused:
            propagate(logs["mcap"], mount=f"tf:{frame}")
        assert str(refused.value) == (
            f"{logs['mcap']}: no static transforms lead from the frame 'imu_link' of the sensor to "
            f"'{frame}'; they lead from it to 'base_link', 'lidar', 'mast'"
        )


def test_a_sensor_outside_the_tree_is_refused(tmp_path):
    """Then all frames are named."""
    path = mcap(tmp_path / "log.mcap", sensor="gyro")
    with pytest.raises(UsageError, match=r"frame 'gyro' of the sensor to 'mast'; there are 'base_"):
        propagate(path, mount="tf:mast")


def test_a_sensor_without_a_frame_is_refused(tmp_path):
    """An empty frame_id names nothing."""
    path = mcap(tmp_path / "log.mcap", sensor="")
    with pytest.raises(UsageError, match="do not name the frame of their sensor; give mount="):
        propagate(path, mount="tf:mast")


def test_logs_without_transforms_are_refused(tmp_path, shared_logs):
    """A table, rates in memory, and a recording whose transforms are all in motion."""
    table = tmp_path / "log.csv"
    table.write_text("t_ns,wx,wy,wz\n0,0,0,1\n10,0,0,1\n")
    for log in (table, GyroSeries([0, 10], np.zeros((2, 3)))):
        with pytest.raises(UsageError, match="mount='tf:base' needs a log of messages with /tf_st"):
            propagate(log, mount="tf:base")
    with pytest.raises(UsageError, match="to 'laser'; the log has none"):
        propagate(shared_logs / "irregular" / "tilt_laser.bag", mount="tf:laser")


def test_what_is_no_rotation_is_refused(tmp_path, monkeypatch):
    """A transform that was never set is named."""

    class Zero:
        def as_quat(self):
            return np.zeros(4)

    monkeypatch.setitem(ROTATIONS, ("base_link", "mast"), Zero())
    path = mcap(tmp_path / "log.mcap")
    with pytest.raises(
        UsageError, match="the transform from 'mast' to 'base_link' on '/tf_static' is not a rot"
    ):
        propagate(path, mount="tf:base_link")
