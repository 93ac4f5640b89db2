"""Encoded messages of a channel, as containers give them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

from quatprop.stores.byte_ranges import ranges_of
from quatprop.tables.batches import NO_BOUND

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy as np
    from numpy.typing import NDArray


_GAP = 256
"""Bytes between two messages that are copied with them: record heads and small other messages."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with one message type, in however many connections or files it was recorded.

    `type_name`: message type as the log spells it, ROS names normalised to ``package/msg/Name``
    `encoding`: how the messages are encoded: ``"cdr"``, ``"ros1"``, ``"json"``, ``"protobuf"``
    `schema_encoding`: language of the definition: ``"ros1msg"``, ``"ros2msg"``, ``"ros2idl"``,
        ``"jsonschema"``, ``"protobuf"``, or ``""`` if the log has none
    `schema`: the definition as the log has it; empty if it has none. Definitions of ROS that differ
        only in comments and blanks are the same: recorders write what their own files say
    `count`: number of messages, where it is known without reading them; not compared
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
        """Keep the definition as it is compared."""
        is_lines = self.schema_encoding in {"ros1msg", "ros2msg"}
        definition = _without_comments(self.schema) if is_lines else self.schema
        object.__setattr__(self, "_definition", definition)


@lru_cache(maxsize=256)
def _without_comments(definition: bytes) -> bytes:
    """Return the lines of a definition without comments and needless blanks."""
    lines = (line.partition(b"#")[0].split() for line in definition.splitlines())
    return b"\n".join(b" ".join(line) for line in lines if line)


def by_topic(channels: Iterable[Channel]) -> list[Channel]:
    """Return channels in order of topic, then of type."""
    return sorted(channels, key=lambda channel: (channel.topic, channel.type_name))


@dataclass(frozen=True, slots=True, eq=False)
class MessageBlock:
    """Messages of one channel in one buffer, usually a chunk.

    Message ``k`` is ``data[starts[k]:ends[k]]``.

    `data`: the buffer, shape ``(B,)``, uint8
    `starts`, `ends`: where each message begins and ends, shape ``(N,)``, int64
    `log_ns`, `publish_ns`: when each was recorded and published, shape ``(N,)``, int64 ns.
        Containers without publish times repeat the log times. Publish times are negative after the
        year 2262; they may be a view of `data`
    `watermark_ns`: no later block of this iteration holds a message with an earlier log time
    `stride`: bytes from each message to the next where all have one length and the same distance; 0
        where that is not known
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
        """Return some of the messages, by their positions or a mask."""
        starts, ends = self.starts[chosen], self.ends[chosen]
        log_ns, publish_ns = self.log_ns[chosen], self.publish_ns[chosen]
        return MessageBlock(self.data, starts, ends, log_ns, publish_ns, self.watermark_ns)

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
