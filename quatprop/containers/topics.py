"""The topics of a message log as tables."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from quatprop.containers.base import MessageLog
from quatprop.containers.topic_table import TopicTable
from quatprop.messages.values import raw_messages

if TYPE_CHECKING:
    from pathlib import Path

    from quatprop.messages.blocks import Channel

TRANSFORM_LISTS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types with a list of ``geometry_msgs/TransformStamped`` as their only field."""


class TopicLog(MessageLog):
    """A container whose tables are its topics; they are valid while it is open."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._tables: dict[Channel, TopicTable] = {}

    def __exit__(self, *_error: object) -> None:
        for table in self._tables.values():
            table.release()
        self.close()

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
    if channel.type_name in TRANSFORM_LISTS:
        from quatprop.containers.transform_lists import TransformTable

        return TransformTable(log, channel)
    table = TopicTable(log, channel)
    if channel.encoding == "json":
        from quatprop.messages.json import sample_of

        # JSON has no other definition than its first messages.
        for block in islice(filter(len, table.blocks), 1):
            table.channel = replace(channel, sample=sample_of(raw_messages(block)))
    return table
