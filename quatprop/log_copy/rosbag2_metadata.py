"""Add a topic to the metadata of a ROS 2 bag.

rosbag2 stores them in metadata.yaml, below a root key, and in each storage file, without that key.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np
from ruamel.yaml import YAML

from quatprop.settings.guarded_text import read_yaml

if TYPE_CHECKING:
    from collections.abc import Mapping, MutableMapping, Sequence

    from quatprop.arrays import Int64
    from quatprop.writers.messages.topics import Topic

    YamlMapping = MutableMapping[str, Any]

_ROOT = "rosbag2_bagfile_information"

_WITH_CUSTOM_DATA = 6
"""The first version of the metadata with custom data."""


@dataclass(slots=True)
class Added:
    """The messages added to a part.

    `first`, `last`: their first and last log time, ns; if there are none, `first` > `last`
    """

    count: int = 0
    first: int = np.iinfo(np.int64).max
    last: int = np.iinfo(np.int64).min

    def add(self, log_ns: Int64) -> None:
        """Count messages with these log times."""
        if len(log_ns):
            self.count += len(log_ns)
            self.first = min(self.first, int(log_ns.min()))
            self.last = max(self.last, int(log_ns.max()))


def extended(
    text: str,
    topic: Topic,
    parts: Sequence[Added],
    custom: Mapping[str, str],
    *,
    has_root: bool = True,
) -> str | None:
    """Return metadata with a topic added; None if they are damaged."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    try:
        content = read_yaml(text)
        # Copies by earlier versions of this package have the root key in storage files, too.
        bag = content[_ROOT] if has_root or _ROOT in content else content
        _extend(bag, topic, parts, custom)
    except (KeyError, TypeError, AttributeError, ValueError):
        return None
    out = StringIO()
    yaml.dump(content if has_root else bag, out)
    return out.getvalue()


def extended_record(
    text: str, topic: Topic, parts: Sequence[Added], custom: Mapping[str, str] | None = None
) -> str:
    """Return the metadata of a storage file with a topic added; unchanged if damaged."""
    return extended(text, topic, parts, custom or {}, has_root=False) or text


def _extend(
    bag: YamlMapping, topic: Topic, parts: Sequence[Added], custom: Mapping[str, str]
) -> None:
    count = sum(part.count for part in parts)
    bag["message_count"] += count
    topics = bag["topics_with_message_count"]
    topics.append({"message_count": count, "topic_metadata": _topic_metadata(topic, topics)})
    _extend_span(bag, parts)
    for file, part in zip(bag.get("files") or (), parts, strict=False):
        file["message_count"] += part.count
        _extend_span(file, [part])
    if custom and bag["version"] >= _WITH_CUSTOM_DATA:
        bag["custom_data"] = {**(bag.get("custom_data") or {}), **custom}


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
    """Extend a start time and duration to include the added messages."""
    start = entry["starting_time"]["nanoseconds_since_epoch"]
    end = start + entry["duration"]["nanoseconds"]
    for part in parts:
        start, end = min(start, part.first), max(end, part.last)
    entry["starting_time"]["nanoseconds_since_epoch"] = start
    entry["duration"]["nanoseconds"] = end - start
