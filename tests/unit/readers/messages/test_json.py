"""JSON messages: all at once or one by one, the answer is the same."""

import json
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make.json_messages import imu
from make.mcap import Topic, write_topics
from make.messages_reference import block_of
from make.reading import found_in, mark, rates

from quatprop.base.errors import (
    AmbiguousTopicError,
    MessageError,
    NoRatesError,
    SchemaError,
    TimelineError,
    UndeclaredError,
    UnsupportedLogError,
)
from quatprop.readers.messages.blocks import Channel, to_ns
from quatprop.readers.messages.columns import ValueDecoder
from quatprop.readers.messages.json import JsonDecoder
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.readers.row_stamps import stamps_of
from quatprop.settings.reading import RateSelection

START = 1_700_000_000_000_000_000


def channel_of(sample, type_name="sensor_msgs/Imu"):
    """Return a channel that has been looked at."""
    data = json.dumps(sample).encode()
    return Channel("/imu", type_name, "json", "jsonschema", b"{}", sample=data)


def encoded(messages):
    """Return messages as a block."""
    return block_of([m if isinstance(m, bytes) else json.dumps(m).encode() for m in messages])


def columns_of(sample, field, messages):
    """Return a field of messages, on a channel that begins with a sample."""
    return JsonDecoder(channel_of(sample), [field], "log").columns(encoded(messages))[0]


def write(folder, messages, type_name="sensor_msgs/Imu"):
    """Write an MCAP file of one topic."""
    return write_topics(folder / "log.mcap", {"/imu": Topic(type_name, messages)})


def read(path, **options):
    """Return the samples of the one source, and how many messages were lost."""
    _, series, losses = rates(path, **options)
    return series, sum(loss.messages for loss in losses)


@pytest.mark.parametrize(
    "stamp",
    [{"sec": 1700000000, "nanosec": 5}, {"nsec": 5, "sec": 1700000000},
     {"secs": 1700000000, "nsecs": 5}, "2023-11-14T22:13:20.000000005Z",
     "2023-11-15T00:13:20.000000005+02:00"],
)  # fmt: skip
def test_stamps_are_told_by_their_form(tmp_path, stamp):
    """Seconds and nanoseconds under any of their names, and RFC 3339."""
    series, _ = read(write(tmp_path, [imu(stamp=stamp)]))
    assert series.t_ns.tolist() == [START + 5]


def test_a_stamp_that_is_a_number_needs_a_unit_and_stays_exact(tmp_path):
    """A double at this epoch would be off by 238 ns."""
    raw = [b'{"t": 1700000000.%09d, "w": [1, 2, %d]}' % (k, k) for k in range(1, 4)]
    path = write(tmp_path, raw, "")
    options = {"rate_field": "w", "rate_unit": "deg/s", "time_field": "t"}
    with pytest.raises(UndeclaredError, match="the time in field 't'"):
        read(path, **options)
    series, _ = read(path, **options, time_unit="s")
    assert series.t_ns.tolist() == [START + k for k in range(1, 4)]
    np.testing.assert_allclose(np.degrees(series.rate), [[1, 2, k] for k in range(1, 4)])


def test_a_field_matches_as_spelled_and_then_as_a_key(tmp_path):
    """As columns of files do: two fields of one key are told apart by their spelling."""
    first, second = ({"x": k, "y": 0, "z": 0} for k in (1, 2))
    message = {"imu": {"bodyRate": first, "body_rate": second, "turnRate": first}}
    path = write(tmp_path, [message] * 2, "")
    options = {"rate_unit": "rad/s", "clock": "log"}
    parts = ",".join(f"imu.Turn_Rate.{axis}" for axis in "xyz")
    for field, rate in {
        "imu.bodyRate": 1, "imu.body_rate": 2, "Imu.turn_rate": 1, parts: 1,
    }.items():  # fmt: skip
        assert read(path, rate_field=field, **options)[0].rate[0].tolist() == [rate, 0, 0]
    with pytest.raises(SchemaError, match=r"imu\.Body_Rate"):
        read(path, rate_field="imu.Body_Rate", **options)


