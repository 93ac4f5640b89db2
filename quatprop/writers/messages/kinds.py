"""Message types in which attitudes can be written: types, topics, frames.

A position or translation is zero if the attitudes have none. The message's frame is the reference
frame; the child frame of a transform is the body, so that it maps body to reference as the attitude
does, and so is the frame of an Imu. Covariances are about reference axes, as ROS defines them;
zeros mean an unknown covariance, -1 an unknown value. All of these types define the quaternion as
x, y, z, w: there is no other layout.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quatprop.errors import UsageError
from quatprop.text import listed, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping


class MessageType(NamedTuple):
    """One row of :data:`MESSAGES`.

    `name`: full name of the type in ROS 2 or Foxglove's schemas
    `parts`: its fields in order: ``stamp``, ``frame``, ``child``, the number of elements ``count``,
        ``position`` and ``xyzw``, or a ``pose`` of both; the ``covariance`` of the orientation, or
        ``pose_covariance`` with it; ``rate``, ``acceleration`` and the covariance of each
    `topic`: its usual topic
    """

    name: str
    parts: tuple[str, ...]
    topic: str = "/attitude"

    @property
    def has_covariance(self) -> bool:
        """Whether it has a covariance of the orientation."""
        return not {"covariance", "pose_covariance"}.isdisjoint(self.parts)

    @property
    def is_ros(self) -> bool:
        """Whether it is a ROS message; otherwise it is one of Foxglove's own, in protobuf."""
        return "/" in self.name


MESSAGES: Mapping[str, MessageType] = {
    "QuaternionStamped": MessageType(
        "geometry_msgs/msg/QuaternionStamped", ("stamp", "frame", "xyzw")
    ),
    "PoseStamped": MessageType(
        "geometry_msgs/msg/PoseStamped", ("stamp", "frame", "position", "xyzw")
    ),
    "TFMessage": MessageType(
        "tf2_msgs/msg/TFMessage", ("count", "stamp", "frame", "child", "position", "xyzw"), "/tf"
    ),
    "PoseWithCovarianceStamped": MessageType(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        ("stamp", "frame", "position", "xyzw", "pose_covariance"),
    ),
    "Imu": MessageType(
        "sensor_msgs/msg/Imu",
        (
            *("stamp", "child", "xyzw", "covariance", "rate", "rate_covariance"),
            *("acceleration", "acceleration_covariance"),
        ),
    ),
    "FrameTransform": MessageType(
        "foxglove.FrameTransform", ("stamp", "frame", "child", "position", "xyzw"), "/tf"
    ),
    "PoseInFrame": MessageType("foxglove.PoseInFrame", ("stamp", "frame", "pose")),
}
"""All message types in which attitudes can be written."""


class Message(NamedTuple):
    """The type, topic and frames of attitude messages.

    `type`: a key of :data:`MESSAGES`, or the full name of a type
    `topic`: None is the usual one: ``/attitude``, or ``/tf`` for transforms
    `frame`: name of the reference frame
    `child`: name of the body frame
    """

    type: str = "QuaternionStamped"
    topic: str | None = None
    frame: str = "reference"
    child: str = "body"

    @property
    def definition(self) -> MessageType:
        """The type's row of :data:`MESSAGES`."""
        short = self.type.replace(".", "/").rpartition("/")[2]
        if short not in MESSAGES or self.type not in _names(MESSAGES[short].name):
            raise UsageError(
                f"attitudes cannot be written as {quoted(self.type)}; choose {listed(MESSAGES)}"
            )
        return MESSAGES[short]

    @property
    def topic_name(self) -> str:
        """The given or the usual topic."""
        return self.topic or self.definition.topic


def _names(name: str) -> tuple[str, ...]:
    """Return the short name, the full name and the ROS 1 name of a type."""
    package, _, short = name.replace(".", "/msg/").split("/")
    return short, name, f"{package}/{short}"
