"""Remarks on a source of rates before anything is propagated."""

import re

import numpy as np
import pandas as pd
import pytest
from make.mcap import Topic, build, saved, write_topics
from make.ros import IMU, ROS1, ROS2, encoded, imu_messages, write_messages
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quatprop import DataLossWarning, RemarkWarning, propagate, read_rates
from quatprop.base.errors import (
    AmbiguousTopicError,
    LogError,
    NoRatesError,
    TimelineError,
    UsageError,
)
from quatprop.base.text import in_python
from quatprop.propagation.job import Job, run
from quatprop.propagation.settings import OutputSettings, PropagationSettings
from quatprop.propagation.survey import survey
from quatprop.readers import column_readings
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.settings.reading import RateSelection

T0 = 1_700_000_000_000_000_000
STAMPS = T0 + np.arange(50) * 10_000_000
RATE = np.array([0.1, 0.2, 0.3]) + np.arange(50)[:, None] % 7 * [0, 0, 0.01]


def bag(path, stamps=STAMPS, frames=("imu",), recorded=STAMPS, marks=(0.0,)):
    """Write Imu messages with these header timestamps, frames in two parts, covariances in turn."""
    messages = list(imu_messages(stamps, RATE, recorded=recorded))
    for k, (_, _, _, values) in enumerate(messages):
        values["header"]["frame_id"] = frames[k * len(frames) // len(messages)]
        values["angular_velocity_covariance"] = np.full(9, marks[k % len(marks)])
    return write_messages(path, messages)


def remarks(path, tmp_path, **options):
    """Return the remarks of a propagation."""
    settings = PropagationSettings(selection=RateSelection(**options))
    report = run(Job(str(path), OutputSettings(str(tmp_path / "out.csv")), settings))
    return [in_python(remark) for remark in report.remarks]


def surveyed(path, **options):
    """Return what an inspection finds of the rates."""
    (source,) = survey(str(path), None, RateSelection(**options)).sources
    return source


SINCE_START = {"stamps": STAMPS - T0 + 60_000_000_000}
OTHER_CLOCK = (
    "header timestamps begin at 1970-01-01T00:01:00Z and the recording at 2023-11-14T22:13:20Z: "
    "another clock, or recorded again later; for the time of recording choose clock='log'"
)
AHEAD = (
    "header timestamps begin at 2023-11-14T23:13:20Z and the recording at 2023-11-14T22:13:20Z: "
    "another clock; for the time of recording choose clock='log'"
)
HOUR_NS = 3_600_000_000_000
SEVERAL_FRAMES = (
    "the frame of topic '/imu' changes from 'left' to 'right_imu' at 1700000000250000000 ns: if "
    "their axes differ, the rates are mixed; read the messages of one with series='left'"
)
OTHER_UNIT = (
    "rate_unit says deg/s, but by definition 'angular_velocity.x', 'angular_velocity.y', "
    "'angular_velocity.z' are in rad/s; read in deg/s, as requested"
)


@pytest.mark.parametrize(
    ("log", "options", "said"),
    [
        # Transport takes its time, and that is no other clock.
        ({"stamps": STAMPS - 50_000_000}, {}, []),
        ({"stamps": STAMPS - HOUR_NS}, {}, []),
        (SINCE_START, {}, [OTHER_CLOCK]),
        ({"stamps": STAMPS + HOUR_NS + 1}, {}, [AHEAD]),
        (SINCE_START, {"clock": "log"}, []),
        ({"frames": ("/imu", "imu")}, {}, []),
        ({"frames": ("left", "right_imu")}, {}, [SEVERAL_FRAMES]),
        ({}, {"rate_unit": "rad/s"}, []),
        ({}, {"rate_unit": "deg/s"}, [OTHER_UNIT]),
        ({}, {"rate_field": "angular_velocity"}, []),
    ],
)
def test_what_is_odd_of_the_messages_is_said_and_nothing_else(tmp_path, log, options, said):
    """By a propagation and by an inspection."""
    path = bag(tmp_path / "log.bag", **log)
    assert remarks(path, tmp_path, **options) == said
    assert list(map(in_python, surveyed(path, **options).remarks)) == said


def test_frames_whose_names_are_not_read_are_no_error(tmp_path):
    """Rates are read in more encapsulations than names, which are as in plain CDR here."""
    (text, _), events = ROS2.generate_msgdef(IMU, ros_version=2), []
    for k, (_, _, at, values) in enumerate(imu_messages(STAMPS, RATE)):
        values["header"]["frame_id"] = ("imu", "gps")[k % 2]
        events.append((0, at, b"\0\7" + encoded(ROS2, IMU, values)[2:], at))
    topic = Topic(IMU, (), text.encode(), "ros2msg", "cdr")
    path = saved(tmp_path, build([("/imu", topic)], events, profile="ros2"))
    assert remarks(path, tmp_path) == []
    np.testing.assert_array_equal(read_rates(path).rate, RATE)


@pytest.mark.parametrize(("back_ms", "is_said"), [(105, False), (115, True), (3_600_000, True)])
def test_a_clock_of_the_recorder_that_is_set_back_is_remarked_on(tmp_path, back_ms, is_said):
    """Samples of both settings are mixed by their times, and that cannot be seen in the result."""
    stamps = STAMPS - np.where(np.arange(50) > 25, back_ms * 1_000_000, 0)
    path = bag(tmp_path / "log.bag", stamps, recorded=stamps)
    remark = (
        "the log times of topic '/imu' go backwards by more than 100 ms: was the recorder's clock "
        "set back? samples are used in the order of their log times"
    )
    assert (remark in remarks(path, tmp_path)) == is_said
    assert (remark in surveyed(path).remarks) == is_said


def test_stamps_of_zero_are_counted(tmp_path):
    """A driver that does not know the time yet writes zero."""
    said = remarks(bag(tmp_path / "log.bag", np.where(np.arange(50) < 3, 0, STAMPS)), tmp_path)
    zeros = (
        "3 of the first 50 header timestamps are zero; for the time of recording choose clock='log'"
    )
    assert said[-1] == zeros


# --- fields, times, and messages that are not there


@pytest.mark.parametrize("topic", [None, "/imu"])
def test_a_field_that_is_not_there_names_those_that_are(tmp_path, topic):
    """A slip of the pen in --rate-field is answered with the rates of the log."""
    path = bag(tmp_path / "log.bag", STAMPS[:1])
    with pytest.raises(UsageError) as caught:
        read_rates(path, topic=topic, rate_field="angular_velocty")
    assert str(caught.value) == (
        f"{path}: no message has a field 'angular_velocty'; the body rates that are recognised "
        "are 'angular_velocity (/imu)'"
    )


@pytest.mark.parametrize(
    ("topic", "field"),
    [
        (
            Topic(
                "tf2_msgs/msg/TFMessage",
                [b""],
                b"geometry_msgs/TransformStamped[] transforms",
                "ros2msg",
                "cdr",
            ),
            "transforms",
        ),
        (Topic("a/B", [b""], b"float64[3] w", "ros2msg", "flatbuffer"), "w"),
    ],
)
def test_a_field_that_holds_no_rates_is_not_called_missing(tmp_path, topic, field):
    """The error was that no message has it, though the definition does."""
    path = write_topics(tmp_path / "log.mcap", {"/x": topic})
    with pytest.raises(NoRatesError, match=r"no body rates found; its topics are '/x \("):
        read_rates(path, rate_field=field)


@pytest.mark.parametrize(
    ("field", "reason"),
    [
        ("samples[0].angular", "a sequence may be empty; name a field outside it"),
        (
            "vec.x,vec.y,vec.w",
            "has no field 'vec.w'; 'geometry_msgs/msg/Vector3' has 'x', 'y', 'z'",
        ),
    ],
)
def test_a_field_of_the_only_topic_is_looked_for_in_its_definition(tmp_path, field, reason):
    """The refusal names the fields, and why samples in a sequence are not read."""
    definition = "geometry_msgs/Vector3 vec\ngeometry_msgs/Twist[] samples\n"
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(definition, "pkg/msg/Batch"))
    messages = [("/batch", "pkg/msg/Batch", T0, ())]
    path = write_messages(tmp_path / "log.bag", messages, types=(store, ROS2))
    with pytest.raises(LogError, match=r"log.bag: 'pkg/msg/Batch' has no field ") as raised:
        read_rates(path, rate_field=field)
    assert str(raised.value).endswith(reason)


