"""What conditioning takes from a log beside its rates: in the same messages or rows, or others."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

from quatprop.conditioning import FROM_TRANSFORMS, Conditioning, ConditioningInputs
from quatprop.errors import LogError, UsageError
from quatprop.logs.matching import Found, Match, find, marks_of
from quatprop.logs.reading import read_vectors
from quatprop.selection import AttitudeSelection, RateSelection
from quatprop.signals.quaternion_check import QuaternionCheck
from quatprop.tables.base import AnyLog, TableLog

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.conditioning.cells import Rows
    from quatprop.signals.signal import AttitudeSignal, RateSignal

_ACCELERATION = (
    r"(?i)(?:.*\.)?(?:a_rs_s_|acc(?:el(?:eration|erometer)?)?[ _]?|linear_acceleration\.|"
    r"accelerometer_m_s2\[?|a)(?P<axis>[xyz012])\]?"
)
"""Columns of specific force, by their name without a unit."""


def conditioning_inputs(
    log: AnyLog | None,
    source: RateSignal,
    selection: RateSelection,
    wanted: Conditioning,
) -> ConditioningInputs:
    """Return what is needed besides the rates.

    Parameters
    ----------
    log
        An open log that can be read again; None for rates in memory.
    source, selection
        Its rates, and how they were chosen.
    wanted
        What is to be done to them.

    Raises
    ------
    LogError, UsageError
        The biases or the mounting that are asked for cannot be read.
    """
    biases = mounting = None
    if wanted.bias_from is not None:
        from quatprop.signals.biases import read_biases

        biases = read_biases(wanted.bias_from, log, selection)
    if wanted.mount is not None and wanted.mount.startswith(FROM_TRANSFORMS):
        from quatprop.signals.static_transforms import frame_mounting

        mounting = frame_mounting(log, source, wanted.mount.removeprefix(FROM_TRANSFORMS))
    if log is None:
        return ConditioningInputs(biases=biases, mounting=mounting)
    return ConditioningInputs(
        force=lambda: _force(log, source, selection),
        orientation=lambda: _orientation(log, source, selection),
        biases=biases,
        mounting=mounting,
        topic=source.name,
    )


def _force(log: AnyLog, source: RateSignal, selection: RateSelection) -> Rows:
    """Yield specific forces, if the log has some that can be read."""
    try:
        yield from specific_forces(log, source, selection) or ()
    except (LogError, UsageError):
        return


def _orientation(log: AnyLog, source: RateSignal, selection: RateSelection) -> Rows:
    """Yield the log's own orientation, if it has one that was ever set."""
    try:
        own = own_orientation(log, source, selection)
    except (LogError, UsageError):
        return
    if not own.placeholder:
        for series in QuaternionCheck(log.path, drop=True).apply(own.rows()):
            yield series.t_ns, series.wxyz


def specific_forces(log: AnyLog, source: RateSignal, selection: RateSelection) -> Rows | None:
    """Return stamps, ns, and specific forces in sensor axes, ``(N, 3)``; None where there are none.

    Parameters
    ----------
    log
        An open log that can be read again.
    source, selection
        Its rates, and how they were chosen.
    """
    if isinstance(log, TableLog):
        return _table_forces(log, selection)
    for match in source.matches:
        for force in _beside(match, "force"):
            return read_vectors(Match(force, match.stamp, marks=marks_of(force)))
    return None


def _beside(rates: Match, quantity: str) -> Iterator[Found]:
    """Yield what is in the same part of the messages as some rates."""
    return (one for one in find(rates.table, quantity) if one.part == rates.found.part)


def _table_forces(log: TableLog, selection: RateSelection) -> Rows | None:
    from quatprop.logs.choose import match_rates
    from quatprop.tables.column_names import parse_name

    axes: dict[int, int] = {}
    for position, name in enumerate(log.columns()):
        if match := re.fullmatch(_ACCELERATION, parse_name(name).key):
            axes.setdefault("xyz012".index(match["axis"]) % 3, position)
    if len(axes) != 3:  # noqa: PLR2004  # axes
        return None
    timed = match_rates(log, selection).timed
    return log.metered_rows(timed._replace(numbers=tuple(axes[axis] for axis in range(3))))


def own_orientation(log: AnyLog, source: RateSignal, selection: RateSelection) -> AttitudeSignal:
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
    from quatprop.signals.attitudes import choose_attitudes

    wanted = AttitudeSelection.like(selection)
    if not isinstance(log, TableLog):
        beside = (one.field for match in source.matches for one in _beside(match, "quat"))
        field = next(beside, None)
        wanted = replace(wanted, topic=source.name, quat_field=field)
        if source.clock in {"header", "log", "publish"}:
            wanted = replace(wanted, clock=source.clock)
    return choose_attitudes(log, wanted)
