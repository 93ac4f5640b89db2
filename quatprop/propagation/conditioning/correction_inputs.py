"""Inputs of conditioning from a log: forces, orientation, biases and mounting."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from quatprop.conditioning import FROM_TRANSFORMS, GyroCorrection, GyroCorrectionInputs
from quatprop.errors import LogError, UsageError
from quatprop.logs.matching.find import Found, Match, beside, marks_of
from quatprop.logs.matching.matcher import ColumnMatcher
from quatprop.logs.signals.quaternion_check import QuaternionCheck
from quatprop.logs.signals.reading import read_vectors
from quatprop.settings.selection import AttitudeSelection, RateSelection

if TYPE_CHECKING:
    from quatprop.conditioning.window_sums import Rows
    from quatprop.logs.signals.signal import AttitudeSignal, RateSignal
    from quatprop.tables.log import Log


def conditioning_inputs(
    log: Log | None,
    source: RateSignal,
    selection: RateSelection,
    wanted: GyroCorrection,
) -> GyroCorrectionInputs:
    """Return the inputs of conditioning besides the rates.

    `log`: an open log that can be read again; None for rates in memory
    """
    biases = mounting = None
    if wanted.bias_from is not None:
        from quatprop.logs.biases import read_biases

        biases = read_biases(wanted.bias_from, log, selection)
    if wanted.mount is not None and wanted.mount.startswith(FROM_TRANSFORMS):
        from quatprop.logs.sensor_frames import frame_mounting

        mounting = frame_mounting(log, source, wanted.mount.removeprefix(FROM_TRANSFORMS))
    if log is None:
        return GyroCorrectionInputs(biases=biases, mounting=mounting)
    return GyroCorrectionInputs(
        force=lambda: _force(source, selection),
        orientation=lambda: _orientation(log, source, selection),
        biases=biases,
        mounting=mounting,
        topic=source.name,
    )


def _force(source: RateSignal, selection: RateSelection) -> Rows:
    """Yield specific forces; none if there are none that can be read."""
    try:
        yield from specific_forces(source, selection) or ()
    except (LogError, UsageError):
        if selection.accel_cols is not None:
            raise
        return


def _orientation(log: Log, source: RateSignal, selection: RateSelection) -> Rows:
    """Yield the orientation recorded in the log, unless it was never set."""
    try:
        own = own_orientation(log, source, selection)
    except (LogError, UsageError):
        return
    if not own.placeholder:
        for series in QuaternionCheck(log.path, drop=True).apply(own.rows()):
            yield series.t_ns, series.wxyz


def specific_forces(source: RateSignal, selection: RateSelection) -> Rows | None:
    """Return timestamps, ns, and specific forces, sensor axes, ``(N, 3)``, in the rows of rates.

    None if there are none.
    """
    for match in source.matches:
        if selection.accel_cols is not None:
            found = Found(match.table, match.row, match.part)
            columns = ColumnMatcher(found, selection, "accel_cols").named(selection.accel_cols)
            named = found._replace(sets=(columns,))
            return read_vectors(Match(*named, match.stamp))
        for force in beside(match, "force"):
            return read_vectors(Match(*force, match.stamp, marks=marks_of(force)))
    return None


def own_orientation(log: Log, source: RateSignal, selection: RateSelection) -> AttitudeSignal:
    """Return the orientation in the same messages or rows as the rates, on the same clock."""
    from quatprop.logs.signals.attitudes import choose_attitudes

    wanted = AttitudeSelection.like(selection)
    for match in source.matches:
        if match.table.is_typed:
            field = next((own.field for own in beside(match, "quat")), None)
            clock = match.stamp.clock if selection.time_field is None else wanted.clock
            wanted = replace(wanted, topic=source.name, quat_field=field, clock=clock)
            break
    return choose_attitudes(log, wanted)
