"""Attitudes as ROS messages in MCAP files and bags, through the readers of the field."""

import json
import re
import sqlite3

import numpy as np
import pytest
from make.mcap_doctor import examine
from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from quatprop.errors import OutputError, UsageError
from quatprop.series import AttitudeSeries
from quatprop.writers import open_writer
from quatprop.writers.formats import WRITERS
from quatprop.writers.messages.kinds import MESSAGES, Message
from quatprop.writers.messages.ros_messages import RosEncoder
from quatprop.writers.messages.topics import ros1_types

ROS = [name for name, known in MESSAGES.items() if known.is_ros]
KINDS = [kind for kind, known in WRITERS.items() if known.encodings]
START = 1_700_000_000_000_000_000
TOLD = {"convention": {"layout": "scalar-last"}, "n": "ø"}
MCAP_KINDS = {"mcap": "a.mcap", "rosbag2-mcap": "a/a.mcap"}


def turning(n):
    """Return attitudes with every bit in use, at stamps that do not repeat a pattern."""
    rng = np.random.default_rng(9)
    wxyz = rng.standard_normal((n, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    return AttitudeSeries(START + np.cumsum(rng.integers(1, 2_000_000, n)), wxyz)


def write(folder, kind, series, cuts=(), message=None):
    """Write a series, cut into batches, and return where."""
    path = folder / ("a" + (WRITERS[kind].suffixes or ("",))[0])
    with open_writer(path, kind, message=message) as writer:
        for rows in np.split(np.arange(len(series)), cuts):
            writer.write(AttitudeSeries(series.t_ns[rows], series.wxyz[rows]))
        writer.commit(TOLD)
    return path


def content(path):
    """Return the bytes of a file, or of all files of a folder by name."""
    return path.read_bytes() if path.is_file() else {p.name: p.read_bytes() for p in path.iterdir()}


# Messages


def told_to_the_library(store, message, wxyz, stamp, seq, known=None):  # noqa: PLR0913, PLR0917
    """Return a message as an object of rosbags; `known` are a covariance and a rate."""
    types = store.types
    seqs = {"seq": seq} if "seq" in types["std_msgs/msg/Header"].__dataclass_fields__ else {}
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9),
        frame_id=message.frame,
        **seqs,
    )
    w, x, y, z = wxyz
    rotation = types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
    nowhere = {"x": 0.0, "y": 0.0, "z": 0.0}
    short = message.type.rpartition("/")[2]
    covariance, rate = known or (np.zeros((3, 3)), np.zeros(3))
    if short == "Imu":
        header.frame_id = message.child
        absent = np.array([-1.0, *[0.0] * 8])
        vector = types["geometry_msgs/msg/Vector3"]
        return types["sensor_msgs/msg/Imu"](
            header=header,
            orientation=rotation,
            orientation_covariance=covariance.reshape(9),
            angular_velocity=vector(*rate),
            angular_velocity_covariance=np.zeros(9) if known else absent,
            linear_acceleration=vector(**nowhere),
            linear_acceleration_covariance=absent,
        )
    if short == "PoseWithCovarianceStamped":
        point = types["geometry_msgs/msg/Point"](**nowhere)
        pose = types["geometry_msgs/msg/Pose"](position=point, orientation=rotation)
        full = np.zeros((6, 6))
        full[3:, 3:] = covariance
        with_covariance = types["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose, covariance=full.reshape(36)
        )
        return types[f"geometry_msgs/msg/{short}"](header=header, pose=with_covariance)
    if short == "QuaternionStamped":
        return types["geometry_msgs/msg/QuaternionStamped"](header=header, quaternion=rotation)
    if short == "PoseStamped":
        point = types["geometry_msgs/msg/Point"](**nowhere)
        pose = types["geometry_msgs/msg/Pose"](position=point, orientation=rotation)
        return types["geometry_msgs/msg/PoseStamped"](header=header, pose=pose)
    vector = types["geometry_msgs/msg/Vector3"](**nowhere)
    transform = types["geometry_msgs/msg/TransformStamped"](
        header=header,
        child_frame_id=message.child,
        transform=types["geometry_msgs/msg/Transform"](translation=vector, rotation=rotation),
    )
    return types["tf2_msgs/msg/TFMessage"](transforms=[transform])


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("name", ROS)
@pytest.mark.parametrize("frame", ["", "m", "map", "odom", "reference"])
@pytest.mark.parametrize("child", ["", "bo", "base_link"])
def test_messages_are_what_the_library_would_encode(name, frame, child, ros1):
    """Every byte of a block is that of rosbags' own serialiser, padding and counters included."""
    store = ros1_types() if ros1 else get_typestore(Stores.ROS2_HUMBLE)
    message = Message(name, frame=frame, child=child)
    series = AttitudeSeries(
        np.array([START + 123_456_789, 5]), np.array([[0.5, -0.5, 0.1, 1e-320], [1.0, 2, 3, 4]])
    )
    encoder = RosEncoder(message, ros1=ros1)
    encoder.encode(series, "a")
    rows = encoder.encode(series, "a")
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    for seq, (row, stamp, wxyz) in enumerate(zip(rows, series.t_ns, series.wxyz, strict=True)):
        expected = told_to_the_library(store, message, wxyz, int(stamp), 2 + seq)
        assert row.tobytes() == bytes(serialize(expected, MESSAGES[name].name))


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("name", ["Imu", "PoseWithCovarianceStamped"])
def test_covariances_are_about_the_axes_of_the_reference(name, ros1):
    """R P R' with scipy's R; with the rate of the body in an Imu."""
    store = ros1_types() if ros1 else get_typestore(Stores.ROS2_HUMBLE)
    random = np.random.default_rng(3)
    root = random.normal(size=(5, 3, 3)) * 1e-2
    bare = turning(5)
    series = AttitudeSeries(
        bare.t_ns, bare.wxyz, None, root @ root.swapaxes(1, 2), random.normal(size=(5, 3))
    )
    rows = RosEncoder(Message(name), ros1=ros1).encode(series, "a")
    turn = Rotation.from_quat(series.wxyz, scalar_first=True).as_matrix()
    expected = turn @ series.covariance @ turn.swapaxes(1, 2)
    deserialize = store.deserialize_ros1 if ros1 else store.deserialize_cdr
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    for k, row in enumerate(rows):
        found = deserialize(row.tobytes(), MESSAGES[name].name)
        if name == "Imu":
            covariance = found.orientation_covariance.reshape(3, 3)
        else:
            covariance = found.pose.covariance.reshape(6, 6)[3:, 3:]
        np.testing.assert_allclose(covariance, expected[k], rtol=0, atol=1e-18)
        known = covariance, series.rate[k]
        same = told_to_the_library(
            store, Message(name), series.wxyz[k], int(series.t_ns[k]), k, known
        )
        assert row.tobytes() == bytes(serialize(same, MESSAGES[name].name))


