"""Base classes of logs: of all logs, and of containers of encoded messages.

A container gives the bytes of each message and when it was recorded; :mod:`quatprop.messages`
decodes them. Tables are in :mod:`quatprop.tables.base`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from quatprop.provenance import JsonObject, provenance_in

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.containers.time_range import TimeRange
    from quatprop.containers.topic_table import TopicTable

NO_BOUND = int(np.iinfo(np.int64).min)
"""`not_before_ns` of a block that says nothing about the blocks after it."""

LATEST = int(np.iinfo(np.int64).max)
"""The last nanosecond that fits int64, in the year 2262; `not_before_ns` of the last block."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with one message type, in however many connections or files it was recorded.

    `topic`: name of the topic
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
        definition = self.schema
        if self.schema_encoding in {"ros1msg", "ros2msg"}:
            lines = (line.partition(b"#")[0].split() for line in definition.splitlines())
            definition = b"\n".join(b" ".join(line) for line in lines if line)
        object.__setattr__(self, "_definition", definition)


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
    `not_before_ns`: No later block of this iteration holds a message with an earlier log time
    `stride`: bytes from each message to the next where all have one length and the same distance; 0
        where that is not known
    """

    data: NDArray[np.uint8]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    publish_ns: NDArray[np.int64]
    not_before_ns: int = NO_BOUND
    stride: int = 0

    def __len__(self) -> int:
        return len(self.starts)

    def at(self, chosen: NDArray[np.generic]) -> MessageBlock:
        """Return some of the messages, by their positions or a mask."""
        starts, ends = self.starts[chosen], self.ends[chosen]
        log_ns, publish_ns = self.log_ns[chosen], self.publish_ns[chosen]
        return MessageBlock(self.data, starts, ends, log_ns, publish_ns, self.not_before_ns)


class Loss(NamedTuple):
    """A part of a damaged log that could not be read.

    `place`: where it is, so that a user can look: "chunk at byte 4096", "line 17"
    `reason`: why it could not be read
    `messages`: how many messages or rows are lost, where that is known
    """

    place: str
    reason: str
    messages: int | None = None


class Losses(list[Loss]):
    """Losses, each of which is noted once, however often the log is read.

    Examples
    --------
    >>> losses = Losses()
    >>> for _ in range(2):
    ...     losses.note("line 17", "it has 3 columns instead of 4", 1)
    >>> len(losses)
    1
    """

    def __init__(self) -> None:
        super().__init__()
        self._entries: dict[tuple[str, str], tuple[int, dict[Hashable, int]]] = {}

    def note(
        self, place: str, reason: str, messages: int | None = None, part: Hashable = None
    ) -> None:
        """Add a loss unless it was noted before."""
        number, counts = self._entries.setdefault((place, reason), (len(self), {}))
        if messages is not None:
            counts[part] = max(messages, counts.get(part, 0))
        loss = Loss(place, reason, sum(counts.values()) if counts else None)
        self[number : number + 1] = [loss]

    def restart(self, count: int) -> None:
        """Forget all but the first `count`, since what comes after them is read again."""
        earlier = self[:count]
        self.clear()
        self._entries.clear()
        for loss in earlier:
            self.note(loss.place, loss.reason, loss.messages)


class Log(ABC):
    """A log of any kind, open for reading; closed when its ``with`` block ends.

    `kind`: the key in :data:`quatprop.logs.kinds.READERS`
    `path`: the file or folder
    `losses`: what could not be read; grows while the log is read
    `remarks`: what may be wrong with the log, though not for certain; grows while the log is read
    `definition_files`: files beside the log that message definitions were taken from
    `unchecked_chunks`: chunks that were read in part and so not compared with their checksum; grows
        likewise
    """

    kind: str
    remarks: Sequence[str] = ()
    definition_files: Sequence[Path] = ()
    unchecked_chunks: int = 0

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses = Losses()

    def close(self) -> None:  # noqa: B027  # nothing to do where files are open only while read
        """Release files and temporary copies."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


class MessageLog(Log):
    """A container of encoded messages: MCAP, ROS 1 bag, ROS 2 bag, ULog.

    `has_log_time`: whether it records when a message was logged; if not, the time in a message
        stands for it, and the order of the file is that of the recording
    `has_publish_time`: whether it records when a message was published, besides when it was logged
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

    def tables(self, topic: str | None = None) -> Sequence[TopicTable]:
        """Return the topics that have messages; only those of a name, or all of them."""
        from quatprop.containers.topics import channels_of, table_of

        chosen = channels_of(self, topic)
        for channel in chosen:
            if channel not in self._tables:
                self._tables[channel] = table_of(self, channel)
        return [self._tables[channel] for channel in chosen]

    @abstractmethod
    def channels(self) -> list[Channel]:
        """Return every channel, in order of topic, with or without rates."""

    @abstractmethod
    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk.

        Messages of a block are in the container's order. Blocks come in order of their earliest
        log time where that is known; :func:`quatprop.containers.merge.merge_by_time` sorts what
        was decoded from them.
        """

    def recorded_span(self, channel: Channel) -> TimeRange | None:  # noqa: ARG002  # of some kinds
        """Return when a channel was recorded by an index that says it of each part of the log.

        None where there is no such index: then only the whole log can be read.
        """
        return None

    def blocks_within(self, channel: Channel, within: TimeRange) -> Iterator[MessageBlock]:
        """Yield the messages of the parts of the log that the index has in a range of log times.

        The channel is one of :meth:`channels` that has a :meth:`recorded_span`.
        """
        raise NotImplementedError

    def complete(self, completed: Callable[[Channel], Channel]) -> None:
        """Add definitions that channels lack; nothing where the format always has them."""

    def provenance(self, topic: str) -> JsonObject:
        """Return how the messages of a topic were made, if this package made them; else empty."""
        recorded = self.recorded_provenance()
        return provenance_in(recorded.get(topic, recorded.get("")), self.path)

    def recorded_provenance(self) -> Mapping[str, str]:
        """Return the provenance of each topic as JSON, under ``""`` that of all others."""
        return {}
