"""Protobuf messages: fields by the descriptors that the log carries."""

import sys

import numpy as np
import pytest
from make.protobuf import DOUBLE, FLOAT, FOXGLOVE, UINT64, described, file_of, made, stamp_file
from make.reading import found_in
from mcap.writer import Writer

from quatprop.errors import SchemaError
from quatprop.logs.clocks.stamps import place_of, stamps_of
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.rates import choose_rates
from quatprop.messages.blocks import Channel
from quatprop.series import GyroSeries
from quatprop.settings.selection import RateSelection

OWN = file_of(
    "own",
    {
        "Node": {"next": ".own.Node", "others*": ".own.Node", "value": DOUBLE},
        "Gyro": {"us": UINT64, "rate": ".own.Rate", "tree": ".own.Node", "many*": FLOAT},
        "Rate": dict.fromkeys("abc", FLOAT),
    },
)


def write(path, type_name, schema, messages):
    """Write an MCAP file."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        id_ = writer.register_schema(type_name, "protobuf", schema)
        channel = writer.register_channel("/t", "protobuf", id_)
        for position, message in enumerate(messages):
            data = message if isinstance(message, bytes) else message.SerializeToString()
            writer.add_message(channel, position * 1000, data, position * 1000)
        writer.finish()
    return path


def read(path, **options):
    """Return the one source, its samples, and what was lost."""
    with open_log(path) as log:
        source = choose_rates(log, RateSelection(**options))
        return source, GyroSeries.joined(list(source.batches())), log.losses


def test_an_odometry_of_foxglove_is_a_rate_that_was_estimated(tmp_path):
    """The velocity is optional: what is not set is not finite. A message that is none is lost."""
    files = (FOXGLOVE, stamp_file())
    odometry = made("foxglove.Odometry", *files)
    messages = [odometry() for _ in range(3)]
    for position, message in enumerate(messages):
        message.timestamp.seconds = 1_700_000_000
        message.timestamp.nanos = position + 1
        message.frame_id = "a" * position
    messages[0].angular_velocity.x = 0.1
    messages[0].angular_velocity.z = -3
    messages[2].angular_velocity.SetInParent()
    path = write(
        tmp_path / "log.mcap", "foxglove.Odometry", described(*files),
        [*messages, b"\xff\xff", odometry()],
    )  # fmt: skip
    source, series, losses = read(path)
    assert source.field == "angular_velocity"
    assert source.clock == "header"
    assert series.t_ns.tolist() == [1_700_000_000_000_000_000 + k for k in (1, 2, 3)]
    assert series.rate[0].tolist() == [0.1, 0, -3]
    assert np.isnan(series.rate[1]).all()
    assert series.rate[2].tolist() == [0, 0, 0]
    (loss,) = losses
    assert loss.messages == 2
    assert "recorded at 3000 ns and 1 others cannot be decoded as protobuf" in loss.reason


def test_any_field_can_be_named(tmp_path):
    """Types that contain themselves do no harm."""
    gyro = made("own.Gyro", OWN)
    messages = [gyro(us=k, rate={"a": k, "b": 0.5, "c": 0.25}, many=[1]) for k in (5, 6)]
    path = write(tmp_path / "log.mcap", "own.Gyro", described(OWN), messages)
    options = {"time_field": "us", "time_unit": "us", "rate_unit": "rad/s"}
    for name in ("rate", "rate.a,rate.b,rate.c"):
        _, series, _ = read(path, rate_field=name, **options)
        assert series.t_ns.tolist() == [5000, 6000]
        assert series.rate.tolist() == [[5, 0.5, 0.25], [6, 0.5, 0.25]]
    with open_log(path) as log, pytest.raises(SchemaError, match=r"'many' of 'own\.Gyro' is not"):
        choose_rates(log, RateSelection(rate_field="many", **options))


def test_descriptors_that_lack_an_import_are_refused():
    """The sentence says what was left out."""
    lacking = file_of("foxglove", {"Odometry": {"pose": ".other.Pose"}}, ["other.proto"])
    channel = Channel("/t", "foxglove.Odometry", "protobuf", "protobuf", described(lacking))
    with pytest.raises(
        SchemaError,
        match=r"^log: topic '/t': the file descriptors that the log carries cannot be read, or do "
        r"not define 'foxglove.Odometry'; record it with all files that it imports$",
    ):
        found_in(channel)


def test_the_time_stamp_of_protobuf_itself_may_be_left_out():
    """As protoc does without --include_imports; every program that reads protobuf knows it."""
    names = "/t", "foxglove.Odometry", "protobuf", "protobuf"
    (whole,) = found_in(Channel(*names, described(FOXGLOVE, stamp_file())))
    assert [place_of(whole.table, stamp) for stamp in stamps_of(whole)] == ["timestamp"]
    (found,) = found_in(Channel(*names, described(FOXGLOVE)))
    assert found[1:] == whole[1:]


def test_without_the_library_the_extra_is_named(monkeypatch):
    """Other topics can still be read."""
    channel = Channel("/t", "foxglove.Odometry", "protobuf", "protobuf", b"none")
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    with pytest.raises(
        SchemaError,
        match=r"^log: topic '/t': 'foxglove.Odometry' is encoded as protobuf, which needs the "
        r"package protobuf; pip install protobuf, or choose another topic$",
    ):
        found_in(channel)
    other = Channel("/t", "foxglove.Grid", "protobuf", "protobuf", b"Odometry")
    assert found_in(other) == []
