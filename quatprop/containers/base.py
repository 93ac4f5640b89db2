"""What a reader gives: channels of message blocks, or a table of columns.

A container knows where the bytes of each message are and when it was recorded; what the bytes
mean is the business of :mod:`quatprop.messages`. A table has its columns already.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path
    from typing import Self

    from numpy.typing import NDArray

    from quatprop.selection import Selection
    from quatprop.series import GyroSeries
    from quatprop.tables.matching.column_matcher import Notes

    Numbers = NDArray[np.float64]

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


@dataclass(frozen=True, slots=True)
class TimedColumns:
    """Which columns of a table to read as numbers, and which as the time.

    Parameters
    ----------
    numbers
        Positions of the columns of numbers.
    time
        Positions of the time column; of seconds and nanoseconds where they are two; empty where
        rows are counted at `sample_rate`.
    time_unit
        ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; of the first column where they are two.
    sample_rate
        Rows a second, Hz, where there is no time column.
    """

    numbers: tuple[int, ...]
    time: tuple[int, ...]
    time_unit: str = "ns"
    sample_rate: float | None = None


@dataclass(frozen=True, slots=True)
class TableColumns:
    """Which columns of a table are the time and the rates, and in what units.

    Parameters
    ----------
    rate
        Positions of the x, y and z rate columns.
    rate_unit
        ``"rad/s"`` or ``"deg/s"``.
    time
        Positions of the time column; of seconds and nanoseconds where they are two; empty where
        rows are counted at `sample_rate`.
    time_unit
        ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; of the first column where they are two.
    sample_rate
        Rows a second, Hz, where there is no time column.
    dialect
        The convention that was recognised, such as ``"EuRoC"``, or ``""`` where options said all.
    rate_scale
        What stored rates are multiplied by to be in `rate_unit`.
    method
        The method that fits what the sensor does, where the convention says it.
    remarks
        What the user should know of the choice.
    """

    rate: tuple[int, int, int]
    rate_unit: str
    time: tuple[int, ...]
    time_unit: str = "ns"
    sample_rate: float | None = None
    dialect: str = ""
    rate_scale: float = 1.0
    method: str | None = None
    remarks: tuple[str, ...] = ()

    @property
    def timed(self) -> TimedColumns:
        """The columns to read, whatever their numbers mean."""
        return TimedColumns(self.rate, self.time, self.time_unit, self.sample_rate)


class TableLog(Log, Protocol):
    """Rows of named or numbered columns: CSV, Parquet, Feather.

    Attributes
    ----------
    notes
        What is known besides the column names.
    """

    notes: Notes

    def columns(self) -> list[str]:
        """Return the column names in order; ``"0"``, ``"1"``... for a table without a header."""

    def provenance(self) -> dict[str, Any]:
        """Return how the content came about, as written beside it; empty where it is not."""

    def choose(self, selection: Selection) -> TableColumns:
        """Return which columns hold time and rates, from the options and the header.

        Raises
        ------
        NoRatesError
            No columns look like body rates and the options name none.
        UndeclaredError
            A unit or the time is said neither by the header nor by an option.
        """

    def series(self, columns: TableColumns) -> Iterator[GyroSeries]:
        """Yield the chosen columns as rates in rad/s and stamps in ns, batch after batch."""

    def rows(self, columns: TimedColumns) -> Iterator[tuple[NDArray[np.int64], Numbers]]:
        """Yield stamps in ns, shape ``(N,)``, and numbers as stored, shape ``(N, k)``."""


def is_table(log: MessageLog | TableLog) -> TypeGuard[TableLog]:
    """Tell a table from a container of messages."""
    return hasattr(log, "choose")
