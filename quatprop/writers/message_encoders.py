"""Attitudes as encoded messages: their topics, and the types of ROS and Foxglove."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quatprop.base.errors import OutputError
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.quaternion import reference_covariance

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray
    from rosbags.typesys.store import Typestore

    from quatprop.base.arrays import Int64, Records
    from quatprop.kinematics.series import AttitudeSeries
    from quatprop.writers.formats import Message


_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms"

PROFILES = {"cdr": "ros2", "ros1": "ros1"}
"""The MCAP profile of a file whose messages all have one encoding."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic to be written.

    `type_name`: message type in the release's spelling: ``package/msg/Name`` in ROS 2,
        ``package/Name`` in ROS 1
    `encoding`: message encoding: ``"cdr"``, ``"ros1"`` or ``"protobuf"``
    `schema_encoding`, `schema`: the definition: ``"ros2msg"``, ``"ros1msg"`` or ``"protobuf"``, and
        its text or bytes
    `digest`: hash of the definition: MD5 in ROS 1, RIHS01 in ROS 2, otherwise empty
    """

    name: str
    type_name: str
    encoding: str
    schema_encoding: str
    schema: bytes
    digest: str = ""


@cache
def ros1_types() -> Typestore:
    """Return the definitions of ROS 1 Noetic and TFMessage, which the library lacks."""
    types = get_typestore(Stores.ROS1_NOETIC)
    types.register(get_types_from_msg(_TRANSFORMS, "tf2_msgs/msg/TFMessage"))
    return types


@cache
def ros2_types() -> Typestore:
    """Return the definitions of ROS 2 Humble."""
    return get_typestore(Stores.ROS2_HUMBLE)


def ros_topic(name: str, type_name: str, *, ros1: bool) -> Topic:
    """Return a topic of ROS messages."""
    if ros1:
        definition, md5sum = ros1_types().generate_msgdef(type_name)
        short = type_name.replace("/msg/", "/")
        return Topic(name, short, "ros1", "ros1msg", definition.encode(), md5sum)
    types = ros2_types()
    definition, _ = types.generate_msgdef(type_name, ros_version=2)
    digest = types.hash_rihs01(type_name)
    return Topic(name, type_name, "cdr", "ros2msg", definition.encode(), digest)


# Encode blocks of attitudes as ROS messages.
#
# The strings are the same in every message, so all messages have the same layout, and a block is an
# array of records. rosbags would encode one message at a time.


ABSENT = (-1.0, *[0.0] * 8)
"""The covariance that marks an unknown part of an Imu message."""

_CDR_LITTLE_ENDIAN = b"\0\1\0\0"
_FORMATS = {
    "count": "<u4",
    "position": "3<f8",
    "xyzw": "4<f8",
    "pose_covariance": "(6,6)<f8",
    "covariance": "(3,3)<f8",
    "rate": "3<f8",
    "rate_covariance": "9<f8",
    "acceleration": "3<f8",
    "acceleration_covariance": "9<f8",
}
"""NumPy formats of the numeric parts of messages."""


class RosEncoder:
    """Encodes attitudes as a ROS message.

    `ros1`: whether in the encoding of ROS 1 rather than CDR, little-endian, of ROS 2
    `constants`: constant values of parts; other parts that are not written are zero
    """

    def __init__(
        self, message: Message, *, ros1: bool, constants: Mapping[str, object] | None = None
    ) -> None:
        definition = message.definition
        self.topic = ros_topic(message.topic_name, definition.name, ros1=ros1)
        self.holds_positions = "position" in definition.parts
        self._has_covariance = definition.has_covariance
        self._ros1 = ros1
        self._written = 0
        fields = list(_fields(message, ros1=ros1))
        # CDR begins with four bytes that state the encoding. Behind them it aligns each number to
        # its size, as C does; ROS 1 packs its fields.
        begin = b"" if ros1 else _CDR_LITTLE_ENDIAN
        body = np.dtype([(name, form) for name, form, _ in fields], align=not ros1)
        self._names = [name for name, *_ in fields]
        places = [body.fields[name] for name in self._names] if body.fields else []
        self._dtype: np.dtype[np.void] = np.dtype(
            {
                "names": self._names,
                "formats": [kind for kind, *_ in places],
                "offsets": [len(begin) + offset for _, offset, *_ in places],
            }
        )
        template = np.zeros(1, self._dtype)
        template.view("u1")[: len(begin)] = list(begin)
        for name, _, value in fields:
            if value is not None:
                template[name] = value
        for name, value in (constants or {"count": 1, "acceleration_covariance": ABSENT}).items():
            if name in self._names:
                template[name] = value
        # As plain bytes, so that NumPy copies all of it, with the padding, at once.
        self._template = template.view(f"V{self._dtype.itemsize}")

    def encode(self, series: AttitudeSeries, target: Path | str) -> Records:
        """Return the messages of a batch, shape ``(N,)``; see :meth:`_stamped` for the errors."""
        rows = self._stamped(series.t_ns, target)
        rows["xyzw"][:, :3], rows["xyzw"][:, 3] = series.wxyz[:, 1:], series.wxyz[:, 0]
        if self.holds_positions and series.position is not None:
            rows["position"] = series.position
        if series.covariance is not None and self._has_covariance:
            covariance = reference_covariance(series.wxyz, series.covariance)
            if "covariance" in self._names:
                rows["covariance"] = covariance
            else:
                rows["pose_covariance"][:, 3:, 3:] = covariance
        if "rate" in self._names:
            if series.rate is None:
                rows["rate_covariance"] = ABSENT
            else:
                rows["rate"] = series.rate
        return rows

    def _stamped(self, t_ns: Int64, target: Path | str) -> Records:
        """Return messages with their timestamps, ``(N,)``, and other fields not filled yet."""
        seconds, nanoseconds = np.divmod(t_ns, NS_PER_S)
        outside = (seconds < 0) | (seconds > np.iinfo(np.int32).max)
        if outside.any():
            raise OutputError(
                target,
                f"ROS cannot represent the timestamp {t_ns[outside.argmax()]} ns; "
                "write a table, or a trajectory",
            )
        rows = np.repeat(self._template, len(t_ns)).view(self._dtype)
        rows["sec"], rows["nanosec"] = seconds, nanoseconds
        if self._ros1:
            rows["seq"] = np.arange(self._written, self._written + len(t_ns), dtype=np.uint64)
        self._written += len(t_ns)
        return rows


def _fields(message: Message, *, ros1: bool) -> Iterator[tuple[str, str, object | None]]:
    """Yield the name, format and constant value (or None) of each field, in order."""
    for part in message.definition.parts:
        if part == "stamp":
            # In ROS 1 a sequence number precedes it.
            for name in ("seq", "sec", "nanosec") if ros1 else ("sec", "nanosec"):
                yield name, "<u4", None
        elif part in _FORMATS:
            yield part, _FORMATS[part], None
        else:
            # In CDR the length of a string includes its terminating zero.
            text = (message.frame if part == "frame" else message.child).encode()
            text += b"" if ros1 else b"\0"
            yield f"{part}_length", "<u4", len(text)
            if text:
                yield part, f"V{len(text)}", np.void(text)


# Encode blocks of attitudes as Foxglove's own messages in protobuf.
#
# Protobuf encoders usually omit numbers that are zero and use as few bytes as a number needs.
# Neither is required: here every number is written, and those of a timestamp in five bytes each, as
# most of them need. So all messages have the same layout, and a block is an array of records. The
# protobuf library, an optional dependency, would encode one message at a time; the tests compare
# the bytes of messages and descriptors with the library's.
#
# Reference: The protobuf guides "Encoding" and "Language guide (proto 3)", and
# ``descriptor.proto``. The schemas FrameTransform and PoseInFrame of
# https://docs.foxglove.dev/docs/visualization/message-schemas


VARINT, FIXED64, LENGTH = 0, 1, 2
"""Wire types: a number with 7 bits per byte, eight bytes, or length-prefixed bytes."""

_TYPES = {"double": 1, "int64": 3, "int32": 5, "string": 9}
_MESSAGE = 11
_OPTIONAL = 1
"""Numbers in ``descriptor.proto`` of field types, and of the label of fields that are not lists."""

_DEFINITIONS: Mapping[str, Mapping[str, str]] = {
    "google.protobuf.Timestamp": {"seconds": "int64", "nanos": "int32"},
    "foxglove.Quaternion": dict.fromkeys("xyzw", "double"),
    "foxglove.Vector3": dict.fromkeys("xyz", "double"),
    "foxglove.Pose": {"position": "foxglove.Vector3", "orientation": "foxglove.Quaternion"},
    "foxglove.FrameTransform": {
        "timestamp": "google.protobuf.Timestamp",
        "parent_frame_id": "string",
        "child_frame_id": "string",
        "translation": "foxglove.Vector3",
        "rotation": "foxglove.Quaternion",
    },
    "foxglove.PoseInFrame": {
        "timestamp": "google.protobuf.Timestamp",
        "frame_id": "string",
        "pose": "foxglove.Pose",
    },
}
"""Names and types of the fields of each message, numbered from 1; used types come first."""


def varint(number: int) -> bytes:
    """Return a non-negative number as a varint: seven bits per byte, the lowest first."""
    parts = []
    while number > 0x7F:  # noqa: PLR2004  # the largest number of seven bits
        parts.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*parts, number])


def tag(number: int, wire: int) -> bytes:
    """Return the tag of a field."""
    return varint(number << 3 | wire)


def delimited(number: int, content: bytes | str) -> bytes:
    """Return a field of bytes, text, or a nested message."""
    data = content.encode() if isinstance(content, str) else content
    return tag(number, LENGTH) + varint(len(data)) + data


def schema_of(name: str) -> bytes:
    """Return the definitions of a type and of the types in it, as a ``FileDescriptorSet``.

    `name`: ``"foxglove.FrameTransform"`` or ``"foxglove.PoseInFrame"``
    """
    used = [name]
    for one in used:
        used += [kind for kind in _DEFINITIONS[one].values() if kind in _DEFINITIONS]
    return b"".join(delimited(1, _file(one)) for one in _DEFINITIONS if one in used)


def _file(name: str) -> bytes:
    """Return the ``FileDescriptorProto`` of one message, in proto 3."""
    package, _, short = name.rpartition(".")
    fields = _DEFINITIONS[name].items()
    imported = sorted(_file_name(kind) for _, kind in fields if kind in _DEFINITIONS)
    descriptors = (delimited(2, _field_descriptor(k, *one)) for k, one in enumerate(fields, 1))
    return b"".join(
        (
            delimited(1, _file_name(name)),
            delimited(2, package),
            *(delimited(3, file) for file in imported),
            delimited(4, delimited(1, short) + b"".join(descriptors)),
            delimited(12, "proto3"),
        )
    )


def _file_name(name: str) -> str:
    *folders, own = name.split(".")
    # The names of Google's files are in lower case.
    return "/".join([*folders, own.lower() if "google" in folders else own]) + ".proto"


def _field_descriptor(number: int, name: str, kind: str) -> bytes:
    parts = (
        delimited(1, name),
        tag(3, VARINT) + varint(number),
        tag(4, VARINT) + varint(_OPTIONAL),
        tag(5, VARINT) + varint(_TYPES.get(kind, _MESSAGE)),
        b"" if kind in _TYPES else delimited(6, f".{kind}"),
    )
    return b"".join(parts)


_VARINT_BYTES = 5
"""Enough for nanoseconds below a second, and for seconds to the year 2262, where int64 ns end."""


class FoxgloveEncoder:
    """Encodes attitudes as one of Foxglove's own messages, as :class:`.RosEncoder` does ROS's."""

    holds_positions = False

    def __init__(self, message: Message) -> None:
        name = message.definition.name
        self.topic = Topic(message.topic_name, name, "protobuf", "protobuf", schema_of(name))
        # Values that differ from message to message are zero in the template.
        content: Mapping[str, bytes | str] = {
            "stamp": _STAMP,
            "frame": message.frame,
            "child": message.child,
            "position": _ORIGIN,
            "xyzw": _ROTATION,
            "pose": delimited(1, _ORIGIN) + delimited(2, _ROTATION),
        }
        template = b"".join(
            delimited(number, content[part])
            for number, part in enumerate(message.definition.parts, 1)
        )
        # All messages begin with the timestamp and end with the quaternion.
        doubles = len(template) - len(_ROTATION) + 1
        seconds = len(delimited(1, _STAMP)) - len(_STAMP) + 1
        self._dtype = np.dtype(
            {
                "names": ["seconds", "nanos", *"xyzw"],
                "formats": [f"{_VARINT_BYTES}u1"] * 2 + ["<f8"] * 4,
                "offsets": [
                    seconds,
                    seconds + _VARINT_BYTES + 1,
                    *range(doubles, len(template), 9),
                ],
                "itemsize": len(template),
            }
        )
        self._template = np.frombuffer(template, f"V{len(template)}")

    def encode(self, series: AttitudeSeries, target: Path | str) -> Records:
        """Return the messages of a batch, shape ``(N,)``."""
        if len(series) and series.t_ns.min() < 0:
            raise OutputError(
                target,
                f"MCAP cannot represent the timestamp {series.t_ns[(series.t_ns < 0).argmax()]} "
                "ns; "
                "write a table, or a trajectory",
            )
        rows = np.repeat(self._template, len(series)).view(self._dtype)
        seconds, nanos = np.divmod(series.t_ns, NS_PER_S)
        rows["seconds"], rows["nanos"] = _varints(seconds), _varints(nanos)
        for place, name in enumerate("wxyz"):
            rows[name] = series.wxyz[:, place]
        return rows


def _varints(numbers: Int64) -> NDArray[np.uint8]:
    """Return numbers as varints of one length, shape ``(N, 5)``."""
    spread = numbers & 0x7F
    for place in range(1, _VARINT_BYTES):
        spread |= numbers << place & 0x7F << 8 * place
    # The high bit of all bytes but the last is set.
    varints = (spread | 0x80808080).astype("<i8", copy=False)
    return varints.view(np.uint8).reshape(-1, varints.itemsize)[:, :_VARINT_BYTES]


_STAMP = tag(1, VARINT) + bytes(_VARINT_BYTES) + tag(2, VARINT) + bytes(_VARINT_BYTES)
_ROTATION = b"".join(tag(number, FIXED64) + bytes(8) for number in range(1, 5))
_ORIGIN = b""
"""A vector of zeros is an empty message."""
