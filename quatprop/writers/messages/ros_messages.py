"""Encode blocks of attitudes as ROS messages.

The strings are the same in every message, so all messages have the same layout, and a block is an
array of records. rosbags would encode one message at a time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import OutputError
from quatprop.kinematics.uncertainty import reference_covariance
from quatprop.times import NS_PER_S
from quatprop.writers.messages.topics import ros_topic

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from quatprop.arrays import Int64, Records
    from quatprop.series import AttitudeSeries
    from quatprop.writers.messages.kinds import Message


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
