"""Series of messages on one topic, by frame and by publisher: chosen, and watched to the last."""

import re

import numpy as np
import pytest
from make.json_messages import imu
from make.mcap import Topic, build, write_topics
from make.protobuf import FOXGLOVE, STAMP, STRING, described, file_of, made, stamp_file
from make.ros import IMU, ROS1, ROS2, encoded, imu_messages, write_messages
from rosbags.rosbag1 import Writer

from quatprop import propagate, read_rates
from quatprop.base.errors import UndeclaredError, UsageError

T0, MS = 1_700_000_000_000_000_000, 1_000_000
COUNT = 240
pytestmark = pytest.mark.filterwarnings("ignore::quatprop.base.errors.RemarkWarning")
LOGS = ["log.mcap", "log.bag", "folder"]


def messages(labels, rate=None):
    """Return messages of 1 ms with these frames; the rate about x is the number of the label."""
    kinds = [*dict.fromkeys(labels)]
    stamps = T0 + np.arange(len(labels)) * MS
    rate = [(float(kinds.index(label)), 0.0, 0.0) for label in labels] if rate is None else rate
    every = [*imu_messages(stamps, rate)]
    for label, (*_, values) in zip(labels, every, strict=True):
        values["header"]["frame_id"] = label
    return every


def refusal(path, **options):
    """Return why reading is refused, without the name of the log."""
    with pytest.raises(UndeclaredError) as raised:
        read_rates(path, **options)
    return str(raised.value).removeprefix(f"{path}: ")


# A chunk of MCAP holds 23 of these messages here, and a block of db3 or of a bag all.
@pytest.mark.thorough
@pytest.mark.parametrize("begin", [1, 22, 23, 24, 100, 200, COUNT - 2])
@pytest.mark.parametrize("name", LOGS)
@pytest.mark.parametrize(("first", "late"), [("imu_left", "imu_right"), ("imu", "/base_link")])
def test_a_second_sensor_that_joins_late_is_found(tmp_path, name, begin, first, late):
    """Only the first 200 messages of the first block were looked at, and a remark was all."""
    labels = [first] * begin + [late, first] * (COUNT - begin)
    path = write_messages(tmp_path / name, messages(labels))
    bare = late.removeprefix("/")
    one, other = sorted([first, bare])
    assert refusal(path) == (
        f"which series to read, of '{one}', '{other}' that take turns in the frames of topic "
        f"'/imu' from {T0 + begin * MS} ns on, is not declared; specify it with series='{one}' or "
        f"'{other}', or if all messages are of one sensor, with series='all'"
    )
    for number, label in enumerate([first, bare]):
        chosen = read_rates(path, series=label)
        assert {*chosen.rate[:, 0].tolist()} == {number}
        assert len(chosen) == (COUNT - begin) + begin * (label == first)
    assert len(read_rates(path, series="all")) == len(labels)


