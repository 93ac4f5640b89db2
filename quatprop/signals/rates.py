"""Body rates of a log, in rad/s at stamps in ns: rates as they are, increments, bursts."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.kept_blocks import beginnings_kept
from quatprop.containers.merge import Columns
from quatprop.errors import MessageError, UndeclaredError
from quatprop.messages.signal_fields import rate_field_at, rate_fields
from quatprop.series import GyroSeries
from quatprop.settings.quantities import SCALED_RATE_UNITS
from quatprop.signals import absent_rates
from quatprop.signals.choice import RATES, Candidate, choose, message_candidates
from quatprop.signals.clock import Clock, choose_clock
from quatprop.signals.message_values import (
    as_rows,
    field_reader,
    group_decoder,
    logged_values,
    series_of,
    stamps_of,
)
from quatprop.signals.signal import RateSignal
from quatprop.tables.base import AnyLog, TableLog
from quatprop.text import Setting, quoted
from quatprop.times import NS_PER_S, NS_PER_UNIT

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.containers.base import Channel, MessageBlock, MessageLog
    from quatprop.containers.time_range import TimeRange
    from quatprop.messages.message_types import Burst, RateField
    from quatprop.messages.stamps import Stamp
    from quatprop.selection import RateSelection
    from quatprop.signals.message_values import MessageReader
    from quatprop.signals.time_ranges import RangeReader, TableRangeReader

UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
"""rad/s in each unit of angular rate."""

MAX_SPACING_NS = NS_PER_S
"""Samples of a burst are not further apart than this, unless the message is damaged."""


def choose_rates(log: AnyLog, selection: RateSelection) -> RateSignal:
    """Return the only body rates that a selection leaves.

    Raises
    ------
    NoRatesError
        Nothing in the log carries body rates.
    NoSuchTopicError
        The topic is not there, or carries none.
    AmbiguousTopicError
        Several topics carry body rates.
    UndeclaredError
        A unit, a column or the time is declared nowhere.
    UsageError
        Settings contradict each other or the log.
    """
    return choose(log, rate_candidates(log, selection), RATES)


def signal_of_series(series: GyroSeries) -> RateSignal:
    """Return rates in memory as a signal."""
    return RateSignal(
        name="series",
        type_name="",
        field="rate",
        clock="",
        batches=lambda: iter([series]),
        unit="rad/s",
        method="end" if series.averages else None,
        increments=series.span_ns is not None,
    )


def rate_candidates(log: AnyLog, selection: RateSelection) -> list[Candidate[RateSignal]]:
    """Return the body rates that a selection leaves, at least one.

    Raises
    ------
    LogError
        As for :func:`choose_rates`, but for the ambiguity; what is not declared about a candidate
        is refused when its signal is asked for.
    """
    if isinstance(log, TableLog):
        return [Candidate("", "", partial(_of_table, log, selection))]
    return message_candidates(log, selection, RATES, _candidates)


def _of_table(log: TableLog, selection: RateSelection) -> RateSignal:
    from quatprop.tables.matching.choose import match_rates

    columns = match_rates(log, selection)
    factors = [factor for factor in (columns.scale, UNITS[columns.unit]) if factor != 1.0]

    if not (is_named := selection.rate_cols is not None):
        absent_rates.refuse_marked_rows(log, columns)

    def batches(parts: frozenset[int] | None = None) -> Iterator[GyroSeries]:
        for t_ns, numbers in log.metered_rows(columns.timed._replace(parts=parts)):
            rate = absent_rates.rates_of_rows(log, columns, numbers, is_named=is_named)
            for factor in factors:
                np.multiply(rate, factor, out=rate)
            yield GyroSeries(t_ns, rate, averages=columns.method == "end")

    def part_reader() -> TableRangeReader | None:
        from quatprop.signals.time_ranges import TableRangeReader

        spans = log.spans(columns.timed)
        return TableRangeReader(spans, batches) if spans else None

    return RateSignal(
        name=columns.name,
        type_name=columns.dialect,
        field=columns.name,
        clock=columns.clock,
        remarks=columns.remarks,
        batches=batches,
        unit=columns.unit,
        method=columns.method,
        part_reader=part_reader,
    )


def _candidates(
    log: MessageLog, channel: Channel, selection: RateSelection
) -> list[Candidate[RateSignal]]:
    """Return the rates of a channel: those of recognised types, or the one that is named."""
    if selection.rate_field is None:
        fields = rate_fields(channel, log.path)
    else:
        named = rate_field_at(channel, selection.rate_field, log.path)
        fields = [] if named is None else [named]
    return [
        Candidate(
            channel.topic,
            field.name,
            partial(_of_field, log, channel, field, selection),
            field.measured,
        )
        for field in fields
    ]


def _of_field(
    log: MessageLog, channel: Channel, field: RateField, selection: RateSelection
) -> RateSignal:
    unit, scale = SCALED_RATE_UNITS.get(field.unit or "", (field.unit, 1.0))
    if selection.rate_unit is not None:
        unit, scale = selection.rate_unit, 1.0
    if unit is None:
        raise UndeclaredError(
            log.path,
            f"the unit of field {quoted(field.name)} in topic {quoted(channel.topic)}",
            Setting("rate_unit", "rad/s|deg/s"),
        )
    factor, averages = scale * UNITS[unit], field.method == "end"
    is_named = selection.rate_field is not None
    with beginnings_kept(log):
        if not is_named:
            absent_rates.refuse_marked_messages(log, channel, field)
        clock = choose_clock(log, channel, field.stamps, selection)
    reader = partial(_reader, log, channel, field, clock, is_named=is_named)

    def scaled(columns: Columns) -> Columns:
        if factor != 1.0:
            np.multiply(columns.values[1], factor, out=columns.values[1])
        return columns

    def rows(within: TimeRange | None = None) -> Iterator[Columns]:
        return map(scaled, logged_values(log, channel, reader(), within))

    def batches(within: TimeRange | None = None) -> Iterator[GyroSeries]:
        return series_of(rows(within), averages=averages)

    def part_reader() -> RangeReader | None:
        span = log.recorded_span(channel)
        if span is None:
            return None
        from quatprop.signals.time_ranges import RangeReader

        return RangeReader(span, lambda within: stamps_of(rows(within)), batches)

    return RateSignal(
        name=channel.topic,
        type_name=channel.type_name,
        field=field.name,
        clock=clock.name,
        remarks=(*_remarks(channel, field, selection.rate_unit), *clock.remarks),
        stamps=lambda: stamps_of(rows()),
        batches=batches,
        logged_batches=lambda: series_of(rows(), averages=averages, logged=True),
        rows=rows,
        unit=unit,
        method=field.method,
        increments=field.span is not None,
        part_reader=part_reader,
    )


def _remarks(channel: Channel, field: RateField, unit: str | None) -> Iterator[str]:
    if field.span is not None:
        yield "the samples are angle increments: the sensor itself has summed up its rate"
    elif field.burst is not None:
        yield "several samples a message: the time of each is counted back from the stamp"
    if unit and field.unit not in (None, unit):
        yield (
            f"{channel.type_name} has its rates in {field.unit}, by definition; they are read as "
            f"{unit}, as asked for"
        )


def _reader(
    log: MessageLog, channel: Channel, field: RateField, clock: Clock, *, is_named: bool
) -> MessageReader:
    """Return what turns the messages of a channel into rates.

    Parameters
    ----------
    log, channel
        Where the messages are.
    field
        What they carry.
    clock
        Time base.
    is_named
        Whether the user names the field: then it is read where it is marked as absent, too.

    Returns
    -------
    MessageReader
        Its values are the arguments of :class:`quatprop.series.GyroSeries`, but in the unit of
        the field.
    """
    if field.burst is not None:
        return _burst_reader(log, channel, field, field.burst, clock)
    if field.span is not None:
        return _increment_reader(log, channel, field, field.span, clock)
    if is_named and field.absent is not None:
        return absent_rates.named_reader(log, channel, field, clock)
    return field_reader(log, channel, clock, field.fields, [field.absent])


def _increment_reader(
    log: MessageLog, channel: Channel, field: RateField, span: Stamp, clock: Clock
) -> MessageReader:
    """Read one increment a message, with the time over which it was integrated."""
    decode = group_decoder(log, channel, clock, field.fields, span.fields)

    def columns(block: MessageBlock) -> Columns:
        t_ns, (increment, spans) = decode(block)
        span_ns = span.ns(spans, log.path)
        # An increment over no time has no rate; it is not finite, and policies deal with that.
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = as_rows(increment) / (span_ns / NS_PER_S)[:, None]
        return Columns(block.log_ns, (t_ns, rate, span_ns), block.not_before_ns)

    return columns


def _burst_reader(
    log: MessageLog, channel: Channel, field: RateField, burst: Burst, clock: Clock
) -> MessageReader:
    """Read many samples a message, evenly spaced up to the stamp; one row a sample."""
    decode = group_decoder(log, channel, clock, field.fields, burst.fields)

    def columns(block: MessageBlock) -> Columns:
        stamp_ns, (axes, (samples, scale, spacing)) = decode(block)
        stored = np.stack(axes, axis=2)
        counts, room = samples.astype(np.int64), stored.shape[1]
        spacing_ns = spacing.astype(np.float64) * NS_PER_UNIT[burst.spacing.unit]
        # Written so that NaN is refused too.
        good = (counts <= room) & (spacing_ns >= 0) & (spacing_ns <= MAX_SPACING_NS)
        if not good.all():
            bad = np.flatnonzero(~good)
            raise MessageError(
                log.path,
                f"a message of topic {quoted(channel.topic)} counts {counts[bad[0]]} samples, "
                f"{spacing_ns[bad[0]]:g} ns apart, and has room for {room}; the log is damaged",
                bad.tolist(),
            )
        message = np.repeat(np.arange(len(counts)), counts)
        position = np.arange(len(message)) - np.repeat(np.cumsum(counts) - counts, counts)
        rate = stored[message, position] * scale.astype(np.float64)[message, None]
        # Rounded last: the spacing need not be a whole number of nanoseconds.
        before = np.rint((counts[message] - 1 - position) * spacing_ns[message]).astype(np.int64)
        t_ns = stamp_ns[message] - before
        return Columns(block.log_ns[message], (t_ns, rate), block.not_before_ns)

    return columns
