"""Message definitions of PX4 ULog files, under the names that the same messages have in ROS 2.

A definition is one line, ``name:type field;type[3] field;``; fields are packed, little endian. The
messages are those of px4_msgs, so one table serves both.

References
----------
PX4 user guide, "ULog File Format".
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from quatprop.messages.schema import (
    MAX_DEPTH,
    Array,
    BadDefinitionError,
    Primitive,
    Struct,
    Unknown,
)
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.containers.base import Channel
    from quatprop.messages.schema import Type

NUMBERS: Mapping[str, Primitive] = {
    "int8_t": Primitive("i1"),
    "uint8_t": Primitive("u1"),
    "int16_t": Primitive("i2"),
    "uint16_t": Primitive("u2"),
    "int32_t": Primitive("i4"),
    "uint32_t": Primitive("u4"),
    "int64_t": Primitive("i8"),
    "uint64_t": Primitive("u8"),
    "float": Primitive("f4"),
    "double": Primitive("f8"),
    "bool": Primitive("b1"),
    "char": Primitive("u1"),
}
"""Names of numbers in definitions."""

MESSAGE_OF_TOPIC: Mapping[str, str] = {
    **dict.fromkeys(
        ("estimator_attitude", "external_ins_attitude", "vehicle_attitude_groundtruth"),
        "vehicle_attitude",
    ),
    **dict.fromkeys(
        ("estimator_odometry", "vehicle_mocap_odometry", "vehicle_visual_odometry"),
        "vehicle_odometry",
    ),
}
"""Topics with the message of another topic, as the TOPICS lines of PX4 declare."""

_FIELD = re.compile(r"([\w/-]+)(?:\[(\d+)\])? ([\w\[\]]+)", re.ASCII)


def px4_name(name: str) -> str:
    """Return the ROS 2 type of a topic's messages.

    Examples
    --------
    >>> px4_name("sensor_gyro_fifo")
    'px4_msgs/msg/SensorGyroFifo'
    >>> px4_name("estimator_attitude")
    'px4_msgs/msg/VehicleAttitude'
    """
    message = MESSAGE_OF_TOPIC.get(name, name)
    return "px4_msgs/msg/" + "".join(part.capitalize() for part in message.split("_"))


def is_secondary(channel: Channel) -> bool:
    """Tell whether a topic of a ULog has the message of another, main topic."""
    return channel.encoding == "ulog" and channel.topic.partition("/")[0] in MESSAGE_OF_TOPIC


def message_type(channel: Channel) -> Struct:
    """Return the type of a channel's messages.

    Parameters
    ----------
    channel
        Its schema is the definition, on the first line, and those of types inside it.

    Raises
    ------
    BadDefinitionError
        It cannot be read.
    """
    lines = channel.schema.decode("utf-8", "replace").splitlines()
    definitions = dict(line.split(":", 1) for line in lines if ":" in line)
    if not definitions:
        raise BadDefinitionError(f"the log carries no definition of {quoted(channel.type_name)}")
    return _struct(next(iter(definitions)), definitions, {}, 0)


def _struct(
    name: str, definitions: Mapping[str, str], made: dict[str, Struct], depth: int
) -> Struct:
    """Return a type, built once however often it is named: nested types multiply quickly."""
    if name in made:
        return made[name]
    if depth > MAX_DEPTH:
        raise BadDefinitionError(f"the definition of {quoted(name)} contains itself")
    fields = []
    for text in filter(None, definitions[name].split(";")):
        match = _FIELD.fullmatch(text.strip())
        if match is None:
            raise BadDefinitionError(
                f"the definition of {quoted(name)} has a field that cannot be read: {quoted(text)}"
            )
        kind, length, own = match.groups()
        element: Type
        if kind in NUMBERS:
            element = NUMBERS[kind]
        elif kind in definitions:
            element = _struct(kind, definitions, made, depth + 1)
        else:
            element = Unknown(kind)
        fields.append((own, element if length is None else Array(element, int(length))))
    made[name] = Struct(px4_name(name), tuple(fields))
    return made[name]