@pytest.mark.thorough
@pytest.mark.parametrize("begin", [1, 22, 23, 24, 200, COUNT - 1])
@pytest.mark.parametrize("name", LOGS)
def test_a_frame_that_changes_once_is_remarked_on(tmp_path, name, begin):
    """Its axes may differ, and it may be only another name."""
    path = write_messages(
        tmp_path / name, messages(["imu_link"] * begin + ["base"] * (COUNT - begin))
    )
    said = (
        f"the frame of topic '/imu' changes from 'imu_link' to 'base' at {T0 + begin * MS} ns: if "
        "their axes differ, the rates are mixed; read the messages of one with series='imu_link'"
    )
    assert said in propagate(path).report.remarks
    chosen = propagate(path, series="imu_link")
    assert len(chosen.t_ns) == begin
    assert [*chosen.report.remarks][-1] == (
        f"{COUNT - begin} messages of other series than 'imu_link' were not read"
    )
    assert not propagate(path, series="all").report.remarks[1:]


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", ["mcap", "bag"])
@pytest.mark.parametrize("changes", range(1, 4))
def test_a_frame_that_changes_between_files_is_remarked_on(tmp_path, suffix, changes):
    """The frames of each file were looked at by themselves."""
    every = messages(["imu_link"] * 60 * changes + ["base"] * (COUNT - 60 * changes))
    parts = [
        write_messages(tmp_path / f"{k}.{suffix}", every[60 * k : 60 * k + 60]) for k in range(4)
    ]
    files = "".join(f", 'imu_link' in {part}" for part in parts[:changes])
    files += "".join(f", 'base' in {part}" for part in parts[changes:])
    said = (
        f"the frame of topic '/imu' is {files[2:]}: if their axes differ, the rates are mixed; "
        "read the messages of one with series='imu_link'"
    )
    assert said in propagate(parts).report.remarks
    for name, number, count in (("imu_link", 0, 60 * changes), ("base", 1, COUNT - 60 * changes)):
        chosen = read_rates(parts, series=name)
        assert (len(chosen), {*chosen.rate[:, 0].tolist()}) == (count, {number})
    for whole in (parts[:changes], parts[changes:]):
        assert "frame" not in str(propagate(whole).report.remarks)
    with pytest.raises(UsageError, match=r"of the series 'another'; there are 'imu_link', 'base'$"):
        read_rates(parts, series="another")
    assert "frame" not in str(propagate(parts, series="all").report.remarks)


SENSOR = file_of(
    "sensor",
    {
        "Header": {"stamp": STAMP, "frame_id": STRING},
        "Gyro": {
            "note": STRING, "header": ".sensor.Header", "angular_velocity": ".foxglove.Vector3"
        },
    },
    ["google/protobuf/timestamp.proto", "foxglove.proto"],
)  # fmt: skip


def of_json(frames, place):
    """Return JSON messages with frames below a name, or next to the rate."""
    for number, frame in frames:
        message = imu(float(number))
        if place == "header.frame_id":
            message["header"]["frame_id"] = frame
        else:
            del message["header"]
            message |= dict(zip(place.split(), frame.split(":"), strict=True))
        yield message


def of_protobuf(frames, place):
    """Return messages with frames and stamps of any length in each of two types."""
    kind = "sensor.Gyro" if place == "header.frame_id" else "foxglove.Odometry"
    new = made(kind, SENSOR, FOXGLOVE, stamp_file())
    for k, (number, frame) in enumerate(frames):
        message = new()
        if place == "header.frame_id":
            message.header.frame_id = frame
            message.note = "n" * (k % 50 == 7)
            message.header.stamp.nanos = 3**k % 10**9
        else:
            for name, each in zip(place.split(), frame.split(":"), strict=True):
                setattr(message, name, each)
            message.timestamp.nanos = 3**k % 10**9
        message.angular_velocity.x = float(number)
        message.angular_velocity.y = 0.0
        message.angular_velocity.z = 0.0
        yield message.SerializeToString()


CODED = {
    ("json", "header.frame_id"): Topic("sensor_msgs/Imu", ()),
    ("json", "frame_id"): Topic("sensor_msgs/Imu", ()),
    ("json", "frame_id child_frame_id"): Topic("sensor_msgs/Imu", ()),
    ("protobuf", "header.frame_id"): Topic(
        "sensor.Gyro", (), described(SENSOR, FOXGLOVE, stamp_file()), "protobuf", "protobuf"
    ),
    ("protobuf", "frame_id body_frame_id"): Topic(
        "foxglove.Odometry", (), described(FOXGLOVE, stamp_file()), "protobuf", "protobuf"
    ),
}
FRAMES_OF = {1: ("left", "right_imu"), 2: ("odom:left", "odom:right_imu")}
BY_FIELD = {"clock": "log", "rate_field": "angular_velocity", "rate_unit": "rad/s"}


