"""Body rates of a log, in rad/s at stamps in ns: rates as they are, increments, bursts."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import UndeclaredError
from quatprop.logs.matching import Match, marks_of
from quatprop.logs.reading import read_rates, without_absent
from quatprop.logs.stamps import choose_stamp
from quatprop.series import GyroSeries
from quatprop.settings.quantities import SCALED_RATE_UNITS
from quatprop.signals.choice import RATES, Candidate, choose, message_candidates
from quatprop.signals.signal import RateSignal, series_of, stamps_of
from quatprop.tables.base import AnyLog, TableLog
from quatprop.text import Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.containers.time_range import TimeRange
    from quatprop.logs.matching import Found
    from quatprop.selection import RateSelection
    from quatprop.signals.time_ranges import RangeReader, TableRangeReader

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
    return [
        Candidate(found.table.name, found.field, partial(_signal, found, selection), measured)
        for found in message_candidates(log, selection, RATES)
        for measured in [found.row.measured]
    ]


def _of_table(log: TableLog, selection: RateSelection) -> RateSignal:
    from quatprop.logs.choose import match_rates

    columns = match_rates(log, selection)
    factors = [factor for factor in (columns.scale, UNITS[columns.unit]) if factor != 1.0]

    def batches(parts: frozenset[int] | None = None) -> Iterator[GyroSeries]:
        for t_ns, numbers in log.metered_rows(columns.timed._replace(parts=parts)):
            rate = numbers[:, :3]
            for mark in numbers[:, 3:].T:
                without_absent(rate, mark)
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


def _signal(found: Found, selection: RateSelection) -> RateSignal:
    """Return rates of a topic with their unit and their time."""
    table, row = found.table, found.row
    unit, scale = SCALED_RATE_UNITS.get(row.unit, (row.unit, 1.0))
    if selection.rate_unit is not None:
        unit, scale = selection.rate_unit, 1.0
    if not unit:
        raise UndeclaredError(
            table.path,
            f"the unit of field {quoted(found.field)} in topic {quoted(table.name)}",
            Setting("rate_unit", "rad/s|deg/s"),
        )
    stamp, remarks = choose_stamp(found, selection)
    match = Match(found, stamp, scale * UNITS[unit], marks_of(found))
    averages = row.method == "end"

    def batches(within: TimeRange | None = None) -> Iterator[GyroSeries]:
        return series_of(read_rates(match, within), averages=averages)

    def part_reader() -> RangeReader | None:
        span = table.log.recorded_span(table.channel)
        if span is None:
            return None
        from quatprop.signals.time_ranges import RangeReader

        return RangeReader(span, lambda within: stamps_of(read_rates(match, within)), batches)

    return RateSignal(
        name=table.name,
        type_name=table.type,
        field=found.field,
        clock=stamp.clock,
        remarks=(*_remarks(found, selection.rate_unit), *remarks),
        stamps=lambda: stamps_of(read_rates(match)),
        batches=batches,
        rows=lambda: read_rates(match),
        unit=unit,
        method=row.method,
        increments=row.span != "",
        part_reader=part_reader,
        matches=(match,),
    )


def _remarks(found: Found, unit: str | None) -> Iterator[str]:
    row = found.row
    if row.span:
        yield "the samples are angle increments: the sensor itself has summed up its rate"
    elif row.burst is not None:
        yield "several samples a message: the time of each is counted back from the stamp"
    if unit and row.unit not in ("", unit):
        yield (
            f"{found.table.type} has its rates in {row.unit}, by definition; they are read as "
            f"{unit}, as asked for"
        )