@pytest.mark.parametrize(
    ("field", "name", "unit", "factor"),
    [
        ("gyro_dps", "gyro_dps", "deg/s", np.pi / 180),
        ("gyro_x_dps,gyro_y_dps,gyro_z_dps", None, "deg/s", np.pi / 180),
        ("imu.gyro_rad_s", "gyro_rad_s", "rad/s", 1.0),
        ("gyro_mdps", "gyro_mdps", "deg/s", np.pi / 180_000),
    ],
)
def test_a_field_whose_name_ends_in_a_unit_declares_it(tmp_path, field, name, unit, factor):
    """As a column of that name does, also where that is a list of three."""
    rate = {name: [1, 2, 3]} if name else {f"gyro_{axis}_dps": k for k, axis in enumerate("xyz", 1)}
    sample = {"imu": rate} if "." in field else rate
    path = write(tmp_path, [sample] * 2, "")
    source, series, _ = rates(path, rate_field=field, clock="log")
    assert source.unit == unit
    np.testing.assert_allclose(series.rate, [[factor, 2 * factor, 3 * factor]] * 2, rtol=1e-15)
    other = "rad/s" if unit == "deg/s" else "deg/s"
    source, _, _ = rates(path, rate_field=field, clock="log", rate_unit=other)
    assert source.unit == other
    (remark,) = source.remarks
    assert f"read in {other}, as requested" in remark
    table = tmp_path / "rates.jsonl"
    table.write_text("".join(json.dumps({"t_ns": t, **sample}) + "\n" for t in (1, 2)))
    assert rates(table)[0].unit == unit


def test_the_order_of_parts_is_that_of_their_names():
    """An object has no order; a vector does."""
    sample = {"w": {"z": 3, "y": 2, "x": 1}}
    assert columns_of(sample, "w", [sample]).tolist() == [[1, 2, 3]]


def test_line_breaks_within_a_message_are_blanks(monkeypatch):
    """Messages may be written for people, and are parsed at once as others are."""
    monkeypatch.setattr(ValueDecoder, "columns", None)
    raw = json.dumps(imu(1, 2, 3), indent=2).encode().replace(b"\n", b"\r\n")
    assert columns_of(imu(), "angular_velocity", [raw] * 3).tolist() == [[1, 2, 3]] * 3


@pytest.mark.parametrize(
    "damaged",
    [b"", b"{", b"[1]", b'{"header": 1}', b"\xff", imu(stamp={"sec": 1}), imu(stamp="today"),
     imu(stamp={"sec": 1.5, "nanosec": 1}), imu(stamp={"sec": 10**30, "nanosec": 1}), imu("fast"),
     b"1 2", b"[" * 100_000],
)  # fmt: skip
def test_messages_that_do_not_fit_are_lost_and_told(tmp_path, damaged):
    """The others are good."""
    stamped = {"sec": 7, "nanosec": 0}
    path = write(tmp_path, [imu(1, stamp=stamped), damaged, imu(3, stamp=stamped)])
    _, series, (loss,) = rates(path)
    assert series.rate[:, 0].tolist() == [1, 3]
    assert loss.messages == 1
    assert "recorded at 1000 ns cannot be decoded as json with the wanted fields" in loss.reason


numbers = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**70), 2**70), st.none()
)
stamps = st.fixed_dictionaries({"sec": st.integers(0, 2**31), "nanosec": st.integers(0, 10**9)})
SAMPLE = {
    "a": {"x": 1, "y": 2, "z": 3},
    "b": {"stamp": {"sec": 1, "nanosec": 2}, "c": 4},
    "l": [1, 2, 3],
}


@given(
    st.lists(
        st.fixed_dictionaries(
            {"a": st.fixed_dictionaries({"x": numbers, "y": numbers, "z": numbers}),
             "b": st.fixed_dictionaries({"stamp": stamps}, optional={"c": numbers}),
             "l": st.lists(numbers, min_size=3, max_size=4)},
            optional={"s": st.text(), "n": st.recursive(st.none() | st.booleans(), st.lists)},
        ),
        min_size=1,
        max_size=6,
    )
)  # fmt: skip
@settings(max_examples=30)
def test_all_at_once_is_one_by_one(messages):
    """Random messages, with fields that come and go."""
    paths = ["a", "b.stamp.sec", "b.stamp.nanosec", "b.c", "l", "l[1]"]
    decoder = JsonDecoder(channel_of(SAMPLE), paths, "log")
    block = encoded(messages)
    at_once, one_by_one = decoder.columns(block), ValueDecoder.columns(decoder, block)
    for found, expected in zip(at_once, one_by_one, strict=True):
        assert found.shape == expected.shape
        # A decimal zero has no sign; nothing else may differ.
        np.testing.assert_array_equal(found.astype(float), expected.astype(float))