@pytest.mark.parametrize("stamp", [-1, (2**31) * 10**9])
@pytest.mark.parametrize("kind", KINDS)
def test_a_stamp_beyond_ros_is_refused(tmp_path, kind, stamp):
    """Times before 1970 or after 2038 do not fit, and nothing is left behind."""
    series = AttitudeSeries(np.array([0, stamp]), np.tile([1.0, 0, 0, 0], (2, 1)))
    words = rf"/a\S*: ROS has no time for the stamp {stamp} ns; write a table, or a trajectory$"
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


@pytest.mark.parametrize("name", ["PoseStamped", "geometry_msgs/PoseStamped"])
def test_a_message_goes_by_any_of_its_names(name):
    """Short, as in ROS 1, or in full as in ROS 2."""
    assert Message(name).definition.name == "geometry_msgs/msg/PoseStamped"


@pytest.mark.parametrize("kind", KINDS)
def test_scalar_first_is_refused(tmp_path, kind):
    """ROS defines the order of a quaternion's fields."""
    words = rf"^{kind} is scalar-last by its own definition, not scalar-first; leave layout out$"
    with pytest.raises(UsageError, match=words):
        open_writer(tmp_path / "a", kind, layout="wxyz")


def test_a_table_has_no_messages(tmp_path):
    """Asking for a message where there is none is refused."""
    sentence = "csv holds no messages; leave message, out_topic and frames out"
    with pytest.raises(UsageError, match=f"^{sentence}$"):
        open_writer(tmp_path / "a.csv", message=Message())


# Containers


@pytest.mark.parametrize("name", ROS)
@pytest.mark.parametrize("kind", KINDS)
def test_rosbags_reads_every_bit(tmp_path, kind, name):
    """The library of the field finds topic, type, log times, stamps and components."""
    series = turning(3000)
    path = write(tmp_path, kind, series, message=Message(name))
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        (connection,) = reader.connections
        assert connection.topic == MESSAGES[name].topic
        assert connection.msgtype == MESSAGES[name].name
        assert connection.msgcount == 3000
        found = [(log, reader.deserialize(data, c.msgtype)) for c, log, data in reader.messages()]
    np.testing.assert_array_equal([log for log, _ in found], series.t_ns)
    stamps, wxyz = [], []
    for _, message in found:
        inner = message.transforms[0] if name == "TFMessage" else message
        stamps.append(inner.header.stamp.sec * 10**9 + inner.header.stamp.nanosec)
        quaternion = {
            "QuaternionStamped": lambda m: m.quaternion,
            "PoseStamped": lambda m: m.pose.orientation,
            "TFMessage": lambda m: m.transform.rotation,
            "PoseWithCovarianceStamped": lambda m: m.pose.pose.orientation,
            "Imu": lambda m: m.orientation,
        }[name](inner)
        wxyz.append([quaternion.w, quaternion.x, quaternion.y, quaternion.z])
    np.testing.assert_array_equal(stamps, series.t_ns)
    np.testing.assert_array_equal(np.array(wxyz).view(np.int64), series.wxyz.view(np.int64))


