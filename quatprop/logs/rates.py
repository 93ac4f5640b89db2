"""Body rates of a log, in rad/s at stamps in ns: rates as they are, increments, bursts."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from quatprop.logs.choice import RATES, Candidate, candidates, choose
from quatprop.logs.rate_columns import match_rates
from quatprop.logs.reading import read_rates, refuse_marked
from quatprop.signals.signal import RateSignal, series_of, stamps_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.conditioning.time_range import PartReader
    from quatprop.logs.matching import Found
    from quatprop.logs.rows import Row
    from quatprop.series import GyroSeries
    from quatprop.settings.selection import RateSelection
    from quatprop.tables.base import AnyLog
    from quatprop.tables.model import Within


def choose_rates(log: AnyLog, selection: RateSelection) -> RateSignal:
    """Return the only body rates that a selection leaves."""
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
    """Return the body rates that a selection leaves, at least one."""
    return [
        Candidate(found, partial(_signal, found, selection), found.row.measured)
        for found in candidates(log, selection, RATES)
    ]


def _signal(found: Found, selection: RateSelection) -> RateSignal:
    """Return rates with their unit and their time."""
    match = match_rates(found, selection)
    refuse_marked(match)
    table, row, stamp = match.table, match.row, match.stamp
    averages = row.method == "end"

    def batches(within: Within = None) -> Iterator[GyroSeries]:
        return series_of(read_rates(match, within), averages=averages)

    def part_reader() -> PartReader | None:
        from quatprop.signals.time_ranges import RangeReader, TableRangeReader

        if spans := table.spans(stamp):
            return TableRangeReader(spans, batches)
        if (span := table.recorded_span()) is None:
            return None
        return RangeReader(span, lambda within: stamps_of(read_rates(match, within)), batches)

    return RateSignal(
        name=table.name or match.found.field,
        type_name=table.type or row.name,
        field=match.found.field,
        clock=stamp.clock,
        remarks=(*_sample_remarks(row), *match.remarks),
        stamps=lambda: stamps_of(read_rates(match)),
        batches=batches,
        rows=lambda: read_rates(match),
        unit=match.unit,
        method=row.method,
        increments=row.span != "",
        part_reader=part_reader,
        matches=(match,),
    )


def _sample_remarks(row: Row) -> tuple[str, ...]:
    """Return the remark on rates that are not one each."""
    if row.span:
        return ("the samples are angle increments: the sensor itself has summed up its rate",)
    if row.burst is not None:
        return ("several samples a message: the time of each is counted back from the stamp",)
    return ()
