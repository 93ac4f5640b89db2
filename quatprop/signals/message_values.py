"""From the messages of a channel to stamps and values, in the order of the log.

What rates and attitudes have in common: fields are decoded as columns, the clock is chosen, values
that a message marks as absent become NaN, and messages that do not fit their definition are counted
as lost.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from quatprop.containers.coalesce import coalesce_blocks
from quatprop.containers.merge import Columns, merge_by_time
from quatprop.errors import MessageError, TimelineError, UndeclaredError, UsageError
from quatprop.messages.decoders import decoder_of
from quatprop.messages.stamps import time_field_at
from quatprop.text import Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
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
    """Time base of a channel's values.

    Parameters
    ----------
    name
        ``"header"``, ``"log"`` or ``"publish"``.
    stamp
        The field of the message, for a header clock.
    remarks
        What is unusual about it.
    """

    name: str
    stamp: Stamp | None = None
    remarks: tuple[str, ...] = ()

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


def choose_clock(
    log: MessageLog,
    channel: Channel,
    stamps: Sequence[Stamp],
    selection: SignalSelection,
    *,
    has_stamp: bool = False,
) -> Clock:
    """Return the time base to read: as selected, else the header stamp, else the log time.

    Parameters
    ----------
    log, channel
        Where the messages are.
    stamps
        The stamps that belong to the values, the nearest first. One that is zero in all messages
        was never set: then the next is used.
    selection
        Its `clock`, `time_field` and `time_unit` count.
    has_stamp
        Whether the values have stamps of their own, such as those in a list of transforms.

    Raises
    ------
    UsageError
        A header stamp or a publish time is asked for and there is none.
    UndeclaredError
        The unit of a time field is not declared.
    TimelineError
        All header stamps are zero.
    """
    has_stamp = has_stamp or bool(stamps) or selection.time_field is not None
    if selection.clock == "header" and not has_stamp:
        raise UsageError(
            f"{quoted(log.path)}: messages of topic {quoted(channel.topic)} have no header stamp; "
            "choose ",
            Setting("clock", "log|publish" if log.has_publish_time else "log"),
            " or name the stamp with ",
            Setting("time_field"),
        )
    if selection.clock == "publish" and not log.has_publish_time:
        raise UsageError(
            f"{quoted(log.path)}: a log of kind {log.kind} does not record when messages were "
            "published; choose ",
            Setting("clock", "header|log" if has_stamp else "log"),
        )
    name = selection.clock or ("header" if has_stamp else "log")
    if name != "header":
        return Clock(name)
    if selection.time_field is not None:
        stamp = time_field_at(channel, selection.time_field, selection.time_unit, log.path)
        if stamp is None:
            raise UndeclaredError(
                log.path,
                f"the unit of the time in field {quoted(selection.time_field)}",
                Setting("time_unit", "s|ms|us|ns"),
            )
        stamps = (stamp,)
    for stamp in stamps:
        if not are_all(_stamps_alone(log, channel, stamp), 0):
            remark = (
                f"the stamps in {quoted(stamps[0].place)} are all zero; those in "
                f"{quoted(stamp.place)} are used"
            )
            return Clock(name, stamp, () if stamp is stamps[0] else (remark,))
    if stamps:
        raise zero_stamps(log, channel)
    return Clock(name)


def zero_stamps(log: MessageLog, channel: Channel) -> TimelineError:
    """Return the error for messages whose stamps were never set."""
    return TimelineError(
        log.path,
        f"all header stamps of topic {quoted(channel.topic)} are zero; for the time of recording "
        "choose ",
        Setting("clock", "log"),
    )


def are_all(batches: Iterable[NDArray[Any]], value: object, limit: int | None = None) -> bool:
    """Tell whether several rows all have one value; reads up to the first other one.

    Parameters
    ----------
    batches
        Rows, shape ``(N, ...)``.
    value
        What each is compared with.
    limit
        So many rows are enough; None is all.
    """
    count = 0
    for rows in batches:
        if (rows != value).any():
            return False
        count += len(rows)
        if limit is not None and count >= limit:
            break
    return count > 1


def _stamps_alone(log: MessageLog, channel: Channel, stamp: Stamp) -> Iterator[Int64]:
    """Yield the stamps of one channel in no order, without noting what cannot be read."""
    decoder = GroupDecoder(log, channel, Clock("header", stamp))
    for block in log.blocks(channel):
        try:
            yield decoder.decode(block)[0]
        except MessageError as error:
            if not error.positions:
                raise
            # Messages that do not fit are noted when they are read for good.
            yield np.ones(1, np.int64)


def channels_of(log: MessageLog, topic: str | None = None) -> list[Channel]:
    """Return the channels that have messages, with a sample where that is what shows the fields.

    Parameters
    ----------
    log
        The container.
    topic
        Only those of this topic; None for all. A ULog topic with one instance may be named without
        it: ``sensor_combined`` for ``sensor_combined/0``.
    """
    channels = [channel for channel in log.channels() if channel.count != 0]
    if topic is not None:
        named = [channel for channel in channels if channel.topic == topic]
        channels = named or _only_instance(channels, topic)
    return [_with_sample(log, channel) for channel in channels]


def _only_instance(channels: list[Channel], topic: str) -> list[Channel]:
    """Return the channel of a ULog topic that is named without its instance, if it has one."""
    instances = [
        channel
        for channel in channels
        if channel.encoding == "ulog" and channel.topic.rpartition("/")[0] == topic
    ]
    return instances if len(instances) == 1 else []


def _with_sample(log: MessageLog, channel: Channel) -> Channel:
    if channel.encoding == "json":
        for block in log.blocks(channel):
            if len(block):
                sample = block.data[block.starts[0] : block.ends[0]].tobytes()
                return replace(channel, sample=sample)
    return channel


class MessageReader(Protocol):
    """Turns the blocks of one channel into rows."""

    def columns(self, block: MessageBlock) -> Columns:
        """Return log times with ``(t_ns, values)``, shapes ``(N,)`` and ``(N, k)``.

        Raises
        ------
        MessageError
            Messages do not fit; its `positions` say which.
        """


class GroupDecoder:
    """Decodes the time and several groups of fields of a channel's messages.

    Parameters
    ----------
    log, channel
        Where the messages are.
    clock
        Time base.
    *groups
        Dotted paths; None is left out.
    """

    def __init__(
        self, log: MessageLog, channel: Channel, clock: Clock, *groups: Sequence[str | None]
    ) -> None:
        self.path = log.path
        self.topic = channel.topic
        self._clock = clock
        present = [[name for name in group if name] for group in (clock.fields, *groups)]
        self._sizes = [len(group) for group in present]
        self._decoder = decoder_of(channel, [name for group in present for name in group], log.path)

    def decode(self, block: MessageBlock) -> tuple[Int64, list[list[NDArray[Any]]]]:
        """Return the time of each message, int64 ns, and the columns of each group."""
        columns = iter(self._decoder.columns(block))
        stamp, *groups = [list(islice(columns, size)) for size in self._sizes]
        return self._clock.ns(stamp, block, self.path), groups


class FieldReader(GroupDecoder):
    """Reads one row of numbers a message.

    Its groups are the values (one row of numbers, or several numbers), a number that is -1 where
    they are absent, and another row of numbers beside them, given as it is.
    """

    def columns(self, block: MessageBlock) -> Columns:
        """Return log times with ``(t_ns, values)``, or also `beside`; the order is the block's."""
        t_ns, (fields, marks, *others) = self.decode(block)
        values = as_rows(fields)
        for mark in marks:
            if (mark == ABSENT).any():
                values[mark == ABSENT] = np.nan
        beside = [as_rows(other) for other in others if other]
        return Columns(block.log_ns, (t_ns, values, *beside), block.not_before_ns)


