"""Attitudes as Foxglove's own messages, encoded in protobuf by the block.

Protobuf encoders usually leave out numbers that are zero and use as few bytes as a number needs.
Neither is required: here every number is written, and those of a time stamp in five bytes each, as
most of them need. So every message has its fields in the same places, and a block is an array of
records. The protobuf library, an optional dependency, would encode one message at a time; the tests
compare the bytes of messages and descriptors with the library's.

References
----------
The protobuf guides "Encoding" and "Language guide (proto 3)", and ``descriptor.proto``.
The schemas FrameTransform and PoseInFrame of https://docs.foxglove.dev/docs/visualization/message-schemas
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.errors import OutputError
from quatprop.writers.messages.topics import Topic

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.arrays import Int64, Records
    from quatprop.series import AttitudeSeries
    from quatprop.writers.messages.kinds import Message


VARINT, FIXED64, LENGTH = 0, 1, 2
"""Wire types: a number of 7 bits a byte, eight bytes, or bytes after their length."""

_TYPES = {"double": 1, "int64": 3, "int32": 5, "string": 9}
_MESSAGE = 11
_OPTIONAL = 1
"""Numbers in ``descriptor.proto``: of types, and of the label of a field that is not a list."""


class ProtoFile(NamedTuple):
    """A file of definitions in proto 3.

    Parameters
    ----------
    package
        What its types are in.
    imports
        Names of the files that define what it uses.
    messages
        Types by name: their fields in order, numbered from 1, with a scalar type or, after a dot,
        the full name of a message.
    """

    package: str
    imports: tuple[str, ...]
    messages: Mapping[str, Mapping[str, str]]


def varint(number: int) -> bytes:
    """Return a number that is not negative, seven bits a byte, the lowest first.

    Examples
    --------
    >>> varint(300).hex()
    'ac02'
    """
    parts = []
    while number > 0x7F:  # noqa: PLR2004  # what fits seven bits
        parts.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*parts, number])


def tag(number: int, wire: int) -> bytes:
    """Return the tag that a field begins with."""
    return varint(number << 3 | wire)


def delimited(number: int, content: bytes | str) -> bytes:
    """Return a field of bytes, text, or a message in a message.

    Examples
    --------
    >>> delimited(2, "map").hex()
    '12036d6170'
    """
    data = content.encode() if isinstance(content, str) else content
    return tag(number, LENGTH) + varint(len(data)) + data


def described(files: Mapping[str, ProtoFile]) -> bytes:
    """Return a ``FileDescriptorSet``, the form of a schema in MCAP.

    Parameters
    ----------
    files
        By name, each after those that it imports.
    """
    return b"".join(delimited(1, _file(name, file)) for name, file in files.items())


def _file(name: str, file: ProtoFile) -> bytes:
    parts = [delimited(1, name), delimited(2, file.package)]
    parts += [delimited(3, imported) for imported in file.imports]
    parts += [delimited(4, _message_descriptor(*message)) for message in file.messages.items()]
    return b"".join([*parts, delimited(12, "proto3")])


def _message_descriptor(name: str, fields: Mapping[str, str]) -> bytes:
    numbered: Iterable[tuple[int, tuple[str, str]]] = enumerate(fields.items(), 1)
    parts = (delimited(2, _field_descriptor(*field, number)) for number, field in numbered)
    return delimited(1, name) + b"".join(parts)


def _field_descriptor(name: str, kind: str, number: int) -> bytes:
    parts = [
        delimited(1, name),
        tag(3, VARINT) + varint(number),
        tag(4, VARINT) + varint(_OPTIONAL),
        tag(5, VARINT) + varint(_TYPES.get(kind, _MESSAGE)),
    ]
    return b"".join(parts if kind in _TYPES else [*parts, delimited(6, kind)])


NS_PER_S = 1_000_000_000
_VARINT_BYTES = 5
"""Enough for nanoseconds below a second, and for seconds to the year 2262, where int64 ns end."""

_TIMESTAMP = "google/protobuf/timestamp.proto"
_QUATERNION = "foxglove/Quaternion.proto"
_VECTOR = "foxglove/Vector3.proto"
_POSE = "foxglove/Pose.proto"

FILES: Mapping[str, ProtoFile] = {
    _TIMESTAMP: ProtoFile(
        "google.protobuf", (), {"Timestamp": {"seconds": "int64", "nanos": "int32"}}
    ),
    _QUATERNION: ProtoFile("foxglove", (), {"Quaternion": dict.fromkeys("xyzw", "double")}),
    _VECTOR: ProtoFile("foxglove", (), {"Vector3": dict.fromkeys("xyz", "double")}),
    _POSE: ProtoFile(
        "foxglove",
        (_QUATERNION, _VECTOR),
        {"Pose": {"position": ".foxglove.Vector3", "orientation": ".foxglove.Quaternion"}},
    ),
    "foxglove/FrameTransform.proto": ProtoFile(
        "foxglove",
        (_QUATERNION, _VECTOR, _TIMESTAMP),
        {
            "FrameTransform": {
                "timestamp": ".google.protobuf.Timestamp",
                "parent_frame_id": "string",
                "child_frame_id": "string",
                "translation": ".foxglove.Vector3",
                "rotation": ".foxglove.Quaternion",
            }
        },
    ),
    "foxglove/PoseInFrame.proto": ProtoFile(
        "foxglove",
        (_POSE, _TIMESTAMP),
        {
            "PoseInFrame": {
                "timestamp": ".google.protobuf.Timestamp",
                "frame_id": "string",
                "pose": ".foxglove.Pose",
            }
        },
    ),
}
"""The definitions, each after those that it imports."""


def schema_of(name: str) -> bytes:
    """Return the definition of a type with all that it uses, as a ``FileDescriptorSet``.

    Parameters
    ----------
    name
        ``"foxglove.FrameTransform"`` or ``"foxglove.PoseInFrame"``.
    """
    used = [name.replace(".", "/") + ".proto"]
    for file in used:
        used += [imported for imported in FILES[file].imports if imported not in used]
    return described({file: FILES[file] for file in FILES if file in used})


class FoxgloveEncoder:
    """Encodes attitudes as one of Foxglove's own messages; see :class:`.encoders.AttitudeEncoder`.

    Parameters
    ----------
    message
        What to encode.

    Attributes
    ----------
    topic
        The topic and its definition.
    """

    holds_positions = False

    def __init__(self, message: Message) -> None:
        name = message.definition.name
        self.topic = Topic(message.topic_name, name, "protobuf", "protobuf", schema_of(name))
        template = b"".join(
            delimited(number, _field(part, message))
            for number, part in enumerate(message.definition.parts, 1)
        )
        # All of them begin with the stamp and end with the quaternion.
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
        """Return the messages of a batch, shape ``(N,)``.

        Raises
        ------
        OutputError
            A stamp is before 1970; the error names the target.
        """
        if len(series) and series.t_ns.min() < 0:
            raise OutputError(
                target,
                f"MCAP has no time for the stamp {series.t_ns[(series.t_ns < 0).argmax()]} ns; "
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
    # The high bit of all but the last says that more follow.
    varints = (spread | 0x80808080).astype("<i8", copy=False)
    return varints.view(np.uint8).reshape(-1, varints.itemsize)[:, :_VARINT_BYTES]


_STAMP = tag(1, VARINT) + bytes(_VARINT_BYTES) + tag(2, VARINT) + bytes(_VARINT_BYTES)
_ROTATION = b"".join(tag(number, FIXED64) + bytes(8) for number in range(1, 5))
_ORIGIN = b""
"""A vector of zeros is an empty message."""


def _field(part: str, message: Message) -> bytes | str:
    """Return a field of a message, with zeros for what differs from message to message."""
    content: Mapping[str, bytes | str] = {
        "stamp": _STAMP,
        "frame": message.frame,
        "child": message.child,
        "position": _ORIGIN,
        "xyzw": _ROTATION,
        "pose": delimited(1, _ORIGIN) + delimited(2, _ROTATION),
    }
    return content[part]
