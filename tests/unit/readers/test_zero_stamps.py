"""Header stamps that were never set, or set wrongly: zero in every message, or beyond a second."""

import json

import numpy as np
import pytest
from make.commands import run
from make.px4_messages import write_mcap
from make.reading import attitudes, rates
from make.ros import ROS1, imu_messages, write_messages
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quatprop import RemarkWarning, read_rates
from quatprop.base.errors import TimelineError, UsageError
from quatprop.readers import matching

STORE = get_typestore(Stores.LATEST)
NAME = "pkg/msg/Motion"
TEXT = "std_msgs/Header header\nsensor_msgs/Imu imu\n"
STORE.register(get_types_from_msg(TEXT, NAME))
PAIR = "pkg/msg/Pair"
STORE.register(get_types_from_msg("sensor_msgs/Imu left\nsensor_msgs/Imu right\n", PAIR))
T0 = 1_700_000_000_000_000_000
GOOD = [T0 + k * 10_000_000 for k in range(40)]
ZERO = [0] * 40
RECORDED = [t_ns + 77 for t_ns in GOOD]
REFUSED = "all header timestamps of topic '/imu' are zero; for the time of recording choose "


def write(path, inner, outer=None):
    """Write Imus, perhaps inside of messages with stamps of their own."""
    rates, wxyz = [(0.5, 0.0, 0.0)] * len(inner), [(0.8, 0.0, 0.0, 0.6)] * len(inner)
    messages = imu_messages(inner, rates, wxyz, recorded=RECORDED)
    if outer is not None:
        messages = [
            (topic, NAME, logged_ns, {"header": {"stamp": stamp_ns}, "imu": imu})
            for (topic, _, logged_ns, imu), stamp_ns in zip(messages, outer, strict=True)
        ]
    return write_messages(path, messages, types=(ROS1, STORE))


@pytest.fixture
def path(tmp_path):
    """Where a test writes its log."""
    return tmp_path / "log.mcap"


def stamps_of(path, **options):
    """Return the stamps of the rates, which are those of the attitudes, and the remarks on them."""
    source, series, _ = rates(path, **options)
    other, t_ns, _, _ = attitudes(path, **options)
    assert (series.t_ns.tolist(), source.remarks) == (t_ns.tolist(), other.remarks)
    return t_ns.tolist(), source.remarks


def test_the_stamp_of_the_message_around_stands_in_for_one_that_is_zero(path):
    """It is used for rates and attitudes, and said; where only some are zero, it is not."""
    remark = "the timestamps in 'imu.header.stamp' are all zero; those in 'header.stamp' are used"
    assert stamps_of(write(path, ZERO, GOOD)) == (GOOD, (remark,))
    later = [0, 0, *(t_ns + 5 for t_ns in GOOD[2:])]
    assert stamps_of(write(path, later, GOOD)) == (later, ())
    # A recording may begin at 0.
    assert stamps_of(write(path, [0])) == ([0], ())


def test_a_number_stands_in_for_one_that_is_zero_in_all_messages(path):
    """Both are named as fields of the message."""
    messages = [{"timestamp": 1000 * k} for k in range(1, 9)]
    source, series, _ = rates(write_mcap(path, "SensorGyro", messages))
    assert series.t_ns.tolist() == [1_000_000 * k for k in range(1, 9)]
    remark = "the timestamps in 'timestamp_sample' are all zero; those in 'timestamp' are used"
    assert remark in source.remarks


def test_stamps_are_not_all_zero_if_those_of_a_later_chunk_are_set(path, monkeypatch):
    """They are looked for behind the rows that are held for other questions, too."""
    monkeypatch.setattr(matching, "ENOUGH_ROWS", 1)
    later = [0] * 30 + GOOD[30:]
    assert stamps_of(write(path, later, GOOD)) == (later, ())


@pytest.mark.parametrize("outer", [None, ZERO])
def test_stamps_that_are_all_zero_are_refused(path, outer):
    """In rates and attitudes; the time of recording is a choice."""
    write(path, ZERO, outer)
    for read, options in ((rates, {}), (rates, {"clock": "header"}), (attitudes, {})):
        with pytest.raises(TimelineError, match=REFUSED + "clock='log'"):
            read(path, **options)
    assert stamps_of(path, clock="log") == (RECORDED, ())


