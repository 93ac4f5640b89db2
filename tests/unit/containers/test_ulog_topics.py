"""Topics of PX4 ULog files: named without their only instance, and those of the estimators."""

import struct

import pytest
from click.testing import CliRunner

from quatprop.cli.commands import cli
from quatprop.errors import AmbiguousTopicError, NoSuchTopicError
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.attitudes import choose_attitudes
from quatprop.logs.signals.rates import choose_rates
from quatprop.settings.selection import AttitudeSelection, RateSelection

COUNT = 5


def record(kind, content):
    """Return one record."""
    return struct.pack("<Hc", len(content), kind) + content


def write(path, topics):
    """Write attitudes at rest, one topic instance after the other, with their instance as z."""
    begin = b"ULog\x01\x12\x35\x01" + bytes(8) + record(b"B", bytes(40))
    for topic in dict.fromkeys(topic for topic, _ in topics):
        fields = "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;"
        begin += record(b"F", f"{topic}:{fields}".encode())
    for number, (topic, instance) in enumerate(topics):
        begin += record(b"A", struct.pack("<BH", instance, number) + topic.encode())
        for k in range(COUNT):
            stamp = 4000 * k + 4000
            q = (1.0, 0.0, 0.0, instance * 1e-4)
            begin += record(b"D", struct.pack("<HQQ4f", number, stamp + 9, stamp, *q))
    path.write_bytes(begin)
    return path


def chosen(path, **options):
    """Return the attitudes of a log and their stamps."""
    with open_log(path) as log:
        signal = choose_attitudes(log, AttitudeSelection(**options))
        (batch,) = signal.rows()
    return signal, batch[0].tolist()


@pytest.mark.parametrize(
    "topic", ["estimator_attitude", "external_ins_attitude", "vehicle_attitude_groundtruth"]
)
def test_attitudes_of_estimators_are_those_of_the_vehicle_s_message(tmp_path, topic):
    """PX4 publishes one message under several names."""
    signal, t_ns = chosen(write(tmp_path / "log.ulg", [(topic, 0)]))
    assert (signal.name, signal.type_name) == (f"{topic}/0", "px4_msgs/msg/VehicleAttitude")
    assert signal.layout == "scalar-first"
    assert t_ns == [4_000_000 * k for k in range(1, COUNT + 1)]


def test_the_vehicle_s_attitude_comes_before_those_of_its_estimators(tmp_path):
    """What is ignored is said; estimators among themselves are ambiguous, and can be chosen."""
    topics = [("estimator_attitude", 0), ("estimator_attitude", 1), ("vehicle_attitude", 0)]
    path = write(tmp_path / "log.ulg", topics)
    signal, _ = chosen(path)
    assert signal.name == "vehicle_attitude/0"
    assert signal.remarks[-1] == (
        "ignored secondary attitudes: 'estimator_attitude/0', 'estimator_attitude/1'"
    )
    assert chosen(path, topic="estimator_attitude/1")[0].name == "estimator_attitude/1"
    with pytest.raises(AmbiguousTopicError, match="'estimator_attitude/0', 'estimator_attitude/1'"):
        chosen(write(tmp_path / "two.ulg", topics[:2]))


def test_the_only_instance_of_a_topic_need_not_be_named(tmp_path, shared_logs):
    """One of several has to be."""
    flight = shared_logs / "ulog" / "sample.ulg"
    with open_log(flight) as log:
        assert choose_rates(log, RateSelection(topic="sensor_combined")).name == "sensor_combined/0"
    assert chosen(write(tmp_path / "one.ulg", [("vehicle_attitude", 3)]),
                  topic="vehicle_attitude")[0].name == "vehicle_attitude/3"  # fmt: skip
    two = write(tmp_path / "two.ulg", [("estimator_attitude", 0), ("estimator_attitude", 1)])
    with pytest.raises(
        NoSuchTopicError,
        match=r"no topic 'estimator_attitude' that carries attitudes; choose one of "
        r"'estimator_attitude/0', 'estimator_attitude/1'; did you mean 'estimator_attitude/0'\?$",
    ):
        chosen(two, topic="estimator_attitude")


def test_the_command_line_takes_it_everywhere(tmp_path, shared_logs):
    """Also where the log is read again, as for a copy with attitudes."""
    flight = str(shared_logs / "ulog" / "sample.ulg")
    out = tmp_path / "out.csv"
    for arguments in (
        ["info", flight, "-t", "sensor_combined"],
        ["propagate", flight, "-t", "sensor_combined", "-o", str(out)],
        ["convert", flight, str(out), "-t", "vehicle_attitude", "--layout", "wxyz"],
        ["compare", flight, flight, "--topic-a", "vehicle_attitude", "--topic-b",
         "vehicle_attitude/0", "--tol", "1e-9rad"],
    ):  # fmt: skip
        result = CliRunner().invoke(cli, arguments)
        assert result.exit_code == 3, result.output  # the flight has dropouts
