"""Attitudes in the columns of a table: quaternions, or rotations written otherwise."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.conventions.representations import REPRESENTATIONS
from quatprop.errors import NoAttitudesError, UsageError
from quatprop.signals.attitude_convention import BY_NAME, meaning_of, recorded_convention
from quatprop.signals.message_values import ABSENT
from quatprop.signals.signal import AttitudeSignal
from quatprop.tables.matching.attitude_columns import choose_quaternion
from quatprop.tables.matching.rotation_columns import OPTION, choose_rotation
from quatprop.text import plain

if TYPE_CHECKING:
    from quatprop.conventions import Meaning
    from quatprop.selection import AttitudeSelection
    from quatprop.signals.signal import Rows
    from quatprop.tables.base import TableLog, TimedColumns
    from quatprop.tables.matching.attitude_columns import QuaternionColumns
    from quatprop.tables.matching.rotation_columns import RotationColumns


def of_table(log: TableLog, selection: AttitudeSelection) -> AttitudeSignal:
    """Return the attitudes of a table.

    Raises
    ------
    NoAttitudesError
        No columns look like attitudes and the options name none.
    UndeclaredError
        The layout, a unit, a column or the time is declared nowhere.
    UsageError
        Options contradict each other or the table.
    """
    provenance = log.provenance()
    recorded = recorded_convention(provenance)
    try:
        columns = choose_quaternion(
            log,
            selection,
            quat_cols=selection.quat_cols,
            layout=selection.from_layout,
            recorded=recorded.get("layout"),
        )
    except NoAttitudesError:
        rotation = choose_rotation(log, selection, selection.from_angle_unit)
        if rotation is None:
            raise
        return _of_rotation(log, selection, rotation, provenance)
    return _of_quaternion(log, selection, columns, provenance)


def _of_quaternion(
    log: TableLog,
    selection: AttitudeSelection,
    columns: QuaternionColumns,
    provenance: dict[str, Any],
) -> AttitudeSignal:
    recorded = recorded_convention(provenance)
    if selection.from_angle_unit is not None:
        raise UsageError(
            f"{plain(log.path)}: {OPTION} is about angles, and this table has a quaternion; "
            "leave it out"
        )
    _refuse_another(log, "quaternion", recorded)
    meaning = meaning_of(log.path, selection, recorded)
    return AttitudeSignal(
        **_described(log, columns.timed, columns.timed.numbers[:4]),
        type_name=columns.dialect,
        layout=columns.layout or BY_NAME,
        meaning=meaning,
        remarks=(),
        provenance=provenance,
        rows=partial(_quaternion_rows, log, columns.timed, meaning),
    )


def _of_rotation(
    log: TableLog,
    selection: AttitudeSelection,
    rotation: RotationColumns,
    provenance: dict[str, Any],
) -> AttitudeSignal:
    recorded = recorded_convention(provenance)
    for option, value in (("--from-layout", selection.from_layout),
                          ("--from-convention", selection.from_convention)):  # fmt: skip
        if value is not None:
            raise UsageError(
                f"{plain(log.path)}: {option} is about quaternions, and this table has "
                f"{rotation.representation}; leave it out"
            )
    named = rotation.representation
    if named + "-deg" in REPRESENTATIONS and rotation.unit == "deg":
        named += "-deg"
    _refuse_another(log, named, recorded)
    meaning = meaning_of(log.path, selection, recorded)
    remarks = ["which of q and -q is meant is not stored: signs are those of each row by itself"]
    if rotation.representation == "euler-zyx":
        remarks.append("yaw, pitch, roll are turns about z, the new y, and the newest x")
    return AttitudeSignal(
        **_described(log, rotation.timed, rotation.timed.numbers),
        type_name="",
        layout="",
        meaning=meaning,
        remarks=tuple(remarks),
        provenance=provenance,
        rows=partial(_rotation_rows, log, rotation, meaning),
        representation=named,
    )


def _refuse_another(log: TableLog, found: str, recorded: dict[str, str]) -> None:
    said = recorded.get("representation", found)
    if said != found:
        raise UsageError(
            f"{plain(log.path)}: its columns are {found}, and the metadata of the file say "
            f"{plain(said)}; write the file again"
        )


def _described(log: TableLog, timed: TimedColumns, places: tuple[int, ...]) -> dict[str, Any]:
    """Return how the columns of an attitude and of its time are called."""
    names = log.columns()
    stored = ",".join(names[position] for position in sorted(places))
    counted = "" if timed.sample_rate is None else f"{timed.sample_rate:g} Hz"
    clock = ",".join(names[position] for position in timed.time) or counted
    return {"name": stored, "field": stored, "clock": clock}


def _quaternion_rows(log: TableLog, timed: TimedColumns, meaning: Meaning) -> Rows:
    for t_ns, numbers in log.rows(timed):
        wxyz = numbers[:, :4]
        for absent in numbers[:, 4:].T:
            wxyz[absent == ABSENT] = np.nan
        yield t_ns, meaning.converted(wxyz)


def _rotation_rows(log: TableLog, rotation: RotationColumns, meaning: Meaning) -> Rows:
    form = REPRESENTATIONS[rotation.representation]
    for t_ns, numbers in log.rows(rotation.timed):
        values = np.radians(numbers) if rotation.unit == "deg" else numbers
        # What is not finite is told later, row by row.
        with np.errstate(invalid="ignore", over="ignore"):
            wxyz = form.attitudes(values)
        yield t_ns, meaning.converted(wxyz)
