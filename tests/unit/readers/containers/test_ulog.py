"""PX4 ULog files: written by the documented format, compared with the library of PX4."""

import os
import re
import struct

import numpy as np
import pytest
import pyulog
from make.commands import run
from make.px4_messages import write_mcap
from make.reading import attitudes, rates
from make.ulog import TOPICS, added, data, fields_of, gyro, record, write
from make.worn import wear

import quatprop
from quatprop.base.errors import (
    AmbiguousTopicError,
    DamagedLogError,
    Loss,
    NoSuchTopicError,
    SchemaError,
    TimelineError,
    UnsupportedLogError,
)
from quatprop.readers.containers import ulog as ulog_records
from quatprop.readers.containers.ulog import SYNC, UlogLog
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates, rate_candidates
from quatprop.settings.reading import RateSelection
from quatprop.stores.file_source import FileSource

BEGIN = b"ULog\x01\x12\x35\x01" + bytes(8)
STAMPS = range(0, 100, 10)


def read(path, **options):
    """Return the samples of the one source, and what was lost."""
    _, series, losses = rates(path, **options)
    return series, losses


def sensor(path, *records, topic="sensor_gyro"):
    """Write a file of one topic, whose id is 1."""
    return write(path, added(topic, 0, 1), *records)


def ns_without(*stamps):
    """Return the usual stamps in ns but some."""
    return [1000 * t for t in STAMPS if t not in stamps]


def test_what_the_library_of_PX4_reads_is_what_is_read(tmp_path):
    """Message for message, with other topics and records between."""
    random = np.random.default_rng(4)
    stamps = np.cumsum(random.integers(900, 1100, 300)) + 10**9
    between = [
        record(b"L", b"6" + struct.pack("<Q", 5) + b"hello"), record(b"S", SYNC),
        record(b"O", b"\x05\0"), record(b"P", b"\x07float X" + bytes(4)),
        data("sensor_combined", 7, timestamp=3, gyro_rad=[1, 2, 3]),
    ]  # fmt: skip
    records = [added("sensor_combined", 0, 7), added("sensor_gyro", 1, 300)]
    for position, message in enumerate(gyro(300, stamps.tolist())):
        records += [message, between[position % len(between)]]
    path = write(tmp_path / "log.ulg", *records)
    series, losses = read(path, topic="sensor_gyro/1")
    (expected,) = [d for d in pyulog.ULog(str(path)).data_list if d.name == "sensor_gyro"]
    assert expected.multi_id == 1
    assert [loss.place for loss in losses] == ["60 dropouts, first at byte 1418"]
    assert (series.t_ns == expected.data["timestamp_sample"].astype(np.int64) * 1000).all()
    assert (series.t_ns == stamps * 1000).all()
    for axis, name in enumerate("xyz"):
        assert (series.rate[:, axis] == expected.data[name]).all()


@pytest.mark.parametrize("topic", TOPICS)
def test_a_message_is_the_same_in_a_ULog_and_in_a_ROS_2_bag(tmp_path, topic):
    """One table tells the rates of both."""
    values = [
        {"timestamp": 1000 * k + 5, "timestamp_sample": 1000 * k, "gyro_rad": [k, 0, 1],
         "x": k, "y": 2, "z": 3, "xyz": [k, 2, 3], "delta_angle": [0, k / 8, 0],
         "delta_angle_dt": 990 + k, "dt": 125.0, "scale": 0.25, "samples": 2}
        for k in range(1, 9)
    ]  # fmt: skip
    lengths = {name: length for name, _, _, length in fields_of(topic)}
    messages = [
        {name: [value, 7] if lengths[name] == 32 else value for name, value in row.items()
         if name in lengths}
        for row in values
    ]  # fmt: skip
    ulog = write(tmp_path / "log.ulg", added(topic, 0, 1), *[data(topic, 1, **m) for m in messages])
    bag = write_mcap(tmp_path / "log.mcap", TOPICS[topic], messages)
    (first, found, _), (second, expected, _) = rates(ulog), rates(bag)
    for name in ("field", "unit", "method", "increments", "remarks"):
        assert getattr(first, name) == getattr(second, name)
    assert len(found) >= 8
    assert (found.t_ns == expected.t_ns).all()
    assert (found.rate == expected.rate).all()
    assert (found.integration_time_ns is None) == (topic != "vehicle_imu")
    if found.integration_time_ns is not None:
        assert (found.integration_time_ns == expected.integration_time_ns).all()


