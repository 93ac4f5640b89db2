"""Forces, orientation, biases and mounting, as recorded with the rates of a log."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from quatprop.base.errors import LogError, UsageError
from quatprop.base.rendering import degrees_text
from quatprop.base.text import Remark, Setting, quoted
from quatprop.kinematics.quaternion import IDENTITY, geodesic_angle
from quatprop.propagation.conditioning.accelerations import specific_forces
from quatprop.propagation.conditioning.frames import (
    SAME,
    StaticTransforms,
    devices_of,
    frame_mounting,
    sensor_frame,
)
from quatprop.readers.attitude_quality import QuaternionCheck
from quatprop.readers.matching import find, same_message_signals
from quatprop.readers.rate_signals import match_bias, match_rates
from quatprop.settings.reading import AttitudeSelection, GyroCorrection, RateSelection

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from quatprop.kinematics.conventions import FrameMounting
    from quatprop.propagation.conditioning.biases import BiasSeries
    from quatprop.propagation.conditioning.static_period import Rows
    from quatprop.propagation.recording import Recording
    from quatprop.readers.matching import Match
    from quatprop.readers.signal import AttitudeSignal, RateSignal
    from quatprop.readers.tables.model import Log, Table

    AsUsed: TypeAlias = Callable[[Rows, bool], Rows]


FROM_TRANSFORMS = "tf:"
"""Prefix of a mounting from the transforms of the log."""


class GyroCorrectionInputs(NamedTuple):
    """Inputs from a log besides its rates; None if absent or not needed.

    `force`: reads timestamps and specific forces, shape ``(N, 3)``, any unit, sensor axes
    `orientation`: reads timestamps and recorded orientations, wxyz body -> reference, ``(N, 4)``
    `mounting`: the mounting from the transforms of the log
    """

    force: Callable[[], Rows] | None = None
    orientation: Callable[[], Rows] | None = None
    biases: BiasSeries | None = None
    mounting: FrameMounting | None = None
    topic: str = ""


def correction_inputs(
    recording: Recording, source: RateSignal, wanted: GyroCorrection, as_used: AsUsed
) -> GyroCorrectionInputs:
    """Return what the corrections of rates need besides them.

    `as_used`: yields rows of another signal as the stages give those of the rates; the second
        argument is whether they stand in the rows of the rates
    """
    log, selection = recording.log, recording.selection
    biases = mounting = None
    if wanted.bias_from is not None:
        from quatprop.propagation.conditioning.biases import read_biases

        biases = read_biases(wanted.bias_from, recording)
        if log is not None:
            recording.other_remarks += _of_other_gyroscope(biases, log, source)
        if log is not None and wanted.rates == "body":
            _turn_to_sensor(biases, log, source, recording)
    if wanted.mount is not None and wanted.mount.startswith(FROM_TRANSFORMS):
        mounting = frame_mounting(log, source, wanted.mount.removeprefix(FROM_TRANSFORMS))
    if log is None:
        return GyroCorrectionInputs(biases=biases, mounting=mounting)
    return GyroCorrectionInputs(
        force=lambda: _force(recording, source, as_used),
        orientation=lambda: _orientation(log, source, selection, as_used),
        biases=biases,
        mounting=mounting,
        topic=source.name,
    )


def _of_other_gyroscope(biases: BiasSeries, log: Log, source: RateSignal) -> list[Remark]:
    """Return a remark on biases of a gyroscope with another number than that of the rates."""
    of_biases = set[int]() if biases.match is None else devices_of(biases.match)
    of_rates = {number for match in source.matches for number in devices_of(match)}
    if not of_biases or not of_rates or of_biases & of_rates:
        return []
    tables = log.tables()
    with_rates = [
        Setting("topic", table.name)
        for table in tables
        if any(devices_of(match) & of_biases for match in _measured(table, "rate"))
    ]
    with_biases = [
        Setting("bias", table.name)
        for table in tables
        if any(devices_of(match) & of_rates for match in _measured(table, "bias"))
    ]
    ways = " or ".join(map(str, (*with_biases[:1], *with_rates[:1])))
    text = (
        f"the biases are those of the gyroscope with device ID {min(of_biases)}, and the rates of "
        f"{quoted(source.name)} are those of {min(of_rates)}: they are subtracted all the same"
    )
    return [
        Remark("bias-of-other-sensor", f"{text}; for one gyroscope use {ways}" if ways else text)
    ]


def _measured(table: Table, quantity: str) -> Iterator[Match]:
    """Yield where messages have rates, or biases, of a gyroscope."""
    for found in find(table, quantity):
        if table.is_typed and found.row.measured:
            with suppress(LogError, UsageError):
                match = match_bias if quantity == "bias" else match_rates
                yield match(found, RateSelection())


def _turn_to_sensor(biases: BiasSeries, log: Log, source: RateSignal, recording: Recording) -> None:
    """Turn biases about the axes of another frame, if static transforms relate them."""
    sensor = sensor_frame(source)
    if "" in {biases.frame, sensor} or biases.frame == sensor:
        return
    with suppress(LogError, UsageError):
        static = StaticTransforms(log)
        found = static.rotation(biases.frame, sensor)
        if found is None:
            text = (
                f"the biases are about axes of {quoted(biases.frame)}, and the rates about those "
                f"of {quoted(sensor)}: they are subtracted as if these were the same"
            )
            recording.other_remarks.append(Remark("bias-of-other-frame", text))
        elif (angle := float(geodesic_angle(found[0], IDENTITY))) > SAME:
            biases.turn(found[0])
            static.remark_on_others(found[1])
            text = (
                f"the biases are about axes of {quoted(biases.frame)}, and the rates about those "
                f"of {quoted(sensor)}: they are turned by {degrees_text(angle, 3)}, by the static "
                "transforms of the log"
            )
            recording.other_remarks.append(Remark("bias-turned", text))


def _force(recording: Recording, source: RateSignal, as_used: AsUsed) -> Rows:
    """Yield specific forces; none if there are none that can be read."""
    try:
        if (found := specific_forces(recording, source)) is not None:
            yield from as_used(*found)
    except (LogError, UsageError):
        if recording.selection.accel_cols is not None:
            raise
        return


def _orientation(log: Log, source: RateSignal, selection: RateSelection, as_used: AsUsed) -> Rows:
    """Yield the orientation recorded in the log, unless it was never set."""
    try:
        own = own_orientation(log, source, selection)
    except (LogError, UsageError):
        return
    if not own.placeholder:
        own = replace(own, in_sequence=source.in_sequence)
        tables = [match.table.name for match in source.matches]
        rows = as_used(own.rows(), own.match.table.name in tables)
        for series in QuaternionCheck(log.path, drop=True).apply(rows):
            yield series.t_ns, series.wxyz


def own_orientation(
    log: Log,
    source: RateSignal,
    selection: RateSelection,
    columns: Sequence[str] | None = None,
    layout: str | None = None,
) -> AttitudeSignal:
    """Return the orientation in the same messages or rows as the rates, on the same clock.

    `columns`, `layout`: of a quaternion in a table whose names do not tell its layout
    """
    from quatprop.readers.attitude_signals import choose_attitudes

    quat_cols = None if columns is None else tuple(columns)
    wanted = replace(AttitudeSelection.like(selection), quat_cols=quat_cols, from_layout=layout)
    for match in source.matches:
        if match.table.is_typed:
            field = next((own.field for own in same_message_signals(match, "quat")), None)
            clock = match.stamp.clock if selection.time_field is None else wanted.clock
            wanted = replace(wanted, topic=source.name, quat_field=field, clock=clock)
            break
    return choose_attitudes(log, wanted)
