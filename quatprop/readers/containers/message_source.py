"""The interface of a container that its tables need."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from quatprop.base.errors import Losses
    from quatprop.base.provenance import JsonObject
    from quatprop.base.text import Remark
    from quatprop.readers.messages.blocks import Channel, MessageBlock
    from quatprop.readers.tables.model import Log, SeriesRead, Table, TimeRange


class MessageSource(Protocol):
    """A container of messages; see :class:`quatprop.readers.containers.message_log.MessageLog`."""

    path: Path
    kind: str
    has_log_time: bool
    has_publish_time: bool
    losses: Losses
    remarks: Sequence[Remark]
    joined: Sequence[Log]
    series_read: Mapping[tuple[str, tuple[str, ...]], SeriesRead]

    def tables(self, topic: str | None = None) -> Sequence[Table]:
        """Return the topics that have messages."""

    def blocks(self, channel: Channel, within: TimeRange | None = None) -> Iterator[MessageBlock]:
        """Yield the messages of one channel."""

    def recorded_span(self, channel: Channel) -> TimeRange | None:
        """Return the range of log times of a channel; None without an index."""

    def publishers(self, channel: Channel) -> Mapping[int, str]:
        """Return the name of each publisher of a channel."""

    def provenance(self, topic: str) -> JsonObject:
        """Return the provenance of a topic."""