def refusal(path, error=DamagedLogError):
    """Return the sentence with which a log is refused, without its name."""
    with pytest.raises(error) as caught:
        read(path)
    return str(caught.value).removeprefix(f"{path}: ")


@pytest.mark.parametrize("garbage", [b"\xff\xff\xff", b"\7\0\xff garbage", b"\7\0L6\xff", b"\0\0D"])
def test_a_log_that_is_damaged_is_refused_and_can_be_cut_before(tmp_path, garbage):
    """The sentence says where; the message before may be part of the damage."""
    messages = gyro(1, STAMPS)
    path = sensor(tmp_path / "log.ulg", *messages[:4], garbage, messages[4][3:], *messages[5:])
    at = path.read_bytes().index(messages[3]) + len(messages[3])
    before = at - len(messages[3])
    sentence = (
        r"byte \d+: its records cannot be followed from there; cut it before \(head -c (\d+)\)"
    )
    cut = int(re.match(sentence, refusal(path))[1])
    assert cut == before or at < cut < at + 50
    path.write_bytes(path.read_bytes()[:cut])
    assert read(path)[0].t_ns.tolist() == ns_without(*STAMPS[3 if cut == before else 4 :])


@pytest.mark.parametrize("size", range(0, 40, 3))
@pytest.mark.parametrize("zeros", [1, 5, 4096, 100_000])
def test_zeros_behind_a_torn_end_are_no_part_of_its_last_message(tmp_path, size, zeros):
    """File systems leave them where power fails: a message cut off had rates of zero."""
    messages = [data("sensor_gyro", 1, timestamp_sample=t, x=1.5, y=2.5, z=3.5) for t in STAMPS]
    path = sensor(tmp_path / "log.ulg", *messages[:9], messages[9][:size], bytes(zeros))
    series, losses = read(path)
    assert losses[0].reason.endswith("bytes are zeros") or losses[0].reason.endswith("cut off")
    assert len(series) in {8, 9}
    assert (series.rate == [1.5, 2.5, 3.5]).all()


def test_another_file_behind_a_cut_one_is_named(tmp_path):
    """A message that goes on in the header of the other was read with its bytes."""
    path = sensor(tmp_path / "log.ulg", *gyro(1, STAMPS))
    content = path.read_bytes()
    for cut in (3, 5, 20):
        begin = len(content) - cut
        path.write_bytes(content[:-cut] + content)
        sentence = f"another file begins in it at byte {begin}; split it there into two"
        assert refusal(path, UnsupportedLogError) == sentence
        path.write_bytes(content[:-cut])
        assert read(path)[0].t_ns.tolist() == ns_without(90)


def test_data_that_was_appended_is_read_behind_a_cut_record(tmp_path):
    """The flags say where it begins."""
    messages = gyro(1, STAMPS)
    path = sensor(tmp_path / "log.ulg", *messages[:5], messages[5][:20])
    content = bytearray(path.read_bytes())
    flags = struct.pack("<8s8s3Q", b"", b"\x01", len(content), 0, 0)
    content[16 + 3 : 16 + 3 + 40] = flags
    path.write_bytes(bytes(content) + b"".join(messages[6:]))
    assert read(path)[0].t_ns.tolist() == ns_without(50)


def test_what_is_no_whole_header_or_of_unknown_features_is_refused(tmp_path):
    """A flag that is not known may change everything behind it."""
    path = write(tmp_path / "log.ulg")
    content = bytearray(path.read_bytes())
    content[16 + 3 + 8] = 2
    path.write_bytes(bytes(content))
    with pytest.raises(UnsupportedLogError, match=r"does not know \(flags 0200000000000000\); "):
        read(path)
    path.write_bytes(BEGIN[:8])
    with pytest.raises(DamagedLogError, match=r"it ends within its header"):
        read(path)


def test_any_field_can_be_named(tmp_path):
    """Also of a message the table does not know, inside another type."""
    path = tmp_path / "log.ulg"
    content = BEGIN + record(b"F", b"inner:float[2] pad;float[3] turn;uint8_t[2] _padding0;")
    content += record(b"F", b"outer:uint64_t timestamp;inner[2] pair;char[3] name;")
    content += added("outer", 0, 1)
    for k in range(3):
        numbers = [0, 0, 1, 2, 3, 9, 9, k, 5, 6]
        inner = [struct.pack("<5f", *numbers[i : i + 5]) + b"\0\0" for i in (0, 5)]
        content += record(b"D", struct.pack("<HQ", 1, k) + b"".join(inner) + b"abc")
    path.write_bytes(content)
    series, losses = read(path, rate_field="pair[1].turn", rate_unit="rad/s")
    assert losses == []
    assert series.t_ns.tolist() == [0, 1000, 2000]
    assert series.rate.tolist() == [[k, 5, 6] for k in range(3)]


