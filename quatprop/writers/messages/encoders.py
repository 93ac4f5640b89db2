"""Attitudes encoded as messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from quatprop.errors import UsageError
from quatprop.text import listed, quoted
from quatprop.writers.messages.foxglove_messages import FoxgloveEncoder
from quatprop.writers.messages.kinds import MESSAGES, Message
from quatprop.writers.messages.ros_messages import RosEncoder

if TYPE_CHECKING:
    from collections.abc import Collection


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
            "messages; write mcap, or choose "
            f"{listed(name for name, definition in MESSAGES.items() if definition.is_ros)}"
        )
    return FoxgloveEncoder(message)


AttitudeEncoder: TypeAlias = RosEncoder | FoxgloveEncoder
"""Encodes attitudes as one type of message: a topic, whether positions are written, and `encode`,
which returns the messages of a batch."""
