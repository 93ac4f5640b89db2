"""Body rates of a log, in rad/s with timestamps in ns: plain rates, increments, bursts."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from quatprop.logs.signals.choice import RATES, Candidate, candidates, choose
from quatprop.logs.signals.rate_columns import match_rates
from quatprop.logs.signals.reading import refuse_marked
from quatprop.logs.signals.signal import RateSignal
from quatprop.text import Remark

if TYPE_CHECKING:
    from quatprop.logs.matching.find import Found
    from quatprop.logs.vocabulary.rows import Row
    from quatprop.series import GyroSeries
    from quatprop.settings.selection import RateSelection
    from quatprop.tables.log import Log


def choose_rates(log: Log, selection: RateSelection) -> RateSignal:
    """Return the only body rates in a log that match a selection."""
    return choose(log, rate_candidates(log, selection), RATES)


def signal_of_series(series: GyroSeries) -> RateSignal:
    """Return rates in memory as a signal."""
    return RateSignal(
        name="series",
        type_name="",
        field="rate",
        clock="",
        series=series,
        unit="rad/s",
        method="end" if series.is_interval_average else None,
        increments=series.integration_time_ns is not None,
    )


def rate_candidates(log: Log, selection: RateSelection) -> list[Candidate[RateSignal]]:
    """Return the body rates in a log that match a selection, at least one."""
    return [
        Candidate(found, partial(_signal, found, selection), found.row.measured)
        for found in candidates(log, selection, RATES)
    ]


def _signal(found: Found, selection: RateSelection) -> RateSignal:
    """Return rates with their unit and timestamp."""
    match = match_rates(found, selection)
    refuse_marked(match)
    table, row = match.table, match.row
    return RateSignal(
        name=table.name or match.field,
        type_name=table.type or row.name,
        field=match.field,
        clock=match.stamp.clock,
        remarks=(*_sample_remarks(row), *match.remarks),
        unit=match.unit,
        unit_is_given=selection.rate_unit is not None,
        method=row.method,
        increments=row.span != "",
        matches=(match,),
    )


def _sample_remarks(row: Row) -> tuple[Remark, ...]:
    """Return the remark on increments or bursts."""
    if row.span:
        text = "the samples are angle increments: the sensor itself has summed up its rate"
        return (Remark("increments", text),)
    if row.burst is not None:
        text = "several samples per message: the time of each is counted back from the timestamp"
        return (Remark("bursts", text),)
    return ()
