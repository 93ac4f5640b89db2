"""Encode blocks of attitudes as Foxglove's own messages in protobuf.

Protobuf encoders usually omit numbers that are zero and use as few bytes as a number needs. Neither
is required: here every number is written, and those of a timestamp in five bytes each, as most of
them need. So all messages have the same layout, and a block is an array of records. The protobuf
library, an optional dependency, would encode one message at a time; the tests compare the bytes of
messages and descriptors with the library's.

References
----------
The protobuf guides "Encoding" and "Language guide (proto 3)", and ``descriptor.proto``.
The schemas FrameTransform and PoseInFrame of https://docs.foxglove.dev/docs/visualization/message-schemas
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import OutputError
from quatprop.times import NS_PER_S
from quatprop.writers.messages.topics import Topic

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.arrays import Float64, Int64, Records
    from quatprop.series import AttitudeSeries
    from quatprop.writers.messages.kinds import Message


VARINT, FIXED64, LENGTH = 0, 1, 2
"""Wire types: a number with 7 bits per byte, eight bytes, or length-prefixed bytes."""

_TYPES = {"double": 1, "int64": 3, "int32": 5, "string": 9}
_MESSAGE = 11
_OPTIONAL = 1
"""Numbers in ``descriptor.proto`` of field types, and of the label of fields that are no lists."""

CURVES: Mapping[str, tuple[str, ...]] = {
    "quatprop.Rates": ("x_rad_s", "y_rad_s", "z_rad_s"),
    "quatprop.Error": ("angle_deg", "x_deg", "y_deg", "z_deg"),
}
"""Messages with only numbers, which viewers plot against log time: names of the fields."""

_DEFINITIONS: Mapping[str, Mapping[str, str]] = {
    **{name: dict.fromkeys(fields, "double") for name, fields in CURVES.items()},
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

    `name`: ``"foxglove.FrameTransform"``, ``"foxglove.PoseInFrame"`` or a key of :data:`CURVES`
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


def curve_messages(values: Float64) -> Records:
    """Return messages with only numbers, shape ``(N,)``, from values, shape ``(N, fields)``."""
    numbers = range(1, values.shape[1] + 1)
    fields = [field for n in numbers for field in ((f"tag {n}", "u1"), (f"{n}", "<f8"))]
    rows = np.empty(len(values), fields)
    for number, column in zip(numbers, values.T, strict=True):
        rows[f"tag {number}"] = tag(number, FIXED64)[0]
        rows[f"{number}"] = column
    return rows


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