@pytest.mark.parametrize(
    ("text", "reason"),
    [(b"other:float x;", "the log carries no definition of 'px4_msgs/msg/SensorGyro'"),
     (b"sensor_gyro:float x;;oh no!;", "has a field that cannot be read: 'oh no!'"),
     (b"sensor_gyro:sensor_gyro x;", "contains itself")],
)  # fmt: skip
def test_definitions_that_make_no_sense_are_refused(tmp_path, text, reason):
    """The sentence names the topic."""
    path = tmp_path / "log.ulg"
    message = record(b"D", bytes(20))
    path.write_bytes(BEGIN + record(b"F", text) + added("sensor_gyro", 0, 0) + message)
    with (
        open_log(path) as log,
        pytest.raises(SchemaError, match=f"topic 'sensor_gyro/0': .*{reason}"),
    ):
        rate_candidates(log, RateSelection())


@pytest.mark.parametrize("second", ["vehicle_angular_velocity", "sensor_gyro"])
def test_an_id_that_is_given_to_another_topic_keeps_the_messages_of_the_first(tmp_path, second):
    """Messages belong to the topic that their id had when they were written."""
    path = tmp_path / "log.ulg"
    rates = [[float(k), -k, 2.0] for k in range(20)]
    begin = [
        data("sensor_gyro", 7, timestamp_sample=k, **dict(zip("xyz", rates[k], strict=True)))
        for k in range(10)
    ]
    end = [
        data(second, 7, timestamp_sample=k, xyz=rates[k], **dict(zip("xyz", rates[k], strict=True)))
        for k in range(10, 20)
    ]
    removed = record(b"R", struct.pack("<H", 7))
    write(path, added("sensor_gyro", 0, 7), *begin, removed, added(second, 1, 7), *end,
          added("sensor_gyro", 0, 7), *begin)  # fmt: skip
    with open_log(path) as log:
        counts = {channel.topic: channel.count for channel in log.channels()}
    assert counts == {"sensor_gyro/0": 20, f"{second}/1": 10}
    first, losses = read(path, topic="sensor_gyro/0")
    assert losses == []
    assert first.t_ns.tolist() == [k * 1000 for k in range(10)] * 2
    np.testing.assert_array_equal(first.rate, rates[:10] * 2)
    other, _ = read(path, topic=f"{second}/1")
    np.testing.assert_array_equal(other.rate, rates[10:])


@pytest.mark.parametrize("topic", ["sensor_gyro", "vehicle_angular_velocity"])
def test_a_clock_that_begins_again_steps_back(tmp_path, topic):
    """Messages are in the order in which they were recorded, whatever their stamps say."""
    stamps = [*range(5000, 9000, 10), *range(1000, 5000, 10)]
    messages = [data(topic, 1, timestamp=stamp + 3, timestamp_sample=stamp) for stamp in stamps]
    path = sensor(tmp_path / "log.ulg", *messages, topic=topic)
    for clock, late_us in (("header", 0), ("log", 3)):
        series, _ = read(path, clock=clock)
        assert series.t_ns.tolist() == [(stamp + late_us) * 1000 for stamp in stamps]
    with pytest.raises(TimelineError, match=r"time steps back by 7\.99 ms at sample 400 "):
        quatprop.propagate(path)


def test_windows_change_nothing(tmp_path, monkeypatch):
    """Records that lie across the border of what is read at a time are found."""
    stamps = list(range(1000, 300_000, 1000))
    messages = gyro(1, stamps)
    text = record(b"L", b"6" + bytes(8) + b"a" * 60_001)
    path = sensor(tmp_path / "log.ulg", *messages[:100], text, record(b"S", SYNC), text,
                  *messages[100:], bytes(150_001))  # fmt: skip
    whole, losses = read(path)
    # The last message ends with a zero, so that it may be cut off.
    del stamps[-1]
    assert len(whole) == len(stamps)
    assert len(losses) == 1
    for window in (1 << 17, 70_001, 66_000):
        monkeypatch.setattr(ulog_records, "WINDOW", window)
        series, told = read(path)
        assert series.t_ns.tolist() == [stamp * 1000 for stamp in stamps]
        assert series.rate.tobytes() == whole.rate.tobytes()
        assert told == losses