@pytest.mark.parametrize(
    "name", ["auk/auk.bag", "auk/auk_sqlite3", "auk/auk_mcap_zstd", "ulog/sample.ulg"]
)
def test_a_publish_time_is_read_only_where_there_is_one(shared_logs, name):
    """A log time is never called a publish time: of these, MCAP alone records one."""
    with open_log(shared_logs / name) as log:
        if "mcap" in name:
            source = choose_rates(log, RateSelection(clock="publish"))
            assert source.clock == "publish"
            assert len(next(source.batches()))
            return
        with pytest.raises(
            UsageError,
            match=r"a log of kind \w+ does not record when messages were published; choose "
            r"clock='header' or 'log'$",
        ):
            choose_rates(log, RateSelection(clock="publish"))


def test_where_all_messages_are_lost_the_reason_is_said(tmp_path):
    """They are not those of their definition, and there is nothing else to look for."""
    path = tmp_path / "log.bag"
    with Writer(path) as writer:
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=ROS1)
        for k in range(3):
            writer.write(connection, T0 + k, b"too short")
    with pytest.raises(LogError) as caught:
        propagate(path)
    assert str(caught.value) == (
        f"{path}: no samples in '/imu'; lost: topic /imu: the message of topic '/imu' recorded at "
        f"{T0} ns and 2 others ends, after 9 bytes, before the wanted field of "
        "'sensor_msgs/msg/Imu'; the log is damaged or its definition does not match its messages"
    )


