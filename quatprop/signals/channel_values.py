"""From the blocks of a channel to stamps and values, in the order of the log.

What rates and orientations have in common: fields are decoded as columns, the clock is chosen,
values that a message marks as absent become NaN, and messages that do not fit their definition
are lost and told.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from quatprop.containers.base import Loss
from quatprop.containers.coalesce import joined
from quatprop.containers.merge import Columns, merge_by_time
from quatprop.errors import MessageError, UndeclaredError, UsageError
from quatprop.messages.decoders import decoder_of
from quatprop.messages.rates import time_field_at
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.containers.base import Channel, MessageBlock, MessageLog
    from quatprop.messages.stamps import Stamp
    from quatprop.selection import SignalSelection

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

ABSENT = -1.0
"""What the first number of a covariance is where the value beside it is not measured."""


class Clock(NamedTuple):
    """Whose time the values of a channel have.

    Parameters
    ----------
    name
        ``"header"``, ``"log"`` or ``"publish"``.
    stamp
        The field of the message, for a header clock.
    """

    name: str
    stamp: Stamp | None = None

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields of the stamp; none for the other clocks."""
        return self.stamp.fields if self.stamp else ()

    def ns(self, fields: Sequence[NDArray[Any]], block: MessageBlock, path: Path | str) -> Int64:
        """Return the time of every message of a block, shape ``(N,)``, int64 ns.

        Parameters
        ----------
        fields
            The fields of the stamp, as decoded; empty for the other clocks.
        block
            The messages.
        path
            The log, for errors.
        """
        if self.stamp is not None:
            return self.stamp.ns(fields, path)
        return block.log_ns if self.name == "log" else block.publish_ns


class Reading(Protocol):
    """How the blocks of one channel become rows."""

    def columns(self, block: MessageBlock) -> Columns:
        """Return log times with ``(t_ns, values)``, shapes ``(N,)`` and ``(N, k)``.

        Raises
        ------
        MessageError
            Messages do not fit; its `positions` say which.
        """


def channels_of(log: MessageLog, topic: str | None = None) -> list[Channel]:
    """Return the channels that have messages, with all that tells their fields.

    Parameters
    ----------
    log
        The container.
    topic
        Only those of this topic; None for all.
    """
    channels = (channel for channel in log.channels() if topic in (None, channel.topic))
    return [_described(log, channel) for channel in channels if channel.count != 0]


def _described(log: MessageLog, channel: Channel) -> Channel:
    """Return a channel with a message of it, where that is what tells the fields."""
    if channel.encoding == "json":
        for block in log.blocks(channel):
            if len(block):
                sample = block.data[block.starts[0] : block.ends[0]].tobytes()
                return replace(channel, sample=sample)
    return channel


def timed_values(
    log: MessageLog, channel: Channel, reading: Reading
) -> Iterator[tuple[NDArray[Any], ...]]:
    """Yield the values of one channel with their stamps, in order of their log times.

    Parameters
    ----------
    log
        The container; what cannot be read is added to its losses.
    channel
        One of its channels.
    reading
        How its blocks become rows.

    Yields
    ------
    tuple
        What the reading gives of each sample: stamps, shape ``(N,)``, int64 ns, and values, shape
        ``(N, k)``, float64, first.
    """
    for columns in _timed(log, channel, reading):
        yield columns.values


def stamps_logged(
    log: MessageLog, channel: Channel, reading: Reading
) -> Iterator[tuple[Int64, Int64]]:
    """Yield the stamps of one channel and when each was logged, in order of their log times.

    Parameters
    ----------
    log, channel, reading
        As for :func:`timed_values`.

    Yields
    ------
    tuple
        Stamps and log times, shape ``(N,)`` each, int64 ns.
    """
    for columns in _timed(log, channel, reading):
        yield columns.values[0], columns.log_ns


def _timed(log: MessageLog, channel: Channel, reading: Reading) -> Iterator[Columns]:
    batches = (_kept(log, channel, reading, block) for block in joined(log.blocks(channel)))
    return merge_by_time([batches])


