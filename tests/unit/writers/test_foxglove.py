"""Attitudes as Foxglove's own messages in MCAP, against the library of protobuf."""

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from make.mcap_doctor import examine
from make.writing import write_series
from mcap.reader import make_reader

from quatprop.base.errors import OutputError
from quatprop.kinematics.series import AttitudeSeries
from quatprop.writers import open_writer
from quatprop.writers.formats import MESSAGES, Message
from quatprop.writers.message_encoders import FoxgloveEncoder, schema_of

NAMES = [name for name, known in MESSAGES.items() if not known.is_ros]
FIELD = descriptor_pb2.FieldDescriptorProto
START = 1_700_000_000_000_000_000
STAMPS = [0, 1, 127 * 10**9 + 127, 2**28 * 10**9, START, START + 999_999_999, 2**63 - 1]

# Names, numbers and types, as the schemas are published.
PUBLISHED = {
    "google.protobuf.Timestamp": [("seconds", 1, "INT64", ""), ("nanos", 2, "INT32", "")],
    "foxglove.Quaternion": [(name, n, "DOUBLE", "") for n, name in enumerate("xyzw", 1)],
    "foxglove.Vector3": [(name, n, "DOUBLE", "") for n, name in enumerate("xyz", 1)],
    "foxglove.Pose": [
        ("position", 1, "MESSAGE", "foxglove.Vector3"),
        ("orientation", 2, "MESSAGE", "foxglove.Quaternion"),
    ],
    "foxglove.FrameTransform": [
        ("timestamp", 1, "MESSAGE", "google.protobuf.Timestamp"),
        ("parent_frame_id", 2, "STRING", ""),
        ("child_frame_id", 3, "STRING", ""),
        ("translation", 4, "MESSAGE", "foxglove.Vector3"),
        ("rotation", 5, "MESSAGE", "foxglove.Quaternion"),
    ],
    "foxglove.PoseInFrame": [
        ("timestamp", 1, "MESSAGE", "google.protobuf.Timestamp"),
        ("frame_id", 2, "STRING", ""),
        ("pose", 3, "MESSAGE", "foxglove.Pose"),
    ],
}


def attitudes(stamps):
    """Return attitudes with every bit in use and with zeros, at given stamps."""
    wxyz = np.random.default_rng(3).standard_normal((len(stamps), 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    wxyz[0] = [1, 0, -0.0, 0]
    return AttitudeSeries(np.array(stamps), wxyz)


def pool_of(name):
    """Return the definitions of a type, as the library takes them from its schema, in order."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema_of(f"foxglove.{name}")).file:
        pool.Add(file)
    return pool


@pytest.mark.parametrize("name", NAMES)
def test_the_definitions_are_those_that_are_published(name):
    """Every type that a schema holds has the fields, numbers and types of its publisher."""
    files = descriptor_pb2.FileDescriptorSet.FromString(schema_of(f"foxglove.{name}")).file
    pool = pool_of(name)
    types = {f"{file.package}.{kind.name}" for file in files for kind in file.message_type}
    assert f"foxglove.{name}" in types
    for full in types:
        fields = pool.FindMessageTypeByName(full).fields
        assert [
            (
                f.name,
                f.number,
                FIELD.Type.Name(f.type)[5:],
                getattr(f.message_type, "full_name", ""),
            )
            for f in fields
        ] == PUBLISHED[full]
        assert not any(field.is_repeated or field.is_required for field in fields)
    assert {file.syntax for file in files} == {"proto3"}


def test_the_time_is_that_of_the_library():
    """Name, package and fields of google/protobuf/timestamp.proto are its own."""
    files = descriptor_pb2.FileDescriptorSet.FromString(schema_of("foxglove.PoseInFrame")).file
    (ours,) = (file for file in files if file.name == timestamp_pb2.DESCRIPTOR.name)
    theirs = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(theirs)
    theirs.ClearField("options")
    for field in theirs.message_type[0].field:
        field.ClearField("json_name")
    assert ours == theirs


@pytest.mark.parametrize("frame", ["", "m", "a" * 127, "ø" * 64, "b" * 20_000])
@pytest.mark.parametrize("name", NAMES)
def test_the_library_reads_every_bit(name, frame):
    """Stamps of any size, names of any length, zeros and signs of zeros come out as they were."""
    series = attitudes(STAMPS)
    rows = FoxgloveEncoder(Message(name, frame=frame, child=frame[:130])).encode(series, "a")
    kind = message_factory.GetMessageClass(pool_of(name).FindMessageTypeByName(f"foxglove.{name}"))
    for row, stamp, wxyz in zip(rows, STAMPS, series.wxyz, strict=True):
        found = kind.FromString(row.tobytes())
        assert (found.timestamp.seconds, found.timestamp.nanos) == divmod(stamp, 10**9)
        if name == "FrameTransform":
            assert (found.parent_frame_id, found.child_frame_id) == (frame, frame[:130])
            assert found.HasField("translation")
            assert not found.translation.ListFields()
            rotation = found.rotation
        else:
            assert found.frame_id == frame
            assert found.pose.HasField("position")
            assert not found.pose.position.ListFields()
            rotation = found.pose.orientation
        components = np.array([rotation.w, rotation.x, rotation.y, rotation.z])
        assert components.tobytes() == wxyz.tobytes()
        # Nothing is there that the definition does not know.
        found.DiscardUnknownFields()
        assert kind.FromString(found.SerializeToString()) == found


@pytest.mark.parametrize("name", [*NAMES, "foxglove.FrameTransform"])
def test_an_mcap_file_declares_them(tmp_path, name):
    """Topic, encodings and the definition are there; the file claims no profile."""
    write_series(tmp_path / "a.mcap", attitudes(STAMPS), message=Message(name))
    assert examine(tmp_path / "a.mcap").counts == {1: len(STAMPS)}
    short = name.rpartition(".")[2]
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == ""
        found = list(reader.iter_messages())
    assert [message.log_time for _, _, message in found] == STAMPS
    schema, channel, _ = found[0]
    assert (schema.name, schema.encoding) == (f"foxglove.{short}", "protobuf")
    assert schema.data == schema_of(f"foxglove.{short}")
    assert channel.message_encoding == "protobuf"
    assert channel.topic == {"FrameTransform": "/tf", "PoseInFrame": "/attitude"}[short]


@pytest.mark.parametrize("name", NAMES)
def test_a_stamp_before_1970_is_refused(tmp_path, name):
    """MCAP has no negative times, and nothing is left behind."""
    series = attitudes([5, -1])
    words = r"/a\.mcap: MCAP cannot represent the timestamp -1 ns; write a table, or a trajectory$"
    with (
        open_writer(tmp_path / "a.mcap", message=Message(name)) as writer,
        pytest.raises(OutputError, match=words),
    ):
        writer.write(series)
    assert list(tmp_path.iterdir()) == []
