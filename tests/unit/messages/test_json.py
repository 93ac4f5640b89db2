"""JSON messages: all at once or one by one, the answer is the same."""

import json
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make.json_messages import imu
from make.messages_reference import block_of
from make.reading import found_in, mark
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from quatprop.errors import (
    AmbiguousTopicError,
    MessageError,
    NoRatesError,
    SchemaError,
    TimelineError,
    UndeclaredError,
    UnsupportedLogError,
)
from quatprop.logs.clocks.stamps import stamps_of
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.rates import choose_rates
from quatprop.messages.blocks import Channel
from quatprop.messages.json import JsonDecoder
from quatprop.messages.times import to_ns
from quatprop.messages.values import ValueDecoder
from quatprop.pipeline.plausibility import frame_remarks
from quatprop.series import GyroSeries
from quatprop.settings.selection import RateSelection


def channel_of(sample, type_name="sensor_msgs/Imu"):
    """Return a channel that has been looked at."""
    return Channel(
        "/imu", type_name, "json", "jsonschema", b"{}", sample=json.dumps(sample).encode()
    )


def encoded(messages):
    """Return messages as a block."""
    return block_of([m if isinstance(m, bytes) else json.dumps(m).encode() for m in messages])


def write(path, topics):
    """Write an MCAP file; topics are names with a type and messages."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for topic, (type_name, messages) in topics.items():
            schema = writer.register_schema(type_name, "jsonschema", b"{}") if type_name else 0
            channel = writer.register_channel(topic, "json", schema)
            for position, message in enumerate(messages):
                data = message if isinstance(message, bytes) else json.dumps(message).encode()
                writer.add_message(channel, position * 1000, data, position * 1000)
        writer.finish()
    return path


def read(path, **options):
    """Return the samples of the one source, and what was lost."""
    with open_log(path) as log:
        batches = list(choose_rates(log, RateSelection(**options)).batches())
        return GyroSeries.joined(batches), log.losses


def test_a_JSON_log_is_the_same_series_as_a_CDR_log(tmp_path):
    """Doubles survive their decimal digits."""
    random = np.random.default_rng(8)
    rate = random.normal(size=(500, 3)) * 10.0 ** random.integers(-9, 3, (500, 1))
    stamps = np.cumsum(random.integers(1, 10**10, 500)) + 1_700_000_000 * 10**9
    times = [divmod(int(t), 10**9) for t in stamps]
    store = get_typestore(Stores.LATEST)
    make = store.types
    with (tmp_path / "cdr.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"")
        channel = writer.register_channel("/imu", "cdr", schema)
        vector, nine = make["geometry_msgs/msg/Vector3"], np.zeros(9)
        for position, ((sec, nanosec), row) in enumerate(zip(times, rate.tolist(), strict=True)):
            header = make["std_msgs/msg/Header"](
                make["builtin_interfaces/msg/Time"](sec, nanosec), "a"
            )
            message = make["sensor_msgs/msg/Imu"](
                header, make["geometry_msgs/msg/Quaternion"](0, 0, 0, 1), nine, vector(*row), nine,
                vector(0, 0, 0), nine,
            )  # fmt: skip
            data = bytes(store.serialize_cdr(message, "sensor_msgs/msg/Imu"))
            writer.add_message(channel, position * 1000, data, position * 1000)
        writer.finish()
    messages = [
        imu(*row, stamp={"sec": sec, "nanosec": nanosec})
        for (sec, nanosec), row in zip(times, rate.tolist(), strict=True)
    ]
    as_json, _ = read(write(tmp_path / "json.mcap", {"/imu": ("sensor_msgs/msg/Imu", messages)}))
    as_cdr, _ = read(tmp_path / "cdr.mcap")
    assert (as_json.t_ns == stamps).all()
    assert (as_json.t_ns == as_cdr.t_ns).all()
    assert (as_json.rate == as_cdr.rate).all()


def test_the_demo_gives_what_an_independent_oracle_gives(shared_logs):
    """The log has images and odometry besides."""
    series, losses = read(shared_logs / "json_imu" / "demo.mcap")
    assert len(series) == 150
    assert losses == []
    assert series.t_ns[0] == 1_730_000_000_000_000_000
    assert series.rate[0].tolist() == [0, 1.2, 0]


@pytest.mark.parametrize(
    "stamp",
    [{"sec": 1700000000, "nanosec": 5}, {"nsec": 5, "sec": 1700000000},
     {"secs": 1700000000, "nsecs": 5}, "2023-11-14T22:13:20.000000005Z",
     "2023-11-15T00:13:20.000000005+02:00"],
)  # fmt: skip
def test_stamps_are_told_by_their_form(stamp):
    """Seconds and nanoseconds under any of their names, and RFC 3339."""
    (found,) = found_in(channel_of(imu(stamp=stamp)))
    decode = found.table.decoder([stamps_of(found)[0]], ())
    (t_ns,) = decode([encoded([imu(stamp=stamp)])]).values
    assert t_ns.tolist() == [1_700_000_000_000_000_005]


def test_a_stamp_that_is_a_number_needs_a_unit_and_stays_exact(tmp_path):
    """A double at this epoch would be off by 238 ns."""
    raw = [
        b'{"t": 1700000000.%09d, "w": [1, 2, %d]}' % (nanoseconds, nanoseconds)
        for nanoseconds in range(1, 4)
    ]
    path = write(tmp_path / "log.mcap", {"/gyro": ("", raw)})
    options = {"rate_field": "w", "rate_unit": "deg/s", "time_field": "t"}
    with open_log(path) as log, pytest.raises(UndeclaredError, match="the time in field 't'"):
        choose_rates(log, RateSelection(**options))
    series, _ = read(path, **options, time_unit="s")
    assert series.t_ns.tolist() == [1_700_000_000_000_000_000 + k for k in range(1, 4)]
    np.testing.assert_allclose(np.degrees(series.rate), [[1, 2, k] for k in range(1, 4)])


def test_a_field_matches_as_spelled_and_then_as_a_key(tmp_path):
    """As columns of files do: two fields of one key are told apart by their spelling."""
    first, second = ({"x": k, "y": 0, "z": 0} for k in (1, 2))
    raw = [
        json.dumps({"imu": {"bodyRate": first, "body_rate": second, "turnRate": first}}).encode()
    ]
    path = write(tmp_path / "log.mcap", {"/gyro": ("", raw * 2)})
    for field, rate in {"imu.bodyRate": 1, "imu.body_rate": 2, "Imu.turn_rate": 1}.items():
        series, _ = read(path, rate_field=field, rate_unit="rad/s", clock="log")
        assert series.rate[0].tolist() == [rate, 0, 0]
    fields = ",".join(f"imu.Turn_Rate.{axis}" for axis in "xyz")
    assert read(path, rate_field=fields, rate_unit="rad/s", clock="log")[0].rate[0, 0] == 1
    with pytest.raises(SchemaError, match=r"imu\.Body_Rate"):
        read(path, rate_field="imu.Body_Rate", rate_unit="rad/s", clock="log")


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
    raw = [json.dumps({"t": stamp, **sample}).encode() for stamp in (1, 2)]
    path = write(tmp_path / "log.mcap", {"/gyro": ("", raw)})
    with open_log(path) as log:
        signal = choose_rates(log, RateSelection(rate_field=field, clock="log"))
        (series,) = signal.batches()
    assert signal.unit == unit
    np.testing.assert_allclose(series.rate, [[factor, 2 * factor, 3 * factor]] * 2, rtol=1e-15)
    other = "rad/s" if unit == "deg/s" else "deg/s"
    with open_log(path) as log:
        signal = choose_rates(log, RateSelection(rate_field=field, clock="log", rate_unit=other))
    assert (signal.unit, len(signal.remarks)) == (other, 1)
    assert f"read in {other}, as asked for" in signal.remarks[0]
    table = tmp_path / "rates.jsonl"
    table.write_bytes(b"".join(line.replace(b'"t"', b'"t_ns"') + b"\n" for line in raw))
    with open_log(table) as log:
        assert choose_rates(log, RateSelection()).unit == unit


def test_the_order_of_parts_is_that_of_their_names():
    """An object has no order; a vector does."""
    sample = {"w": {"z": 3, "y": 2, "x": 1}}
    (rate,) = JsonDecoder(channel_of(sample), ["w"], "log").columns(encoded([sample]))
    assert rate.tolist() == [[1, 2, 3]]


def test_line_breaks_within_a_message_are_blanks():
    """Messages may be written for people."""
    raw = json.dumps(imu(1, 2, 3), indent=2).encode().replace(b"\n", b"\r\n")
    (rate,) = JsonDecoder(channel_of(imu()), ["angular_velocity"], "log").columns(
        encoded([raw] * 3)
    )
    assert rate.tolist() == [[1, 2, 3]] * 3


def test_a_rate_that_is_null_or_missing_is_not_finite():
    """The policy for rates that are not finite decides."""
    gone = imu()
    del gone["angular_velocity"]
    decoder = JsonDecoder(channel_of(imu()), ["angular_velocity"], "log")
    (rate,) = decoder.columns(encoded([imu(1), imu(None, 2, 3), gone]))
    assert rate[0].tolist() == [1, 0, 0]
    assert np.isnan(rate[1]).tolist() == [True, False, False]
    assert np.isnan(rate[2]).all()


@pytest.mark.parametrize(
    "damaged",
    [b"", b"{", b"[1]", b'{"header": 1}', b"\xff", imu(stamp={"sec": 1}), imu(stamp="today"),
     imu(stamp={"sec": 1.5, "nanosec": 1}), imu(stamp={"sec": 10**30, "nanosec": 1}), imu("fast"),
     b"1 2", b"[" * 100_000],
)  # fmt: skip
def test_messages_that_do_not_fit_are_lost_and_told(tmp_path, damaged):
    """The others are good."""
    stamped = {"sec": 7, "nanosec": 0}
    messages = [imu(1, stamp=stamped), damaged, imu(3, stamp=stamped)]
    path = write(tmp_path / "log.mcap", {"/imu": ("sensor_msgs/Imu", messages)})
    series, losses = read(path)
    assert series.rate[:, 0].tolist() == [1, 3]
    (loss,) = losses
    assert loss.messages == 1
    assert "recorded at 1000 ns cannot be decoded as json with the wanted fields" in loss.reason


numbers = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**70), 2**70), st.none()
)
stamps = st.fixed_dictionaries({"sec": st.integers(0, 2**31), "nanosec": st.integers(0, 10**9)})


@given(
    st.lists(
        st.fixed_dictionaries(
            {"a": st.fixed_dictionaries({"x": numbers, "y": numbers, "z": numbers}),
             "b": st.fixed_dictionaries({"stamp": stamps}, optional={"c": numbers}),
             "l": st.lists(numbers, min_size=3, max_size=4)},
            optional={"s": st.text(), "n": st.recursive(st.none() | st.booleans(), st.lists)},
        ),
        min_size=1,
    )
)  # fmt: skip
@settings(max_examples=50)
def test_all_at_once_is_one_by_one(messages):
    """Random messages, with fields that come and go."""
    sample = {"a": {"x": 1, "y": 2, "z": 3}, "b": {"stamp": {"sec": 1, "nanosec": 2}, "c": 4}}
    sample["l"] = [1, 2, 3]
    paths = ["a", "b.stamp.sec", "b.stamp.nanosec", "b.c", "l", "l[1]"]
    decoder = JsonDecoder(channel_of(sample), paths, "log")
    block = encoded(messages)
    at_once, one_by_one = decoder.columns(block), ValueDecoder.columns(decoder, block)
    for found, expected in zip(at_once, one_by_one, strict=True):
        assert found.shape == expected.shape
        # A decimal zero has no sign; nothing else may differ.
        np.testing.assert_array_equal(found.astype(float), expected.astype(float))


def test_numbers_by_themselves_are_exact_either_way():
    """They may be times."""
    raw = [b'{"t": 1700000000.123456789123}', b'{"t": 3}']
    decoder = JsonDecoder(channel_of({"t": 1.5}), ["t"], "log")
    for columns in (decoder.columns, lambda block: ValueDecoder.columns(decoder, block)):
        (found,) = columns(encoded(raw))
        assert found.tolist() == [Decimal("1700000000.123456789123"), 3]
    t_ns = to_ns([found], ["s"], ["t"], "log")
    assert t_ns.tolist() == [1_700_000_000_123_456_789, 3_000_000_000]
    with pytest.raises(MessageError, match="does not fit in 64 bits of nanoseconds") as caught:
        to_ns([np.array([1, 10**12, float("nan")], object)], ["s"], ["t"], "log")
    assert caught.value.positions == (1, 2)


def test_channels_without_a_type_carry_rates_where_the_options_say_so(tmp_path):
    """Topics that lack the field are passed over; several that have it are ambiguous."""
    topics = {
        "/a": ("", [{"w": [1, 2, 3]}]),
        "/b": ("", [{"v": 1}]),
        "/c": ("", [{"w": [4, 5, 6]}]),
    }
    path = write(tmp_path / "log.mcap", topics)
    with open_log(path) as log:
        with pytest.raises(NoRatesError):
            choose_rates(log, RateSelection())
        with pytest.raises(AmbiguousTopicError, match="'/a', '/c'"):
            choose_rates(log, RateSelection(rate_field="w", rate_unit="rad/s"))
    series, _ = read(path, topic="/c", rate_field="w", rate_unit="rad/s")
    assert series.rate.tolist() == [[4, 5, 6]]


@pytest.mark.parametrize("name", ["sensor_msgs/Imu", "sensor_msgs/msg/Imu", "ros.sensor_msgs.Imu"])
def test_an_Imu_goes_by_many_names(name):
    """Package and name count."""
    (rate,), (quat,) = (found_in(channel_of(imu(), name), one) for one in ("rate", "quat"))
    assert rate.row.unit == "rad/s"
    assert mark(rate) == "angular_velocity_covariance[0]"
    assert quat.field == "orientation"


@pytest.mark.parametrize(
    "first",
    [
        imu() | {"angular_velocity": None},
        imu(x=None, y=None, z=None),
        imu() | {"angular_velocity": [], "header": {}},
        {"frame": "a"},
        b"",
        b"[1]",
    ],
)
def test_the_first_message_may_lack_what_later_ones_have(tmp_path, first):
    """A gyroscope that warms up; a rate that is missing is not finite, and other messages count."""
    later = [imu(k, 1, 2, {"sec": 1, "nanosec": k}) for k in range(1, 9)]
    path = write(tmp_path / "log.mcap", {"/imu": ("sensor_msgs/Imu", [first, *later])})
    series, losses = read(path)
    is_whole = not isinstance(first, bytes) and first.get("header", {}) != {}
    assert sum(loss.messages for loss in losses) == 1 - is_whole
    assert series.t_ns.tolist() == [0] * is_whole + [10**9 + k for k in range(1, 9)]
    assert np.isnan(series.rate[: int(is_whole)]).all()
    assert series.rate[int(is_whole) :].tolist() == [[k, 1, 2] for k in range(1, 9)]


def test_messages_that_do_not_fit_for_several_reasons_are_all_lost(tmp_path):
    """One is no JSON, another has a stamp beyond 64 bits: both are left out of what is checked."""
    stamps = [{"sec": 1 + k, "nanosec": 0} for k in range(8)]
    stamps[3]["sec"] = 10**11
    messages = [imu(k, 1, 2, stamp) for k, stamp in enumerate(stamps)]
    messages[5] = b"{"
    series, losses = read(write(tmp_path / "log.mcap", {"/imu": ("sensor_msgs/Imu", messages)}))
    assert series.rate[:, 0].tolist() == [0, 1, 2, 4, 6, 7]
    assert sum(loss.messages for loss in losses) == 2


def test_stamps_are_looked_at_where_an_orientation_is_missing(tmp_path):
    """Messages without an orientation count, too, where stamps of zero are looked for."""
    messages = [imu(k, 1, 2, {"sec": 0, "nanosec": 0}) for k in range(8)]
    for message in messages[1:]:
        del message["orientation"]
    path = write(tmp_path / "log.mcap", {"/imu": ("sensor_msgs/Imu", messages)})
    with pytest.raises(TimelineError, match="all header stamps of topic '/imu' are zero"):
        read(path)


def test_a_covariance_that_one_message_has_counts_there(tmp_path):
    """-1 says that its rate is absent."""
    messages = [imu(k, 1, 2, {"sec": 1, "nanosec": k}) for k in range(9)]
    for k, message in enumerate(messages):
        message["angular_velocity_covariance"] = [-1] * 9
        if k != 4:
            del message["angular_velocity_covariance"]
    series, losses = read(write(tmp_path / "log.mcap", {"/imu": ("sensor_msgs/Imu", messages)}))
    assert not losses
    assert np.flatnonzero(np.isnan(series.rate).all(axis=1)).tolist() == [4]


def test_stamps_are_exact_where_their_integers_are_text(tmp_path):
    """Protobuf writes integers of 64 bits as text in JSON."""
    stamps = [{"sec": "1700000000", "nsec": str(k)} for k in range(9)]
    messages = [imu(k, 1, 2, stamp) for k, stamp in enumerate(stamps)]
    messages[5]["header"]["stamp"]["sec"] = "1.5e9"
    path = write(tmp_path / "log.mcap", {"/imu": ("sensor_msgs/Imu", messages)})
    series, losses = read(path)
    assert [loss.messages for loss in losses] == [1]
    assert series.t_ns.tolist() == [1_700_000_000 * 10**9 + k for k in range(9) if k != 5]


def test_a_first_message_that_is_no_object_is_refused(tmp_path):
    """There is nothing to tell the fields by."""
    path = write(tmp_path / "log.mcap", {"/imu": ("sensor_msgs/Imu", [b"[1]"])})
    with (
        open_log(path) as log,
        pytest.raises(SchemaError, match="is not a JSON object"),
    ):
        choose_rates(log, RateSelection())


def test_a_topic_in_an_encoding_that_is_not_read_is_listed_with_it(tmp_path):
    """The rates may be in it, so its type alone would mislead."""
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("foxglove.Imu", "flatbuffer", b"")
        writer.add_message(writer.register_channel("/imu", "flatbuffer", schema), 1, b"imu", 1)
        writer.finish()
    for topic in (None, "/imu", "/nothing"):
        with open_log(path) as log, pytest.raises(NoRatesError) as raised:
            choose_rates(log, RateSelection(topic=topic))
        assert str(raised.value) == (
            f"{path}: no body rates found; its topics are '/imu (foxglove.Imu, encoded as "
            "flatbuffer, which is not read)'; name the field with topic and rate_field"
        )


def test_definitions_with_and_without_a_stamp_are_not_mixed(tmp_path):
    """The stamps of one topic are of one clock."""
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for number, name in enumerate(("sensor_msgs/Imu", "sensor_msgs/msg/Imu")):
            channel = writer.register_channel(
                "/imu", "json", writer.register_schema(name, "jsonschema", b"{}")
            )
            for k in range(number, 20, 2):
                message = imu(k, stamp={"sec": 1, "nanosec": k})
                if number:
                    del message["header"]
                writer.add_message(channel, k * 1000, json.dumps(message).encode(), 0)
        writer.finish()
    with open_log(path) as log, pytest.raises(UnsupportedLogError) as raised:
        choose_rates(log, RateSelection())
    assert str(raised.value) == (
        f"{path}: topic '/imu' was recorded with 2 different message definitions, and some have no "
        "header stamp; choose clock='log'"
    )
    series, _ = read(path, clock="log")
    assert series.t_ns.tolist() == list(range(0, 20_000, 1000))
    assert series.rate[:, 0].tolist() == list(range(20))


@pytest.mark.parametrize("number", ["6.7e54", "-1e300", "1.5e-200"])
def test_numbers_beyond_the_decimals_of_columns_are_read_one_by_one(number):
    """The parser of columns gives wrong ones for them without a word."""
    raw = b'{"t": %s}' % number.encode()
    (found,) = JsonDecoder(channel_of({"t": 1.5}), ["t"], "log").columns(encoded([raw, raw]))
    assert found.tolist() == [Decimal(number)] * 2


def test_several_sensors_on_one_topic_are_remarked_on(tmp_path):
    """Frames that differ were said of binary messages alone."""
    frames, said = ("left", "right", "left"), []
    for name, chosen in {"one": frames[:1], "two": frames}.items():
        messages = [imu(k, stamp={"sec": 1, "nanosec": k}) for k in range(30)]
        for k, message in enumerate(messages):
            message["header"]["frame_id"] = chosen[k % len(chosen)]
        del messages[3]["header"]["frame_id"]
        path = write(tmp_path / f"{name}.mcap", {"/imu": ("sensor_msgs/Imu", messages)})
        with open_log(path) as log:
            said.append(frame_remarks(choose_rates(log, RateSelection())))
    first, (second,) = said
    assert first == []
    assert second.startswith("its messages are in several frames, 'left', 'right': if they are ")


def test_a_field_whose_name_has_blanks_can_be_named(tmp_path):
    """Keys of JSON are any text, and those with blanks or signs were refused as no field path."""
    turn = {"x (deg/s)": 1, "y (deg/s)": 2, "z (deg/s)": 3}
    raw = [{"My IMU": {"Body-Rate": {"x": 1, "y": 2, "z": 3}, "turn": turn}, "time (us)": k}
           for k in (5, 6)]  # fmt: skip
    path = write(tmp_path / "log.mcap", {"/gyro": ("", raw)})
    stamp = {"time_field": "time (us)", "time_unit": "us"}
    axes = ", ".join(f"My IMU.turn.{name}" for name in turn)
    for field, factor in (("My IMU.Body-Rate", 1), ("my_imu.body_rate", 1), (axes, np.pi / 180)):
        unit = "rad/s" if factor == 1 else None
        series, losses = read(path, rate_field=field, rate_unit=unit, **stamp)
        np.testing.assert_allclose(series.rate, np.array([[1, 2, 3]] * 2) * factor, rtol=1e-15)
        assert (series.t_ns.tolist(), losses) == ([5000, 6000], [])


def test_the_numbers_of_an_object_without_an_order_can_be_named(tmp_path):
    """They were refused with the advice to name them, also where they were named."""
    turn = {"pitch": 2, "roll": 1, "yaw": 3}
    path = write(tmp_path / "log.mcap", {"/gyro": ("", [{"imu": {"turn": turn}}] * 2)})
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
