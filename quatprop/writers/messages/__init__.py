"""Attitudes as encoded ROS and Foxglove messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.errors import UsageError
from quatprop.text import listed, quoted
from quatprop.writers.messages.kinds import MESSAGES

if TYPE_CHECKING:
    from collections.abc import Collection

    from quatprop.writers.messages.foxglove_messages import FoxgloveEncoder
    from quatprop.writers.messages.kinds import Message
    from quatprop.writers.messages.ros_messages import RosEncoder

    AttitudeEncoder = RosEncoder | FoxgloveEncoder
    """Encodes attitudes as messages of one type: has a topic, whether positions are written, and
    `encode`, which returns the messages of a batch."""


def attitude_encoder(message: Message, encodings: Collection[str]) -> AttitudeEncoder:
    """Return the encoder of a message for a container.

    `encodings`: encodings of the container: ``"cdr"`` or ``"ros1"``, and ``"protobuf"``
    """
    if message.definition.is_ros:
        from quatprop.writers.messages.ros_messages import RosEncoder

        return RosEncoder(message, ros1="ros1" in encodings)
    if "protobuf" not in encodings:
        raise UsageError(
            f"{quoted(message.type)} is Foxglove's own, in protobuf, and ROS bags hold ROS "
            "messages; write mcap, or choose "
            f"{listed(name for name, definition in MESSAGES.items() if definition.is_ros)}"
        )
    from quatprop.writers.messages.foxglove_messages import FoxgloveEncoder

    return FoxgloveEncoder(message)
