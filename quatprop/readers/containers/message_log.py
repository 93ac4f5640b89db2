"""The base class of containers of encoded messages.

A container yields the bytes and the log time of each message; :mod:`quatprop.messages`
decodes them.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

from quatprop.provenance import JsonObject, provenance_in
from quatprop.tables.log import Log

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from quatprop.messages.blocks import Channel, MessageBlock
    from quatprop.tables.model import TimeRange


class MessageLog(Log):
    """A container of encoded messages: MCAP, ROS 1 bag, ROS 2 bag, ULog.

    `has_log_time`: whether it records the log time of messages; if not, the time in each message is
        used, and the order of the file is that of the recording
    `has_publish_time`: whether it records the publish time of messages besides the log time
    """

    has_log_time = True
    has_publish_time = False

    @abstractmethod
    def channels(self) -> list[Channel]:
        """Return all channels in order of topic, with or without rates."""

    @abstractmethod
    def blocks(self, channel: Channel, within: TimeRange | None = None) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk.

        The messages of a block are in the container's order. Blocks are in order of their earliest
        log time if known; :func:`quatprop.tables.batches.merge_by_time` sorts the decoded rows.

        `within`: yield only the parts of the log that, by its index, overlap this range of log
            times, for a channel that has a :meth:`recorded_span`; None for all
        """

    def recorded_span(self, channel: Channel) -> TimeRange | None:  # noqa: ARG002  # of some kinds
        """Return the range of log times of a channel, if an index has it of each part of the log.

        None if there is no such index: then only the whole log can be read.
        """
        return None

    def complete(self, completed: Callable[[Channel], Channel]) -> None:
        """Add the definitions that channels lack; a no-op for formats that always have them."""

    def provenance(self, topic: str) -> JsonObject:
        """Return the provenance of a topic that this package wrote; empty for others."""
        recorded = self.recorded_provenance()
        return provenance_in(recorded.get(topic, recorded.get("")), self.path)

    def recorded_provenance(self) -> Mapping[str, str]:
        """Return the provenance of each topic as JSON; that of all other topics under ``""``."""
        return {}
