"""The definitions of the messages that are written, as the ROS releases have them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms"


def ros1_types() -> Typestore:
    """Return the definitions of ROS 1 Noetic, with that of transforms, which the library lacks."""
    types = get_typestore(Stores.ROS1_NOETIC)
    types.register(get_types_from_msg(_TRANSFORMS, "tf2_msgs/msg/TFMessage"))
    return types


def ros2_types() -> Typestore:
    """Return the definitions of ROS 2 Humble."""
    return get_typestore(Stores.ROS2_HUMBLE)
