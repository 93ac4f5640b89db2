"""Which field of a message is a rate, and what its stamp is in ns."""

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from quatprop.containers.base import Channel, MessageBlock
from quatprop.errors import MessageError, SchemaError
from quatprop.messages.binary import BinaryDecoder
from quatprop.messages.message_types import MESSAGE_TYPES, RateField, SignalFields
from quatprop.messages.signal_fields import rate_field_at, rate_fields, signal_fields
from quatprop.messages.stamps import Stamp, time_field_at

HEADER = Stamp(("header.stamp.sec", "header.stamp.nanosec"), "s")


def channel_of(text, name="pkg/msg/T", encoding="cdr"):
    """Return a channel with a definition."""
    grammar = "ros1msg" if encoding == "ros1" else "ros2msg"
    return Channel("/t", name, encoding, grammar, text.encode())


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_an_Imu_is_a_rate_with_its_stamp_and_its_mark_of_absence(encoding):
    """The standard type is known without a definition."""
    (fields,) = signal_fields(Channel("/imu", "sensor_msgs/msg/Imu", encoding), "log", "rate")
    field = fields.rate
    assert field.fields == ("angular_velocity",)
    assert field.unit == "rad/s"
    assert field.stamps[0] == HEADER
    assert field.absent == "angular_velocity_covariance[0]"
    assert field.measured
    assert fields.orientation.name == "orientation"
    assert fields.orientation.absent == "orientation_covariance[0]"
    assert fields.acceleration == ("linear_acceleration", "linear_acceleration_covariance[0]")


def test_every_row_of_the_table_fits_the_standard_type_of_its_name():
    """The paths are those of the definitions, as far as these are at hand."""
    known = [name for name in MESSAGE_TYPES if name in get_typestore(Stores.LATEST).fielddefs]
    assert len(known) == 8
    for name in known:
        channel, row = Channel("/t", name, "cdr"), MESSAGE_TYPES[name]
        kind = "rate" if row.rate else "orientation"
        (fields,) = signal_fields(channel, "log", kind)
        paths = []
        if row.rate:
            assert fields.rate._replace(stamps=()) == row.rate
            paths += [*fields.rate.fields, fields.rate.absent, *fields.rate.stamps[0].fields]
        if row.orientation:
            assert fields.orientation._replace(stamps=(), fields=()) == row.orientation
            paths += [*fields.orientation.fields, fields.orientation.absent]
            paths += fields.orientation.stamps[0].fields
        assert fields.acceleration == row.acceleration
        paths = [path for path in (*paths, *(row.acceleration or ())) if path]
        columns = BinaryDecoder(channel, paths, "log").columns(
            MessageBlock(np.zeros(0, np.uint8), *[np.zeros(0, np.int64)] * 4)
        )
        assert columns[0].shape == ((0, 3) if row.rate else (0,))


def test_a_gyroscope_of_PX4_has_its_rate_in_three_numbers_and_its_stamp_in_us():
    """Three neighbouring numbers are as good as a vector."""
    text = "uint64 timestamp\nuint64 timestamp_sample\nuint32 id\nfloat32 x\nfloat32 y\nfloat32 z\n"
    (field,) = rate_fields(channel_of(text, "px4_msgs/msg/SensorGyro"), "log")
    assert field.fields == ("x", "y", "z")
    assert field.stamps[0] == Stamp(("timestamp_sample",), "us")
    assert field.name == "x,y,z"


def test_an_Imu_inside_another_message_is_found_with_its_own_header():
    """The prefix goes before every path."""
    (field,) = rate_fields(channel_of("std_msgs/Header header\nsensor_msgs/Imu imu\n"), "log")
    assert field.fields == ("imu.angular_velocity",)
    assert field.absent == "imu.angular_velocity_covariance[0]"
    assert field.stamps[0] == Stamp(("imu.header.stamp.sec", "imu.header.stamp.nanosec"), "s")


def test_an_Imu_without_a_header_takes_the_one_around_it():
    """An older or leaner type of the same name may lack the stamp and the covariance."""
    text = (
        "std_msgs/Header header\nsensor_msgs/Imu imu\n" + "=" * 80 + "\nMSG: sensor_msgs/Imu\n"
        "geometry_msgs/Vector3 angular_velocity\n"
    )
    (fields,) = signal_fields(channel_of(text), "log", "rate")
    assert fields.rate.stamps[0] == HEADER
    assert fields.rate.absent is None
    assert fields.orientation is None


def test_several_Imus_in_a_message_are_several_rates():
    """Fields and elements of fixed arrays count, elements of sequences do not."""
    text = "sensor_msgs/Imu[2] pair\nsensor_msgs/Imu third\nsensor_msgs/Imu[] more\n"
    found = rate_fields(channel_of(text), "log")
    assert [field.name for field in found] == [
        "third.angular_velocity",
        "pair[0].angular_velocity",
        "pair[1].angular_velocity",
    ]


