"""Which field of a message is a rate, and what its stamp is in ns."""

from types import SimpleNamespace

import numpy as np
import pytest
from make.reading import found_in, mark, names, stamps
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from quatprop.containers.topic_table import TopicTable
from quatprop.errors import MessageError, SchemaError, UndeclaredError
from quatprop.logs.clocks.stamps import message_stamp, place_of, stamps_of
from quatprop.logs.matching.matcher import ColumnMatcher
from quatprop.logs.vocabulary.rows import Row
from quatprop.logs.vocabulary.sources import ROWS, TYPES
from quatprop.messages.blocks import Channel, MessageBlock
from quatprop.messages.times import to_ns
from quatprop.settings.selection import RateSelection

HEADER = (["header.stamp.sec", "header.stamp.nanosec"], ("s", "ns"))


def channel_of(text, name="pkg/msg/T", encoding="cdr"):
    """Return a channel with a definition."""
    grammar = "ros1msg" if encoding == "ros1" else "ros2msg"
    return Channel("/t", name, encoding, grammar, text.encode())


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_an_Imu_is_a_rate_with_its_stamp_and_its_mark_of_absence(encoding):
    """The standard type is known without a definition."""
    channel = Channel("/imu", "sensor_msgs/msg/Imu", encoding)
    (rate,), (quat,), (force,) = (found_in(channel, one) for one in ("rate", "quat", "force"))
    assert rate.field == "angular_velocity"
    assert names(rate, rate.sets[0]) == [f"angular_velocity.{axis}" for axis in "xyz"]
    assert (rate.row.unit, rate.row.measured) == ("rad/s", True)
    assert stamps(rate)[0] == HEADER
    assert mark(rate) == "angular_velocity_covariance[0]"
    assert quat.field == "orientation"
    assert mark(quat) == "orientation_covariance[0]"
    assert (force.field, mark(force)) == (
        "linear_acceleration",
        "linear_acceleration_covariance[0]",
    )


def test_every_row_of_the_table_fits_the_standard_type_of_its_name():
    """The names are those of the definitions, as far as these are at hand."""
    known = [name for name in TYPES if name in get_typestore(Stores.LATEST).fielddefs]
    assert len(known) == 9
    for name in known:
        channel, row = Channel("/t", name, "cdr"), TYPES[name]
        for quantity in ("rate", "quat", "bias", "force"):
            found = found_in(channel, quantity)
            assert len(found) == bool(getattr(row, quantity))
            for one in found:
                assert stamps(one)[0] == HEADER


def test_no_type_has_two_rows():
    """Which of them counts would depend on their order."""
    assert len(TYPES) == sum(len(row.types) for row in ROWS)


def test_a_gyroscope_of_PX4_has_its_rate_in_three_numbers_and_its_stamp_in_us():
    """Three neighbouring numbers are as good as a vector."""
    text = "uint64 timestamp\nuint64 timestamp_sample\nuint32 id\nfloat32 x\nfloat32 y\nfloat32 z\n"
    (found,) = found_in(channel_of(text, "px4_msgs/msg/SensorGyro"))
    assert names(found, found.sets[0]) == ["x", "y", "z"]
    assert stamps(found)[0] == (["timestamp_sample"], ("us",))
    assert found.field == "x,y,z"


def test_an_Imu_inside_another_message_is_found_with_its_own_header():
    """The prefix goes before every path."""
    (found,) = found_in(channel_of("std_msgs/Header header\nsensor_msgs/Imu imu\n"))
    assert found.field == "imu.angular_velocity"
    assert mark(found) == "imu.angular_velocity_covariance[0]"
    assert stamps(found)[0][0] == ["imu.header.stamp.sec", "imu.header.stamp.nanosec"]


def test_an_Imu_without_a_header_takes_the_one_around_it():
    """An older or leaner type of the same name may lack the stamp and the covariance."""
    text = (
        "std_msgs/Header header\nsensor_msgs/Imu imu\n" + "=" * 80 + "\nMSG: sensor_msgs/Imu\n"
        "geometry_msgs/Vector3 angular_velocity\n"
    )
    (found,) = found_in(channel_of(text))
    assert stamps(found)[0] == HEADER
    assert mark(found) is None
    assert found_in(channel_of(text), "quat") == []


def test_several_Imus_in_a_message_are_several_rates():
    """Fields and elements of fixed arrays count, elements of sequences do not."""
    text = "sensor_msgs/Imu[2] pair\nsensor_msgs/Imu third\nsensor_msgs/Imu[] more\n"
    assert [found.field for found in found_in(channel_of(text))] == [
        "third.angular_velocity",
        "pair[0].angular_velocity",
        "pair[1].angular_velocity",
    ]


def test_velocities_of_an_odometry_are_not_called_measured():
    """An estimate or a command is no gyroscope."""
    channel = Channel("/odom", "nav_msgs/msg/Odometry", "cdr")
    (rate,), (quat,) = found_in(channel), found_in(channel, "quat")
    assert rate.field == "twist.twist.angular"
    assert quat.field == "pose.pose.orientation"
    assert not rate.row.measured


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
    assert found_in(channel) == []


def test_an_unreadable_definition_of_a_known_type_is_an_error():
    """Passing over it would hide the rates the log has."""
    channel = Channel("/imu", "sensor_msgs/msg/Imu", "cdr", "ros2msg", b"}{")
    with pytest.raises(SchemaError, match=r"cannot be parsed as ros2msg$"):
        found_in(channel)