@pytest.mark.parametrize("kind", KINDS)
def test_batches_of_any_size_give_the_same_bytes(tmp_path, kind):
    """Chunks end at fixed messages, and nothing of the moment gets into a file."""
    series = turning(40_000)
    (tmp_path / "cut").mkdir()
    whole = write(tmp_path, kind, series)
    cut = write(tmp_path / "cut", kind, series, (1, 1, 700, 11_000, 33_333))
    assert content(cut) == content(whole)


@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_without_messages_is_still_one(tmp_path, kind):
    """Committing without a write gives a file that rosbags opens."""
    path = write(tmp_path, kind, turning(0))
    with AnyReader([path]) as reader:
        assert reader.message_count == 0


@pytest.mark.parametrize("kind", MCAP_KINDS)
def test_the_reference_reader_accepts_every_checksum(tmp_path, kind):
    """Chunks and data section are intact, by the index and from end to end alike."""
    series = turning(30_000)
    write(tmp_path, kind, series)
    path = tmp_path / MCAP_KINDS[kind]
    with path.open("rb") as stream:
        by_index = list(make_reader(stream, validate_crcs=True).iter_messages())
        stream.seek(0)
        in_order = list(NonSeekingReader(stream, validate_crcs=True).iter_messages())
    assert len(by_index) == 30_000
    assert [m.data for _, _, m in by_index] == [m.data for _, _, m in in_order]
    assert [m.sequence for _, _, m in by_index] == list(range(30_000))
    assert [m.log_time for _, _, m in by_index] == series.t_ns.tolist()
    assert [m.publish_time for _, _, m in by_index] == series.t_ns.tolist()


@pytest.mark.parametrize("name", ROS)
@pytest.mark.parametrize("kind", MCAP_KINDS)
def test_mcap_files_are_as_their_specification_says(tmp_path, kind, name):
    """Indexes, statistics, chunk times, checksums and offsets say what a walk over it finds."""
    write(tmp_path, kind, turning(30_000), message=Message(name))
    found = examine(tmp_path / MCAP_KINDS[kind])
    assert found.counts == {1: 30_000}
    assert len(found.chunks) > 1
    assert found.starts == sorted(found.starts)
    assert len(found.metadata) == 1


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


def test_a_ros1_bag_keeps_the_provenance_with_its_connection(tmp_path):
    """The index repeats the connection with one field more, which other readers pass over."""
    data = write(tmp_path, "bag", turning(3)).read_bytes()
    words = b"quatprop=" + json.dumps(TOLD, sort_keys=True).encode()
    assert data.count(words) == 1
    assert data.index(words) > int.from_bytes(data[data.index(b"index_pos=") + 10 :][:8], "little")


# Places


@pytest.mark.parametrize(("kind", "what"), [("bag", "a ROS 1 bag"), ("npy", "a NumPy file")])
def test_what_begins_with_its_end_refuses_devices(kind, what):
    """The beginning is written last, so it must still be there."""
    words = (
        f"^/dev/null: a pipe or a device cannot take {what}, whose beginning is written last; "
        "name a file$"
    )
    with pytest.raises(OutputError, match=words):
        open_writer("/dev/null", kind)


@pytest.mark.parametrize("kind", ["rosbag2", "rosbag2-mcap"])
def test_a_bag_folder_replaces_nothing(tmp_path, kind):
    """Where something is already, a folder is refused."""
    (tmp_path / "a").mkdir()
    words = f"^{re.escape(str(tmp_path / 'a'))}: exists already; choose another name, with a "
    with pytest.raises(OutputError, match=words):
        open_writer(tmp_path / "a", kind)


@pytest.mark.parametrize("kind", ["rosbag2", "rosbag2-mcap"])
def test_a_failed_bag_folder_leaves_nothing(tmp_path, kind):
    """An exception before the commit leaves no folder and no stray."""

    def fail_midway():
        with open_writer(tmp_path / "a", kind) as writer:
            writer.write(turning(20_000))
            raise RuntimeError("midway")

    with pytest.raises(RuntimeError, match="midway"):
        fail_midway()
    assert list(tmp_path.iterdir()) == []
