"""From what a log holds to body rates in rad/s at stamps in ns.

This is where a topic or a set of columns is chosen, the unit applied and the clock read. Nothing
is guessed silently: what was inferred stands in :attr:`Source.remarks`, what is ambiguous is
refused with the option that settles it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, cast

import numpy as np

from quatprop.errors import (
    AmbiguousTopicError,
    NoRatesError,
    NoSuchTopicError,
    UndeclaredError,
    UsageError,
)
from quatprop.messages.rates import rate_field_at, rate_fields
from quatprop.series import GyroSeries
from quatprop.signals.channel_values import channels_of, clock_of, stamps_logged, timed_values
from quatprop.signals.rate_readings import rate_reading
from quatprop.tables.base import is_table
from quatprop.tables.matching.choose import match_rates
from quatprop.text import listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from quatprop.containers.base import Channel, MessageLog
    from quatprop.messages.rate_types import RateField
    from quatprop.selection import RateSelection
    from quatprop.signals.channel_values import Clock
    from quatprop.tables.base import TableLog
    from quatprop.tables.matching.choose import ColumnMatch
    from quatprop.text import Text

    Int64 = NDArray[np.int64]

UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
"""rad/s in each unit of angular rate."""


@dataclass(frozen=True, slots=True)
class Source:
    """One series of body rates in a log.

    Parameters
    ----------
    name
        The topic, or the names of the rate columns.
    type_name
        The message type, or the dialect of a table; ``""`` where there is none.
    rate
        The field or the columns that are the rate.
    unit
        Their unit, ``"rad/s"`` or ``"deg/s"``.
    clock
        Whose stamps: ``"header"``, ``"log"``, ``"publish"``, or the name of a column.
    remarks
        What was inferred.
    batches
        Reads the samples, rad/s and ns, in batches in the order of the log.
    measured
        Whether this is a gyroscope; false for velocities that were estimated or commanded.
    method
        The method that fits what the sensor does, where the definition of its messages says it.
    increments
        Whether the sensor has integrated: then no method rules an interval.
    stamps
        Reads the stamps of messages and when they were logged, ns, as `batches` reads the samples;
        None for a table.
    """

    name: str
    type_name: str
    rate: str
    unit: str
    clock: str
    remarks: tuple[str | Text, ...]
    batches: Callable[[], Iterator[GyroSeries]]
    measured: bool = True
    method: str | None = None
    increments: bool = False
    stamps: Callable[[], Iterator[tuple[Int64, Int64]]] | None = None

    def ruled_by(self, method: str) -> str:
        """Return what rules the intervals if a method is asked for: the sensor, or the method."""
        return "increments" if self.increments else method

    def remarks_on(self, method: str) -> list[str]:
        """Return what is to be said about propagating this source with a method."""
        if self.method in (None, method) or self.increments:
            return []
        said = (
            "each rate is the average over the interval before its stamp, which --method "
            f"{self.method} takes it for; --method {method} was used"
        )
        return [said]


def choose(log: MessageLog | TableLog, selection: RateSelection) -> Source:
    """Return the one source that the options leave.

    Raises
    ------
    NoRatesError
        Nothing in the log carries body rates.
    NoSuchTopicError
        The topic asked for is not there, or carries none.
    AmbiguousTopicError
        Several sources remain.
    UndeclaredError
        A unit, a column or the time is declared nowhere.
    """
    every = sources(log, selection)
    # A velocity that was estimated or commanded does not compete with a gyroscope.
    found = [source for source in every if source.measured] or every
    if len(found) > 1:
        names = [source.name for source in found]
        if len(set(names)) == 1:
            raise _same_topic(log, found)
        raise AmbiguousTopicError(log.path, names)
    passed_over = [source.name for source in every if source not in found]
    if not passed_over:
        return found[0]
    remark = f"passed over rates that are estimates, not measured: {listed(passed_over)}"
    return replace(found[0], remarks=(*found[0].remarks, remark))


def stamps_of(
    selection: RateSelection, log: MessageLog | TableLog
) -> Iterator[tuple[Int64, Int64]]:
    """Yield the stamps of the messages that :func:`choose` chooses, and when they were logged.

    Yields
    ------
    tuple
        Shapes ``(N,)``, int64 ns, in order of log times; none for a table.
    """
    read = choose(log, selection).stamps
    return iter(()) if read is None else read()


def sources(log: MessageLog | TableLog, selection: RateSelection) -> list[Source]:
    """Return every source of body rates that the options leave, at least one.

    Raises
    ------
    LogError
        As for :func:`choose`, but for the ambiguity.
    """
    if is_table(log):
        return [_of_table(log, selection)]
    return _of_messages(cast("MessageLog", log), selection)


def _of_table(log: TableLog, selection: RateSelection) -> Source:
    columns = match_rates(log, selection)
    return Source(
        name=columns.name,
        type_name=columns.dialect,
        rate=columns.name,
        unit=columns.unit,
        clock=columns.clock,
        remarks=columns.remarks,
        batches=partial(_table_rates, log, columns),
        method=columns.method,
    )


def _table_rates(log: TableLog, columns: ColumnMatch) -> Iterator[GyroSeries]:
    """Yield the rates of a table in rad/s."""
    factors = [factor for factor in (columns.scale, UNITS[columns.unit]) if factor != 1.0]
    for t_ns, rate in log.rows(columns.timed):
        for factor in factors:
            np.multiply(rate, factor, out=rate)
        yield GyroSeries(t_ns, rate)


def _of_messages(log: MessageLog, selection: RateSelection) -> list[Source]:
    for option, value in (("--rate-cols", selection.rate_cols), ("--time-col", selection.time_col),
                          ("--sample-rate", selection.sample_rate)):  # fmt: skip
        if value is not None:
            raise UsageError(f"{option} is for tables, and {quoted(log.path)} holds messages")
    wanted = channels_of(log, selection.topic)
    found = [
        _of_channel(log, channel, field, selection)
        for channel in wanted
        for field in _fields(log, channel, selection)
    ]
    if found:
        return found
    if selection.topic is not None:
        if wanted and selection.rate_field is not None:
            raise _no_such_field(log, wanted, selection.rate_field)
        named = [c.topic for c in channels_of(log) if rate_fields(c, log.path)]
        raise NoSuchTopicError(log.path, selection.topic, named)
    if wanted and selection.rate_field is not None:
        raise _no_such_field(log, wanted, selection.rate_field)
    raise NoRatesError(log.path, [f"{c.topic} ({c.type_name})" for c in wanted])


def _no_such_field(log: MessageLog, channels: list[Channel], name: str) -> UsageError:
    """Return the error for a field that no message has, with the rates that there are."""
    known = [
        f"{field.name} ({channel.topic})"
        for channel in channels
        for field in rate_fields(channel, log.path)
    ]
    there = (
        f"the rates that are known are {listed(known)}"
        if known
        else (f"the topics are {listed(f'{c.topic} ({c.type_name})' for c in channels)}")
    )
    return UsageError(f"{plain(log.path)}: no message has a field {quoted(name)}; {there}")


def _fields(log: MessageLog, channel: Channel, selection: RateSelection) -> list[RateField]:
    """Return the rates of a channel: those of known types, or the one the options name."""
    if selection.rate_field is None:
        return rate_fields(channel, log.path)
    field = rate_field_at(channel, selection.rate_field, log.path)
    return [] if field is None else [field]


def _of_channel(
    log: MessageLog, channel: Channel, field: RateField, selection: RateSelection
) -> Source:
    unit = _unit(log, channel, field, selection)
    clock = clock_of(log, channel, field.stamp, selection)
    return Source(
        name=channel.topic,
        type_name=channel.type_name,
        rate=field.name,
        unit=unit,
        clock=clock.name,
        remarks=(*_remarks(field), *_unit_remarks(channel, field, unit)),
        batches=partial(_samples, log, channel, field, UNITS[unit], clock),
        measured=field.measured,
        method=field.method,
        increments=field.span is not None,
        stamps=partial(_stamps, log, channel, field, clock),
    )


def _remarks(field: RateField) -> tuple[str, ...]:
    if field.span is not None:
        return ("increments that the sensor has integrated: taken as they are under every method",)
    if field.burst is not None:
        return ("many samples a message: each has its own time, counted back from the stamp",)
    return ()


def _unit_remarks(channel: Channel, field: RateField, unit: str) -> Iterator[str]:
    if field.unit is not None and unit != field.unit:
        yield (
            f"{channel.type_name} has its rates in {field.unit}, by definition; they are read as "
            f"{unit}, as --rate-unit says"
        )


def _unit(log: MessageLog, channel: Channel, field: RateField, selection: RateSelection) -> str:
    unit = selection.rate_unit or field.unit
    if unit is None:
        raise UndeclaredError(
            log.path,
            f"the unit of field {quoted(field.name)} in topic {quoted(channel.topic)}",
            "--rate-unit rad/s|deg/s",
        )
    return unit


def _samples(
    log: MessageLog, channel: Channel, field: RateField, scale: float, clock: Clock
) -> Iterator[GyroSeries]:
    """Yield the rates of one channel in order of their log times."""
    reading = rate_reading(log, channel, field, clock)
    for t_ns, rate, *span_ns in timed_values(log, channel, reading):
        yield GyroSeries(t_ns, rate if scale == 1.0 else rate * scale, *span_ns)


def _stamps(
    log: MessageLog, channel: Channel, field: RateField, clock: Clock
) -> Iterator[tuple[Int64, Int64]]:
    """Yield the stamps of one channel and when they were logged."""
    return stamps_logged(log, channel, rate_reading(log, channel, field, clock))


def _same_topic(log: MessageLog | TableLog, found: list[Source]) -> UsageError:
    """Return the error for one topic with several rates in its messages."""
    rates = listed(source.rate for source in found)
    return UsageError(
        f"{plain(log.path)}: messages of topic {quoted(found[0].name)} carry several body rates: "
        f"{rates}; choose one with --rate-field"
    )