def clock_of(
    log: MessageLog, channel: Channel, stamp: Stamp | None, selection: SignalSelection
) -> Clock:
    """Return whose time to read, from the options and what a message has.

    Parameters
    ----------
    log, channel
        Where the messages are.
    stamp
        The message's own stamp, if it is known to have one.
    selection
        The options `clock`, `time_field` and `time_unit`.

    Raises
    ------
    UsageError
        A header stamp is asked for and there is none.
    UndeclaredError
        The unit of a time field is not said.
    """
    has_stamp = stamp is not None or selection.time_field is not None
    if selection.clock == "header" and not has_stamp:
        raise UsageError(
            f"{quoted(log.path)}: messages of topic {quoted(channel.topic)} have no header stamp; "
            "choose --clock log|publish or name the stamp with --time-field"
        )
    clock = selection.clock or ("header" if has_stamp else "log")
    if clock != "header":
        return Clock(clock)
    if selection.time_field is not None:
        stamp = time_field_at(channel, selection.time_field, selection.time_unit, log.path)
        if stamp is None:
            raise UndeclaredError(
                log.path,
                f"the unit of the time in field {quoted(selection.time_field)}",
                "--time-unit s|ms|us|ns",
            )
    return Clock(clock, stamp)


class Groups:
    """Takes several groups of fields out of the messages of a channel.

    Parameters
    ----------
    channel
        Whose messages.
    groups
        Dotted paths.
    path
        The log, for errors.
    """

    def __init__(self, channel: Channel, groups: Sequence[Sequence[str]], path: Path | str) -> None:
        self._sizes = [len(group) for group in groups]
        self._decoder = decoder_of(channel, [name for group in groups for name in group], path)

    def of(self, block: MessageBlock) -> list[list[NDArray[Any]]]:
        """Return the columns of each group."""
        columns = iter(self._decoder.columns(block))
        return [list(islice(columns, size)) for size in self._sizes]


class FieldReading:
    """Reads fields that every message has.

    Parameters
    ----------
    log, channel
        Where the messages are.
    fields
        Dotted paths of the values: one of a row of numbers, or several of one.
    clock
        Whose time.
    absent
        Dotted path of a number that is -1 where the values are absent.
    """

    def __init__(
        self,
        log: MessageLog,
        channel: Channel,
        fields: Sequence[str],
        clock: Clock,
        absent: str | None = None,
    ) -> None:
        self._path = log.path
        self._clock = clock
        groups = (fields, clock.fields, (absent,) if absent else ())
        self._groups = Groups(channel, groups, log.path)

    def columns(self, block: MessageBlock) -> Columns:
        """Return log times with ``(t_ns, values)``; the order is the block's."""
        fields, stamp, marks = self._groups.of(block)
        values = rows(fields)
        for absent in marks:
            if (absent == ABSENT).any():
                values[absent == ABSENT] = np.nan
        t_ns = self._clock.ns(stamp, block, self._path)
        return Columns(block.log_ns, (t_ns, values), block.not_before_ns)


def _kept(log: MessageLog, channel: Channel, reading: Reading, block: MessageBlock) -> Columns:
    """Return the rows of a block without the messages that do not fit."""
    try:
        return reading.columns(block)
    except MessageError as error:
        if not error.positions:
            raise
        log.losses.append(Loss(f"topic {channel.topic}", str(error.reason), len(error.positions)))
        return _kept(log, channel, reading, _without(block, error.positions))


def rows(parts: list[NDArray[Any]]) -> Float64:
    """Return one row of numbers, or several numbers, as rows of float64 of their own."""
    joined = parts[0] if len(parts) == 1 else np.stack(parts, axis=1)
    return np.array(joined, dtype=np.float64, order="C")


def _without(block: MessageBlock, positions: tuple[int, ...]) -> MessageBlock:
    keep = np.ones(len(block), dtype=np.bool_)
    keep[list(positions)] = False
    return replace(
        block,
        starts=block.starts[keep],
        ends=block.ends[keep],
        log_ns=block.log_ns[keep],
        publish_ns=block.publish_ns[keep],
    )
