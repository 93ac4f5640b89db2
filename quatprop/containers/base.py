"""What all logs have in common, and containers of encoded messages.

A container knows where the bytes of each message are and when it was recorded; what the bytes
mean is the business of :mod:`quatprop.messages`. Tables are in :mod:`quatprop.tables.base`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path
    from typing import Self

    from numpy.typing import NDArray

NO_BOUND = int(np.iinfo(np.int64).min)
"""`not_before_ns` of a block that promises nothing about the blocks after it."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One topic as one message type, however many connections or files carry it.

    Parameters
    ----------
    topic
        The name it was published under.
    type_name
        Message type as the log spells it, ROS names normalised to ``package/msg/Name``.
    encoding
        How the messages are encoded: ``"cdr"``, ``"ros1"``, ``"json"``, ``"protobuf"``...
    schema_encoding
        How the definition is written: ``"ros1msg"``, ``"ros2msg"``, ``"ros2idl"``,
        ``"jsonschema"``, ``"protobuf"``, or ``""`` where the log carries none.
    schema
        The definition as the log carries it; empty where it carries none.
    count
        Messages in the log where the container says so without reading them. Not part of a
        channel's identity.
    sample
        A message, for encodings whose messages tell their fields by themselves; empty where it
        has not been looked at. Not part of a channel's identity.
    """

    topic: str
    type_name: str
    encoding: str
    schema_encoding: str = ""
    schema: bytes = b""
    count: int | None = field(default=None, compare=False)
    sample: bytes = field(default=b"", compare=False)


@dataclass(frozen=True, slots=True)
class MessageBlock:
    """Messages of one channel that lie in one buffer, usually a chunk.

    Message ``k`` is ``data[starts[k]:ends[k]]``.

    Parameters
    ----------
    data
        The buffer, shape ``(B,)``, uint8.
    starts, ends
        Where each message begins and ends, shape ``(N,)``, int64.
    log_ns, publish_ns
        When each was recorded and published, shape ``(N,)``, int64 ns. Containers that know no
        publish time give the log time twice.
    not_before_ns
        No later block of this iteration holds a message with an earlier log time.
    """

    data: NDArray[np.uint8]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    publish_ns: NDArray[np.int64]
    not_before_ns: int = NO_BOUND

    def __len__(self) -> int:
        return len(self.starts)


@dataclass(frozen=True, slots=True)
class Loss:
    """Something of a damaged log that could not be read.

    Parameters
    ----------
    place
        Where, in words a user can check: "chunk at byte 4096", "line 17".
    reason
        Why it could not be read.
    messages
        How many messages or rows are lost with it, where that is known.
    """

    place: str
    reason: str
    messages: int | None = None


class Losses(list[Loss]):
    """Losses, of which each is noted once, however often the log is read.

    Examples
    --------
    >>> losses = Losses()
    >>> for _ in range(2):
    ...     losses.note(Loss("line 17", "it has 3 columns instead of 4", 1))
    >>> len(losses)
    1
    """

    def __init__(self, losses: Iterable[Loss] = ()) -> None:
        super().__init__(losses)
        self._noted = set(self)

    def note(self, loss: Loss) -> None:
        """Add a loss unless it was noted before; a damaged log may have a hundred thousand."""
        if loss not in self._noted:
            self._noted.add(loss)
            self.append(loss)


class Closing:
    """Closes when its ``with`` block ends."""

    remarks: Sequence[str] = ()

    def close(self) -> None:
        """Release files and temporary copies; nothing, where files are open only while read."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


class Log(Protocol):
    """What message logs and tables have in common.

    Attributes
    ----------
    kind
        The key in :data:`quatprop.formats.READERS`.
    path
        The file or folder.
    losses
        What could not be read; grows while the log is read.
    remarks
        What may be wrong with the log and nobody can tell; grows while the log is read.
    """

    kind: str
    path: Path
    losses: list[Loss]
    remarks: Sequence[str]

    def close(self) -> None:
        """Release files and temporary copies."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_error: object) -> None: ...


class MessageLog(Log, Protocol):
    """A container of encoded messages: MCAP, ROS 1 bag, ROS 2 bag."""

    def channels(self) -> list[Channel]:
        """Return every channel, in order of topic, with or without rates."""

    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one channel, chunk after chunk.

        Within a block messages are in the container's order. Blocks come so that
        `not_before_ns` rises as early as it can;
        :func:`quatprop.containers.merge.merge_by_time` turns them into time order.
        """

    def provenance(self, topic: str) -> dict[str, Any]:
        """Return how a topic came about, as written beside it; empty where it is not.

        Raises
        ------
        DamagedLogError
            What is written there is not what this package writes.
        """