def test_a_file_that_becomes_shorter_while_it_is_read_loses_its_end(tmp_path):
    """Nothing dies of it, and what is missing is counted."""
    path = sensor(tmp_path / "log.ulg", *gyro(1, range(1000)) * 150)
    with open_log(path) as log:
        batches = choose_rates(log, RateSelection()).batches()
        first = next(batches)
        with path.open("r+b") as file:
            file.truncate(path.stat().st_size // 2)
        count = len(first) + sum(len(batch) for batch in batches)
    assert 70_000 < count < 90_000
    assert sum(loss.messages for loss in log.losses) == 150_000 - count
    assert {loss.reason for loss in log.losses} == {"the file has become shorter"}


def test_messages_that_cannot_be_read_any_more_are_counted(tmp_path, monkeypatch):
    """As where a disk fails after the walk over the records."""
    path = sensor(tmp_path / "log.ulg", *gyro(1, STAMPS))
    with UlogLog(path) as log:
        wear(monkeypatch)
        assert sum(map(len, log.blocks(*log.channels()))) == 0
    place, reason = path.read_bytes().index(gyro(1, STAMPS)[0]), "'Input/output error'"
    assert log.losses == [Loss(f"byte {place}", f"it cannot be read: {reason}", len(STAMPS))]


def test_a_file_that_becomes_shorter_before_the_walk_is_cut(tmp_path):
    """The walk ends where nothing is, and says that more was to come."""
    source = FileSource(sensor(tmp_path / "log.ulg"))
    os.truncate(source.path, 17)
    assert UlogLog(source).losses == [Loss("byte 16", "the last record is cut off")]


@pytest.mark.parametrize("length", [6, 71])
def test_a_message_without_the_length_of_its_format_is_refused(tmp_path, length):
    """It is damaged, or its length is, which would pass over others."""
    odd = record(b"D", struct.pack("<H", 1).ljust(length, b"\1"))
    path = sensor(tmp_path / "a.ulg", *gyro(1, STAMPS), odd, *gyro(1, STAMPS))
    at = path.read_bytes().index(odd)
    assert refusal(path).startswith(f"byte {at}: its records cannot be followed from there; cut")


def test_a_log_that_ends_inside_the_head_of_a_record_is_cut(tmp_path):
    """All messages are read; that another one followed is told."""
    path = sensor(tmp_path / "a.ulg", *gyro(1, STAMPS), b"\x06\x00")
    series, losses = read(path)
    assert len(series) == 10
    assert losses == [Loss(f"byte {path.stat().st_size - 2}", "the last record is cut off")]


def test_dropouts_are_losses(tmp_path, shared_logs):
    """Messages that the recorder could not write are as lost as unreadable ones."""
    dropouts = [record(b"O", milliseconds.to_bytes(2, "little")) for milliseconds in (20, 300)]
    path = sensor(tmp_path / "log.ulg", *gyro(1, [5, 10]), *dropouts)
    for log, count, first, total in (
        (path, 2, path.stat().st_size - 10, 320),
        (shared_logs / "ulog" / "sample.ulg", 4, 36590, 119),
    ):
        with open_log(log) as opened:
            reason = f"the recorder lost all messages for {total} ms in total"
            assert opened.losses == [Loss(f"{count} dropouts, first at byte {first}", reason)]


@pytest.mark.parametrize(
    ("damage", "place", "reason"),
    [
        (
            lambda m: m[:3] + b"\x05" + m[4:],
            "1 messages, first at byte",
            "no topic has their number",
        ),
        (lambda m: m[:2] + b"L" + m[3:], "byte", "a record is of no known kind"),
        (
            lambda m: m[:2] + b"L6" + bytes(8) + b"\xff" * (len(m) - 12),
            "byte",
            "a record is of no known kind",
        ),
        (
            lambda m: m[:2] + b"A" + bytes(3) + b"\xff" + b"a" * (len(m) - 7),
            "byte",
            "a record is of no known kind",
        ),
    ],
)
def test_a_message_of_no_known_id_or_kind_is_lost(tmp_path, damage, place, reason):
    """A damaged bit of an id, or of a kind, cost the message without a word, also at the end."""
    for which, between in ((4, b""), (4, record(b"L", b"6" + bytes(8) + b"hi")), (9, b"")):
        messages = gyro(1, STAMPS)
        messages[which] = damage(messages[which])
        path = sensor(tmp_path / "log.ulg", *messages[: which + 1], between, *messages[which + 1 :])
        series, losses = read(path)
        assert series.t_ns.tolist() == ns_without(STAMPS[which])
        at = path.read_bytes().index(messages[which])
        assert losses == [Loss(f"{place} {at}", reason, 1)]


def test_a_format_that_is_defined_again_is_refused(tmp_path):
    """The second definition was applied to all messages, those before it included."""
    again = record(b"F", b"sensor_gyro:uint64_t timestamp;float[3] x;")
    path = sensor(tmp_path / "log.ulg", *gyro(1, STAMPS), again, *gyro(1, STAMPS))
    place = path.read_bytes().index(again)
    with pytest.raises(UnsupportedLogError) as refused:
        read(path)
    assert str(refused.value) == (
        f"{path}: byte {place}: it redefines format 'sensor_gyro', so it is not certain what the "
        "messages of topic 'sensor_gyro/0' hold; ULog forbids that; cut the file there and read "
        "both parts"
    )


def at_rest(path, *topics):
    """Write attitudes at rest, one topic instance after the other, with their instance as z."""
    begin = BEGIN + record(b"B", bytes(40))
    for topic in dict.fromkeys(topic for topic, _ in topics):
        fields = "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;"
        begin += record(b"F", f"{topic}:{fields}".encode())
    for number, (topic, instance) in enumerate(topics):
        begin += added(topic, instance, number)
        for stamp in (4000, 8000):
            q = (1.0, 0.0, 0.0, instance * 1e-4)
            begin += record(b"D", struct.pack("<HQQ4f", number, stamp + 9, stamp, *q))
    path.write_bytes(begin)
    return path


@pytest.mark.parametrize(
    "topic", ["estimator_attitude", "external_ins_attitude", "vehicle_attitude_groundtruth"]
)
def test_attitudes_of_estimators_are_those_of_the_vehicle_s_message(tmp_path, topic):
    """PX4 publishes one message under several names."""
    source, t_ns, _, _ = attitudes(at_rest(tmp_path / "log.ulg", (topic, 0)))
    assert (source.name, source.type_name) == (f"{topic}/0", "px4_msgs/msg/VehicleAttitude")
    assert source.layout == "scalar-first"
    assert t_ns.tolist() == [4_000_000, 8_000_000]


def test_the_vehicle_s_attitude_comes_before_those_of_its_estimators(tmp_path):
    """Ignored estimators are named; several are ambiguous, and one can be chosen."""
    path, two = tmp_path / "log.ulg", [("estimator_attitude", 0), ("estimator_attitude", 1)]
    source, *_ = attitudes(at_rest(path, *two, ("vehicle_attitude", 0)))
    assert source.name == "vehicle_attitude/0"
    names = "'estimator_attitude/0', 'estimator_attitude/1'"
    assert source.remarks[-1] == f"ignored secondary attitudes: {names}"
    assert attitudes(path, topic="estimator_attitude/1")[0].name == "estimator_attitude/1"
    with pytest.raises(AmbiguousTopicError, match=names):
        attitudes(at_rest(path, *two))
    with pytest.raises(
        NoSuchTopicError,
        match=f"no topic 'estimator_attitude' that carries attitudes; choose one of {names}; did "
        r"you mean 'estimator_attitude/0'\?$",
    ):
        attitudes(path, topic="estimator_attitude")


def test_the_only_instance_of_a_topic_need_not_be_named(tmp_path, shared_logs):
    """Also where the log is read again, as for a copy with attitudes."""
    log = at_rest(tmp_path / "one.ulg", ("vehicle_attitude", 3))
    assert attitudes(log, topic="vehicle_attitude")[0].name == "vehicle_attitude/3"
    flight, out = shared_logs / "ulog" / "sample.ulg", tmp_path / "out.csv"
    for arguments in (
        ("info", flight, "-t", "sensor_combined"),
        ("propagate", flight, "-t", "sensor_combined", "-o", out),
        ("convert", flight, out, "-t", "vehicle_attitude", "--layout", "wxyz"),
        ("compare", flight, flight, "--topic-a", "vehicle_attitude", "--topic-b",
         "vehicle_attitude/0", "--tol", "1e-9rad"),
    ):  # fmt: skip
        run(*arguments, code=3)  # the flight has dropouts
