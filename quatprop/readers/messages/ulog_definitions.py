"""Message definitions of PX4 ULog files, with the type names of the same messages in ROS 2.

A definition is one line, ``name:type field;type[3] field;``; fields are packed, little endian. The
messages are those of px4_msgs, so one vocabulary serves both.

References
----------
PX4 user guide, "ULog File Format".
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from quatprop.base.text import quoted
from quatprop.readers.messages.definitions import ARRAY, BASE, NAME, NUMBERS, TypeBuilder
from quatprop.readers.messages.schema import BadDefinitionError, Struct

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.readers.messages.blocks import Channel
    from quatprop.readers.messages.definitions import Fields, Kind

_NUMBERS = {
    **{f"{name}_t": name for name in NUMBERS if "int" in name},
    "float": "float32",
    "double": "float64",
    "bool": "bool",
    "char": "char",
}
"""ROS names of the number types, by their names in ULog definitions."""

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
"""Topics whose message is that of another topic, from the TOPICS lines of PX4."""

_MOST_BYTES = 1 << 16
"""Maximum size of a message, bytes: a record is shorter."""

_FIELD = r"(?a)([\w/-]+)(?:\[(\d+)\])? ([\w\[\]]+)"


def px4_name(name: str) -> str:
    """Return the ROS 2 type of a topic's messages."""
    message = MESSAGE_OF_TOPIC.get(name, name)
    return "px4_msgs/msg/" + "".join(part.capitalize() for part in message.split("_"))


def is_secondary(channel: Channel) -> bool:
    """Return whether a channel of a ULog has the message of another, main topic."""
    return channel.encoding == "ulog" and channel.topic.partition("/")[0] in MESSAGE_OF_TOPIC


def definition_text(name: str, formats: Mapping[str, str]) -> bytes:
    """Return the definitions of a message and of its nested types, one a line."""
    needed = [name] if name in formats else []
    for type_name in needed:
        words = dict.fromkeys(re.findall(r"\w+", formats[type_name]))
        needed += [word for word in words if word in formats and word not in needed]
    return "\n".join(f"{type_name}:{formats[type_name]}" for type_name in needed).encode()


def message_sizes(name: str, formats: Mapping[str, str]) -> tuple[int, int] | None:
    """Return the bytes of a message without and with the padding at its end; None if unknown."""
    sizes = {kind: NUMBERS[number].size for kind, number in _NUMBERS.items()}
    try:
        padded = _size(name, formats, sizes)
        *_, last = _matches(name, formats)
        padding = _size_of(last, formats, sizes) if last[3].startswith("_padding") else 0
        return (padded - padding, padded) if padded <= _MOST_BYTES else None
    except (BadDefinitionError, KeyError, RecursionError, ValueError):
        return None


def _size(name: str, formats: Mapping[str, str], sizes: dict[str, int]) -> int:
    if name not in sizes:
        fields = _matches(name, formats)
        sizes[name] = sum(_size_of(field, formats, sizes) for field in fields)
    return sizes[name]


def _size_of(field: re.Match[str], formats: Mapping[str, str], sizes: dict[str, int]) -> int:
    return _size(field[1], formats, sizes) * int(field[2] or 1)


def message_type(channel: Channel) -> Struct:
    """Return the type of a channel's messages."""
    lines = channel.schema.decode("utf-8", "replace").splitlines()
    texts = dict(line.split(":", 1) for line in lines if ":" in line)
    if not texts:
        raise BadDefinitionError(f"the log carries no definition of {quoted(channel.type_name)}")
    types = {px4_name(name): list(_fields(name, texts)) for name in texts}
    # The fields are packed, as in ROS 1.
    return TypeBuilder(types, ros1=True).struct(next(iter(types)))


def _fields(name: str, texts: Mapping[str, str]) -> Fields:
    """Yield the name and type of each field in a definition."""
    for match in _matches(name, texts):
        kind, length, own = match.groups()
        element: Kind = (NAME, px4_name(kind) if kind in texts else kind)
        if kind in _NUMBERS:
            element = (BASE, (_NUMBERS[kind], 0))
        yield own, element if length is None else (ARRAY, (element, int(length)))


def _matches(name: str, texts: Mapping[str, str]) -> list[re.Match[str]]:
    """Return matches of the type, length and name of each field in a definition."""
    matches = []
    for text in filter(None, texts[name].split(";")):
        match = re.fullmatch(_FIELD, text.strip())
        if match is None:
            raise BadDefinitionError(
                f"the definition of {quoted(name)} has a field that cannot be read: {quoted(text)}"
            )
        matches.append(match)
    return matches
