"""Channels and blocks of encoded messages, as containers yield them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from quatprop.stores.byte_ranges import ranges_of
from quatprop.tables.batches import NO_BOUND

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray


_GAP = 256
"""Gaps up to this many bytes are copied with the messages: record heads, small other messages."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with one message type; it may have several connections or files.

    `type_name`: message type as the log spells it, ROS names normalised to ``package/msg/Name``
    `encoding`: message encoding: ``"cdr"``, ``"ros1"``, ``"ulog"``, ``"json"``, ``"protobuf"``
    `schema_encoding`: language of the definition: ``"ros1msg"``, ``"ros2msg"``, ``"ros2idl"``,
        ``"jsonschema"``, ``"protobuf"``, or ``""`` if the log has none
    `schema`: the definition as the log has it; empty if it has none. ROS definitions that differ
        only in comments and white space are equal: recorders copy them from their own files
    `count`: number of messages, if known without reading them; not compared
    `sample`: a message, for encodings whose messages name their fields; empty if none was read; not
        compared
    """

    topic: str
    type_name: str
    encoding: str
    schema_encoding: str = ""
    schema: bytes = field(default=b"", compare=False)
    count: int | None = field(default=None, compare=False)
    sample: bytes = field(default=b"", compare=False)
    _definition: bytes = field(init=False, repr=False, default=b"")

    def __post_init__(self) -> None:
        """Store the definition in the form that is compared."""
        is_lines = self.schema_encoding in {"ros1msg", "ros2msg"}
        definition = _without_comments(self.schema) if is_lines else self.schema
        object.__setattr__(self, "_definition", definition)


@lru_cache(maxsize=256)
def _without_comments(definition: bytes) -> bytes:
    """Return the lines of a definition without comments and superfluous white space."""
    lines = (line.partition(b"#")[0].split() for line in definition.splitlines())
    return b"\n".join(b" ".join(line) for line in lines if line)


def by_topic(channels: Iterable[Channel]) -> list[Channel]:
    """Return channels sorted by topic, then by type."""
    return sorted(channels, key=lambda channel: (channel.topic, channel.type_name))


@dataclass(frozen=True, slots=True, eq=False)
class MessageBlock:
    """Messages of one channel in one buffer, usually a chunk.

    Message ``k`` is ``data[starts[k]:ends[k]]``.

    `data`: the buffer, shape ``(B,)``, uint8
    `starts`, `ends`: offsets of the first byte and behind the last byte, shape ``(N,)``, int64
    `log_ns`, `publish_ns`: log and publish times, shape ``(N,)``, int64 ns. Containers without
        publish times repeat the log times. Publish times are negative after the year 2262; they may
        be a view of `data`
    `watermark_ns`: no later block of this iteration holds a message with an earlier log time
    `stride`: distance between messages of one length, bytes, if it is known to be constant; else 0
    """

    data: NDArray[np.uint8]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    publish_ns: NDArray[np.int64]
    watermark_ns: int = NO_BOUND
    stride: int = 0

    def __len__(self) -> int:
        return len(self.starts)

    def at(self, chosen: NDArray[np.generic]) -> MessageBlock:
        """Return the messages at some positions, or those of a mask."""
        starts, ends = self.starts[chosen], self.ends[chosen]
        log_ns, publish_ns = self.log_ns[chosen], self.publish_ns[chosen]
        return MessageBlock(self.data, starts, ends, log_ns, publish_ns, self.watermark_ns)

    def without(self, positions: Sequence[int]) -> MessageBlock:
        """Return the messages except those at some positions."""
        return self.at(np.delete(np.arange(len(self)), positions))

    def compacted(self) -> MessageBlock:
        """Return a copy without the bytes between the messages."""
        if not len(self):
            return self
        ranges = ranges_of(self.starts, self.ends, _GAP)
        return replace(
            self,
            data=ranges.of(self.data),
            starts=self.starts - ranges.moved,
            ends=self.ends - ranges.moved,
            publish_ns=self.publish_ns.copy(),
            stride=0,
        )
