"""Body rates of a log, in rad/s at stamps in ns."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import UndeclaredError
from quatprop.messages.signal_fields import rate_field_at, rate_fields
from quatprop.series import GyroSeries
from quatprop.settings.quantities import SCALED_RATE_UNITS
from quatprop.signals.choice import RATES, Candidate, choose, message_candidates
from quatprop.signals.clock import choose_clock
from quatprop.signals.message_values import logged_values, series_of, stamps_of
from quatprop.signals.rate_readers import rate_reader
from quatprop.signals.signal import RateSignal
from quatprop.tables.base import TableLog
from quatprop.text import Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.containers.base import Channel, MessageLog
    from quatprop.containers.merge import Columns
    from quatprop.containers.time_range import TimeRange
    from quatprop.messages.message_types import RateField
    from quatprop.selection import RateSelection
    from quatprop.signals.time_ranges import RangeReader, TableRangeReader
    from quatprop.tables.base import AnyLog

UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
"""rad/s in each unit of angular rate."""


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

    def batches(parts: frozenset[int] | None = None) -> Iterator[GyroSeries]:
        for t_ns, rate in log.metered_rows(columns.timed._replace(parts=parts)):
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
    clock = choose_clock(log, channel, field.stamps, selection)
    reader = partial(rate_reader, log, channel, field, clock)

    def rows(within: TimeRange | None = None) -> Iterator[Columns]:
        for columns in logged_values(log, channel, reader(), within):
            if factor != 1.0:
                np.multiply(columns.values[1], factor, out=columns.values[1])
            yield columns

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