def test_a_named_field_that_is_a_known_rate_keeps_all_that_is_known_of_it():
    """Naming the field does not lose its unit, stamp and mark of absence."""
    channel = channel_of("sensor_msgs/Imu imu\n")
    (named,), (found,) = found_in(channel, field="imu.angular_velocity"), found_in(channel)
    assert named[1:] == found[1:]


def test_any_three_numbers_can_be_named_and_take_the_nearest_stamp():
    """The unit is then for the user to say."""
    channel = channel_of(
        "std_msgs/Header header\nfloat32[3] gyro\nfloat64 a\nfloat64 b\nfloat64 c\n"
    )
    for name, rate in (("gyro", [f"gyro[{k}]" for k in range(3)]), ("c, a,b", ["c", "a", "b"])):
        (found,) = found_in(channel, field=name)
        assert names(found, found.sets[0]) == rate
        assert found.row.unit == ""
        assert stamps(found)[0] == HEADER


def test_a_stamped_vector_is_a_rate_only_if_the_options_say_so():
    """It may be anything; so its unit is for the user to say, too."""
    channel = Channel("/gyro", "geometry_msgs/msg/Vector3Stamped", "cdr")
    assert found_in(channel) == []
    (found,) = found_in(channel, field="vector")
    assert found.field == "vector"
    assert found.row.unit == ""
    assert stamps(found)[0] == HEADER


def test_an_odometry_of_foxglove_in_ROS_2_is_known():
    """Its stamp is no header."""
    text = "builtin_interfaces/Time timestamp\ngeometry_msgs/Vector3 angular_velocity\n"
    (found,) = found_in(channel_of(text, "foxglove_msgs/msg/Odometry"))
    assert found.field == "angular_velocity"
    assert stamps(found)[0] == (["timestamp.sec", "timestamp.nanosec"], ("s", "ns"))
    assert not found.row.measured


def test_a_named_field_that_is_elsewhere_is_no_error():
    """Another topic may have it."""
    assert found_in(channel_of("float64 x\n"), field="gyro") == []


def test_a_named_field_that_is_not_three_numbers_is_an_error():
    """The sentence says what a rate field is."""
    with pytest.raises(
        SchemaError,
        match=r"^log: field 'q' of 'pkg/msg/T' is not three numbers; "
        r"name a field of x, y, z or three numbers as a,b,c$",
    ):
        found_in(channel_of("float64[4] q\n"), field="q")


def test_time_fields_are_times_or_numbers_with_a_unit():
    """A time says its unit itself; a number needs one."""
    channel = channel_of("builtin_interfaces/Time t\nuint64 us\nstring s\nfloat64[3] w\n")
    (found,) = found_in(channel, field="w")
    log = SimpleNamespace(
        path="log", kind="mcap", has_publish_time=False, kept=None, blocks=lambda _: []
    )
    found = found._replace(table=TopicTable(log, channel))

    def chosen(**named):
        matcher = ColumnMatcher(found, RateSelection(**named), "rate_field")
        stamp = message_stamp(matcher, found)
        assert matcher.remarks == []
        return names(found, stamp.columns), stamp.units

    assert chosen(time_field="t") == (["t.sec", "t.nanosec"], ("s", "ns"))
    assert chosen(time_field="us", time_unit="us") == (["us"], ("us",))
    with pytest.raises(UndeclaredError, match=r"^log: the unit of the time in field 'us' is not "):
        chosen(time_field="us")
    with pytest.raises(SchemaError, match=r"^log: field 's' of 'pkg/msg/T' is not a time; "):
        chosen(time_field="s", time_unit="s")


@pytest.mark.parametrize(
    ("units", "columns", "t_ns"),
    [
        ("s ns", [np.array([1], np.int32), np.array([5], np.uint32)], 1_000_000_005),
        ("s ns", [np.array([-1], np.int32), np.array([5], np.uint32)], -999_999_995),
        ("s ns", [np.array([2**32 - 1], np.uint32), np.array([7], np.uint32)],
         4_294_967_295_000_000_007),
        ("s ns", [np.array([1]), np.array([1_500_000_000], np.uint64)], 2_500_000_000),
        ("us", [np.array([1_700_000_000_123_457], np.uint64)],
         1_700_000_000_123_457_000),
        ("ns", [np.array([2**63 - 2], np.uint64)], 2**63 - 2),
        ("s", [np.array([1_700_000_000.25])], 1_700_000_000_250_000_000),
        ("s", [np.array([-0.5])], -500_000_000),
    ],
)  # fmt: skip
def test_stamps_are_exact_nanoseconds(units, columns, t_ns):
    """No stamp goes through a float, unless it was one."""
    result = to_ns(columns, units.split(), ["t"], "log")
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
        to_ns([column], [unit], ["t"], "log")
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
            for found in found_in(channel) if raw else ():
                stamp = stamps_of(found)[0]
                t_ns, rate = found.table.decoder([stamp], found.sets)([_block(raw)]).values
                for position, message in enumerate(raw):
                    decoded = reader.deserialize(message, connection.msgtype)
                    vector = _attribute(decoded, found.field)
                    time = _attribute(decoded, place_of(found.table, stamp))
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
    for name in ("pkg/msg/Outer", "pkg/msg/Inner"):
        monkeypatch.setitem(TYPES, name, Row((name,), rate=r"w\[(?P<part>[012])\]"))
    found = found_in(channel_of(text, "pkg/msg/Both"))
    assert [one.field for one in found] == ["first.w", "second.w"]