def coded(path, coding, numbers):
    """Write messages with the frame and, as rate about x, its number; return the frames."""
    encoding, place = coding
    frames = FRAMES_OF[len(place.split())]
    data = {"json": of_json, "protobuf": of_protobuf}[encoding](
        [(number, frames[number]) for number in numbers], place
    )
    timed = [(T0 + k * MS, message) for k, message in enumerate(data)]
    write_topics(path, {"/imu": CODED[coding]._replace(messages=timed)}, chunk_size=3000)
    return frames


@pytest.mark.thorough
@pytest.mark.parametrize("begin", [1, 19, 20, 21, 37, 200, COUNT - 2])
@pytest.mark.parametrize("coding", CODED)
def test_frames_of_messages_in_every_encoding_are_watched(tmp_path, coding, begin):
    """Those of protobuf, those without a header and those of bodies were not."""
    path = tmp_path / "log.mcap"
    one, other = coded(path, coding, [0] * begin + [1, 0] * (COUNT - begin))
    turning = f"'{one}', '{other}' that take turns in the frames of topic '/imu'"
    assert f"{turning} from {T0 + begin * MS} ns on" in refusal(path, **BY_FIELD)
    for number, label in enumerate((one, other)):
        for name in {label, label.rpartition(":")[2]}:
            chosen = read_rates(path, series=name, **BY_FIELD)
            assert {*chosen.rate[:, 0].tolist()} == {number}
            assert len(chosen) == (COUNT - begin) + begin * (not number)
    assert len(read_rates(path, series="all", **BY_FIELD)) == 2 * COUNT - begin


@pytest.mark.thorough
@pytest.mark.parametrize("begin", [1, 20, 200, COUNT - 1])
@pytest.mark.parametrize("coding", CODED)
def test_a_change_of_the_frame_in_every_encoding_is_remarked_on(tmp_path, coding, begin):
    """With its place."""
    path = tmp_path / "log.mcap"
    one, other = coded(path, coding, [0] * begin + [1] * (COUNT - begin))
    said = (
        f"the frame of topic '/imu' changes from '{one}' to '{other}' at {T0 + begin * MS} ns: if "
        f"their axes differ, the rates are mixed; read the messages of one with series='{one}'"
    )
    assert said in propagate(path, **BY_FIELD).report.remarks
    assert len(propagate(path, series=one, **BY_FIELD).t_ns) == begin
    coded(path, coding, [0] * COUNT)
    assert not [*filter(re.compile("frame").search, propagate(path, **BY_FIELD).report.remarks)]


def bag(path, order, nodes):
    """Write a bag whose messages are of connections in an order; the rate about x is its number."""
    text, md5 = ROS1.generate_msgdef(IMU, ros_version=1)
    made = messages(["imu"] * len(order), [(float(k), 0.0, 0.0) for k in order])
    with Writer(path) as writer:
        connections = [
            # Two of one node have to differ in something.
            writer.add_connection(
                "/imu", IMU, msgdef=text, md5sum=md5, callerid=node, latching=number
            )
            for number, node in enumerate(nodes)
        ]
        for conn, (_, _, at, values) in zip(order, made, strict=True):
            writer.write(connections[conn], at, encoded(ROS1, IMU, values))
    return path


def mcap(path, order, nodes):
    """Write an MCAP file of several channels on one topic."""
    text, _ = ROS2.generate_msgdef(IMU, ros_version=2)
    made = messages(["imu"] * len(order), [(float(k), 0.0, 0.0) for k in order])
    topics = [
        ("/imu", Topic(IMU, (), text.encode(), "ros2msg", "cdr", [("callerid", node)]))
        for node in nodes
    ]
    events = [
        (conn, at, encoded(ROS2, IMU, values), at)
        for conn, (_, _, at, values) in zip(order, made, strict=True)
    ]
    path.write_bytes(build(topics, events, profile="ros2", chunk_size=8000))
    return path


WRITERS = {"log.bag": bag, "log.mcap": mcap}


