"""Attitudes out of tables and messages: real recordings, and logs that rosbags wrote."""

import csv
import gzip
import re
import struct
from functools import partial

import numpy as np
import pandas as pd
import pytest
from make.mcap import Topic, write_topics
from make.reading import attitudes
from make.ros import ROS2, TF, encoded, write_messages

from quatprop import convert, read_attitudes
from quatprop.base.errors import (
    AmbiguousTopicError,
    LogError,
    NoAttitudesError,
    NoSamplesError,
    NoSuchTopicError,
    NotRotationsError,
    SchemaError,
    TimelineError,
    UndeclaredError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.propagation.other_logs import attitude_at, first_orientation
from quatprop.propagation.q0_check import OverlappingAttitudes
from quatprop.propagation.recording import Recording, open_recording
from quatprop.readers.attitude_quality import QuaternionCheck
from quatprop.readers.attitude_signals import choose_attitudes
from quatprop.readers.open_log import open_log
from quatprop.settings.reading import AttitudeSelection, RateSelection
from quatprop.stores.file_source import FileSource

HALF = 2.0**-0.5


@pytest.fixture
def table(tmp_path):
    """Return a function that writes a text table."""

    def write(text, name="log.csv"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def checked(path, **how):
    """Return stamps and quaternions of the valid rows of a log, and what was invalid."""
    check = QuaternionCheck(path, **how)
    with open_log(path) as log:
        batches = list(check.apply(choose_attitudes(log, AttitudeSelection()).rows()))
    t_ns = [t for batch in batches for t in batch.t_ns.tolist()]
    return t_ns, [q for batch in batches for q in batch.wxyz.tolist()], check.counts


def refused(error, path, sentence, **options):
    """Assert that a log is refused with a sentence."""
    with pytest.raises(error) as caught:
        attitudes(path, **options)
    assert sentence in str(caught.value)


# Real recordings

COMPONENTS = "wxyz"


@pytest.mark.parametrize(
    ("name", "time", "scale", "wxyz"),
    [
        ("euroc_v102/state_groundtruth_data.csv", "#timestamp", 1, " q_RS_{} []"),
        ("px4/sample_vehicle_attitude_0.csv", "timestamp", 1000, "q[{}]"),
        ("xio3/Quaternion.csv", "Timestamp (us)", 1000, "{} Element"),
        ("rostopic_echo.csv", "field.header.stamp", 1, "field.orientation.{}"),
    ],
)
def test_real_tables_are_read_by_their_names(shared_logs, name, time, scale, wxyz):
    """Every stamp and component is the number in the text, to the bit; no option is needed."""
    path = shared_logs / "csv" / name
    with path.open() as file:
        rows = list(csv.DictReader(file))
    _, t_ns, found, _ = attitudes(path)
    assert len(t_ns) >= 500
    assert t_ns.tolist() == [int(row[time]) * scale for row in rows]
    for place, part in enumerate("0123" if "[" in wxyz[:3] else COMPONENTS):
        title = wxyz.format(part.upper() if "Element" in wxyz else part)
        assert found[:, place].tolist() == [float(row[title]) for row in rows]


def test_recordings_of_several_attitudes_ask_for_one(shared_logs):
    """By their topics and frames; an Imu inside a message of one's own is found."""
    source, _, wxyz, _ = attitudes(shared_logs / "nested_imu" / "kiran_11sec_motion")
    assert (source.field, len(wxyz)) == ("imu.orientation", 414)
    auk = shared_logs / "auk" / "auk.bag"
    several = "several topics carry attitudes: '/auk/fcu/imu', '/vicon/auk/auk'; choose one with"
    refused(AmbiguousTopicError, auk, several)
    refused(
        NoSuchTopicError, auk, "no topic '/nothing' that carries attitudes; ch", topic="/nothing"
    )
    tilt = partial(refused, UsageError, shared_logs / "irregular" / "tilt_laser.bag", topic="/tf")
    tilt(
        "topic '/tf' has several transforms: '/tilt_axis:/camera', '/tilt_base:/tilt_axis', "
        "'/tilt_axis:/laser'; choose one with frame='PARENT:CHILD'"
    )
    tilt("topic '/tf' has no transform '/arm', but '/tilt_axis:", frame="/arm")


# Tables made up

XSENS = "// Update Rate: 100.0Hz\nPacketCounter\t"
MATRIX = "\t".join(f"Mat[{row}][{column}]" for column in (1, 2, 3) for row in (1, 2, 3))
SENSOR_LOGGER = "time,seconds_elapsed,quaternionX,quaternionY,quaternionZ,quaternionW\n"
ARDUPILOT = "timestamp,TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw\n"
ARIA = "graph_uid,tracking_timestamp_us,utc_timestamp_ns," + ",".join(
    f"q{axis}_world_device" for axis in "xyzw"
)
DOT = "PacketCounter,SampleTimeFine"
ABOUT_X, QUARTER_X, QUARTER_Z = [0.8, 0.6, 0, 0], [HALF, HALF, 0, 0], [HALF, 0, 0, HALF]


@pytest.mark.parametrize(
    ("name", "text", "t_ns", "wxyz"),
    [
        ("log.csv", "time,seconds_elapsed,qz,qy,qx,qw\n7,0.5,0,0,0.6,0.8\n", 7, ABOUT_X),
        # Three decimals are as good as a table may have; they are not touched.
        ("log.csv", "t_ns,qw,qx,qy,qz\n1,0.5,0.5,0.5,0.501\n", 1, [0.5, 0.5, 0.5, 0.501]),
        # Its stamps are in ns, which x-io's would have to declare.
        ("WatchMotion.csv", f"{SENSOR_LOGGER}10000000,0.01,0.6,0,0,0.8\n", 10**7, ABOUT_X),
        # Quat_q0 is w, by the manual; the counter is the time.
        ("mt.txt", f"{XSENS}Quat_q0\tQuat_q1\tQuat_q2\tQuat_q3\n0\t.8\t.6\t.0\t.0\n", 0, ABOUT_X),
        # Mat[2][1] is in the second row, wherever it stands.
        ("mt.txt", f"{XSENS}{MATRIX}\n0\t1.\t0.\t0.\t0.\t0.\t1.\t0.\t-1.\t0.\n", 0, QUARTER_X),
        # DesRoll and the like are what was wanted; the unit is known by convention.
        ("att.csv", f"{ARDUPILOT}1.7e9,10000,9,0,9,0,9,90,0,0\n", 10**7, QUARTER_Z),
        # Those of the device in the world, at the time of tracking.
        ("closed_loop_trajectory.csv", f"{ARIA}\na,10000,-1,0.6,0,0,0.8\n", 10**7, ABOUT_X),
        # The file of quaternions of an NGIMU, whose columns are components alone.
        ("quaternion.csv", "Time (s),W,X,Y,Z\n0.01,.8,.6,0,0\n", 10**7, ABOUT_X),
        # That of an x-IMU3 counts microseconds: it had no attitudes.
        ("Quaternion.csv", "Timestamp (us),W,X,Y,Z\n10000,.8,.6,0,0\n", 10**7, ABOUT_X),
        # The clock of a Movella DOT counts microseconds, by its manual; it had to be declared.
        ("dot.csv", f"{DOT},Quat_W,Quat_X,Quat_Y,Quat_Z\n0,10000,.8,.6,0,0\n", 10**7, ABOUT_X),
        # Nor were its angles known: of z, the new y, the newest x, in deg, by the manual.
        ("dot.csv", f"{DOT},Euler_X,Euler_Y,Euler_Z\n0,10000,0,0,90\n", 10**7, QUARTER_Z),
        # q[0] is the scalar in what ulog2csv writes.
        ("a_vehicle_attitude_0.csv", "timestamp,q[0],q[1],q[2],q[3]\n1,.8,.6,0,0\n", 1000, ABOUT_X),
    ],
)
def test_the_names_of_a_program_tell_the_components(table, name, text, t_ns, wxyz):
    """In any order, as quaternions, matrices or angles."""
    _, found_ns, found, _ = attitudes(table(text, name))
    assert found_ns.tolist() == [t_ns]
    np.testing.assert_allclose(found[0], wxyz, rtol=0, atol=1e-15)


def test_tum_trajectories_are_scalar_last_in_exact_seconds(table):
    """Comments are passed over, and decimal seconds become the nanoseconds they say."""
    path = table(
        "# ground truth trajectory\n# file: 'a.bag'\n# timestamp tx ty tz qx qy qz qw\n"
        "1305031098.665900001 1.3 0.6 1.6 0.6 0 0 0.8\n"
        "# a remark\n1305031099.6758 1.3 0.6 1.6 0 0.6 0 0.8\n"
        "1305031100 1.3 0.6 1.6 0 0 0.6 0.8\n",
        "groundtruth.txt",
    )
    source, t_ns, wxyz, _ = attitudes(path)
    assert source.type_name == "TUM"
    assert t_ns.tolist() == [1305031098665900001, 1305031099675800000, 1305031100000000000]
    assert wxyz.tolist() == [[0.8, 0.6, 0, 0], [0.8, 0, 0.6, 0], [0.8, 0, 0, 0.6]]


TRAJECTORY = "10.5 1 2 3 0.6 0 0 0.8\n11.5 1 2 3 0 0.6 0 0.8\n"


@pytest.mark.parametrize(
    "text", [TRAJECTORY, "# ours\n" + TRAJECTORY, TRAJECTORY.replace(" ", ",")]
)
def test_a_tum_trajectory_needs_no_header(table, text):
    """Its suffix says what its eight columns are; compressed files keep it before their own."""
    plain = table(text, "log.tum")
    packed = plain.with_suffix(".tum.gz")
    packed.write_bytes(gzip.compress(text.encode()))
    for path in (plain, packed):
        source, t_ns, wxyz, _ = attitudes(path)
        assert (t_ns.tolist(), source.type_name) == ([10_500_000_000, 11_500_000_000], "TUM")
        assert wxyz.tolist() == [[0.8, 0.6, 0, 0], [0.8, 0, 0.6, 0]]


def test_a_tum_trajectory_of_another_name_is_read_as_one_where_the_user_says_so(table):
    """Eight numbers a row may be anything otherwise; of another width it is no trajectory."""
    path = table(TRAJECTORY, "log.txt")
    refused(NoAttitudesError, path, "no attitudes found")
    packed = path.with_suffix(".csv.gz")
    packed.write_bytes(gzip.compress(TRAJECTORY.encode()))
    for each in (path, packed):
        with open_log(each, "tum") as log:
            assert choose_attitudes(log, AttitudeSelection()).type_name == "TUM"
    path = table("1 2 3 4\n5 6 7 8\n")
    with pytest.raises(UnsupportedLogError, match="it has 4 columns, and a TUM trajectory has 8"):
        open_log(path, "tum").__enter__()


def test_a_bag_is_a_folder_and_cannot_come_from_stdin():
    """Its files are needed by their names."""
    with pytest.raises(UnsupportedLogError, match="-: a ROS 2 bag is a folder; name it"):
        open_log("-", "rosbag2").__enter__()


def test_a_range_without_attitudes_is_refused(table):
    """Also where they are interpolated; a stretch that is shorter than an interval has none."""
    # From 1 s to 2 s are ten intervals, which are no gap.
    stamps = [*range(11), *range(20, 31), *range(53, 57), *range(80, 91)]
    path = table("t_ms,qw,qx,qy,qz\n" + "".join(f"{t}00,1,0,0,0\n" for t in stamps))
    for options in ({}, {"rate": 1}):
        with pytest.raises(NoSamplesError, match="no samples in"):
            convert(path, path.with_name("out.csv"), start="+10s", **options)
    with pytest.raises(NoSamplesError, match="no samples in"):
        read_attitudes(path, start="+10s")
    (remark,) = convert(path, path.with_name("out.csv"), rate=1).remarks
    assert remark == "no attitudes are interpolated across 2 gaps longer than 1 s"
    assert (read_attitudes(path.with_name("out.csv")).t_ns // 10**9).tolist() == [0, 1, 2, 3, 8, 9]


def test_numbered_columns_need_columns_and_a_layout(table):
    """Without a header nothing is guessed, one question after the other."""
    path = table("10,0.6,0,0,0.8\n20,0.6,0,0,0.8\n")
    refused(NoAttitudesError, path, "no attitudes found; its columns are '0: 10', '1: 0.6', '2: 0'")
    named = {"quat_cols": ("1", "2", "3", "4"), "time_col": "0", "time_unit": "us"}
    sentence = (
        "which of the columns '1', '2', '3', '4' is the scalar is not declared; specify it "
        "with from_layout='scalar-first' or 'scalar-last'"
    )
    refused(UndeclaredError, path, sentence, **named)
    _, t_ns, wxyz, _ = attitudes(path, **named, from_layout="scalar-last")
    assert (t_ns.tolist(), wxyz[0].tolist()) == ([10_000, 20_000], [0.8, 0.6, 0, 0])
    assert attitudes(path, **named, from_layout="wxyz")[2][0].tolist() == [0.6, 0, 0, 0.8]
    # Components by number are only trusted in known files.
    path = table("timestamp,q[0],q[1],q[2],q[3]\n1,0.8,0.6,0,0\n2,0.8,0.6,0,0\n", "other.csv")
    refused(NoAttitudesError, path, "quat_cols")


def test_an_option_that_contradicts_the_names_is_refused(table):
    """Columns in the order w, x, y, z are not scalar-last, whatever the option says."""
    path = table("t_ns,qw,qx,qy,qz\n1,1,0,0,0\n2,1,0,0,0\n")
    sentence = (
        "from_layout says scalar-last, but the columns 'qw', 'qx', 'qy', 'qz' are "
        "scalar-first by name; omit it, or rename the columns if they are wrong"
    )
    for named in ({}, {"quat_cols": ("qw", "qx", "qy", "qz")}):
        refused(UsageError, path, sentence, from_layout="xyzw", **named)


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        ("a.qw,a.qx,a.qy,a.qz,b.qw,b.qx,b.qy,b.qz", "(their scalar columns are 'a.qw', 'b.qw'"),
        # Of the same names twice, their numbers settle which is meant.
        ("qw,qx,qy,qz,qw,qx,qy,qz", "1-2-3-4, 5-6-7-8"),
    ],
)
def test_several_quaternions_are_refused(table, names, sentence):
    """Two complete sets of columns are ambiguous until one is named."""
    path = table(f"t_ns,{names}\n1,1,0,0,0,0,1,0,0\n2,1,0,0,0,0,1,0,0\n")
    refused(UndeclaredError, path, "which quaternion to use")
    refused(UndeclaredError, path, sentence)
    assert attitudes(path, quat_cols=("5", "6", "7", "8"))[2][0].tolist() == [0, 1, 0, 0]


def test_a_quaternion_of_a_millionth_is_none(table):
    """Whatever is longer can be scaled."""
    path = table("t_ns,qw,qx,qy,qz\n1,9e-7,0,0,0\n2,1.2e-6,0,0,0\n3,1,0,0,0\n")
    t_ns, wxyz, counts = checked(path, normalize=True, drop=True)
    assert (t_ns, wxyz) == ([2, 3], [[1, 0, 0, 0]] * 2)
    assert (counts.zero, counts.normalized, counts.not_unit) == (1, 1, 0)
    assert checked(path, drop=True)[2].not_unit == 1


def test_the_first_invalid_row_is_counted_over_batches():
    """Those before it are valid."""
    check = QuaternionCheck("log", drop=True)
    t_ns, valid = np.arange(3), np.eye(4)[[0, 1, 2]]
    kept = list(check.apply([(t_ns, valid), (t_ns + 3, valid * [[1], [0], [1]])]))
    assert [series.t_ns.tolist() for series in kept] == [[0, 1, 2], [3, 5]]
    assert (check.counts.first, check.counts.first_ns, check.counts.invalid) == (4, 4, 1)


# Messages made up


def imu(stamp_ns, wxyz, covariance=0.0):
    """Return an Imu message."""
    return {
        "header": {"stamp": {"sec": 0, "nanosec": stamp_ns}, "frame_id": "map"},
        "orientation": dict(zip(COMPONENTS, wxyz, strict=True)),
        "orientation_covariance": [covariance] + 8 * [0.0],
        "angular_velocity": {"x": 0.0, "y": 0.0, "z": 0.1},
        "angular_velocity_covariance": 9 * [0.0],
    }


def write_imus(path, *messages):
    """Write Imu messages."""
    return write_topics(path, {"/imu": Topic("sensor_msgs/Imu", list(messages))})


def test_an_absent_orientation_is_no_rotation(table, tmp_path):
    """A covariance of -1 marks it, whatever stands in the quaternion; zeros are none either."""
    names = ",".join(f"field.orientation.{part}" for part in "xyzw")
    text = f"%time,field.header.stamp,{names},field.orientation_covariance0\n"
    rows = table(text + "1,5,0.6,0,0,0.8,0\n2,6,0,0,0,1,-1\n3,7,0,0,0,0,0\n")
    messages = (imu(5, (0.8, 0.6, 0, 0)), imu(6, (1, 0, 0, 0), -1.0), imu(7, (0, 0, 0, 0)))
    for path in (rows, write_imus(tmp_path / "log.mcap", *messages)):
        t_ns, wxyz, counts = checked(path, drop=True)
        assert (t_ns, wxyz) == ([5], [[0.8, 0.6, 0, 0]])
        assert (counts.not_finite, counts.zero) == (1, 1)


def test_transforms_are_not_read_to_choose_among_topics(tmp_path, monkeypatch):
    """Of hours of them every message was read, to refuse to choose."""
    stamps = [{"header": {"stamp": k}, "quaternion": (0, 0, 0, 1)} for k in range(5)]
    messages = [("/q", "geometry_msgs/msg/QuaternionStamped", k, q) for k, q in enumerate(stamps)]
    turned = ([0, 0, 0], [0, 0, 0, 1])
    for k in range(5, 2000):
        head = {"stamp": k, "frame_id": "odom"}
        messages.append(("/tf", TF, k, [[[head, "base", turned]]]))
    log = write_messages(tmp_path / "log.mcap", messages)
    read, lengths = FileSource.read, []

    def counted(source, start, length):
        lengths.append(length)
        return read(source, start, length)

    monkeypatch.setattr(FileSource, "read", counted)
    with pytest.raises(LogError, match="several topics carry attitudes: '/q', '/tf'; choose"):
        attitudes(log)
    assert sum(lengths) < log.stat().st_size / 2


def test_transforms_are_found_wherever_they_stand_in_their_lists(tmp_path):
    """Lists of any length, names of any length, the same pair twice in a message."""
    random = np.random.default_rng(3)
    names = ["", "b", "base", "base_link", "camera_optical_frame"]
    messages, expected = [], []
    stamp = 0
    for k in range(200):
        transforms = []
        for _ in range(random.integers(0, 5)):
            parent, child = map(str, random.choice(names, 2))
            wxyz = random.normal(size=4)
            wxyz = (wxyz / np.linalg.norm(wxyz)).tolist()
            stamp += 10**8
            moved = ([1.0, 2.0, 3.0], np.roll(wxyz, -1).tolist())
            transforms.append([{"stamp": stamp, "frame_id": parent}, child, moved])
            if (parent, child) == ("base", "b"):
                expected.append((stamp, wxyz))
        messages.append(("/tf", TF, k, [transforms]))
    log = write_messages(tmp_path / "log.mcap", messages)
    source, t_ns, wxyz, _ = attitudes(log, frame="base:b")
    assert source.field == "base <- b"
    assert len(expected) > 5
    assert list(zip(t_ns.tolist(), wxyz.tolist(), strict=True)) == expected
    for options in ({"series": "base:b"}, {"series": "base:b", "frame": "base:b"}):
        assert attitudes(log, **options)[2].tolist() == wxyz.tolist()
    sentence = "frame and series choose different transforms; give one"
    refused(UsageError, log, sentence, series="base:b", frame="a")


@pytest.mark.parametrize("size", [2, 6, 20, 60])
def test_a_damaged_list_of_transforms_costs_itself(tmp_path, size):
    """All messages of its block were taken for empty lists, and the topic was refused."""
    lists = [[[{"stamp": k, "frame_id": "a"}, "b", ((), (0.0, 0.0, 0.0, 1.0))]] for k in range(9)]
    messages = [encoded(ROS2, TF, [each]) for each in lists]
    messages[4] = messages[4][:size]
    definition = ROS2.generate_msgdef(TF, ros_version=2)[0].encode()
    topic = Topic(TF, messages, definition, "ros2msg", "cdr")
    _, t_ns, _, losses = attitudes(write_topics(tmp_path / "log.mcap", {"/tf": topic}))
    assert t_ns.tolist() == [0, 1, 2, 3, 5, 6, 7, 8]
    reason = "recorded at 4000 ns ends before its list of transforms; the log is damaged"
    assert [loss.messages for loss in losses if loss.reason.endswith(reason)] == [1]


def test_px4_attitudes_are_scalar_first(tmp_path):
    """VehicleAttitude.q is w, x, y, z from FRD to NED, its time in us since boot."""
    definition = b"uint64 timestamp\nuint64 timestamp_sample\nfloat32[4] q\n"
    data = b"\0\1\0\0" + struct.pack("<2Q4f", 9, 7, 0.5, -0.5, 0.5, 0.5)
    topic = Topic("px4_msgs/msg/VehicleAttitude", [data], definition, "ros2msg", "cdr")
    log = write_topics(tmp_path / "log.mcap", {"/fmu/out/vehicle_attitude": topic})
    source, t_ns, wxyz, _ = attitudes(log)
    assert (t_ns.tolist(), wxyz.tolist()) == ([7000], [[0.5, -0.5, 0.5, 0.5]])
    assert source.layout == "scalar-first"
    assert source.remarks == ("by its type FRD body to NED reference",)
    sentence = (
        "from_layout says scalar-last, but 'q' of 'px4_msgs/msg/VehicleAttitude' is "
        "scalar-first by definition; omit it"
    )
    refused(UsageError, log, sentence, from_layout="scalar-last")


def test_a_field_of_an_unknown_type_can_be_named(tmp_path):
    """An array of four numbers needs a layout; a struct of w, x, y, z does not."""
    definition = b"builtin_interfaces/Time t\nfloat64[4] q\ngeometry_msgs/Quaternion o\n"
    data = b"\0\1\0\0" + struct.pack("<2I8d", 0, 3, 0.0, 0.6, 0.0, 0.8, 0.6, 0.0, 0.0, 0.8)
    topic = Topic("my_msgs/msg/Pose", [data], definition, "ros2msg", "cdr")
    log = write_topics(tmp_path / "log.mcap", {"/pose": topic})
    refused(NoAttitudesError, log, "no attitudes found; its topics are '/pose (my_m")
    assert attitudes(log, quat_field="o")[2].tolist() == [[0.8, 0.6, 0, 0]]
    refused(UndeclaredError, log, "which of the columns 'q[0]', ", quat_field="q")
    for field in ("t", "q[0]"):
        refused(SchemaError, log, f"field '{field}' of 'my_msgs/msg/Pose' is n", quat_field=field)
    _, t_ns, wxyz, _ = attitudes(log, quat_field="q", time_field="t", from_layout="scalar-last")
    assert (t_ns.tolist(), wxyz.tolist()) == ([3], [[0.8, 0, 0.6, 0]])


# One attitude, for the beginning of a propagation


def attitude(path, t_ns):
    """Return the attitude of a series at a time."""
    return attitude_at(path, t_ns, Recording((), None), OverlappingAttitudes(np.array([t_ns])))[0]


def test_the_attitude_at_a_stamp_is_the_row_and_between_two_the_arc(table):
    """A quarter of the way through a turn of 90 degrees it has turned by 22.5; outside is none."""
    path = table(f"t_ns,qw,qx,qy,qz\n100,1,0,0,0\n500,{-HALF!r},0,0,{-HALF!r}\n")
    assert attitude(path, 100).tolist() == [1, 0, 0, 0]
    assert attitude(path, 500).tolist() == [-HALF, 0, 0, -HALF]
    angle = np.radians(22.5)
    expected = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
    assert geodesic_angle(attitude(path, 200), expected) < 1e-15
    with pytest.raises(TimelineError, match=r"its first attitude is 1 ns after the first sample"):
        attitude(path, 99)
    with pytest.raises(TimelineError, match=r"its last attitude is 1 ns before the first samp"):
        attitude(path, 501)


def test_ten_seconds_are_bridged_and_no_more(table):
    """Whenever they are."""
    first, second = 17 * 10**17, 17 * 10**17 + 10**10
    path = table(f"t_ns,qw,qx,qy,qz\n{first},1,0,0,0\n{second},1,0,0,0\n{second * 2},1,0,0,0\n")
    assert attitude(path, first + 10**9).tolist() == [1, 0, 0, 0]
    path = table(f"t_ns,qw,qx,qy,qz\n{first},1,0,0,0\n{second + 1},1,0,0,0\n")
    with pytest.raises(TimelineError, match="is in a gap of 10 s between its attitudes"):
        attitude(path, first + 10**9)


def test_a_series_without_rotations_has_no_attitude(table):
    """Zeros are none."""
    path = table("t_ns,qw,qx,qy,qz\n100,0,0,0,0\n500,0,0,0,0\n")
    with pytest.raises(NotRotationsError, match=r"no orientation: 2 of 2 rows .* \(2 all zero\)"):
        attitude(path, 100)
    with pytest.raises(NoSamplesError, match=r"no samples in 'qw,qx,qy,qz'"):
        attitude(table("t_ns,qw,qx,qy,qz\n"), 100)


def own_orientation(path, topic=None, t_ns=None):
    """Return the orientation next to the rates of a topic."""
    with open_recording([str(path)], RateSelection(topic=topic)) as recording:
        rates = recording.rate_signal()
        t_ns = next(rates.batches()).t_ns[0] if t_ns is None else t_ns
        overlap = OverlappingAttitudes(np.array([t_ns]))
        return first_orientation(recording.tables, rates, recording, t_ns, overlap).tolist()


def test_the_orientation_of_a_log_is_that_of_the_message_of_the_rate(shared_logs, tmp_path):
    """Or of the row; an Imu that marks every orientation as absent is refused as a beginning."""
    path = shared_logs / "husky" / "test1_husky.bag"
    _, t_ns, wxyz, _ = attitudes(path, topic="/imu/data")
    assert own_orientation(path, "/imu/data") == wxyz[0].tolist()
    assert own_orientation(path, "/imu/data", t_ns[100]) == wxyz[100].tolist()
    found = own_orientation(shared_logs / "csv" / "rostopic_echo.csv")
    assert found[0] == pytest.approx(0.7109, abs=1e-4)
    log = write_imus(tmp_path / "log.mcap", imu(5, (1.0, 0.0, 0.0, 0.0), -1.0))
    with pytest.raises(LogError, match=r"the orientation of '/imu' is absent or invalid through"):
        own_orientation(log)


# --- words of roles in names of columns

ROLES = ["cmd", "command", "sp", "ref", "reference", "target", "goal", "err"]


@pytest.mark.filterwarnings("ignore::quatprop.base.errors.RemarkWarning")
@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("names", ["{}_q_w {}_q_x {}_q_y {}_q_z", "{}_roll {}_pitch {}_yaw"])
@pytest.mark.parametrize("is_first", [False, True])
def test_attitudes_with_a_role_in_their_names_are_no_choice(tmp_path, role, names, is_first):
    """A table with commanded and estimated attitudes was refused, and commands alone were read."""
    commanded, own = (names.format(*[word] * 4).split() for word in (role, "imu"))
    wxyz = np.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.6, 0.0, 0.0]])
    turned = wxyz if len(own) == 4 else np.array([[0.0, 0.0, 0.0], [2 * np.arctan(0.75), 0.0, 0.0]])
    columns = {"t_ns": [0, 10**9]} | dict(zip(own, turned.T, strict=True))
    others = dict(zip(commanded, turned[::-1].T, strict=True))
    columns = others | columns if is_first else columns | others
    options = {} if len(own) == 4 else {"from_angle_unit": "rad"}
    pd.DataFrame(columns).to_csv(tmp_path / "both.csv", index=False)
    found = read_attitudes(tmp_path / "both.csv", **options)
    np.testing.assert_allclose(found.wxyz, wxyz, rtol=0, atol=1e-15)
    del columns[own[0]]
    pd.DataFrame(columns).to_csv(tmp_path / "commanded.csv", index=False)
    with pytest.raises(UndeclaredError) as raised:
        read_attitudes(tmp_path / "commanded.csv", **options)
    assert f"are the attitude of the body ('{role}' does not tell)" in str(raised.value)
    (remedy,) = re.findall(r"quat_cols='(.*?)'", str(raised.value))
    if len(own) == 3:
        assert "from_euler='zyx' if they are" in str(raised.value)
        options["from_euler"] = "zyx"
    named = read_attitudes(tmp_path / "commanded.csv", quat_cols=remedy.split(","), **options)
    np.testing.assert_allclose(named.wxyz, wxyz[::-1], rtol=0, atol=1e-15)