def test_velocities_of_an_odometry_are_not_called_measured():
    """An estimate or a command is no gyroscope."""
    channel = Channel("/odom", "nav_msgs/msg/Odometry", "cdr")
    (fields,) = signal_fields(channel, "log", "rate")
    assert fields.rate.fields == ("twist.twist.angular",)
    assert fields.orientation.name == "pose.pose.orientation"
    assert not fields.rate.measured


@pytest.mark.parametrize(
    "channel",
    [
        Channel("/t", "std_msgs/msg/String", "cdr"),
        Channel("/t", "sensor_msgs/msg/Imu", "json", "jsonschema", b"{}"),
        Channel("/t", "pkg/msg/T", "cdr", "ros2msg", b"Imu }{"),
        Channel("/t", "pkg/msg/T", "cdr", "ros2msg", b"float64 Immune\n"),
    ],
    ids=["other type", "other encoding", "unreadable", "other field"],
)
def test_other_messages_carry_no_rates(channel):
    """A search passes over what it cannot use."""
    assert rate_fields(channel, "log") == []


def test_an_unreadable_definition_of_a_known_type_is_an_error():
    """Passing over it would hide the rates the log has."""
    channel = Channel("/imu", "sensor_msgs/msg/Imu", "cdr", "ros2msg", b"}{")
    with pytest.raises(SchemaError, match=r"cannot be parsed as ros2msg$"):
        rate_fields(channel, "log")


def test_a_named_field_that_is_a_known_rate_keeps_all_that_is_known_of_it():
    """Naming the field does not lose its unit, stamp and mark of absence."""
    channel = channel_of("sensor_msgs/Imu imu\n")
    assert rate_field_at(channel, "imu.angular_velocity", "log") == rate_fields(channel, "log")[0]


def test_any_three_numbers_can_be_named_and_take_the_nearest_stamp():
    """The unit is then for the user to say."""
    channel = channel_of(
        "std_msgs/Header header\nfloat32[3] gyro\nfloat64 a\nfloat64 b\nfloat64 c\n"
    )
    for name, rate in (("gyro", ("gyro",)), ("c, a,b", ("c", "a", "b"))):
        field = rate_field_at(channel, name, "log")
        assert field.fields == rate
        assert field.unit is None
        assert field.stamps[0] == HEADER


def test_a_stamped_vector_is_a_rate_only_if_the_options_say_so():
    """It may be anything; so its unit is for the user to say, too."""
    channel = Channel("/gyro", "geometry_msgs/msg/Vector3Stamped", "cdr")
    assert rate_fields(channel, "log") == []
    field = rate_field_at(channel, "vector", "log")
    assert field.fields == ("vector",)
    assert field.unit is None
    assert field.stamps[0] == HEADER


def test_an_odometry_of_foxglove_in_ROS_2_is_known():
    """Its stamp is no header."""
    text = "builtin_interfaces/Time timestamp\ngeometry_msgs/Vector3 angular_velocity\n"
    (fields,) = signal_fields(channel_of(text, "foxglove_msgs/msg/Odometry"), "log", "rate")
    assert fields.rate.fields == ("angular_velocity",)
    assert fields.rate.stamps[0] == Stamp(("timestamp.sec", "timestamp.nanosec"), "s")
    assert fields.orientation is None
    assert not fields.rate.measured


def test_a_named_field_that_is_elsewhere_is_no_error():
    """Another topic may have it."""
    assert rate_field_at(channel_of("float64 x\n"), "gyro", "log") is None


def test_a_named_field_that_is_not_three_numbers_is_an_error():
    """The sentence says what a rate field is."""
    with pytest.raises(
        SchemaError,
        match=r"^log: field 'q' of 'pkg/msg/T' is not three numbers; "
        r"name a field of x, y, z or three numbers as a,b,c$",
    ):
        rate_field_at(channel_of("float64[4] q\n"), "q", "log")


def test_time_fields_are_times_or_numbers_with_a_unit():
    """A time says its unit itself; a number needs one."""
    channel = channel_of("builtin_interfaces/Time t\nuint64 us\nstring s\n")
    assert time_field_at(channel, "t", None, "log") == Stamp(("t.sec", "t.nanosec"), "s")
    assert time_field_at(channel, "us", "us", "log") == Stamp(("us",), "us")
    assert time_field_at(channel, "us", None, "log") is None
    with pytest.raises(SchemaError, match=r"^log: field 's' of 'pkg/msg/T' is not a time; "):
        time_field_at(channel, "s", "s", "log")


