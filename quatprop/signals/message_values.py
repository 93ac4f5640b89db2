"""From the messages of a channel to stamps and values, in the order of the log.

What rates and attitudes have in common: fields are decoded as columns, values that a message marks
as absent become NaN, and messages that do not fit their definition are counted as lost.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from quatprop.containers.coalesce import coalesce_blocks
from quatprop.containers.kept_blocks import blocks_of
from quatprop.containers.merge import Columns, joined_rows, merge_by_time
from quatprop.errors import MessageError
from quatprop.messages.decoders import decoder_of
from quatprop.messages.values import raw_messages
from quatprop.progress import metered
from quatprop.series import GyroSeries
from quatprop.text import quoted
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from quatprop.arrays import AnyArray, Float64, Int64
    from quatprop.containers.base import Channel, MessageBlock, MessageLog
    from quatprop.containers.time_range import TimeRange
    from quatprop.signals.clock import Clock

    MessageReader: TypeAlias = Callable[[MessageBlock], Columns]
    """Turns the blocks of one channel into rows: log times with ``(t_ns, values)``, shapes ``(N,)``
    and ``(N, k)``. MessageError has the `positions` of messages that do not fit."""


ABSENT = -1.0
"""What the first number of a covariance is where the value beside it is not measured."""


CLOCK_STEP_NS = 100_000_000
"""Time services set a clock that is wrong by more than this; what is less they catch up slowly."""

_ROWS = 1 << 13
"""Rows of a batch that is large enough."""


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
        instances = [
            channel
            for channel in channels
            if channel.encoding == "ulog" and channel.topic.rpartition("/")[0] == topic
        ]
        channels = named or (instances if len(instances) == 1 else [])
    return [_with_sample(log, channel) for channel in channels]


def _with_sample(log: MessageLog, channel: Channel) -> Channel:
    if channel.encoding == "json":
        from quatprop.messages.json import sample_of

        for block in blocks_of(log, channel):
            if len(block):
                return replace(channel, sample=sample_of(raw_messages(block)))
    return channel


def group_decoder(
    log: MessageLog, channel: Channel, clock: Clock, *groups: Sequence[str | None]
) -> Callable[[MessageBlock], tuple[Int64, list[list[AnyArray]]]]:
    """Return what decodes the time and several groups of fields of a channel's messages.

    Parameters
    ----------
    log, channel
        Where the messages are.
    clock
        Time base.
    *groups
        Dotted paths; None is left out.

    Returns
    -------
    callable
        Returns the time of each message of a block, int64 ns, and the columns of each group.
    """
    present = [[name for name in group if name] for group in (clock.fields, *groups)]
    decoder = decoder_of(channel, [name for group in present for name in group], log.path)

    def decode(block: MessageBlock) -> tuple[Int64, list[list[AnyArray]]]:
        columns = iter(decoder.columns(block))
        stamp, *others = [list(islice(columns, len(group))) for group in present]
        return clock.ns(stamp, block, log.path), others

    return decode


def field_reader(
    log: MessageLog, channel: Channel, clock: Clock, *groups: Sequence[str | None]
) -> MessageReader:
    """Return what reads one row of numbers a message; the order is that of the block.

    Its groups are the values (one row of numbers, or several numbers), a number that is -1 where
    they are absent, and other rows of numbers beside them, given as they are.
    """
    decode = group_decoder(log, channel, clock, *groups)

    def columns(block: MessageBlock) -> Columns:
        t_ns, (fields, marks, *others) = decode(block)
        values = without_absent(as_rows(fields), marks)
        beside = [as_rows(other) for other in others if other]
        return Columns(block.log_ns, (t_ns, values, *beside), block.not_before_ns)

    return columns


def without_absent(rows: Float64, marks: Iterable[AnyArray]) -> Float64:
    """Set rows of numbers to NaN where one of the marks beside them says that they are absent."""
    for mark in marks:
        if count := np.count_nonzero(is_absent := mark == ABSENT):
            # Setting all of them is much quicker without a mask.
            rows[is_absent if count < len(mark) else ...] = np.nan
    return rows


def as_rows(fields: list[AnyArray]) -> Float64:
    """Return one row of numbers, or several numbers, as a new array ``(N, k)`` of float64.

    Its columns are contiguous: that is how rows are computed with, and quicker to make.
    """
    stacked = fields[0] if len(fields) == 1 else np.stack(fields).T
    with np.errstate(invalid="ignore"):  # a damaged log may have float32 NaNs that signal
        return np.array(stacked, dtype=np.float64, order="F")


def timed_values(
    log: MessageLog, channel: Channel, reader: MessageReader
) -> Iterator[tuple[AnyArray, ...]]:
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
    for columns in logged_values(log, channel, reader):
        yield columns.values


def stamps_of(rows: Iterable[Columns]) -> Iterator[tuple[Int64, Int64]]:
    """Yield the stamps of rows and their log times, shapes ``(N,)``, int64 ns."""
    for columns in rows:
        yield columns.values[0], columns.log_ns


def series_of(rows: Iterable[Columns], *, averages: bool) -> Iterator[GyroSeries]:
    """Yield rates, rad/s, of rows whose values are their stamps, the rates, and their spans."""
    for columns in rows:
        t_ns, rate, *spans = columns.values
        yield GyroSeries(t_ns, rate, spans[0] if spans else None, averages)


def logged_values(
    log: MessageLog, channel: Channel, reader: MessageReader, within: TimeRange | None = None
) -> Iterator[Columns]:
    """Yield the values of one channel with their log times, in order of these if they are recorded.

    Parameters
    ----------
    log, channel, reader
        As for :func:`timed_values`.
    within
        Only the parts of the log that have this range of log times by its index; None is all.
    """
    every = blocks_of(log, channel) if within is None else log.blocks_within(channel, within)
    blocks = metered(coalesce_blocks(every), channel.count if within is None else None)
    batches = (_readable(log, channel, reader, block) for block in blocks)
    return merge_by_time([_joined(batches)]) if log.has_log_time else filter(len, batches)


def _joined(batches: Iterable[Columns]) -> Iterator[Columns]:
    """Yield batches of more rows, each of which takes less time; the first one as it is."""
    waiting: list[Columns] = []
    rows, enough = 0, 0
    for batch in batches:
        waiting.append(batch)
        rows += len(batch)
        if rows >= enough:
            yield joined_rows(waiting)
            waiting, rows, enough = [], 0, _ROWS
    if waiting:
        yield joined_rows(waiting)


def _remark_on_step(log: MessageLog, channel: Channel, log_ns: Int64) -> None:
    """Remark on log times, in the order of the log, that step back as after setting a clock."""
    remark = (
        f"the log times of topic {quoted(channel.topic)} step back on the way by more than "
        f"{duration_text(CLOCK_STEP_NS)}, as where the recorder's clock was set back; samples are "
        "taken in the order of their log times"
    )
    if log.has_log_time and np.diff(log_ns).min() < -CLOCK_STEP_NS and remark not in log.remarks:
        log.remarks = [*log.remarks, remark]


def _readable(
    log: MessageLog, channel: Channel, reader: MessageReader, block: MessageBlock
) -> Columns:
    """Return the rows of a block without the messages that do not fit."""
    if (block.log_ns[1:] < block.log_ns[:-1]).any():
        _remark_on_step(log, channel, block.log_ns)
    try:
        return reader(block)
    except MessageError as error:
        if not error.positions:
            raise
        # Of the same reason in several blocks each counts, however often they are read.
        first_ns = int(block.log_ns[error.positions[0]])
        reason, count = str(error.reason), len(error.positions)
        log.losses.note(f"topic {channel.topic}", reason, count, part=first_ns)
        keep = np.ones(len(block), np.bool_)
        keep[list(error.positions)] = False
        return _readable(log, channel, reader, block.at(keep))
