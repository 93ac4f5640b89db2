"""The messages that attitudes can be written as: types, topics, frames.

A position or translation is zero where the attitudes have none. The message's frame is the
reference; the child of a transform is the body, so that it maps body to reference, as the attitude
does, and so is the frame of an Imu. Covariances are about the axes of the reference, as ROS defines
them; zeros say that one is not known, and -1 that the value itself is not. All of these types
define the quaternion as x, y, z, w: there is no other layout.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quatprop.errors import UsageError
from quatprop.text import listed, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping


class MessageType(NamedTuple):
    """One row of :data:`MESSAGES`.

    `name`: the type, as ROS 2 names it, or as Foxglove does
    `parts`: its fields in order: ``stamp``, ``frame``, ``child``, the number of elements ``count``,
        ``position`` and ``xyzw``, or a ``pose`` of both; the ``covariance`` of the orientation, or
        ``pose_covariance`` with it; ``rate``, ``acceleration`` and the covariance of each
    `topic`: the topic it is usually published under
    """

    name: str
    parts: tuple[str, ...]
    topic: str = "/attitude"

    @property
    def has_covariance(self) -> bool:
        """Whether it has a place for the covariance of the orientation."""
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
"""Every message that attitudes can be written as."""


class Message(NamedTuple):
    """The message that attitudes are written as, and its topic and frames.

    `type`: a key of :data:`MESSAGES`, or its full name
    `topic`: none is the usual one: ``/attitude``, or ``/tf`` for transforms
    `frame`: name of the reference
    `child`: name of the body
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
        """The topic, given or usual."""
        return self.topic or self.definition.topic


def _names(name: str) -> tuple[str, ...]:
    """Return the names of a type: short, in full, and as in ROS 1."""
    package, _, short = name.replace(".", "/msg/").split("/")
    return short, name, f"{package}/{short}"