# --- rates that are marked as absent


def test_measured_rates_that_are_all_marked_as_absent_are_named(tmp_path):
    """Every /gps/imu of NovAtel's driver has -1 next to finite rates; nothing read them."""
    path = bag(tmp_path / "log.bag", marks=(-1.0,))
    sentence = (
        "all rates are marked as absent, by a covariance of -1 in topic '/imu'; if they were "
        "measured anyway, read them with rate_field='angular_velocity'"
    )
    with pytest.raises(TimelineError) as caught:
        remarks(path, tmp_path)
    assert str(caught.value) == f"{path}: {sentence}"
    assert (surveyed(path).source, in_python(surveyed(path).missing)) == ("/imu", sentence)
    (said,) = remarks(path, tmp_path, rate_field="angular_velocity")
    assert said == (
        "rates that a covariance of -1 in topic '/imu' marks as absent are read anyway, as "
        "requested"
    )
    source = surveyed(path, rate_field="angular_velocity")
    assert (source.samples, source.nonfinite) == (50, 0)


@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_a_topic_whose_rates_are_all_marked_as_absent_is_no_choice(tmp_path, suffix):
    """A camera has its accelerations on a topic of their own: the log was refused as ambiguous."""
    messages = []
    for topic, mark in (("/camera/accel/sample", -1.0), ("/camera/gyro/sample", 0.01)):
        for _, kind, t_ns, values in imu_messages(STAMPS, RATE):
            more = {"angular_velocity_covariance": np.full(9, mark)}
            messages.append((topic, kind, t_ns, values | more))
    path = write_messages(tmp_path / f"log.{suffix}", messages)
    assert remarks(path, tmp_path) == [
        "ignored rates that are all marked as absent: '/camera/accel/sample'"
    ]
    assert len(read_rates(path, topic="/camera/gyro/sample").t_ns) == len(STAMPS)
    with pytest.raises(TimelineError, match="all rates are marked as absent"):
        read_rates(path, topic="/camera/accel/sample")
    sources = {one.source: one.missing for one in survey(str(path), None, RateSelection()).sources}
    assert sources["/camera/gyro/sample"] is None
    assert "marked as absent" in sources["/camera/accel/sample"]


NONE = {"nan": (0.0, (np.nan,) * 3), "one axis": (0.0, (0.1, np.nan, 0.2)), "both": (-1.0, np.nan)}
"""Covariance and rates of topics without a rate, and one with marks and missing numbers in turn."""


@pytest.mark.parametrize("absent", NONE)
@pytest.mark.parametrize("suffix", ["bag", "mcap"])
@pytest.mark.parametrize("is_first", [False, True])
def test_a_topic_whose_rates_are_all_nan_is_no_choice(tmp_path, suffix, absent, is_first):
    """Drivers that do not mark what is absent leave it NaN: the log was refused as ambiguous."""
    mark, rate = NONE[absent]
    own = {"angular_velocity_covariance": np.full(9, mark)}
    without = np.broadcast_to(rate, RATE.shape)
    if absent == "both":
        without = np.where(np.arange(50)[:, None] % 2, 0.1, without)
    parts = [("/b", *m[1:]) for m in imu_messages(STAMPS, RATE)]
    parts[0 if is_first else len(parts) : 0] = [
        ("/a", kind, t_ns, values | (own if absent != "both" or k % 2 else {}))
        for k, (_, kind, t_ns, values) in enumerate(imu_messages(STAMPS, without))
    ]
    path = write_messages(tmp_path / f"log.{suffix}", parts)
    assert remarks(path, tmp_path) == ["ignored rates that are all absent: '/a'"]
    with pytest.warns(RemarkWarning, match="all absent"):
        assert np.array_equal(read_rates(path).rate, RATE)
    assert len(read_rates(path, topic="/b").t_ns) == len(STAMPS)


