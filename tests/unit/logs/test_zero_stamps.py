"""Header stamps that were never set: zero in every message."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quatprop.cli.commands import cli
from quatprop.errors import TimelineError
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.attitudes import choose_attitudes
from quatprop.logs.signals.rates import choose_rates
from quatprop.settings.selection import AttitudeSelection, RateSelection

STORE = get_typestore(Stores.LATEST)
NAME = "pkg/msg/Motion"
TEXT = "std_msgs/Header header\nsensor_msgs/Imu imu\n"
STORE.register(get_types_from_msg(TEXT, NAME))
T0 = 1_700_000_000_000_000_000
STEP_NS = 10_000_000
COUNT = 40
TYPES = STORE.types


def header(stamp_ns):
    """Return a header with a stamp."""
    return TYPES["std_msgs/msg/Header"](
        TYPES["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9)), "imu"
    )


def imu(stamp_ns):
    """Return an Imu that spins about x."""
    vector, zeros = TYPES["geometry_msgs/msg/Vector3"], np.zeros(9)
    attitude = TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, 0.8)
    return TYPES["sensor_msgs/msg/Imu"](
        header(stamp_ns),
        attitude,
        zeros,
        vector(0.5, 0.0, 0.0),
        zeros,
        vector(0.0, 0.0, 9.8),
        zeros,
    )


def write(path, messages, name):
    """Write messages as a ROS 2 MCAP file, recorded every 10 ms from T0 + 77 on."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        text = TEXT if name == NAME else ""
        schema = writer.register_schema(name, "ros2msg", text.encode())
        channel = writer.register_channel("/imu", "cdr", schema)
        for k, message in enumerate(messages):
            data = bytes(STORE.serialize_cdr(message, name))
            writer.add_message(channel, T0 + k * STEP_NS + 77, data, T0 + k * STEP_NS + 77)
        writer.finish()
    return path


def nested(path, outer, inner):
    """Write Imus inside messages, with the stamps of both."""
    pairs = zip(outer, inner, strict=True)
    messages = [TYPES[NAME](header(first), imu(second)) for first, second in pairs]
    return write(path, messages, NAME)


def plain(path, stamps):
    """Write Imus."""
    return write(path, [imu(stamp) for stamp in stamps], "sensor_msgs/msg/Imu")


GOOD = [T0 + k * STEP_NS for k in range(COUNT)]
ZERO = [0] * COUNT
REMARK = "the stamps in 'imu.header.stamp' are all zero; those in 'header.stamp' are used"
REFUSED = "all header stamps of topic '/imu' are zero; for the time of recording choose "


def stamps_of(path, **options):
    """Return the stamps of rates and attitudes, and the remarks on both."""
    with open_log(path) as log:
        rates = choose_rates(log, RateSelection(**options))
        attitudes = choose_attitudes(log, AttitudeSelection(**options))
        t_ns = np.concatenate([batch.t_ns for batch in rates.batches()])
        other = np.concatenate([t_ns for t_ns, _ in attitudes.rows()])
    return t_ns.tolist(), other.tolist(), rates.remarks, attitudes.remarks


def test_the_stamp_of_the_message_around_stands_in_for_one_that_is_zero(tmp_path):
    """It is used for rates and attitudes, and said."""
    path = nested(tmp_path / "log.mcap", GOOD, ZERO)
    assert stamps_of(path) == (GOOD, GOOD, (REMARK,), (REMARK,))


def test_a_stamp_of_its_own_comes_first(tmp_path):
    """Also where some of the stamps are zero: that is another matter, remarked on elsewhere."""
    later = [0, 0, *(t_ns + 5 for t_ns in GOOD[2:])]
    path = nested(tmp_path / "log.mcap", GOOD, later)
    assert stamps_of(path) == (later, later, (), ())


def test_stamps_that_are_all_zero_are_refused(tmp_path):
    """In rates and attitudes; the time of recording is a choice."""
    logs = (
        plain(tmp_path / "plain.mcap", ZERO),
        nested(tmp_path / "nested.mcap", ZERO, ZERO),
    )
    recorded = [T0 + k * STEP_NS + 77 for k in range(COUNT)]
    for path in logs:
        with open_log(path) as log:
            for choose, selection in (
                (choose_rates, RateSelection()),
                (choose_rates, RateSelection(clock="header")),
                (choose_attitudes, AttitudeSelection()),
            ):
                with pytest.raises(TimelineError, match=REFUSED + "clock='log'"):
                    choose(log, selection)
        assert stamps_of(path, clock="log")[:2] == (recorded, recorded)


def test_one_message_at_zero_is_used(tmp_path):
    """A recording may begin at 0."""
    assert stamps_of(plain(tmp_path / "log.mcap", [0]))[0] == [0]


def test_every_command_says_so(tmp_path):
    """Exit code 2, and no output; info shows the source all the same."""
    path, good = plain(tmp_path / "log.mcap", ZERO), plain(tmp_path / "good.mcap", GOOD)
    out = tmp_path / "out.csv"
    for arguments, option in (
        (["propagate", path, "-o", out], "--clock log"),
        (["convert", path, out], "--clock log"),
        (["compare", good, path], "--clock-b log"),
        (["plot", path, "-o", tmp_path / "out.svg"], "--clock log"),
    ):
        result = CliRunner().invoke(cli, [*map(str, arguments)])
        assert result.exit_code == 2
        assert REFUSED + option in result.stderr
    assert not out.exists()
    result = CliRunner().invoke(cli, ["info", "--json", str(path)])
    (facts,) = json.loads(result.stdout)
    for kind in ("sources", "attitudes"):
        assert facts[kind][0]["missing"] == REFUSED + "clock='log'"
    batch = CliRunner().invoke(cli, ["batch", str(path), str(good), "-o", str(tmp_path / "all")])
    assert batch.exit_code == 2


def test_a_comparison_counts_stamps_of_zero(tmp_path):
    """Some stamps of a series were never set: they match nothing, and that has a reason."""
    path = plain(tmp_path / "log.mcap", [0, 0, 0, *GOOD[3:]])
    good = plain(tmp_path / "good.mcap", GOOD)
    result = CliRunner().invoke(cli, ["compare", str(good), str(path), "--json"])
    report = json.loads(result.stdout)
    assert report["a"]["remarks"] == []
    assert report["b"]["remarks"] == ["3 of 40 header stamps are zero"]
