"""The base class of containers of encoded messages.

A container gives the bytes of each message and when it was recorded; :mod:`quatprop.messages`
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

    `has_log_time`: whether it records when a message was logged; if not, the time in a message
        stands for it, and the order of the file is that of the recording
    `has_publish_time`: whether it records when a message was published, besides when it was logged
    """

    has_log_time = True
    has_publish_time = False

    @abstractmethod
    def channels(self) -> list[Channel]:
        """Return every channel, in order of topic, with or without rates."""

    @abstractmethod
    def blocks(self, channel: Channel, within: TimeRange | None = None) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk.

        Messages of a block are in the container's order. Blocks come in order of their earliest
        log time if known; :func:`quatprop.tables.batches.merge_by_time` sorts what
        was decoded from them.

        `within`: only parts of the log that the index has in a range of log times, of a channel
            that has a :meth:`recorded_span`; None is all
        """

    def recorded_span(self, channel: Channel) -> TimeRange | None:  # noqa: ARG002  # of some kinds
        """Return when a channel was recorded by an index that says it of each part of the log.

        None if there is no such index: then only the whole log can be read.
        """
        return None

    def complete(self, completed: Callable[[Channel], Channel]) -> None:
        """Add definitions that channels lack; nothing where the format always has them."""

    def provenance(self, topic: str) -> JsonObject:
        """Return how the messages of a topic were made, if this package made them; else empty."""
        recorded = self.recorded_provenance()
        return provenance_in(recorded.get(topic, recorded.get("")), self.path)

    def recorded_provenance(self) -> Mapping[str, str]:
        """Return the provenance of each topic as JSON, under ``""`` that of all others."""
        return {}
