"""How MCAP declares what attitudes are written as: profile, encodings, definition."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quatprop.writers.messages.foxglove_messages import FoxgloveEncoder, schema_of
from quatprop.writers.messages.ros_messages import Encoder
from quatprop.writers.messages.ros_types import ros1_types, ros2_types

if TYPE_CHECKING:
    from quatprop.writers.messages.kinds import Message


class Declared(NamedTuple):
    """What MCAP needs to know about messages.

    Parameters
    ----------
    profile
        Of a file that holds nothing else.
    encoder
        Encodes the attitudes.
    encoding
        How messages are encoded.
    schema_name, schema_encoding, schema
        Their definition.
    """

    profile: str
    encoder: Encoder | FoxgloveEncoder
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


def declared(message: Message, *, ros1: bool = False) -> Declared:
    """Return how MCAP declares a kind of message.

    Parameters
    ----------
    message
        What the attitudes are written as.
    ros1
        Whether ROS messages are encoded as ROS 1 does, in a file that holds such.

    Raises
    ------
    UsageError
        There is no such kind.
    """
    name = message.definition.name
    if message.definition.is_ros and ros1:
        definition, _ = ros1_types().generate_msgdef(name)
        encoder = Encoder(message, ros1=True)
        short = name.replace("/msg/", "/")
        return Declared("ros1", encoder, "ros1", short, "ros1msg", definition.encode())
    if message.definition.is_ros:
        definition, _ = ros2_types().generate_msgdef(name, ros_version=2)
        return Declared("ros2", Encoder(message), "cdr", name, "ros2msg", definition.encode())
    schema = schema_of(name)
    return Declared("", FoxgloveEncoder(message), "protobuf", name, "protobuf", schema)