@pytest.mark.parametrize(
    ("stamp", "columns", "t_ns"),
    [
        (HEADER, [np.array([1], np.int32), np.array([5], np.uint32)], 1_000_000_005),
        (HEADER, [np.array([-1], np.int32), np.array([5], np.uint32)], -999_999_995),
        (HEADER, [np.array([2**32 - 1], np.uint32), np.array([7], np.uint32)],
         4_294_967_295_000_000_007),
        (HEADER, [np.array([1]), np.array([1_500_000_000], np.uint64)], 2_500_000_000),
        (Stamp(("t",), "us"), [np.array([1_700_000_000_123_457], np.uint64)],
         1_700_000_000_123_457_000),
        (Stamp(("t",), "ns"), [np.array([2**63 - 2], np.uint64)], 2**63 - 2),
        (Stamp(("t",), "s"), [np.array([1_700_000_000.25])], 1_700_000_000_250_000_000),
        (Stamp(("t",), "s"), [np.array([-0.5])], -500_000_000),
    ],
)  # fmt: skip
def test_stamps_are_exact_nanoseconds(stamp, columns, t_ns):
    """No stamp goes through a float, unless it was one."""
    result = stamp.ns(columns, "log")
    assert result.dtype == np.int64
    assert result.tolist() == [t_ns]


@pytest.mark.parametrize(
    ("unit", "column"),
    [
        ("s", np.array([0.0, np.nan])),
        ("s", np.array([0.0, np.inf])),
        ("ns", np.array([0.0, 2.0**63])),
        ("us", np.array([0, 2**63], np.uint64)),
        ("s", np.array([0, -(2**62)], np.int64)),
    ],
)
def test_stamps_that_do_not_fit_are_reported_with_their_place(unit, column):
    """A stamp never wraps round."""
    with pytest.raises(MessageError, match="does not fit in 64 bits of nanoseconds") as caught:
        Stamp(("t",), unit).ns([column], "log")
    assert caught.value.positions == (1,)


@pytest.mark.parametrize(
    "name",
    [
        "auk/auk.bag",
        "auk/auk_mcap_zstd",
        "husky/test1_husky.bag",
        "irregular/tilt_laser.bag",
        "two_imus/test1_2014_xsens.bag",
        "nested_imu/kiran_11sec_motion",
        "rosbag2/geocam_all_types",
        "rosbag2/plotjuggler_rosbag2_test",
    ],
)
def test_real_recordings_give_what_the_library_decodes(shared_logs, name):
    """Rates and stamps of every known topic, message for message."""
    seen = 0
    store = get_typestore(Stores.LATEST)
    with AnyReader([shared_logs / name], default_typestore=store) as reader:
        for connection in reader.connections:
            channel = _channel(reader, connection)
            raw = [bytes(message) for _, _, message in reader.messages([connection])][:300]
            for field in rate_fields(channel, name) if raw else ():
                decoder = BinaryDecoder(channel, [*field.fields, *field.stamps[0].fields], name)
                rate, *stamp = decoder.columns(_block(raw))
                t_ns = field.stamps[0].ns(stamp, name)
                for position, message in enumerate(raw):
                    decoded = reader.deserialize(message, connection.msgtype)
                    vector = _attribute(decoded, field.fields[0])
                    time = _attribute(decoded, field.stamps[0].fields[0].removesuffix(".sec"))
                    assert rate[position].tolist() == [vector.x, vector.y, vector.z]
                    assert t_ns[position] == time.sec * 10**9 + time.nanosec
                seen += len(raw)
    assert seen


def _channel(reader, connection):
    encoding, grammar = ("cdr", "ros2msg") if reader.is2 else ("ros1", "ros1msg")
    text = connection.msgdef.data
    return Channel(
        connection.topic, connection.msgtype, encoding, grammar if text else "", text.encode()
    )


def _block(raw):
    ends = np.cumsum([len(message) for message in raw])
    starts = ends - [len(message) for message in raw]
    return MessageBlock(np.frombuffer(b"".join(raw), np.uint8), starts, ends, starts, starts)


def _attribute(value, path):
    for name in path.split("."):
        value = getattr(value, name)
    return value


def test_what_is_inside_a_known_type_is_its_own_affair(monkeypatch):
    """Of known types within one another the outermost counts, and those beside it."""
    line = "=" * 80
    text = (
        f"pkg/msg/Outer first\npkg/msg/Inner second\n{line}\nMSG: pkg/msg/Outer\n"
        f"float64[3] w\npkg/msg/Inner within\n{line}\nMSG: pkg/msg/Inner\nfloat64[3] w\n"
    )
    row = SignalFields(rate=RateField(("w",)))
    rows = {"pkg/msg/Outer": row, "pkg/msg/Inner": row}
    monkeypatch.setattr("quatprop.messages.message_types.MESSAGE_TYPES", rows)
    monkeypatch.setattr("quatprop.messages.signal_fields.MESSAGE_TYPES", rows)
    found = rate_fields(channel_of(text, "pkg/msg/Both"), "log")
    assert [field.name for field in found] == ["first.w", "second.w"]
