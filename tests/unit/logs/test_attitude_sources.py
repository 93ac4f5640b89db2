"""Attitudes out of tables and messages: real recordings, and logs that rosbags wrote."""

import csv
import gzip
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quatprop import read_attitudes
from quatprop.errors import (
    AmbiguousTopicError,
    LogError,
    NoAttitudesError,
    NoSamplesError,
    NoSuchTopicError,
    NotRotationsError,
    TimelineError,
    UndeclaredError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.logs.interpolation import attitude_at, first_orientation
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.attitudes import choose_attitudes
from quatprop.logs.signals.quaternion_check import QuaternionCheck
from quatprop.logs.signals.rates import choose_rates
from quatprop.settings.selection import AttitudeSelection, RateSelection
from quatprop.text import in_python

STORE = get_typestore(Stores.ROS2_HUMBLE)
HALF = 2.0**-0.5


def read(path, topic=None, clock=None, *, drop=False, normalize=False, **options):
    """Return stamps and wxyz of the attitudes of a log, and the source."""
    with open_log(path) as log:
        source = choose_attitudes(log, AttitudeSelection(topic=topic, clock=clock, **options))
        check = QuaternionCheck(path, drop=drop, normalize=normalize)
        batches = list(check.apply(source.rows()))
    t_ns = np.concatenate([np.empty(0, np.int64), *(batch.t_ns for batch in batches)])
    wxyz = np.concatenate([np.empty((0, 4)), *(batch.wxyz for batch in batches)])
    return t_ns, wxyz, source, check.counts


def table(tmp_path, text, name="log.csv"):
    """Write a text table."""
    path = tmp_path / name
    path.write_text(text)
    return path


# Real recordings.


def column(path, name):
    """Return a column of a CSV as text, read by Python's own module."""
    with Path(path).open() as file:
        rows = list(csv.reader(file))
    place = rows[0].index(name)
    return [row[place] for row in rows[1:]]


TABLES = {
    "euroc_v102/state_groundtruth_data.csv": (
        *("#timestamp", 1, " q_RS_w []", " q_RS_x []", " q_RS_y []", " q_RS_z []"),
    ),
    "px4/sample_vehicle_attitude_0.csv": ("timestamp", 1000, "q[0]", "q[1]", "q[2]", "q[3]"),
    "xio3/Quaternion.csv": (
        *("Timestamp (us)", 1000, "W Element", "X Element", "Y Element", "Z Element"),
    ),
    "rostopic_echo.csv": (
        *("field.header.stamp", 1, "field.orientation.w", "field.orientation.x"),
        *("field.orientation.y", "field.orientation.z"),
    ),
}
"""Name of the time column, ns in its unit, and the columns w, x, y, z."""


@pytest.mark.parametrize("name", TABLES)
def test_real_tables_are_read_by_their_names(shared_logs, name):
    """Every stamp and component is the number in the text, to the bit; no option is needed."""
    time, scale, *wxyz = TABLES[name]
    path = shared_logs / "csv" / name
    t_ns, found, _, _ = read(path)
    assert len(t_ns) >= 500
    assert t_ns.tolist() == [int(text) * scale for text in column(path, time)]
    for place, title in enumerate(wxyz):
        assert found[:, place].tolist() == [float(text) for text in column(path, title)]


def test_xsens_tables_carry_attitudes_beside_their_rates(shared_logs):
    """Quat_w is the scalar, rows are counted at the rate of the comments."""
    t_ns, wxyz, source, _ = read(shared_logs / "csv" / "data_xsens.txt")
    assert (t_ns[0], t_ns[1], source.clock) == (0, 20_000_000, "Counter at 50 Hz")
    assert wxyz[0].tolist() == [0.567189, 0.769786, 0.003829, 0.292765]


def test_stamps_that_a_sample_rate_replaces_are_named(tmp_path):
    """Rows are counted as asked, of attitudes as of rates, and it is said what is not used."""
    path = table(tmp_path, "t_ns,qw,qx,qy,qz\n5,1,0,0,0\n6,1,0,0,0\n")
    t_ns, _, source, _ = read(path, sample_rate=100)
    assert t_ns.tolist() == [0, 10_000_000]
    assert tuple(map(in_python, source.remarks)) == (
        "sample_rate='100' counts the rows; the stamps in 't_ns' are not used",
    )


def by_library(path, topic, quaternion):
    """Return header stamps and wxyz of a topic, message by message with rosbags."""
    t_ns, wxyz = [], []
    with AnyReader([path], default_typestore=STORE) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        for connection, _, data in reader.messages(connections=connections):
            message = reader.deserialize(data, connection.msgtype)
            found = quaternion(message)
            if found is not None:
                stamp, q = found
                t_ns.append(stamp.sec * 10**9 + stamp.nanosec)
                wxyz.append((q.w, q.x, q.y, q.z))
    return t_ns, wxyz


def one_field(*names):
    """Return a function that takes the header stamp and a nested field of a message."""

    def take(message):
        stamp = message.header.stamp
        for name in names:
            message = getattr(message, name)
        return stamp, message

    return take


def transform(parent, child):
    """Return a function that takes the transform between two frames out of a list."""

    def take(message):
        for one in message.transforms:
            if (one.header.frame_id, one.child_frame_id) == (parent, child):
                return one.header.stamp, one.transform.rotation
        return None

    return take


@pytest.mark.parametrize(
    ("log", "topic", "quaternion", "frame"),
    [
        ("auk/auk.bag", "/vicon/auk/auk", one_field("transform", "rotation"), None),
        ("husky/test1_husky.bag", "/imu/data", one_field("orientation"), None),
        (
            "husky/test1_husky.bag",
            "/husky_velocity_controller/odom",
            one_field("pose", "pose", "orientation"),
            None,
        ),
        ("irregular/tilt_laser.bag", "/tf", transform("/tilt_axis", "/laser"), "/laser"),
        (
            "irregular/tilt_laser.bag",
            "/tf",
            transform("/tilt_base", "/tilt_axis"),
            "/tilt_base:/tilt_axis",
        ),
        *(
            ("rosbag2/geocam_all_types", f"/test/{name}", take, None)
            for name, take in (
                ("geometry_msgs/quaternion_stamped", one_field("quaternion")),
                ("geometry_msgs/pose_stamped", one_field("pose", "orientation")),
                (
                    "geometry_msgs/pose_with_covariance_stamped",
                    one_field("pose", "pose", "orientation"),
                ),
                ("geometry_msgs/transform_stamped", one_field("transform", "rotation")),
                ("nav_msgs/odometry", one_field("pose", "pose", "orientation")),
                ("sensor_msgs/imu", one_field("orientation")),
                ("tf2_msgs/tf_message", transform("test_frame", "child_frame")),
            )
        ),
    ],
)
def test_real_messages_agree_with_their_library(shared_logs, log, topic, quaternion, frame):
    """Stamps and components are those that rosbags decodes a message at a time, to the bit."""
    t_ns, wxyz, source, _ = read(shared_logs / log, topic, frame=frame)
    expected_ns, expected = by_library(shared_logs / log, topic, quaternion)
    assert len(t_ns) > 1
    assert source.layout == "scalar-last"
    assert t_ns.tolist() == expected_ns
    assert wxyz.tolist() == [list(row) for row in expected]


def test_the_containers_of_one_recording_carry_the_same_attitudes(shared_logs):
    """ROS 1, MCAP and SQLite give the same stamps and numbers."""
    first = read(shared_logs / "auk" / "auk.bag", "/vicon/auk/auk")
    for name in ("auk_mcap_zstd", "auk_sqlite3"):
        other = read(shared_logs / "auk" / name, "/vicon/auk/auk")
        assert (other[0] == first[0]).all()
        assert (other[1] == first[1]).all()


def test_an_orientation_inside_a_message_of_ones_own_is_found(shared_logs):
    """A custom message with an Imu inside carries that Imu's orientation."""
    _, wxyz, source, _ = read(shared_logs / "nested_imu" / "kiran_11sec_motion")
    assert (source.field, len(wxyz)) == ("imu.orientation", 414)


def test_several_topics_are_refused_by_name(shared_logs):
    """A log with two attitudes is ambiguous until one is chosen."""
    with pytest.raises(
        AmbiguousTopicError,
        match=r"several topics carry attitudes: '/auk/fcu/imu', '/vicon/auk/auk'; choose one with",
    ):
        read(shared_logs / "auk" / "auk.bag")


def test_a_topic_without_attitudes_is_refused(shared_logs):
    """The error names those that have some."""
    with pytest.raises(NoSuchTopicError, match=r"no topic '/nothing' that carries attitudes; ch"):
        read(shared_logs / "auk" / "auk.bag", "/nothing")


def test_several_transforms_are_refused_by_their_frames(shared_logs):
    """A list of several frames says which there are."""
    log = shared_logs / "irregular" / "tilt_laser.bag"
    with pytest.raises(
        UsageError,
        match=r"topic '/tf' has several transforms: '/tilt_axis:/camera', "
        r"'/tilt_base:/tilt_axis', '/tilt_axis:/laser'; choose one with frame='PARENT:CHILD'",
    ):
        read(log, "/tf")
    with pytest.raises(UsageError, match=r"topic '/tf' has no transform '/arm', but '/tilt_axis:"):
        read(log, "/tf", frame="/arm")


# Tables made up.


def test_names_tell_the_components_in_any_order(tmp_path):
    """A table with reversed columns is read by name; its layout is neither of the two."""
    path = table(tmp_path, "time,seconds_elapsed,qz,qy,qx,qw\n7,0.5,0.3,0.4,0.5,0.7\n")
    t_ns, wxyz, source, _ = read(path, normalize=True)
    assert (t_ns.tolist(), source.layout) == ([7], "by name")
    np.testing.assert_allclose(wxyz[0] / wxyz[0, 0], np.array([7, 5, 4, 3]) / 7, rtol=1e-15)


def test_tum_trajectories_are_scalar_last_in_exact_seconds(tmp_path):
    """Comments are passed over, and decimal seconds become the nanoseconds they say."""
    path = table(
        tmp_path,
        "# ground truth trajectory\n# file: 'a.bag'\n# timestamp tx ty tz qx qy qz qw\n"
        "1305031098.665900001 1.3 0.6 1.6 0.6 0 0 0.8\n"
        "# a remark\n1305031099.6758 1.3 0.6 1.6 0 0.6 0 0.8\n"
        "1305031100 1.3 0.6 1.6 0 0 0.6 0.8\n",
        "groundtruth.txt",
    )
    t_ns, wxyz, source, _ = read(path)
    assert source.type_name == "TUM"
    assert t_ns.tolist() == [
        1305031098665900001,
        1305031099675800000,
        1305031100000000000,
    ]
    assert wxyz.tolist() == [[0.8, 0.6, 0, 0], [0.8, 0, 0.6, 0], [0.8, 0, 0, 0.6]]


TRAJECTORY = "10.5 1 2 3 0.6 0 0 0.8\n11.5 1 2 3 0 0.6 0 0.8\n"


@pytest.mark.parametrize(
    "text", [TRAJECTORY, "# ours\n" + TRAJECTORY, TRAJECTORY.replace(" ", ",")]
)
def test_a_tum_trajectory_needs_no_header(tmp_path, text):
    """Its suffix says what its eight columns are; compressed files keep it before their own."""
    plain, packed = table(tmp_path, text, "log.tum"), tmp_path / "log.tum.gz"
    packed.write_bytes(gzip.compress(text.encode()))
    for path in (plain, packed):
        t_ns, wxyz, source, _ = read(path)
        assert (t_ns.tolist(), source.type_name) == ([10_500_000_000, 11_500_000_000], "TUM")
        assert wxyz.tolist() == [[0.8, 0.6, 0, 0], [0.8, 0, 0.6, 0]]


def test_a_tum_trajectory_of_another_name_is_read_as_one_where_the_user_says_so(tmp_path):
    """Eight numbers a row may be anything otherwise; of another width it is no trajectory."""
    path = table(tmp_path, TRAJECTORY, "log.txt")
    with pytest.raises(NoAttitudesError):
        read(path)
    with open_log(path, "tum") as log:
        assert choose_attitudes(log, AttitudeSelection()).type_name == "TUM"
    path = table(tmp_path, "1 2 3 4\n5 6 7 8\n")
    with pytest.raises(UnsupportedLogError, match="it has 4 columns, and a TUM trajectory has 8"):
        open_log(path, "tum").__enter__()


def test_numbered_columns_need_columns_and_a_layout(tmp_path):
    """Without a header nothing is guessed, one question after the other."""
    path = table(tmp_path, "10,0.6,0,0,0.8\n20,0.6,0,0,0.8\n")
    with pytest.raises(
        NoAttitudesError, match=r"no attitudes found; its columns are '0', '1', '2'"
    ):
        read(path)
    named = {"quat_cols": ("1", "2", "3", "4"), "time_col": "0", "time_unit": "us"}
    with pytest.raises(
        UndeclaredError,
        match=r"which of the columns '1', '2', '3', '4' is the scalar is not declared; say it "
        r"with from_layout='scalar-first' or 'scalar-last'",
    ):
        read(path, **named)
    t_ns, wxyz, _, _ = read(path, **named, from_layout="scalar-last")
    assert t_ns.tolist() == [10_000, 20_000]
    assert wxyz[0].tolist() == [0.8, 0.6, 0, 0]
    assert read(path, **named, from_layout="wxyz")[1][0].tolist() == [0.6, 0, 0, 0.8]


def test_components_by_number_are_only_trusted_in_known_files(tmp_path):
    """q[0] is the scalar in what ulog2csv writes, and a question anywhere else."""
    header = "timestamp,q[0],q[1],q[2],q[3]\n1,0.8,0.6,0,0\n2,0.8,0.6,0,0\n"
    assert read(table(tmp_path, header, "x_vehicle_attitude_0.csv"))[1][0, 0] == 0.8
    with pytest.raises(NoAttitudesError, match=r"quat_cols"):
        read(table(tmp_path, header, "other.csv"))


def test_an_option_that_contradicts_the_names_is_refused(tmp_path):
    """Columns in the order w, x, y, z are not scalar-last, whatever the option says."""
    path = table(tmp_path, "t_ns,qw,qx,qy,qz\n1,1,0,0,0\n2,1,0,0,0\n")
    with pytest.raises(
        UsageError,
        match=r"from_layout says scalar-last, but the columns 'qw', 'qx', 'qy', 'qz' are "
        r"scalar-first by name; leave it out$",
    ):
        read(path, from_layout="xyzw")
    with pytest.raises(
        UsageError, match=r"from_layout says scalar-last, but .* are scalar-first by name; leave"
    ):
        read(path, quat_cols=("qw", "qx", "qy", "qz"), from_layout="xyzw")


def test_several_quaternions_are_refused(tmp_path):
    """Two complete sets of columns are ambiguous until one is named."""
    path = table(
        tmp_path,
        "t_ns,a.qw,a.qx,a.qy,a.qz,b.qw,b.qx,b.qy,b.qz\n1,1,0,0,0,0,1,0,0\n2,1,0,0,0,0,1,0,0\n",
    )
    with pytest.raises(
        UndeclaredError, match=r"which quaternion to use \(their scalar columns are 'a.qw', 'b.qw'"
    ):
        read(path)
    assert read(path, quat_cols=("b.qw", "b.qx", "b.qy", "b.qz"))[1][0].tolist() == [0, 1, 0, 0]


def test_the_same_quaternion_names_twice_are_refused(tmp_path):
    """Their numbers settle which is meant."""
    path = table(tmp_path, "t_ns,qw,qx,qy,qz,qw,qx,qy,qz\n1,1,0,0,0,0,1,0,0\n2,1,0,0,0,0,1,0,0\n")
    with pytest.raises(UndeclaredError, match=r"which quaternion .*1-2-3-4, 5-6-7-8.*quat_cols="):
        read(path)
    assert read(path, quat_cols=("5", "6", "7", "8"))[1][0].tolist() == [0, 1, 0, 0]


def test_rows_that_are_no_rotations_are_located_and_counted(tmp_path):
    """All of them are counted before the series is refused, the first is named."""
    path = table(
        tmp_path,
        "t_ns,qw,qx,qy,qz\n1,1,0,0,0\n2,0,0,0,0\n3,2,0,0,0\n4,nan,0,0,0\n5,0,0,0,0\n6,1,0,0,0\n",
    )
    with pytest.raises(
        NotRotationsError,
        match=r"4 of 6 rows are invalid quaternions \(2 all zero, 1 off unit length by up to "
        r"1, 1 absent or not finite\), the first is row 1 at 2 ns; normalize scales those of "
        r"another length, on_invalid='drop' leaves them out",
    ):
        read(path)
    t_ns, _, _, counts = read(path, drop=True)
    assert (t_ns.tolist(), counts.zero, counts.not_unit, counts.not_finite) == ([1, 6], 2, 1, 1)
    t_ns, wxyz, _, counts = read(path, drop=True, normalize=True)
    assert (t_ns.tolist(), counts.normalized) == ([1, 3, 6], 1)
    assert wxyz[1].tolist() == [1, 0, 0, 0]


def test_lengths_within_the_tolerance_pass_unchanged(tmp_path):
    """Three decimals are as good as a table may have; they are not touched."""
    path = table(tmp_path, "t_ns,qw,qx,qy,qz\n1,0.5,0.5,0.5,0.501\n2,0.708,0.707,0,0\n")
    assert read(path)[1].tolist() == [[0.5, 0.5, 0.5, 0.501], [0.708, 0.707, 0, 0]]


def test_an_absent_orientation_of_a_table_is_no_rotation(tmp_path):
    """A ROS covariance of -1 marks it, whatever stands in the quaternion."""
    names = ",".join(f"field.orientation.{part}" for part in "xyzw")
    path = table(
        tmp_path,
        f"%time,field.header.stamp,{names},field.orientation_covariance0\n"
        "1,10,0,0,0,1,0\n2,20,0,0,0,1,-1\n",
    )
    t_ns, _, _, counts = read(path, drop=True)
    assert (t_ns.tolist(), counts.not_finite) == ([10], 1)


# Messages made up.


def ros2(path, topics, types=STORE):
    """Write a ROS 2 bag: topic -> (type, messages); messages are logged a second apart."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, (kind, messages) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=types)
            for k, message in enumerate(messages):
                data = types.serialize_cdr(message, kind)
                writer.write(connection, (k + 1) * 10**9, data)
    return path


def header(stamp_ns, frame="map", types=STORE):
    """Return a header."""
    time = types.types["builtin_interfaces/msg/Time"]
    return types.types["std_msgs/msg/Header"](
        stamp=time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9), frame_id=frame
    )


def quaternion(w, x, y, z):
    """Return a quaternion message."""
    return STORE.types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)


def imu(stamp_ns, wxyz, covariance=0.0, rate=(0.0, 0.0, 0.1)):
    """Return an Imu message."""
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    return STORE.types["sensor_msgs/msg/Imu"](
        header=header(stamp_ns),
        orientation=quaternion(*wxyz),
        orientation_covariance=np.array([covariance, *[0.0] * 8]),
        angular_velocity=vector(*rate),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(0.0, 0.0, 9.8),
        linear_acceleration_covariance=np.zeros(9),
    )


def test_an_absent_orientation_of_a_message_is_no_rotation(tmp_path):
    """orientation_covariance[0] of -1 says that there is none, and zeros are none either."""
    log = ros2(
        tmp_path / "bag",
        {
            "/imu": (
                "sensor_msgs/msg/Imu",
                [
                    imu(5, (0.8, 0.6, 0.0, 0.0)),
                    imu(6, (1.0, 0.0, 0.0, 0.0), -1.0),
                    imu(7, (0.0, 0.0, 0.0, 0.0)),
                ],
            )
        },
    )
    t_ns, wxyz, _, counts = read(log, drop=True)
    assert (t_ns.tolist(), counts.not_finite, counts.zero) == ([5], 1, 1)
    assert wxyz.tolist() == [[0.8, 0.6, 0, 0]]


def test_transforms_are_found_wherever_they_stand_in_their_lists(tmp_path):
    """Lists of any length, names of any length, the same pair twice in a message."""
    random = np.random.default_rng(3)
    vector = STORE.types["geometry_msgs/msg/Vector3"]

    def stamped(stamp_ns, parent, child, wxyz):
        return STORE.types["geometry_msgs/msg/TransformStamped"](
            header=header(stamp_ns, parent),
            child_frame_id=child,
            transform=STORE.types["geometry_msgs/msg/Transform"](
                translation=vector(1.0, 2.0, 3.0), rotation=quaternion(*wxyz)
            ),
        )

    names = ["", "b", "base", "base_link", "camera_optical_frame"]
    messages, expected = [], []
    stamp = 0
    for _ in range(200):
        transforms = []
        for _ in range(random.integers(0, 5)):
            parent, child = random.choice(names, 2)
            wxyz = random.normal(size=4)
            wxyz /= np.linalg.norm(wxyz)
            stamp += 10**8
            transforms.append(stamped(stamp, str(parent), str(child), wxyz.tolist()))
            if (parent, child) == ("base", "b"):
                expected.append((stamp, wxyz.tolist()))
        messages.append(STORE.types["tf2_msgs/msg/TFMessage"](transforms=transforms))
    log = ros2(tmp_path / "bag", {"/tf": ("tf2_msgs/msg/TFMessage", messages)})
    t_ns, wxyz, source, _ = read(log, frame="base:b")
    assert source.field == "base <- b"
    assert len(expected) > 5
    assert list(zip(t_ns.tolist(), wxyz.tolist(), strict=True)) == expected
    assert read(log, series="base:b")[1].tolist() == wxyz.tolist()
    assert read(log, series="base:b", frame="base:b")[1].tolist() == wxyz.tolist()
    with pytest.raises(UsageError, match="frame and series choose different transforms; give one"):
        read(log, series="base:b", frame="a")


VEHICLE_ATTITUDE = """uint64 timestamp
uint64 timestamp_sample
float32[4] q
float32[4] delta_q_reset
uint8 quat_reset_counter
"""


def test_px4_attitudes_are_scalar_first(tmp_path):
    """VehicleAttitude.q is w, x, y, z from FRD to NED, its time in us since boot."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    name = "px4_msgs/msg/VehicleAttitude"
    types.register(get_types_from_msg(VEHICLE_ATTITUDE, name))
    message = types.types[name](
        timestamp=9,
        timestamp_sample=7,
        q=np.array([0.5, -0.5, 0.5, 0.5], np.float32),
        delta_q_reset=np.zeros(4, np.float32),
        quat_reset_counter=0,
    )
    log = ros2(tmp_path / "bag", {"/fmu/out/vehicle_attitude": (name, [message])}, types)
    t_ns, wxyz, source, _ = read(log)
    assert t_ns.tolist() == [7000]
    assert wxyz.tolist() == [[0.5, -0.5, 0.5, 0.5]]
    assert (source.layout, source.remarks) == (
        "scalar-first",
        ("by its type FRD body to NED reference",),
    )
    with pytest.raises(
        UsageError,
        match=r"from_layout says scalar-last, but 'q' of 'px4_msgs/msg/VehicleAttitude' is "
        r"scalar-first by definition; leave it out",
    ):
        read(log, from_layout="scalar-last")


def test_a_field_of_an_unknown_type_can_be_named(tmp_path):
    """An array of four numbers needs a layout; a struct of w, x, y, z does not."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    name = "my_msgs/msg/Pose"
    types.register(
        get_types_from_msg(
            "std_msgs/Header header\nfloat64[4] q\ngeometry_msgs/Quaternion o\n", name
        )
    )
    message = types.types[name](
        header=header(3, types=types),
        q=np.array([0.0, 0.6, 0.0, 0.8]),
        o=types.types["geometry_msgs/msg/Quaternion"](x=0.6, y=0.0, z=0.0, w=0.8),
    )
    log = ros2(tmp_path / "bag", {"/pose": (name, [message])}, types)
    with pytest.raises(NoAttitudesError, match=r"no attitudes found; its topics are '/pose \(my_m"):
        read(log)
    assert read(log, quat_field="o")[1].tolist() == [[0.8, 0.6, 0, 0]]
    with pytest.raises(UndeclaredError, match=r"which of the columns 'q\[0\]', .* is the scalar"):
        read(log, quat_field="q")
    assert read(log, quat_field="q", from_layout="scalar-last")[1].tolist() == [[0.8, 0, 0.6, 0]]


# One attitude, for the beginning of a propagation.


def test_the_attitude_at_a_stamp_is_the_row_and_between_two_the_arc(tmp_path):
    """A quarter of the way through a turn of 90 degrees it has turned by 22.5."""
    path = table(tmp_path, f"t_ns,qw,qx,qy,qz\n100,1,0,0,0\n500,{-HALF!r},0,0,{-HALF!r}\n")
    assert attitude_at(path, 100).tolist() == [1, 0, 0, 0]
    assert attitude_at(path, 500).tolist() == [-HALF, 0, 0, -HALF]
    angle = np.radians(22.5)
    expected = [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
    assert geodesic_angle(attitude_at(path, 200), expected) < 1e-15


def test_no_attitude_is_made_up_outside_the_series(tmp_path):
    """Before the first and after the last there is none; the error says which end and where."""
    path = table(tmp_path, "t_ns,qw,qx,qy,qz\n100,1,0,0,0\n500,1,0,0,0\n")
    with pytest.raises(TimelineError, match=r"its first attitude is 1 ns after the first sample"):
        attitude_at(path, 99)
    with pytest.raises(TimelineError, match=r"its last attitude is 1 ns before the first samp"):
        attitude_at(path, 501)


def test_a_series_without_rotations_has_no_attitude(tmp_path):
    """Zeros are none."""
    path = table(tmp_path, "t_ns,qw,qx,qy,qz\n100,0,0,0,0\n500,0,0,0,0\n")
    with pytest.raises(NotRotationsError, match=r"no orientation: 2 of 2 rows .* \(2 all zero\)"):
        attitude_at(path, 100)
    path = table(tmp_path, "t_ns,qw,qx,qy,qz\n")
    with pytest.raises(NoSamplesError, match=r"no samples in 'its attitudes'"):
        attitude_at(path, 100)


def own_orientation(path, topic, t_ns=None):
    """Return the orientation beside the rates of a topic."""
    with open_log(path) as log:
        selection = RateSelection(topic=topic)
        rates = choose_rates(log, selection)
        if t_ns is None:
            t_ns = next(rates.batches()).t_ns[0]
        return first_orientation(log, rates, selection, t_ns)


def test_the_orientation_of_a_log_is_that_of_the_message_of_the_rate(shared_logs):
    """The husky's first orientation, and that at a later stamp, are those of its messages."""
    path = shared_logs / "husky" / "test1_husky.bag"
    t_ns, wxyz = by_library(path, "/imu/data", one_field("orientation"))
    assert own_orientation(path, "/imu/data").tolist() == list(wxyz[0])
    assert own_orientation(path, "/imu/data", t_ns[100]).tolist() == list(wxyz[100])


def test_the_orientation_of_a_table_is_that_of_its_rows(shared_logs):
    """A table with rates and quaternions begins with its first quaternion."""
    found = own_orientation(shared_logs / "csv" / "rostopic_echo.csv", None)
    assert found[0] == pytest.approx(0.7109, abs=1e-4)


def test_a_log_whose_orientation_is_absent_has_none(tmp_path):
    """An Imu that marks every orientation as absent is refused as a beginning."""
    message = imu(5, (1.0, 0.0, 0.0, 0.0), -1.0)
    log = ros2(tmp_path / "bag", {"/imu": ("sensor_msgs/msg/Imu", [message])})
    with pytest.raises(LogError, match=r"the orientation of '/imu' is absent or invalid through"):
        own_orientation(log, None)


def test_attitudes_of_sensor_logger_are_not_taken_for_those_of_x_io(tmp_path):
    """Its stamps are in ns, which x-io's would have to declare."""
    path = tmp_path / "WatchMotion.csv"
    header = "time,seconds_elapsed,quaternionX,quaternionY,quaternionZ,quaternionW\n"
    path.write_text(header + "".join(f"{k}0000000,{k / 100},0.6,0,0,0.8\n" for k in range(9)))
    attitudes = read_attitudes(path)
    assert attitudes.t_ns.tolist() == [k * 10**7 for k in range(9)]
    assert attitudes.wxyz[0].tolist() == [0.8, 0.6, 0, 0]


@pytest.mark.filterwarnings("ignore:.*2 samples lost by the counter:quatprop.RemarkWarning")
def test_numbered_quaternions_of_xsens_begin_with_the_scalar(tmp_path):
    """Quat_q0 is w, by its manual; the counter is the time."""
    path = tmp_path / "mt.txt"
    names = "\t".join(("PacketCounter", *(f"Quat_q{k}" for k in range(4))))
    rows = "".join(f"{k}\t0.8\t0.6\t0.0\t0.0\n" for k in (0, 1, 2, 5))
    path.write_text(f"// Update Rate: 100.0Hz\n{names}\n{rows}")
    attitudes = read_attitudes(path)
    assert attitudes.t_ns.tolist() == [0, 10**7, 2 * 10**7, 5 * 10**7]
    assert attitudes.wxyz[0].tolist() == [0.8, 0.6, 0, 0]


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_matrices_of_xsens_are_read_by_row_and_column(tmp_path):
    """Mat[2][1] is in the second row, wherever it stands."""
    path = tmp_path / "mt.txt"
    cells = {(1, 1): 1, (2, 2): 0, (2, 3): -1, (3, 2): 1, (3, 3): 0}
    names = [(row, column) for column in (1, 2, 3) for row in (1, 2, 3)]
    header = "\t".join(("PacketCounter", *(f"Mat[{row}][{column}]" for row, column in names)))
    row = "\t".join(f"{float(cells.get(name, 0))}" for name in names)
    path.write_text(f"// Update Rate: 100.0Hz\n{header}\n0\t{row}\n1\t{row}\n")
    half = 0.5**0.5
    np.testing.assert_allclose(read_attitudes(path).wxyz[0], [half, half, 0, 0], atol=1e-15)


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_angles_of_ardupilot_are_those_it_has_and_in_degrees(tmp_path):
    """DesRoll and the like are what was wanted; the unit is known by convention."""
    path = tmp_path / "att.csv"
    header = "timestamp,TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw\n"
    rows = "".join(f"{1.7e9 + k / 100},{k}0000,9,0,9,0,9,90,0,0\n" for k in range(9))
    path.write_text(header + rows)
    attitudes = read_attitudes(path)
    half = 0.5**0.5
    assert attitudes.t_ns[1] == 10**7
    np.testing.assert_allclose(attitudes.wxyz[0], [half, 0, 0, half], atol=1e-15)


def test_attitudes_of_project_aria_are_read_by_their_names(tmp_path):
    """Those of the device in the world, at the time of tracking."""
    path = tmp_path / "closed_loop_trajectory.csv"
    quaternion = ",".join(f"q{axis}_world_device" for axis in "xyzw")
    rows = "".join(f"a,{k}0000,-1,0.6,0,0,0.8\n" for k in range(9))
    path.write_text(f"graph_uid,tracking_timestamp_us,utc_timestamp_ns,{quaternion}\n{rows}")
    attitudes = read_attitudes(path)
    assert attitudes.t_ns[1] == 10**7
    assert attitudes.wxyz[0].tolist() == [0.8, 0.6, 0, 0]
