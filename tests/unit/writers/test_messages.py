"""Attitudes as ROS messages in MCAP files and bags, through the readers of the field."""

import json
import sqlite3
from itertools import product

import numpy as np
import pytest
from make.mcap_doctor import examine
from make.ros import ROS1, ROS2
from make.ros import message as ros_message
from make.writing import write_series
from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from quatprop.base.errors import OutputError, UsageError
from quatprop.kinematics.series import AttitudeSeries
from quatprop.writers.formats import MESSAGES, WRITERS, Message
from quatprop.writers.message_encoders import RosEncoder, ros1_types

ROS = [name for name, known in MESSAGES.items() if known.is_ros]
KINDS = [kind for kind, known in WRITERS.items() if known.encodings]
START = 1_700_000_000_000_000_000
TOLD = {"convention": {"layout": "scalar-last"}, "n": "ø"}
MCAP_KINDS = {"mcap": "a.mcap", "rosbag2-mcap": "a/a.mcap"}
STORES = {True: ROS1, False: ROS2}
"""The types of the library, for ROS 1 and ROS 2."""

LONG = "m" * 5_000
"""A name of a frame with which 250 messages fill more than one chunk."""


def turning(n):
    """Return attitudes with every bit in use, at stamps that do not repeat a pattern."""
    rng = np.random.default_rng(9)
    wxyz = rng.standard_normal((n, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    return AttitudeSeries(START + np.cumsum(rng.integers(1, 2_000_000, n)), wxyz)


def write(folder, kind, series, cuts=(), message=None):
    """Write a series, cut into batches, and return where."""
    path = folder / ("a" + (WRITERS[kind].suffixes or ("",))[0])
    cut = np.split(np.arange(len(series)), cuts)
    parts = [AttitudeSeries(series.t_ns[rows], series.wxyz[rows]) for rows in cut]
    return write_series(path, *parts, kind=kind, told=TOLD, message=message)


def content(path):
    """Return the bytes of a file, or of all files of a folder by name."""
    return path.read_bytes() if path.is_file() else {p.name: p.read_bytes() for p in path.iterdir()}


# Messages


def by_the_library(ros1, message, wxyz, stamp, seq, known=None):  # noqa: PLR0913, PLR0917
    """Return a message as rosbags encodes it; `known` are a covariance and a rate."""
    frame = message.child if message.type == "Imu" else message.frame
    header = {"seq": seq, "stamp": int(stamp), "frame_id": frame}
    rotation = np.roll(wxyz, -1).tolist()
    covariance, rate = known or (np.zeros((3, 3)), np.zeros(3))
    full, absent = np.zeros((6, 6)), [-1.0, *[0.0] * 8]
    full[3:, 3:] = covariance
    values = {
        "QuaternionStamped": [header, rotation],
        "PoseStamped": [header, [(), rotation]],
        "PoseWithCovarianceStamped": [header, [[(), rotation], full.ravel()]],
        "TFMessage": [[[header, message.child, [(), rotation]]]],
        "Imu": {
            "header": header,
            "orientation": rotation,
            "orientation_covariance": covariance.ravel(),
            "angular_velocity": rate.tolist(),
            "angular_velocity_covariance": np.zeros(9) if known else absent,
            "linear_acceleration_covariance": absent,
        },
    }[message.type]
    store, name = STORES[ros1], MESSAGES[message.type].name
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    return bytes(serialize(ros_message(store, name, values), name))


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("name", ROS)
def test_messages_are_what_the_library_would_encode(name, ros1):
    """Every byte of a block is that of rosbags' own serialiser, padding and counters included."""
    series = AttitudeSeries(
        np.array([START + 123_456_789, 5]), np.array([[0.5, -0.5, 0.1, 1e-320], [1.0, 2, 3, 4]])
    )
    for frame, child in product(["", "m", "map", "odom", "reference"], ["", "bo", "base_link"]):
        message = Message(name, frame=frame, child=child)
        encoder = RosEncoder(message, ros1=ros1)
        encoder.encode(series, "a")
        rows = encoder.encode(series, "a")
        for k, (row, stamp, wxyz) in enumerate(zip(rows, series.t_ns, series.wxyz, strict=True)):
            assert row.tobytes() == by_the_library(ros1, message, wxyz, stamp, 2 + k)


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("name", ["Imu", "PoseWithCovarianceStamped"])
def test_covariances_are_about_the_axes_of_the_reference(name, ros1):
    """R P R' with scipy's R; with the rate of the body in an Imu."""
    random = np.random.default_rng(3)
    root = random.normal(size=(5, 3, 3)) * 1e-2
    bare = turning(5)
    series = AttitudeSeries(
        bare.t_ns, bare.wxyz, None, root @ root.swapaxes(1, 2), random.normal(size=(5, 3))
    )
    turn = Rotation.from_quat(series.wxyz, scalar_first=True).as_matrix()
    expected = turn @ series.covariance @ turn.swapaxes(1, 2)
    store, message = STORES[ros1], Message(name)
    deserialize = store.deserialize_ros1 if ros1 else store.deserialize_cdr
    for k, row in enumerate(RosEncoder(message, ros1=ros1).encode(series, "a")):
        found = deserialize(row.tobytes(), MESSAGES[name].name)
        if name == "Imu":
            covariance = found.orientation_covariance.reshape(3, 3)
        else:
            covariance = found.pose.covariance.reshape(6, 6)[3:, 3:]
        np.testing.assert_allclose(covariance, expected[k], rtol=0, atol=1e-18)
        known = covariance, series.rate[k]
        same = by_the_library(ros1, message, series.wxyz[k], series.t_ns[k], k, known)
        assert row.tobytes() == same


@pytest.mark.parametrize("stamp", [-1, (2**31) * 10**9])
@pytest.mark.parametrize("kind", KINDS)
def test_a_stamp_beyond_ros_is_refused(tmp_path, kind, stamp):
    """Times before 1970 or after 2038 do not fit, and nothing is left behind."""
    series = AttitudeSeries(np.array([0, stamp]), np.tile([1.0, 0, 0, 0], (2, 1)))
    words = (
        rf"/a\S*: ROS cannot represent the timestamp {stamp} ns; write a table, or a trajectory$"
    )
    with pytest.raises(OutputError, match=words):
        write(tmp_path, kind, series)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["Pose", "nav_msgs/QuaternionStamped", "nav_msgs/msg/Odometry"])
def test_another_message_is_refused(tmp_path, name):
    """Types that are not in the table are refused with those that are."""
    words = (
        f"^attitudes cannot be written as '{name}'; "
        "choose 'QuaternionStamped', 'PoseStamped', 'TFMessage', 'PoseWithCovarianceStamped', "
        "'Imu', 'FrameTransform', 'PoseInFrame'$"
    )
    with pytest.raises(UsageError, match=words):
        write(tmp_path, "mcap", turning(1), message=Message(name))
    assert list(tmp_path.iterdir()) == []


def test_a_message_goes_by_any_of_its_names():
    """Short, as in ROS 1, or in full as in ROS 2."""
    for name in ("PoseStamped", "geometry_msgs/PoseStamped", "geometry_msgs/msg/PoseStamped"):
        assert Message(name).definition.name == "geometry_msgs/msg/PoseStamped"


# Containers

ROTATIONS = {
    "QuaternionStamped": lambda message: message.quaternion,
    "PoseStamped": lambda message: message.pose.orientation,
    "TFMessage": lambda message: message.transform.rotation,
    "PoseWithCovarianceStamped": lambda message: message.pose.pose.orientation,
    "Imu": lambda message: message.orientation,
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", ROS)
@pytest.mark.parametrize("kind", KINDS)
def test_rosbags_reads_every_bit(tmp_path, kind, name):
    """The library of the field finds topic, type, frame, log times, stamps and components."""
    series = turning(500)
    path = write(tmp_path, kind, series, message=Message(name, frame=LONG, child=LONG))
    with AnyReader([path], default_typestore=STORES[False]) as reader:
        (connection,) = reader.connections
        assert connection.topic == MESSAGES[name].topic
        assert connection.msgtype == MESSAGES[name].name
        assert connection.msgcount == 500
        found = [(log, reader.deserialize(data, c.msgtype)) for c, log, data in reader.messages()]
    assert [log for log, _ in found] == series.t_ns.tolist()
    messages = [one.transforms[0] if name == "TFMessage" else one for _, one in found]
    stamps = [(one.header.stamp.sec, one.header.stamp.nanosec) for one in messages]
    assert stamps == [divmod(stamp, 10**9) for stamp in series.t_ns.tolist()]
    assert {one.header.frame_id for one in messages} == {LONG}
    wxyz = np.array([[q.w, q.x, q.y, q.z] for q in map(ROTATIONS[name], messages)])
    assert wxyz.tobytes() == series.wxyz.tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_batches_of_any_size_give_the_same_bytes(tmp_path, kind):
    """Chunks end at fixed messages, and nothing of the moment gets into a file."""
    series, message = turning(1_000), Message(frame=LONG)
    (tmp_path / "cut").mkdir()
    whole = write(tmp_path, kind, series, message=message)
    cut = write(tmp_path / "cut", kind, series, (1, 1, 17, 300, 820), message=message)
    assert content(cut) == content(whole)


@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_without_messages_is_still_one(tmp_path, kind):
    """Committing without a write gives a file that rosbags opens."""
    path = write(tmp_path, kind, turning(0))
    with AnyReader([path]) as reader:
        assert reader.message_count == 0


@pytest.mark.parametrize("name", ROS)
@pytest.mark.parametrize("kind", MCAP_KINDS)
def test_mcap_files_are_as_their_specification_says(tmp_path, kind, name):
    """Indexes, statistics, checksums and offsets hold, for a walk and for the library's readers."""
    series = turning(500)
    write(tmp_path, kind, series, message=Message(name, frame=LONG, child=LONG))
    path = tmp_path / MCAP_KINDS[kind]
    found = examine(path)
    assert found.counts == {1: 500}
    assert len(found.chunks) > 1
    assert found.starts == sorted(found.starts)
    assert len(found.metadata) == 1
    with path.open("rb") as stream:
        by_index = list(make_reader(stream, validate_crcs=True).iter_messages())
        stream.seek(0)
        in_order = list(NonSeekingReader(stream, validate_crcs=True).iter_messages())
    schema, channel, _ = by_index[0]
    assert (schema.name, schema.encoding) == (MESSAGES[name].name, "ros2msg")
    assert (channel.topic, channel.message_encoding) == (MESSAGES[name].topic, "cdr")
    assert [m.data for _, _, m in by_index] == [m.data for _, _, m in in_order]
    assert [m.sequence for _, _, m in by_index] == list(range(500))
    assert [m.log_time for _, _, m in by_index] == series.t_ns.tolist()
    assert [m.publish_time for _, _, m in by_index] == series.t_ns.tolist()


def test_transforms_have_the_checksum_that_ros1_gives_them():
    """The MD5 of tf2_msgs/TFMessage is the one that Noetic's own definition has."""
    _, md5sum = ros1_types().generate_msgdef("tf2_msgs/msg/TFMessage")
    assert md5sum == "94810edda583a504dfda3829e70d7eec"


# Provenance


def test_mcap_keeps_the_provenance_in_a_metadata_record(tmp_path):
    """It is named quatprop and found through the summary."""
    write(tmp_path, "mcap", turning(3))
    with (tmp_path / "a.mcap").open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    assert record.name == "quatprop"
    assert json.loads(record.metadata["provenance"]) == TOLD


@pytest.mark.parametrize("kind", ["rosbag2", "rosbag2-mcap"])
def test_a_ros2_bag_keeps_the_provenance_in_its_metadata(tmp_path, kind):
    """It is custom data, in metadata.yaml and in the storage's own copy of it."""
    path = write(tmp_path, kind, turning(3))
    yaml = YAML(typ="safe")
    told = yaml.load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert json.loads(told["custom_data"]["quatprop"]) == TOLD
    if kind == "rosbag2":
        with sqlite3.connect(path / "a.db3") as database:
            ((inside,),) = database.execute("SELECT metadata FROM metadata")
        database.close()
    else:
        with (path / "a.mcap").open("rb") as stream:
            (record,) = make_reader(stream).iter_metadata()
        inside = record.metadata["serialized_metadata"]
    assert yaml.load(inside) == told


@pytest.mark.parametrize("kind", ["rosbag2", "rosbag2-mcap"])
@pytest.mark.parametrize("provenance", [TOLD, {}])
def test_ros2_humble_can_read_the_metadata(tmp_path, kind, provenance):
    """The profiles were a list, of which Humble's decoder, which wants text, made an error."""
    write_series(tmp_path / "a", turning(3), kind=kind, told=provenance)
    text = (tmp_path / "a" / "metadata.yaml").read_text()
    told = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
    (topic,) = told["topics_with_message_count"]
    # Before version 9 the profiles are text, and Jazzy's decoder knows that, too.
    assert told["version"] == 8
    assert topic["topic_metadata"]["offered_qos_profiles"] == ""
    # Its decoder reads these with `as<std::string>()`, which throws on anything but a scalar.
    words = [*topic["topic_metadata"].values(), told["storage_identifier"], told["ros_distro"],
             told["compression_format"], told["compression_mode"]]  # fmt: skip
    assert all(isinstance(word, str) for word in words)


def test_a_ros1_bag_keeps_the_provenance_with_its_connection(tmp_path):
    """The index repeats the connection with one field more, which other readers pass over."""
    data = write(tmp_path, "bag", turning(3)).read_bytes()
    words = b"quatprop=" + json.dumps(TOLD, sort_keys=True).encode()
    assert data.count(words) == 1
    assert data.index(words) > int.from_bytes(data[data.index(b"index_pos=") + 10 :][:8], "little")
