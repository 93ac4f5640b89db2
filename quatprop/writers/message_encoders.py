"""Topics to be written, with the message types and definitions of ROS releases."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

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