@pytest.mark.thorough
@pytest.mark.parametrize("begin", [1, 23, 24, 200])
@pytest.mark.parametrize("name", WRITERS)
def test_two_publishers_of_a_topic_are_told_apart(tmp_path, name, begin):
    """Two drivers on one topic were read as one, in the order of their times."""
    order = [0] * begin + [1, 0] * (COUNT - begin)
    path = WRITERS[name](tmp_path / name, order, ["/driver_a", "/driver_b"])
    assert refusal(path) == (
        "which series to read, of '/driver_a', '/driver_b' that take turns as publishers of topic "
        f"'/imu' from {T0 + begin * MS} ns on, is not declared; specify it with series='/driver_a' "
        "or '/driver_b', or if all messages are of one sensor, with series='all'"
    )
    for number, node in enumerate(["/driver_a", "driver_b"]):
        chosen = read_rates(path, series=node)
        assert {*chosen.rate[:, 0].tolist()} == {number}
        assert len(chosen) == order.count(number)
    assert len(read_rates(path, series="all")) == len(order)


@pytest.mark.parametrize("name", WRITERS)
def test_a_driver_that_was_started_again_is_one_publisher(tmp_path, name):
    """It has another connection, of the same name or, later, of another."""
    path = WRITERS[name](tmp_path / name, [0, 1] * 50, ["/driver", "/driver"])
    assert len(read_rates(path)) == 100
    path.unlink()
    path = WRITERS[name](tmp_path / name, [0] * 50 + [1] * 50, ["/driver_1", "/driver_2"])
    assert len(read_rates(path)) == 100


def test_publishers_without_a_name_are_told_apart_by_their_channels(tmp_path):
    """In MCAP, each publisher has a channel of its own."""
    path = mcap(tmp_path / "log.mcap", [0, 1] * 50, ["", ""])
    assert "specify it with series='channel-1' or 'channel-2'" in refusal(path)
    assert {*read_rates(path, series="channel-2").rate[:, 0].tolist()} == {1}


def test_a_series_that_is_not_there_is_refused(tmp_path):
    """The sentence says which are."""
    path = bag(tmp_path / "log.bag", [0, 1] * 9, ["/a", "/b"])
    with pytest.raises(UsageError, match=r"of the series 'c'; there are '/a', '/b', 'imu'$"):
        read_rates(path, series="c")


def test_the_mounting_is_that_of_the_chosen_frame(tmp_path):
    """The frame of the first message of the topic was looked up in the transforms."""
    half = np.sqrt(0.5)
    transforms = [
        [{"stamp": T0, "frame_id": "base"}, child, [[0.0, 0.0, 0.0], [0.0, 0.0, z, w]]]
        for child, z, w in (("left", 0.0, 1.0), ("right", half, half))
    ]
    rate = np.tile([1.0, 0.0, 0.0], (COUNT, 1))
    made = [("/tf_static", "tf2_msgs/msg/TFMessage", T0, [transforms])]
    path = write_messages(tmp_path / "log.mcap", made + messages(["left", "right"] * 120, rate))
    turned = propagate(path, series="right", mount="tf:base", method="start")
    angle = 0.002 * (COUNT // 2 - 1) / 2
    np.testing.assert_allclose(
        turned.wxyz[-1], [np.cos(angle), 0, np.sin(angle), 0], rtol=0, atol=1e-12
    )


@pytest.mark.filterwarnings("default::quatprop.base.errors.RemarkWarning")
@pytest.mark.parametrize("name", LOGS)
def test_the_name_of_a_frame_may_contain_commas(tmp_path, name):
    """The choice that the remark names was of no series."""
    one, other = "imu, left", "/imu, right"
    path = write_messages(tmp_path / name, messages([one] * 90 + [other] * 40))
    with pytest.warns(match="read the messages of one with series='imu, left'"):
        read_rates(path)
    assert len(read_rates(path, series=one)) == 90
    assert len(read_rates(path, series=other)) == 40
    assert len(read_rates(path, series=f"{one},{other}")) == 130