def as_rows(fields: list[NDArray[Any]]) -> Float64:
    """Return one row of numbers, or several numbers, as a new array ``(N, k)`` of float64."""
    stacked = fields[0] if len(fields) == 1 else np.stack(fields, axis=1)
    return np.array(stacked, dtype=np.float64, order="C")


def timed_values(
    log: MessageLog, channel: Channel, reader: MessageReader
) -> Iterator[tuple[NDArray[Any], ...]]:
    """Yield the values of one channel with their stamps, in order of their log times.

    Parameters
    ----------
    log
        The container; what cannot be read is added to its losses.
    channel
        One of its channels.
    reader
        Turns its blocks into rows.

    Yields
    ------
    tuple
        What the reader gives of each sample: stamps, shape ``(N,)``, int64 ns, and values, shape
        ``(N, k)``, float64, first.
    """
    for columns in _in_log_order(log, channel, reader):
        yield columns.values


def stamps_logged(
    log: MessageLog, channel: Channel, reader: MessageReader
) -> Iterator[tuple[Int64, Int64]]:
    """Yield the stamps of one channel and their log times, in order of the log times.

    Yields
    ------
    tuple
        Shapes ``(N,)``, int64 ns.
    """
    for columns in _in_log_order(log, channel, reader):
        yield columns.values[0], columns.log_ns


def _in_log_order(log: MessageLog, channel: Channel, reader: MessageReader) -> Iterator[Columns]:
    blocks = coalesce_blocks(log.blocks(channel))
    batches = (_readable(log, channel, reader, block) for block in blocks)
    return merge_by_time([batches])


def _readable(
    log: MessageLog, channel: Channel, reader: MessageReader, block: MessageBlock
) -> Columns:
    """Return the rows of a block without the messages that do not fit."""
    try:
        return reader.columns(block)
    except MessageError as error:
        if not error.positions:
            raise
        # Of the same reason in several blocks each counts, however often they are read.
        first_ns = int(block.log_ns[error.positions[0]])
        reason, count = str(error.reason), len(error.positions)
        log.losses.note(f"topic {channel.topic}", reason, count, part=first_ns)
        return _readable(log, channel, reader, _without(block, error.positions))


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