@pytest.mark.parametrize(
    ("sample", "values", "expected", "bad"),
    [
        (True, [False, True], [False, True], 1),
        ("0.5", ["25e-2", "-7"], [0.25, -7], "n/a"),
        (["1", "2"], [["0.1", " 3 "], ["4", None]], [[0.1, 3], [4, np.nan]], ["1", "?"]),
        ("2023-11-14T22:13:20Z", ["2023-11-15T00:13:20.5+02:00"], [START + 500_000_000], 5),
        ([[1, 2], [3, 4]], [[[1, 2], [3, None]]], [[1, 2, 3, np.nan]], [1]),
    ],
)
def test_fields_of_other_kinds_are_the_same_either_way(sample, values, expected, bad):
    """Booleans, times as text and lists of lists; what is of another kind is named."""
    decoder = JsonDecoder(channel_of({"f": sample, "none": None}), ["f"], "log")
    block = encoded([{"f": value} for value in values])
    for (found,) in (decoder.columns(block), ValueDecoder.columns(decoder, block)):
        np.testing.assert_array_equal(found, expected)
    with pytest.raises(MessageError) as caught:
        decoder.columns(encoded([{"f": values[0]}, {"f": bad}]))
    assert caught.value.positions == (1,)
    with pytest.raises(SchemaError, match="is not made of equal numbers"):
        JsonDecoder(decoder.channel, ["none"], "log")


@pytest.mark.parametrize("number", ["2.1099891540908808e-206", "1E-267", f"-0.{'0' * 221}1"])
def test_a_tiny_number_is_not_zero(number):
    """Arrow reads a decimal of 222 to 224 or 267 places as zero, and so did the decoder."""
    block = encoded([b'{"t": %s}' % number.encode(), b'{"t": 0}'])
    decoder = JsonDecoder(channel_of({"t": 1.5}), ["t"], "log")
    assert decoder.columns(block)[0].tolist() == [Decimal(number), 0]


def test_numbers_by_themselves_are_exact_either_way():
    """They may be times."""
    block = encoded([b'{"t": 1700000000.123456789123}', b'{"t": 3}'])
    decoder = JsonDecoder(channel_of({"t": 1.5}), ["t"], "log")
    for found in (*decoder.columns(block), *ValueDecoder.columns(decoder, block)):
        assert found.tolist() == [Decimal("1700000000.123456789123"), 3]
        t_ns = to_ns([found], ["s"], ["t"], "log")
        assert t_ns.tolist() == [START + 123_456_789, 3_000_000_000]
    with pytest.raises(MessageError, match="does not fit in 64 bits of nanoseconds") as caught:
        to_ns([np.array([1, 10**12, float("nan")], object)], ["s"], ["t"], "log")
    assert caught.value.positions == (1, 2)


@pytest.mark.parametrize("number", ["6.7e54", "-1e300", "1.5e-200"])
def test_numbers_beyond_the_decimals_of_columns_are_read_one_by_one(number):
    """The parser of columns gives wrong ones for them without a word."""
    raw = b'{"t": %s}' % number.encode()
    assert columns_of({"t": 1.5}, "t", [raw, raw]).tolist() == [Decimal(number)] * 2


@pytest.mark.parametrize("field", ["imu.gyro", "imu.list", "imu.gyro.x,imu.gyro.y,imu.gyro.z"])
def test_numbers_that_messages_write_as_text_are_read(tmp_path, field):
    """They were refused as if they were none; a remark says what they are."""
    rates = np.random.default_rng(4).normal(0, 1, (20, 3))
    texts = [[repr(x) for x in rate] for rate in rates.tolist()]
    messages = [
        {"t": str(START + k), "imu": {"gyro": dict(zip("xyz", text, strict=True)), "list": text}}
        for k, text in enumerate(texts)
    ]
    path = write(tmp_path, messages, "")
    options = {"rate_unit": "rad/s", "time_field": "t", "time_unit": "ns"}
    series, _ = read(path, rate_field=field, **options)
    assert series.rate.tobytes() == rates.tobytes()
    assert series.t_ns.tolist() == [START + k for k in range(20)]
    with open_log(path) as log:
        chosen = choose_rates(log, RateSelection(rate_field=field, **options))
        assert "are text" in str(chosen.remarks)


def test_channels_without_a_type_carry_rates_where_the_options_say_so(tmp_path):
    """Topics that lack the field are passed over; several that have it are ambiguous."""
    first, other, second = {"w": [1, 2, 3]}, {"v": 1}, {"w": [4, 5, 6]}
    topics = {
        name: Topic("", [one]) for name, one in zip("abc", (first, other, second), strict=True)
    }
    path = write_topics(tmp_path / "log.mcap", topics)
    with pytest.raises(NoRatesError):
        read(path)
    with pytest.raises(AmbiguousTopicError, match="'a', 'c'"):
        read(path, rate_field="w", rate_unit="rad/s")
    series, _ = read(path, topic="c", rate_field="w", rate_unit="rad/s")
    assert series.rate.tolist() == [[4, 5, 6]]


