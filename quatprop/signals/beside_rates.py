"""What a log has beside its rates, in the same messages or rows: specific force, orientation."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

from quatprop.messages.signal_fields import fields_beside
from quatprop.selection import AttitudeSelection
from quatprop.signals.attitudes import choose_attitudes
from quatprop.signals.clock import choose_clock
from quatprop.signals.message_values import FieldReader, channels_of, timed_values
from quatprop.tables.base import is_table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.containers.base import MessageLog
    from quatprop.selection import RateSelection
    from quatprop.signals.signal import AttitudeSignal, RateSignal
    from quatprop.tables.base import TableLog

    Rows = Iterator[Any]

_ACCELERATION = re.compile(
    r"(?:.*\.)?(?:a_rs_s_|acc(?:el(?:eration|erometer)?)?[ _]?|linear_acceleration\.|"
    r"accelerometer_m_s2\[?|a)(?P<axis>[xyz012])\]?",
    re.IGNORECASE,
)
"""Columns of specific force, by their name without a unit."""


def specific_forces(
    log: MessageLog | TableLog, source: RateSignal, selection: RateSelection
) -> Rows | None:
    """Return stamps, ns, and specific forces in sensor axes, ``(N, 3)``; None where there are none.

    Parameters
    ----------
    log
        An open log that can be read again.
    source, selection
        Its rates, and how they were chosen.
    """
    if is_table(log):
        return _table_forces(log, selection)
    return _message_forces(cast("MessageLog", log), source, selection)


def _message_forces(log: MessageLog, source: RateSignal, selection: RateSelection) -> Rows | None:
    for channel in channels_of(log, source.name):
        if channel.type_name != source.type_name:
            continue
        beside = fields_beside(channel, source.field, log.path)
        if beside.rate is None or beside.acceleration is None:
            continue
        name, absent = beside.acceleration
        clock = choose_clock(log, channel, beside.rate.stamps, selection)
        reading = FieldReader(log, channel, clock, [name], [absent])
        rows: Rows = timed_values(log, channel, reading)
        return rows
    return None


def _table_forces(log: TableLog, selection: RateSelection) -> Rows | None:
    from quatprop.tables.matching.choose import match_rates
    from quatprop.tables.matching.column_names import parse_name

    axes: dict[int, int] = {}
    for position, name in enumerate(log.columns()):
        if match := _ACCELERATION.fullmatch(parse_name(name).key):
            axes.setdefault("xyz012".index(match["axis"]) % 3, position)
    if len(axes) != 3:  # noqa: PLR2004  # axes
        return None
    timed = match_rates(log, selection).timed
    rows: Rows = log.metered_rows(replace(timed, numbers=tuple(axes[axis] for axis in range(3))))
    return rows


def own_orientation(
    log: MessageLog | TableLog, source: RateSignal, selection: RateSelection
) -> AttitudeSignal:
    """Return the orientation that is in the same messages or rows as the rates, on their clock.

    Parameters
    ----------
    log, source, selection
        As for :func:`specific_forces`.

    Raises
    ------
    LogError, UsageError
        There is none, or it cannot be read.
    """
    wanted = AttitudeSelection.like(selection)
    if not is_table(log):
        beside = _beside(cast("MessageLog", log), source)
        wanted = replace(wanted, topic=source.name, quat_field=beside)
        if source.clock in {"header", "log", "publish"}:
            wanted = replace(wanted, clock=source.clock)
    return choose_attitudes(log, wanted)


def _beside(log: MessageLog, source: RateSignal) -> str | None:
    """Return the orientation in the same part of the message as the rate, if it has one."""
    for channel in channels_of(log, source.name):
        if channel.type_name == source.type_name:
            beside = fields_beside(channel, source.field, log.path).orientation
            if beside is not None:
                return beside.name
    return None