def test_rates_that_begin_late_are_still_a_choice(tmp_path, monkeypatch):
    """Unless they begin behind the part that is looked at, whose length is stated."""
    late = np.where(np.arange(50)[:, None] < 49, np.nan, RATE)
    parts = [
        (topic, *rest)
        for topic, own in (("/late", late), ("/gyro", RATE))
        for _, *rest in imu_messages(STAMPS, own)
    ]
    path = write_messages(tmp_path / "log.mcap", sorted(parts, key=lambda part: part[2]))
    with pytest.raises(AmbiguousTopicError, match="'/gyro', '/late'; choose one with topic"):
        read_rates(path)
    monkeypatch.setattr(column_readings, "ENOUGH_ROWS", 40)
    with pytest.warns(RemarkWarning, match="absent in the first 40 samples: '/late'"):
        assert np.array_equal(read_rates(path).rate, RATE)


@pytest.mark.parametrize("suffix", ["csv", "parquet", "jsonl", "npz"])
@pytest.mark.parametrize("absent", [["imu1_gyro"], ["imu0_gyro", "imu2_gyro"]])
def test_columns_of_rates_without_a_number_are_no_choice(tmp_path, suffix, absent):
    """A logger with a sensor that is not fitted: the log was refused as ambiguous."""
    sets = [f"imu{k}_gyro" for k in range(2 if len(absent) == 1 else 3)]
    columns = {"timestamp_us": (STAMPS - T0) // 1000}
    for name in sets:
        own = RATE * (np.nan if name in absent else 1)
        columns |= {f"{name}_{axis} [rad/s]": own[:, k] for k, axis in enumerate("xyz")}
    path = tmp_path / f"log.{suffix}"
    frame = pd.DataFrame(columns)
    if suffix == "npz":
        np.savez(path, **columns)
    elif suffix == "jsonl":
        frame.to_json(path, orient="records", lines=True, double_precision=15)
    else:
        frame.to_csv(path, index=False) if suffix == "csv" else frame.to_parquet(path)
    names = ", ".join(
        f"'{','.join(f'{name}_{axis} [rad/s]' for axis in 'xyz')}'" for name in absent
    )
    said = f"ignored rates that are absent in the first 50 rows: {names}"
    with pytest.warns(RemarkWarning, match=re.escape(said)):
        # Of JSON with 15 digits.
        assert np.allclose(read_rates(path).rate, RATE, rtol=1e-14, atol=0)


def test_rates_of_which_some_are_marked_as_absent_are_a_matter_of_policy(tmp_path):
    """They are dropped or held as asked; a field that is named is read as it is."""
    path = bag(tmp_path / "log.bag", marks=(0.5, -1.0))
    with pytest.raises(TimelineError, match=r"sample 1 .* is absent or not finite; choose"):
        remarks(path, tmp_path)
    with pytest.warns(RemarkWarning, match="are read anyway"):
        assert len(read_rates(path, rate_field="angular_velocity").t_ns) == 50
    with pytest.warns(RemarkWarning), pytest.warns(DataLossWarning, match="25 rows were dropped"):
        propagate(path, on_nonfinite="drop")


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_rates_of_a_table_that_are_all_marked_as_absent_are_named(tmp_path, suffix):
    """For files as for messages."""
    names = [f"angular_velocity.{axis}" for axis in "xyz"]
    columns = {"header.stamp.sec": range(30), "header.stamp.nanosec": 0, "o": 1.0}
    frame = pd.DataFrame(columns).assign(**dict.fromkeys(names, 0.1))
    frame["angular_velocity_covariance[0]"] = -1.0
    path = tmp_path / f"log.{suffix}"
    frame.to_csv(path, index=False) if suffix == "csv" else frame.to_parquet(path)
    with pytest.raises(TimelineError) as caught:
        read_rates(path)
    assert str(caught.value) == (
        f"{path}: all rates are marked as absent, by a covariance of -1 in column "
        "'angular_velocity_covariance[0]'; if they were measured anyway, read them with "
        "rate_cols='angular_velocity.x,angular_velocity.y,angular_velocity.z'"
    )
    with pytest.warns(RemarkWarning, match="marks as absent are read anyway, as requested"):
        rates = read_rates(path, rate_cols=",".join(names))
    assert np.isfinite(rates.rate).all()