@pytest.mark.parametrize("name", ["sensor_msgs/Imu", "sensor_msgs/msg/Imu", "ros.sensor_msgs.Imu"])
def test_an_Imu_goes_by_many_names(name):
    """Package and name count."""
    (rate,), (quat,) = (found_in(channel_of(imu(), name), one) for one in ("rate", "quat"))
    assert rate.row.unit == "rad/s"
    assert mark(rate) == "angular_velocity_covariance[0]"
    assert quat.field == "orientation"


@pytest.mark.parametrize(
    ("first", "rate"),
    [
        (imu() | {"angular_velocity": None}, [[np.nan] * 3]),
        (imu(x=None, y=1.0, z=2.0), [[np.nan, 1, 2]]),
        ({name: imu()[name] for name in ("header", "orientation")}, [[np.nan] * 3]),
        *(
            (one, [])
            for one in ({"angular_velocity": [], "header": {}}, {"frame": "a"}, b"", b"[1]")
        ),
    ],
)
def test_the_first_message_may_lack_what_later_ones_have(tmp_path, first, rate):
    """A gyroscope that warms up; a rate that is missing is not finite, and other messages count."""
    later = [imu(k, 1, 2, {"sec": 1, "nanosec": k}) for k in range(1, 9)]
    series, lost = read(write(tmp_path, [first, *later]))
    assert lost == 1 - len(rate)
    assert series.t_ns.tolist() == [0] * len(rate) + [10**9 + k for k in range(1, 9)]
    np.testing.assert_array_equal(series.rate, rate + [[k, 1, 2] for k in range(1, 9)])


@pytest.mark.parametrize("message", [b"[1]", b"{", b"\xff", b"[" * 100_000], ids=len)
def test_a_first_message_that_is_no_object_is_refused(tmp_path, message):
    """There is nothing to tell the fields by."""
    with pytest.raises(SchemaError, match="is not a JSON object"):
        read(write(tmp_path, [message]))


def test_messages_that_do_not_fit_for_several_reasons_are_all_lost(tmp_path):
    """One is no JSON, another has a stamp beyond 64 bits: both are left out of what is checked."""
    messages = [imu(k, 1, 2, {"sec": 10**11 if k == 3 else k, "nanosec": 0}) for k in range(8)]
    messages[5] = b"{"
    series, lost = read(write(tmp_path, messages))
    assert series.rate[:, 0].tolist() == [0, 1, 2, 4, 6, 7]
    assert lost == 2


def test_stamps_are_looked_at_where_an_orientation_is_missing(tmp_path):
    """Messages without an orientation count, too, where stamps of zero are looked for."""
    messages = [imu(k, 1, 2, {"sec": 0, "nanosec": 0}) for k in range(8)]
    for message in messages[1:]:
        del message["orientation"]
    with pytest.raises(TimelineError, match="all header timestamps of topic '/imu' are zero"):
        read(write(tmp_path, messages))


def test_a_covariance_that_one_message_has_counts_there(tmp_path):
    """-1 says that its rate is absent."""
    messages = [imu(k, 1, 2, {"sec": 1, "nanosec": k}) for k in range(9)]
    for k, message in enumerate(messages):
        message["angular_velocity_covariance"] = [-1] * 9
        if k != 4:
            del message["angular_velocity_covariance"]
    series, lost = read(write(tmp_path, messages))
    assert not lost
    assert np.flatnonzero(np.isnan(series.rate).all(axis=1)).tolist() == [4]


def test_stamps_are_exact_where_their_integers_are_text(tmp_path):
    """Protobuf writes integers of 64 bits as text in JSON."""
    messages = [imu(stamp={"sec": "1700000000", "nsec": str(k)}) for k in range(9)]
    messages[5]["header"]["stamp"]["sec"] = "1.5e9"
    series, lost = read(write(tmp_path, messages))
    assert lost == 1
    assert series.t_ns.tolist() == [START + k for k in range(9) if k != 5]


