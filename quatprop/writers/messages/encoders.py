"""Attitudes encoded as messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from quatprop.errors import UsageError
from quatprop.kinematics.uncertainty import reference_covariance
from quatprop.text import listed, quoted
from quatprop.writers.messages.foxglove_messages import FoxgloveEncoder
from quatprop.writers.messages.kinds import MESSAGES
from quatprop.writers.messages.ros_records import HEADER_TIME, RosRecords
from quatprop.writers.messages.topics import ros_topic

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping
    from pathlib import Path

    from quatprop.arrays import Records
    from quatprop.series import AttitudeSeries
    from quatprop.writers.messages.kinds import Message


ABSENT = (-1.0, *[0.0] * 8)
"""The covariance of a part of an Imu message that is not known."""


def attitude_encoder(message: Message, encodings: Collection[str]) -> AttitudeEncoder:
    """Return the encoder of a message for a container.

    Parameters
    ----------
    message
        What to encode.
    encodings
        What the container takes: ``"cdr"`` or ``"ros1"``, and ``"protobuf"``.

    Raises
    ------
    UsageError
        There is no such message, or the container does not take its encoding.
    """
    if message.definition.is_ros:
        return RosEncoder(message, ros1="ros1" in encodings)
    if "protobuf" not in encodings:
        raise UsageError(
            f"{quoted(message.type)} is Foxglove's own, in protobuf, and ROS bags hold ROS "
            "messages; write mcap, or choose ",
            listed(name for name, definition in MESSAGES.items() if definition.is_ros),
        )
    return FoxgloveEncoder(message)


class RosEncoder:
    """Encodes attitudes as a ROS message.

    Parameters
    ----------
    message
        What to encode.
    ros1
        Whether as in ROS 1 rather than in CDR, as in ROS 2.
    constants
        What parts are in every message; others are zero where they are not written.
    """

    def __init__(
        self, message: Message, *, ros1: bool, constants: Mapping[str, object] | None = None
    ) -> None:
        definition = message.definition
        self.topic = ros_topic(message.topic_name, definition.name, ros1=ros1)
        formats: dict[str, str | bytes] = {
            "stamp": HEADER_TIME,
            "frame": message.frame.encode(),
            "child": message.child.encode(),
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
        self._has_covariance = definition.has_covariance
        self.holds_positions = "position" in definition.parts
        fields = {part: formats[part] for part in definition.parts}
        constants = constants or {"count": 1, "acceleration_covariance": ABSENT}
        self._records = RosRecords(
            fields, {name: constants[name] for name in constants if name in fields}, ros1=ros1
        )
        self._parts = definition.parts

    def encode(self, series: AttitudeSeries, target: Path | str) -> Records:
        """Return the messages of a batch."""
        rows = self._records.stamped(series.t_ns, target)
        rows["xyzw"][:, :3], rows["xyzw"][:, 3] = series.wxyz[:, 1:], series.wxyz[:, 0]
        if self.holds_positions and series.position is not None:
            rows["position"] = series.position
        if series.covariance is not None and self._has_covariance:
            covariance = reference_covariance(series.wxyz, series.covariance)
            if "covariance" in self._parts:
                rows["covariance"] = covariance
            else:
                rows["pose_covariance"][:, 3:, 3:] = covariance
        if "rate" in self._parts:
            if series.rate is None:
                rows["rate_covariance"] = ABSENT
            else:
                rows["rate"] = series.rate
        return rows


AttitudeEncoder: TypeAlias = RosEncoder | FoxgloveEncoder
"""Encodes attitudes as one type of message: a topic, whether positions are written, and `encode`,
which returns the messages of a batch."""
