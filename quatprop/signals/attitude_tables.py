"""Attitudes in the columns of a table."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import UsageError, quoted
from quatprop.readers.attitude_columns import choose_quaternion
from quatprop.signals.attitude_source import BY_NAME, AttitudeSource, meaning_of, recorded_in
from quatprop.signals.channel_values import ABSENT

if TYPE_CHECKING:
    from quatprop.conventions import Meaning
    from quatprop.readers.base import TableLog, TimedColumns
    from quatprop.signals.attitude_source import AttitudeSelection, Rows


def of_table(log: TableLog, selection: AttitudeSelection) -> AttitudeSource:
    """Return the attitudes of a table.

    Raises
    ------
    NoAttitudesError
        No columns look like a quaternion and the options name none.
    UndeclaredError
        The layout, a column or the time is declared nowhere.
    UsageError
        Options contradict each other or the table.
    """
    for option, value in (("--quat-field", selection.quat_field), ("--frame", selection.frame)):
        if value is not None:
            raise UsageError(f"{option} is for messages, and {quoted(log.path)} is a table")
    provenance = log.provenance()
    recorded = recorded_in(provenance)
    columns = choose_quaternion(
        log,
        selection.samples,
        quat_cols=selection.quat_cols,
        layout=selection.layout,
        recorded=recorded.get("layout"),
    )
    meaning = meaning_of(log.path, selection, recorded)
    names = log.columns()
    timed = columns.timed
    stored = ",".join(names[position] for position in sorted(timed.numbers[:4]))
    counted = "" if timed.sample_rate is None else f"{timed.sample_rate:g} Hz"
    return AttitudeSource(
        name=stored,
        type_name=columns.dialect,
        quaternion=stored,
        layout=columns.layout or BY_NAME,
        meaning=meaning,
        clock=",".join(names[position] for position in timed.time) or counted,
        remarks=(),
        provenance=provenance,
        rows=partial(_table_rows, log, timed, meaning),
    )


def _table_rows(log: TableLog, timed: TimedColumns, meaning: Meaning) -> Rows:
    for t_ns, numbers in log.rows(timed):
        wxyz = numbers[:, :4]
        for absent in numbers[:, 4:].T:
            wxyz[absent == ABSENT] = np.nan
        yield t_ns, meaning.restated(wxyz)