@pytest.mark.parametrize("topic", [None, "/imu", "/nothing"])
def test_a_topic_in_an_encoding_that_is_not_read_is_listed_with_it(tmp_path, topic):
    """The rates may be in it, so its type alone would mislead."""
    messages = Topic("foxglove.Imu", [b"imu"], b"", "flatbuffer", "flatbuffer")
    path = write_topics(tmp_path / "log.mcap", {"/imu": messages})
    with pytest.raises(NoRatesError) as raised:
        read(path, topic=topic)
    assert str(raised.value) == (
        f"{path}: no body rates found; its topics are '/imu (foxglove.Imu, encoded as "
        "flatbuffer, which is not read)'; name the field, or three as x,y,z, with topic and "
        "rate_field"
    )


def test_definitions_with_and_without_a_stamp_are_not_mixed(tmp_path):
    """The stamps of one topic are of one clock."""
    messages = [(k * 1000, imu(k, stamp={"sec": 1, "nanosec": k})) for k in range(20)]
    for _, message in messages[1::2]:
        del message["header"]
    types = {"sensor_msgs/Imu": messages[::2], "sensor_msgs/msg/Imu": messages[1::2]}
    topics = [("/imu", Topic(name, half)) for name, half in types.items()]
    path = write_topics(tmp_path / "log.mcap", topics)
    with pytest.raises(UnsupportedLogError) as raised:
        read(path)
    assert str(raised.value) == (
        f"{path}: topic '/imu' was recorded with 2 different message definitions, and some have no "
        "header timestamp; choose clock='log'"
    )
    series, _ = read(path, clock="log")
    assert series.t_ns.tolist() == list(range(0, 20_000, 1000))
    assert series.rate[:, 0].tolist() == list(range(20))


@pytest.mark.parametrize("begin", [1, 7, 200, 299])
def test_the_frame_of_every_message_is_read(tmp_path, begin):
    """Only the first messages were looked at; one of them has no frame here, and none is lost."""
    messages = [imu(k, stamp={"sec": 1, "nanosec": k}) for k in range(300)]
    for k, message in enumerate(messages):
        message["header"]["frame_id"] = "left" if k < begin else "right"
    del messages[3]["header"]["frame_id"]
    path = write(tmp_path, messages)
    with open_log(path) as log:
        signal = choose_rates(log, RateSelection())
        assert sum(map(len, signal.batches())) == 300
        (remark,) = log.remarks
    assert "changes from 'left' to 'right' at" in remark


def test_a_field_whose_name_has_blanks_can_be_named(tmp_path):
    """Keys of JSON are any text, and those with blanks or signs were refused as no field path."""
    turn = {"x (deg/s)": 1, "y (deg/s)": 2, "z (deg/s)": 3}
    rate = {"x": 1, "y": 2, "z": 3}
    messages = [{"My IMU": {"Body-Rate": rate, "turn": turn}, "time (us)": k} for k in (5, 6)]
    path = write(tmp_path, messages, "")
    stamp = {"time_field": "time (us)", "time_unit": "us"}
    axes = ", ".join(f"My IMU.turn.{name}" for name in turn)
    for field, factor in (("My IMU.Body-Rate", 1), ("my_imu.body_rate", 1), (axes, np.pi / 180)):
        unit = "rad/s" if factor == 1 else None
        series, lost = read(path, rate_field=field, rate_unit=unit, **stamp)
        np.testing.assert_allclose(series.rate, np.array([[1, 2, 3]] * 2) * factor, rtol=1e-15)
        assert (series.t_ns.tolist(), lost) == ([5000, 6000], 0)


def test_the_numbers_of_an_object_without_an_order_can_be_named(tmp_path):
    """They were refused with the advice to name them, also where they were named."""
    turn = {"pitch": 2, "roll": 1, "yaw": 3}
    path = write(tmp_path, [{"imu": {"turn": turn}}] * 2, "")
    options = {"rate_unit": "rad/s", "clock": "log"}
    for names, rate in {("roll", "pitch", "yaw"): [1, 2, 3], tuple(turn): [2, 1, 3]}.items():
        field = ",".join(f"imu.turn.{name}" for name in names)
        assert read(path, rate_field=field, **options)[0].rate.tolist() == [rate] * 2
    with pytest.raises(SchemaError, match="is not three numbers; name a field of x, y, z or three"):
        read(path, rate_field="imu.turn", **options)


def test_an_orientation_in_JSON_is_read_by_the_names_of_its_parts():
    """The same tree serves both tables."""
    (found,) = found_in(channel_of(imu()), "quat")
    message = imu() | {"orientation": {"x": 0.1, "w": 0.9, "z": 0.3, "y": 0.2}}
    decode = found.table.decoder([stamps_of(found)[0]], found.sets)
    assert decode([encoded([message])]).values[1].tolist() == [[0.9, 0.1, 0.2, 0.3]]
