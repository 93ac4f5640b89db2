"""The topics of a log of messages as tables."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from quatprop.containers.base import MessageLog
from quatprop.containers.kept_blocks import blocks_of
from quatprop.containers.topic_table import TopicTable
from quatprop.messages.values import raw_messages

if TYPE_CHECKING:
    from quatprop.messages.blocks import Channel

TRANSFORM_LISTS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types that consist of one list of ``geometry_msgs/TransformStamped``."""


class TopicLog(MessageLog):
    """A container whose tables are its topics."""

    def tables(self, topic: str | None = None) -> list[TopicTable]:
        """Return the topics that have messages.

        `topic`: only those of this name; None for all. A ULog topic with one instance may be named
            without it: ``sensor_combined`` for ``sensor_combined/0``
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
        return [_table_of(self, channel) for channel in channels]


def _table_of(log: MessageLog, channel: Channel) -> TopicTable:
    if channel.type_name in TRANSFORM_LISTS:
        from quatprop.containers.transform_lists import TransformTable

        return TransformTable(log, channel)
    if channel.encoding == "json":
        from quatprop.messages.json import sample_of

        # The first messages are all the definition there is.
        block = next((block for block in blocks_of(log, channel) if len(block)), None)
        if block is not None:
            channel = replace(channel, sample=sample_of(raw_messages(block)))
    return TopicTable(log, channel)
