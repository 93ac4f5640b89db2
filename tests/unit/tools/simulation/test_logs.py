"""Simulated logs are logs: encoded as the libraries of the field encode and read by them."""

from fractions import Fraction

import numpy as np
import pytest
from make.ros import IMU, ROS1, ROS2, encoded
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from quatprop.base.errors import OutputError
from quatprop.kinematics.series import AttitudeSeries
from quatprop.tools.simulation import (
    GRAVITY,
    Gyroscope,
    ImuEncoder,
    Shape,
    motion_named,
    open_log_writer,
    record,
    simulate,
    truth_path,
)
from quatprop.writers.formats import GENERAL_KINDS, WRITERS

SHAPE = Shape(angle=Fraction(25))


# Messages


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_messages_are_what_the_library_would_encode(encoding):
    """Every byte of a block of messages is that of rosbags' own serialiser."""
    store = ROS2 if encoding == "cdr" else ROS1
    s = np.sqrt(0.5)
    up = 2 * (s * s)
    series = AttitudeSeries(
        [1_700_000_000_123_456_789], [[s, s, 0.0, 0.0]], rate=np.array([[0.1, -0.2, 3.0]])
    )
    expected = {
        "header": {"seq": 41, "stamp": 1_700_000_000_123_456_789, "frame_id": "imu"},
        "orientation_covariance": [-1.0] + [0.0] * 8,
        "angular_velocity": (0.1, -0.2, 3.0),
        "angular_velocity_covariance": np.diag([0.25] * 3).ravel(),
        "linear_acceleration": (0.0, GRAVITY * up, GRAVITY * (1 - up)),
    }
    encoder = ImuEncoder(0.5, ros1=encoding == "ros1")
    *_, message = [encoder.encode(series, "a")[0] for _ in range(42)]
    assert message.tobytes() == encoded(store, IMU, expected)


def test_accelerations_are_the_reaction_to_gravity():
    """A tilted sensor at rest feels g along what is up for it."""
    tilt = Rotation.from_euler("xyz", [20, -40, 70], degrees=True)
    wxyz = np.roll(tilt.as_quat(), 1)
    (series,) = record(motion_named("rest", SHAPE), Gyroscope(Fraction(1), 1), wxyz)
    (message,) = ImuEncoder(0.0, ros1=False).encode(series, "a")
    imu = ROS2.deserialize_cdr(message.tobytes(), "sensor_msgs/msg/Imu")
    felt = imu.linear_acceleration
    np.testing.assert_allclose(
        [felt.x, felt.y, felt.z], tilt.inv().apply([0, 0, GRAVITY]), atol=1e-14
    )


# Logs

KINDS_AND_COMPRESSIONS = [(kind, c) for kind in GENERAL_KINDS for c in WRITERS[kind].compressions]


def log_of(folder, kind, compression=None):
    """Write a log of 300 samples; return path and samples."""
    gyroscope = Gyroscope(Fraction(100), 300, noise=1e-3, seed=2)
    (series,) = record(motion_named("tumbling", SHAPE), gyroscope)
    folder.mkdir(exist_ok=True)
    path = folder / ("log" + (WRITERS[kind].suffixes or ("",))[0])
    with open_log_writer(path, kind, compression=compression) as writer:
        writer.write(series)
        writer.commit({})
    return path, series


def content(path):
    """Return the bytes of a file, or of all files of a folder by name."""
    if path.is_file():
        return path.read_bytes()
    return {part.name: part.read_bytes() for part in path.iterdir()}


@pytest.mark.parametrize(("kind", "compression"), KINDS_AND_COMPRESSIONS)
def test_the_same_samples_give_the_same_bytes(tmp_path, kind, compression):
    """Nothing of the moment or the place gets into a log."""
    first, _ = log_of(tmp_path / "a", kind, compression)
    second, _ = log_of(tmp_path / "b", kind, compression)
    assert content(first) == content(second)
    assert [path.name for path in (tmp_path / "a").iterdir()] == [first.name]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kind", "compression"),
    [(kind, c) for kind, c in KINDS_AND_COMPRESSIONS if kind.startswith(("bag", "ros", "mcap"))],
)
def test_rosbags_reads_simulated_logs(tmp_path, kind, compression):
    """The library of the field finds the samples, stamped when they were taken."""
    path, measured = log_of(tmp_path, kind, compression)
    with AnyReader([path], default_typestore=ROS2) as reader:
        assert [c.topic for c in reader.connections] == ["/imu"]
        log_ns, messages = zip(
            *((ns, reader.deserialize(data, c.msgtype)) for c, ns, data in reader.messages()),
            strict=True,
        )
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]
    np.testing.assert_array_equal(stamps, measured.t_ns)
    rates = [[getattr(m.angular_velocity, axis) for axis in "xyz"] for m in messages]
    np.testing.assert_array_equal(rates, measured.rate)
    delays = np.array(log_ns) - measured.t_ns
    assert delays.min() >= 1_000_000
    assert delays.max() < 1_100_000
    assert len(set(delays.tolist())) > 100


@pytest.mark.parametrize("kind", GENERAL_KINDS)
def test_a_failed_log_leaves_nothing(tmp_path, kind):
    """An exception midway leaves no file, no folder, and no stray."""
    (series,) = record(motion_named("spin", SHAPE), Gyroscope(Fraction(100), 300))

    def fail_midway():
        with open_log_writer(tmp_path / "log", kind) as writer:
            writer.write(series)
            raise RuntimeError("midway")

    with pytest.raises(RuntimeError, match="midway"):
        fail_midway()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("target", "kind", "truth"),
    [
        ("a.csv", None, "a.truth.csv"),
        ("a.parquet", None, "a.truth.parquet"),
        ("d/a.b", "rosbag2", "d/a.b.truth.csv"),
        ("bag", None, "bag.truth.csv"),
        ("-", None, None),
    ],
)
def test_the_truth_goes_next_to_the_log(target, kind, truth):
    """Its name is the log's with .truth before the suffix."""
    assert truth_path(target, kind) == truth


def test_without_a_place_for_the_truth_there_is_no_log(tmp_path):
    """Both are written or neither is."""
    gyroscope, truth = Gyroscope(Fraction(10), 10), tmp_path / "none" / "truth.csv"
    with pytest.raises(OutputError, match="there is no folder"):
        simulate(tmp_path / "a.csv", "spin", SHAPE, gyroscope, truth=truth)
    assert list(tmp_path.iterdir()) == []