def test_messages_without_stamps_have_the_time_of_recording(path):
    """A header is refused with that way out."""
    vectors = [("/w", "geometry_msgs/msg/Vector3", t, {"x": 0.5}) for t in GOOD]
    options = {"rate_field": "x,y,z", "rate_unit": "rad/s"}
    write_messages(path, vectors)
    assert rates(path, **options)[1].t_ns.tolist() == GOOD
    with pytest.raises(UsageError, match="have no header timestamp; choose clock='log' or"):
        rates(path, clock="header", **options)


def test_of_two_rates_in_a_message_one_is_named(path):
    """Each has a stamp of its own."""
    pairs = [
        ("/pair", PAIR, t, dict.fromkeys(("left", "right"), imu))
        for t, (_, _, _, imu) in zip(GOOD, imu_messages(GOOD, [(0.5, 0, 0)] * 40), strict=True)
    ]
    write_messages(path, pairs, types=(ROS1, STORE))
    both = "'left.angular_velocity', 'right.angular_velocity'; choose one with rate_field"
    with pytest.raises(UsageError, match=f"messages of topic '/pair' carry several .*: {both}"):
        rates(path)
    assert rates(path, rate_field="left.angular_velocity")[1].t_ns.tolist() == GOOD


def test_an_orientation_that_is_first_set_after_very_many_messages_is_a_placeholder(path):
    """It is looked for in as many, and not in all of a log of hours."""
    stamps, wxyz = range(1, 4001), [(1.0, 0.0, 0.0, 0.0)] * 3999 + [(0.0, 1.0, 0.0, 0.0)]
    write_messages(path, imu_messages(stamps, [(0.5, 0.0, 0.0)] * 4000, wxyz))
    for limit in (4000, 1000):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("quatprop.readers.attitude_signals.CONSTANT_MESSAGES", limit)
            assert attitudes(path)[0].placeholder == (limit == 1000)


def test_every_command_says_so(path, tmp_path):
    """Exit code 2, and no output; info shows the source all the same."""
    good, out = write(tmp_path / "good.mcap", GOOD), tmp_path / "out.csv"
    write(path, ZERO)
    for arguments, option in (
        (["propagate", path, "-o", out], "--clock log"),
        (["convert", path, out], "--clock log"),
        (["compare", good, path], "--clock-b log"),
        (["plot", path, "-o", tmp_path / "out.svg"], "--clock log"),
    ):
        assert REFUSED + option in run(*arguments, code=2).stderr
    assert not out.exists()
    (facts,) = json.loads(run("info", "--json", path).stdout)
    for kind in ("sources", "attitudes"):
        assert facts[kind][0]["missing"] == REFUSED + "clock='log'"


@pytest.mark.parametrize(("count", "said"), [(1, []), (2, ["2 of 40 header timestamps are zero"])])
def test_a_comparison_counts_stamps_of_zero(path, tmp_path, count, said):
    """Some stamps of a series were never set: they match nothing, and that has a reason."""
    write(path, [0] * count + GOOD[count:])
    good = write(tmp_path / "good.mcap", GOOD)
    report = json.loads(run("compare", good, path, "--json").stdout)
    assert report["a"]["remarks"] == []
    assert report["b"]["remarks"] == said


@pytest.mark.parametrize("name", ["log.bag", "log.mcap", "log"])
def test_nanoseconds_of_more_than_a_second_are_told(tmp_path, name):
    """Stamps of a second and more in the field of nanoseconds were taken without a word."""
    parts = range(900_000_000, 1_500_000_000, 10_000_000)
    headers = [{"stamp": (7, part), "frame_id": "imu"} for part in parts]
    messages = [
        (topic, kind, at, values | {"header": header})
        for (topic, kind, at, values), header in zip(
            imu_messages(T0 + np.array(parts)), headers, strict=True
        )
    ]
    path = write_messages(tmp_path / name, messages)
    with pytest.warns(RemarkWarning, match="the fraction of a second, reaches a second or more"):
        found = read_rates(path)
    assert found.t_ns.tolist() == [7 * 10**9 + part for part in parts]
    assert read_rates(path, clock="log").t_ns[0] == T0 + parts[0]
