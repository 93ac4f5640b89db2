"""Which field of a message is a rate, and what its stamp is in ns."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from make.protobuf import DOUBLE, FLOAT, described, file_of
from make.reading import found_in, mark, names, stamps
from rosbags.typesys import Stores, get_typestore

from quatprop import read_rates
from quatprop.base.errors import MessageError, SchemaError, UndeclaredError
from quatprop.readers.containers.topic_table import TopicTable
from quatprop.readers.matching import ColumnMatcher
from quatprop.readers.messages.blocks import Channel, to_ns
from quatprop.readers.row_stamps import message_stamp
from quatprop.readers.vocabulary import TYPES, Row
from quatprop.settings.reading import RateSelection

HEADER = (["header.stamp.sec", "header.stamp.nanosec"], ("s", "ns"))
LINE = "=" * 80


def channel_of(text, name="pkg/msg/T", encoding="cdr"):
    """Return a channel with a definition."""
    grammar = "ros1msg" if encoding == "ros1" else "ros2msg"
    return Channel("/t", name, encoding, grammar, text.encode())


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_an_Imu_is_a_rate_with_its_stamp_and_its_mark_of_absence(encoding):
    """The standard type is known without a definition."""
    channel = Channel("/imu", "sensor_msgs/msg/Imu", encoding)
    fields = {"rate": "angular_velocity", "quat": "orientation", "force": "linear_acceleration"}
    for quantity, field in fields.items():
        (found,) = found_in(channel, quantity)
        assert (found.field, mark(found)) == (field, f"{field}_covariance[0]")
        assert stamps(found)[0] == HEADER
    (rate,) = found_in(channel)
    assert names(rate, rate.sets[0]) == [f"angular_velocity.{axis}" for axis in "xyz"]
    assert (rate.row.unit, rate.row.measured) == ("rad/s", True)


def test_every_row_of_the_table_fits_the_standard_type_of_its_name():
    """The names are those of the definitions, as far as these are at hand."""
    known = [name for name in TYPES if name in get_typestore(Stores.LATEST).fielddefs]
    assert len(known) == 9
    for name in known:
        for quantity in ("rate", "quat", "bias", "force"):
            found = found_in(Channel("/t", name, "cdr"), quantity)
            assert len(found) == bool(getattr(TYPES[name], quantity))
            assert all(stamps(one)[0] == HEADER for one in found)


def time_in(place):
    """Return names and units of a time of ROS."""
    return [f"{place}.sec", f"{place}.nanosec"], ("s", "ns")


GYRO = "uint64 timestamp\nuint64 timestamp_sample\nuint32 id\nfloat32 x\nfloat32 y\nfloat32 z\n"
SEVERAL = "sensor_msgs/Imu[2] pair\nsensor_msgs/Imu third\nsensor_msgs/Imu[] more\n"
ODOMETRY = "builtin_interfaces/Time timestamp\ngeometry_msgs/Vector3 angular_velocity\n"
LEAN = (
    f"std_msgs/Header header\nsensor_msgs/Imu imu\n{LINE}\nMSG: sensor_msgs/Imu\n"
    "geometry_msgs/Vector3 angular_velocity\n"
)


@pytest.mark.parametrize(
    ("channel", "fields", "stamp"),
    [
        # Three neighbouring numbers are as good as a vector.
        (channel_of(GYRO, "px4_msgs/msg/SensorGyro"), ["x,y,z"], (["timestamp_sample"], ("us",))),
        # An Imu inside of another message has its own header; one without takes that around it.
        (
            channel_of("std_msgs/Header header\nsensor_msgs/Imu imu\n"),
            ["imu.angular_velocity"],
            time_in("imu.header.stamp"),
        ),
        (channel_of(LEAN), ["imu.angular_velocity"], HEADER),
        # Fields and elements of fixed arrays count, elements of sequences do not.
        (
            channel_of(SEVERAL),
            [f"{one}.angular_velocity" for one in ("third", "pair[0]", "pair[1]")],
            time_in("third.header.stamp"),
        ),
        # An estimate or a command is no gyroscope.
        (Channel("/odom", "nav_msgs/msg/Odometry", "cdr"), ["twist.twist.angular"], HEADER),
        (
            channel_of(ODOMETRY, "foxglove_msgs/msg/Odometry"),
            ["angular_velocity"],
            time_in("timestamp"),
        ),
    ],
)
def test_rates_are_found_by_the_types_of_fields(channel, fields, stamp):
    """With the nearest stamp, and whether they are measured."""
    found = found_in(channel)
    assert [one.field for one in found] == fields
    assert stamps(found[0])[0] == stamp
    assert found[0].row.measured == ("dometry" not in channel.type_name)
    is_whole_imu = b"Imu" in channel.schema and channel.schema != LEAN.encode()
    assert mark(found[0]) == (f"{fields[0]}_covariance[0]" if is_whole_imu else None)
    assert bool(found_in(channel, "quat")) == (is_whole_imu or channel.topic == "/odom")


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


THREE = "std_msgs/Header header\nfloat32[3] gyro\nfloat64 a\nfloat64 b\nfloat64 c\n"


@pytest.mark.parametrize(
    ("channel", "field", "columns"),
    [
        (channel_of(THREE), "gyro", [f"gyro[{k}]" for k in range(3)]),
        (channel_of(THREE), "c, a,b", ["c", "a", "b"]),
        # A stamped vector may be anything.
        (
            Channel("/gyro", "geometry_msgs/msg/Vector3Stamped", "cdr"),
            "vector",
            [f"vector.{axis}" for axis in "xyz"],
        ),
    ],
)
def test_any_three_numbers_can_be_named_and_take_the_nearest_stamp(channel, field, columns):
    """The unit is then for the user to say."""
    assert found_in(channel) == []
    (found,) = found_in(channel, field=field)
    assert names(found, found.sets[0]) == columns
    assert (found.row.unit, stamps(found)[0]) == ("", HEADER)


def test_what_is_named_is_found_or_refused_or_elsewhere():
    """A known rate keeps its unit, stamp and mark; another topic may have what is not there."""
    channel = channel_of("sensor_msgs/Imu imu\n")
    (named,), (found,) = found_in(channel, field="imu.angular_velocity"), found_in(channel)
    assert named[1:] == found[1:]
    for elsewhere in (channel_of("float64 x\n"), Channel("/camera", "pkg/msg/T", "jpeg")):
        assert found_in(elsewhere, field="gyro") == []
    with pytest.raises(
        SchemaError,
        match=r"^log: field 'q' of 'pkg/msg/T' is not three numbers; "
        r"name a field of x, y, z or three numbers as a,b,c$",
    ):
        found_in(channel_of("float64[4] q\n"), field="q")


A_LIST = (
    "it is a list of any length, which is not read from such messages; record an array of fixed "
    "length, or write the messages as JSON lines, of which lists are read"
)


@pytest.mark.parametrize("encoding", ["cdr", "ros1", "protobuf"])
def test_a_list_of_numbers_is_refused_as_one_with_what_is_read_instead(tmp_path, encoding):
    """The error was that it is not three numbers, although it has three in every message."""
    gyro = file_of("pkg", {"T": {"t": DOUBLE, "w*": FLOAT}})
    proto = Channel("/t", "pkg.T", "protobuf", "protobuf", described(gyro))
    text = "float64 t\nfloat32[] w\n"
    channel = proto if encoding == "protobuf" else channel_of(text, encoding=encoding)
    name = channel.type_name
    for quantity in ("rate", "quat"):
        with pytest.raises(SchemaError) as caught:
            found_in(channel, quantity, field="w")
        assert str(caught.value) == f"log: field 'w' of '{name}' cannot be used: {A_LIST}"
    with pytest.raises(SchemaError) as caught:
        TopicTable(
            SimpleNamespace(path="log", kind="mcap", has_publish_time=False), channel
        ).refuse_unknown("w[0]")
    assert str(caught.value) == f"log: '{name}' has no field 'w[0]' in every message: {A_LIST}"
    path = tmp_path / "log.jsonl"
    rows = [{"t": k / 100, "w": [0.1 * k, 0.5, -0.25]} for k in range(30)]
    path.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    series = read_rates(path, rate_cols="w[0],w[1],w[2]", rate_unit="rad/s", time_unit="s")
    np.testing.assert_array_equal(series.rate, [row["w"] for row in rows])


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
    ("parts", "t_ns"),
    [
        ([("s", "i4", 1), ("ns", "u4", 5)], 1_000_000_005),
        ([("s", "i4", -1), ("ns", "u4", 5)], -999_999_995),
        ([("s", "u4", 2**32 - 1), ("ns", "u4", 7)], 4_294_967_295_000_000_007),
        ([("s", "i8", 1), ("ns", "u8", 1_500_000_000)], 2_500_000_000),
        ([("us", "u8", 1_700_000_000_123_457)], 1_700_000_000_123_457_000),
        ([("ns", "u8", 2**63 - 2)], 2**63 - 2),
        ([("s", "f8", 1_700_000_000.25)], 1_700_000_000_250_000_000),
        ([("s", "f8", -0.5)], -500_000_000),
        ([("s", "f8", np.nan)], None),
        ([("s", "f8", np.inf)], None),
        ([("ns", "f8", 2.0**63)], None),
        ([("us", "u8", 2**63)], None),
        ([("s", "i8", -(2**62))], None),
    ],
)
def test_stamps_are_exact_nanoseconds_or_refused(parts, t_ns):
    """No stamp goes through a float, unless it was one; none wraps round."""
    columns = [np.array([0, value], kind) for _, kind, value in parts]
    units = [unit for unit, *_ in parts]
    if t_ns is not None:
        result = to_ns(columns, units, ["t"], "log")
        assert (result.dtype, result.tolist()) == (np.int64, [0, t_ns])
        return
    with pytest.raises(MessageError, match="does not fit in 64 bits of nanoseconds") as caught:
        to_ns(columns, units, ["t"], "log")
    assert caught.value.positions == (1,)


def test_what_is_inside_a_known_type_is_its_own_affair(monkeypatch):
    """Of known types within one another the outermost counts, and those next to it."""
    text = (
        f"pkg/msg/Outer first\npkg/msg/Inner second\n{LINE}\nMSG: pkg/msg/Outer\n"
        f"float64[3] w\npkg/msg/Inner within\n{LINE}\nMSG: pkg/msg/Inner\nfloat64[3] w\n"
    )
    for name in ("pkg/msg/Outer", "pkg/msg/Inner"):
        monkeypatch.setitem(TYPES, name, Row((name,), rate=r"w\[(?P<part>[012])\]"))
    found = found_in(channel_of(text, "pkg/msg/Both"))
    assert [one.field for one in found] == ["first.w", "second.w"]
