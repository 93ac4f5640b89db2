"""metadata.yaml of a ROS 2 bag to which a topic is added."""

from __future__ import annotations

from dataclasses import dataclass
from io import StringIO
from typing import TYPE_CHECKING, Any

from ruamel.yaml import YAML

if TYPE_CHECKING:
    from collections.abc import Mapping, MutableMapping, Sequence

    from quatprop.writers.messages.topics import Topic

    YamlMapping = MutableMapping[str, Any]

_ROOT = "rosbag2_bagfile_information"

_WITH_CUSTOM_DATA = 6
"""The first version of the metadata with a place for custom data."""


@dataclass(slots=True)
class Added:
    """The messages added to a part.

    Parameters
    ----------
    count
        How many.
    first, last
        Their first and last log time, ns; None where there are none.
    """

    count: int = 0
    first: int | None = None
    last: int | None = None


def extended(text: str, topic: Topic, parts: Sequence[Added], custom: Mapping[str, str]) -> str:
    """Return metadata to which a topic is added.

    Parameters
    ----------
    text
        The metadata of the bag.
    topic
        The topic.
    parts
        The messages added to each part, in order.
    custom
        Custom data to add.
    """
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    content = yaml.load(text)
    bag = content[_ROOT]
    count = sum(part.count for part in parts)
    bag["message_count"] += count
    topics = bag["topics_with_message_count"]
    topics.append({"message_count": count, "topic_metadata": _topic_metadata(topic, topics)})
    _extend_span(bag, parts)
    for file, part in zip(bag.get("files") or (), parts, strict=False):
        file["message_count"] += part.count
        _extend_span(file, [part])
    if bag["version"] >= _WITH_CUSTOM_DATA:
        bag["custom_data"] = {**(bag.get("custom_data") or {}), **custom}
    out = StringIO()
    yaml.dump(content, out)
    return out.getvalue()


def _topic_metadata(topic: Topic, others: Sequence[YamlMapping]) -> YamlMapping:
    """Return the metadata of the new topic, in the same version as the others."""
    entry: YamlMapping = {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": topic.encoding,
    }
    entries = [other["topic_metadata"] for other in others]
    if any("offered_qos_profiles" in other for other in entries):
        as_list = any(isinstance(other.get("offered_qos_profiles"), list) for other in entries)
        entry["offered_qos_profiles"] = [] if as_list else ""
    if any("type_description_hash" in other for other in entries):
        entry["type_description_hash"] = topic.digest
    return entry


def _extend_span(entry: YamlMapping, parts: Sequence[Added]) -> None:
    """Extend a start and a duration to the added messages."""
    start = entry["starting_time"]["nanoseconds_since_epoch"]
    end = start + entry["duration"]["nanoseconds"]
    for part in parts:
        if part.first is not None and part.last is not None:
            start, end = min(start, part.first), max(end, part.last)
    entry["starting_time"]["nanoseconds_since_epoch"] = start
    entry["duration"]["nanoseconds"] = end - start
