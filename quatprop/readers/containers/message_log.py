"""The base class of containers of encoded messages.

A container yields the bytes and the log time of each message; :mod:`quatprop.readers.messages`
decodes them.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from quatprop.base.provenance import JsonObject, provenance_in
from quatprop.readers.tables.model import Log

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    from quatprop.readers.containers.topic_table import TopicTable
    from quatprop.readers.messages.blocks import Channel, MessageBlock
    from quatprop.readers.tables.model import TimeRange


TRANSFORM_LISTS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types with a list of ``geometry_msgs/TransformStamped`` as their only field."""


class MessageLog(Log):
    """A container of encoded messages: MCAP, ROS 1 bag, ROS 2 bag, ULog.

    Its tables are its topics; they are valid while it is open.

    `has_log_time`: whether it records the log time of messages; if not, the time in each message is
        used, and the order of the file is that of the recording
    `has_publish_time`: whether it records the publish time of messages besides the log time
    """

    has_log_time = True
    has_publish_time = False

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._tables: dict[Channel, TopicTable] = {}

    def __exit__(self, *_error: object) -> None:
        for table in self._tables.values():
            table.release()
        self.close()

    @abstractmethod
    def channels(self) -> list[Channel]:
        """Return all channels in order of topic, with or without rates."""

    @abstractmethod
    def blocks(self, channel: Channel, within: TimeRange | None = None) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk.

        The messages of a block are in the container's order. Blocks are in order of their earliest
        log time if known; :func:`.merge_by_time` sorts the decoded rows.

        `within`: yield only the parts of the log that, by its index, overlap this range of log
            times, for a channel that has a :meth:`recorded_span`; None for all
        """

    def recorded_span(self, channel: Channel) -> TimeRange | None:  # noqa: ARG002  # of some kinds
        """Return the range of log times of a channel, if an index has it of each part of the log.

        None if there is no such index: then only the whole log can be read.
        """
        return None

    def publishers(self, channel: Channel) -> Mapping[int, str]:  # noqa: ARG002  # of some kinds
        """Return the name of each publisher of a channel, by the numbers in its blocks.

        Empty if there is only one, or if the container does not tell them apart.
        """
        return {}

    def complete(self, completed: Callable[[Channel], Channel]) -> None:
        """Add the definitions that channels lack; a no-op for formats that always have them."""

    def provenance(self, topic: str) -> JsonObject:
        """Return the provenance of a topic that this package wrote; empty for others."""
        recorded = self.recorded_provenance()
        return provenance_in(recorded.get(topic, recorded.get("")), self.path)

    def recorded_provenance(self) -> Mapping[str, str]:
        """Return the provenance of each topic as JSON; that of all other topics under ``""``."""
        return {}

    def tables(self, topic: str | None = None) -> list[TopicTable]:
        """Return the topics that have messages.

        `topic`: only those of this name; None for all. A ULog topic with a single instance may be
            named without its number: ``sensor_combined`` for ``sensor_combined/0``
        """
        channels = [channel for channel in self.channels() if channel.count != 0]
        if topic is not None:
            named = [channel for channel in channels if channel.topic == topic]
            instances = [
                channel
                for channel in channels
                if channel.encoding == "ulog" and channel.topic.rpartition("/")[0] == topic
            ]
            channels = named or (instances if len(instances) == 1 else [])
        for channel in channels:
            if channel not in self._tables:
                self._tables[channel] = _table_of(self, channel)
        return [self._tables[channel] for channel in channels]


def _table_of(log: MessageLog, channel: Channel) -> TopicTable:
    from quatprop.readers.containers.topic_table import TopicTable

    if channel.type_name in TRANSFORM_LISTS:
        from quatprop.readers.containers.transforms import TransformTable

        return TransformTable(log, channel)
    table = TopicTable(log, channel)
    if channel.encoding == "json":
        from quatprop.readers.messages.columns import raw_messages
        from quatprop.readers.messages.json import sample_of

        # JSON has no other definition than its first messages.
        for block in islice(filter(len, table.blocks), 1):
            table.channel = replace(channel, sample=sample_of(raw_messages(block)))
    return table


# Message definitions in ``.msg`` files, for bags without definitions (before ROS 2 Iron).


_LARGEST = 1 << 16
"""Maximum size of a definition file, bytes; real ones have a few thousand."""
_FIELD = r"(?m)^[ \t]*((?:\w+/)*[A-Z]\w*)(?:\[[^\]\n]*\])?[ \t]+\w+"
_RULE = "=" * 80


class MsgFiles:
    """Finds the definitions of message types by file names.

    `places`: folders in which the file of ``package/msg/Name`` may be ``package/msg/Name.msg``,
        ``msg/Name.msg`` or ``Name.msg``, or such files themselves
    `is_given`: whether the user named the places, so that their subfolders are searched, too
    `used`: the files from which definitions were read, by type name
    """

    def __init__(self, places: Iterable[Path], *, is_given: bool = False) -> None:
        self._places = tuple(places)
        self._is_given = is_given
        self.used: dict[str, Path] = {}

    def completed(self, channel: Channel) -> Channel:
        """Return a channel with its missing definition added, if there is a file for it."""
        if channel.schema or channel.encoding != "cdr":
            return channel
        schema = self.definition(channel.type_name)
        return replace(channel, schema_encoding="ros2msg", schema=schema) if schema else channel

    def definition(self, type_name: str) -> bytes:
        """Return the definition of a type and its nested types; empty if it has no file."""
        text = self._text(type_name)
        if text is None:
            return b""
        parts = {type_name: text}
        waiting = [type_name]
        while waiting:
            name = waiting.pop()
            for field in re.findall(_FIELD, parts[name]):
                package = field.split("/")[0] if "/" in field else name.split("/")[0]
                inner = f"{package}/msg/{field.split('/')[-1]}"
                found = None if inner in parts else self._text(inner)
                if found is not None:
                    parts[inner] = found
                    waiting.append(inner)
        own = parts.pop(type_name)
        others = (f"{_RULE}\nMSG: {name}\n{text}" for name, text in parts.items())
        return "\n".join([own, *others]).encode()

    def _text(self, type_name: str) -> str | None:
        """Return the text of a type's file; None if there is none."""
        package, _, name = type_name.partition("/msg/")
        for place in self._places:
            for file in self._candidates(place, package, name):
                try:
                    if file.is_file() and file.stat().st_size <= _LARGEST:
                        text = file.read_text(encoding="utf-8", errors="replace")
                        self.used[type_name] = file
                        return text
                except OSError:
                    continue
        return None

    def _candidates(self, place: Path, package: str, name: str) -> Iterable[Path]:
        if not package.isidentifier() or not name.isidentifier():
            return
        if place.suffix == ".msg":
            if place.stem == name:
                yield place
            return
        yield place / package / "msg" / f"{name}.msg"
        if not self._is_given or place.name in {package, "msg"}:
            yield place / "msg" / f"{name}.msg"
        yield place / f"{name}.msg"
        if self._is_given:
            yield from sorted(place.glob(f"**/{package}/msg/{name}.msg"))
