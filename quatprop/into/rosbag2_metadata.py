"""metadata.yaml of a ROS 2 bag to which a topic was added."""

from __future__ import annotations

from io import StringIO
from typing import TYPE_CHECKING, Any

from ruamel.yaml import YAML

from quatprop.writers.messages.ros_types import ros2_types

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from quatprop.into.rosbag2 import Added
    from quatprop.writers.messages.kinds import Message

_ROOT = "rosbag2_bagfile_information"


def extended(text: str, message: Message, parts: Sequence[Added], custom: Mapping[str, str]) -> str:
    """Return metadata to which a topic was added.

    Parameters
    ----------
    text
        The metadata of the bag, which readers have read already.
    message
        What is published where.
    parts
        What was added to each part, in order.
    custom
        What is told beside it.
    """
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    told = yaml.load(text)
    bag = told[_ROOT]
    count = sum(part.count for part in parts)
    bag["message_count"] += count
    topics = bag["topics_with_message_count"]
    topics.append({"message_count": count, "topic_metadata": _topic(message, topics)})
    _span(bag, parts)
    for file, part in zip(bag.get("files") or (), parts, strict=False):
        file["message_count"] += part.count
        _span(file, [part])
    if bag["version"] >= _WITH_CUSTOM_DATA:
        bag["custom_data"] = {**(bag.get("custom_data") or {}), **custom}
    out = StringIO()
    yaml.dump(told, out)
    return out.getvalue()


_WITH_CUSTOM_DATA = 6
"""The first version of the metadata that has a place for what others add."""


def _topic(message: Message, topics: Sequence[Any]) -> dict[str, Any]:
    """Return what is told of the new topic, in the terms of the version of the others."""
    name = message.definition.name
    told: dict[str, Any] = {"name": message.place, "type": name, "serialization_format": "cdr"}
    others = [topic["topic_metadata"] for topic in topics]
    if any("offered_qos_profiles" in other for other in others):
        as_list = any(isinstance(other.get("offered_qos_profiles"), list) for other in others)
        told["offered_qos_profiles"] = [] if as_list else ""
    if any("type_description_hash" in other for other in others):
        told["type_description_hash"] = ros2_types().hash_rihs01(name)
    return told


def _span(entry: dict[str, Any], parts: Sequence[Added]) -> None:
    """Let a beginning and a duration take in what was added."""
    added = [part for part in parts if part.count]
    if not added:
        return
    start = entry["starting_time"]["nanoseconds_since_epoch"]
    end = max(start + entry["duration"]["nanoseconds"], *(part.last for part in added))
    start = min(start, *(part.first for part in added))
    entry["starting_time"]["nanoseconds_since_epoch"] = start
    entry["duration"]["nanoseconds"] = end - start
