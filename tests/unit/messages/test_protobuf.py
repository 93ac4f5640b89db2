"""Protobuf messages: fields by the descriptors that the log carries."""

import sys

import numpy as np
import pytest
from make.mcap import Topic, write_topics
from make.protobuf import DOUBLE, FLOAT, FOXGLOVE, UINT64, described, file_of, made, stamp_file
from make.reading import found_in, rates

from quatprop.errors import SchemaError
from quatprop.logs.clocks.stamps import place_of, stamps_of
from quatprop.messages.blocks import Channel

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
    data = [m if isinstance(m, bytes) else m.SerializeToString() for m in messages]
    return write_topics(path, {"/t": Topic(type_name, data, schema, "protobuf", "protobuf")})


def channel_of(schema, type_name="foxglove.Odometry"):
    """Return a channel of protobuf messages."""
    return Channel("/t", type_name, "protobuf", "protobuf", schema)


def test_an_odometry_of_foxglove_is_a_rate_that_was_estimated(tmp_path):
    """The velocity is optional: what is not set is not finite. A message that is none is lost."""
    files = (FOXGLOVE, stamp_file())
    odometry = made("foxglove.Odometry", *files)
    messages = [odometry(frame_id="a" * position) for position in range(3)]
    for position, message in enumerate(messages):
        message.timestamp.seconds, message.timestamp.nanos = 1_700_000_000, position + 1
    messages[0].angular_velocity.x, messages[0].angular_velocity.z = 0.1, -3
    messages[2].angular_velocity.SetInParent()
    messages += [b"\xff\xff", odometry()]
    path = write(tmp_path / "log.mcap", "foxglove.Odometry", described(*files), messages)
    source, series, (loss,) = rates(path)
    assert (source.field, source.clock) == ("angular_velocity", "header")
    assert series.t_ns.tolist() == [1_700_000_000_000_000_000 + k for k in (1, 2, 3)]
    np.testing.assert_array_equal(series.rate, [[0.1, 0, -3], [np.nan] * 3, [0, 0, 0]])
    assert loss.messages == 2
    assert "recorded at 3000 ns and 1 others cannot be decoded as protobuf" in loss.reason


def test_any_field_can_be_named(tmp_path):
    """Types that contain themselves do no harm."""
    gyro = made("own.Gyro", OWN)
    messages = [gyro(us=k, rate={"a": k, "b": 0.5, "c": 0.25}, many=[1]) for k in (5, 6)]
    path = write(tmp_path / "log.mcap", "own.Gyro", described(OWN), messages)
    options = {"time_field": "us", "time_unit": "us", "rate_unit": "rad/s"}
    for name in ("rate", "rate.a,rate.b,rate.c"):
        _, series, _ = rates(path, rate_field=name, **options)
        assert series.t_ns.tolist() == [5000, 6000]
        assert series.rate.tolist() == [[5, 0.5, 0.25], [6, 0.5, 0.25]]
    with pytest.raises(SchemaError, match=r"'many' of 'own\.Gyro' is not"):
        rates(path, rate_field="many", **options)


def test_descriptors_that_lack_an_import_are_refused():
    """The sentence says what was left out."""
    lacking = file_of("foxglove", {"Odometry": {"pose": ".other.Pose"}}, ["other.proto"])
    with pytest.raises(
        SchemaError,
        match=r"^log: topic '/t': the file descriptors that the log carries cannot be read, or do "
        r"not define 'foxglove.Odometry'; record it with all files that it imports$",
    ):
        found_in(channel_of(described(lacking)))


def test_the_time_stamp_of_protobuf_itself_may_be_left_out():
    """As protoc does without --include_imports; every program that reads protobuf knows it."""
    (whole,) = found_in(channel_of(described(FOXGLOVE, stamp_file())))
    assert [place_of(whole.table, stamp) for stamp in stamps_of(whole)] == ["timestamp"]
    (found,) = found_in(channel_of(described(FOXGLOVE)))
    assert found[1:] == whole[1:]


def test_without_the_library_the_extra_is_named(monkeypatch):
    """Other topics can still be read."""
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    with pytest.raises(
        SchemaError,
        match=r"^log: topic '/t': 'foxglove.Odometry' is encoded as protobuf, which needs the "
        r"package protobuf; pip install protobuf, or choose another topic$",
    ):
        found_in(channel_of(b"none"))
    assert found_in(channel_of(b"Odometry", "foxglove.Grid")) == []
