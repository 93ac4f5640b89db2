"""Attitudes of a log, as Hamilton quaternions body -> reference with timestamps in ns.

The layout is taken from names, definitions or metadata, or else has to be given.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.conventions import AttitudeConvention
from quatprop.conventions.layout import layout_named
from quatprop.conventions.representations import REPRESENTATIONS
from quatprop.errors import LogError, UsageError
from quatprop.kinematics.quaternion import IDENTITY
from quatprop.logs.clocks.stamps import are_all
from quatprop.logs.matching.find import beside
from quatprop.logs.signals.attitude_columns import match_attitudes
from quatprop.logs.signals.attitude_covariance import CONSTANT_MESSAGES, covariance_beside
from quatprop.logs.signals.choice import ATTITUDES, Candidate, candidates, choose
from quatprop.logs.signals.signal import AttitudeSignal
from quatprop.provenance import entry_of
from quatprop.settings.choices import LAYOUTS
from quatprop.text import Remark, Setting, plain

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.logs.matching.find import Found
    from quatprop.settings.selection import AttitudeSelection
    from quatprop.tables.log import Log
    from quatprop.tables.model import Table

BY_NAME = "by name"
"""The layout of named components that are neither scalar-first nor scalar-last."""


def choose_attitudes(log: Log, selection: AttitudeSelection) -> AttitudeSignal:
    """Return the only attitudes in a log that match a selection."""
    found = attitude_candidates(log, selection)
    if len(found) > 1:
        # Placeholders and absent orientations are ignored if there are others.
        found = [candidate for candidate in found if not _is_placeholder(candidate)] or found
    return choose(log, found, ATTITUDES)


def _is_placeholder(candidate: Candidate[AttitudeSignal]) -> bool:
    # To choose among transforms reads the whole topic.
    if candidate.field == "transforms":
        return False
    try:
        signal = candidate.signal()
        present = (np.isfinite(wxyz) for _, wxyz in signal.first())
        return signal.placeholder or are_all(present, value=False)
    except (LogError, UsageError):
        return False


def attitude_candidates(log: Log, selection: AttitudeSelection) -> list[Candidate[AttitudeSignal]]:
    """Return the attitudes in a log that match a selection, at least one."""
    return [
        Candidate(found, partial(_signal, found, selection), not found.table.is_secondary)
        for found in candidates(log, selection, ATTITUDES)
    ]


def _signal(found: Found, selection: AttitudeSelection) -> AttitudeSignal:
    """Return attitudes with their convention and timestamp."""
    provenance = found.table.provenance()
    recorded = recorded_convention(provenance)
    match = match_attitudes(found, selection, recorded.get("layout"))
    table, row, form = match.table, match.row, match.representation
    if match.unit == "deg" and f"{form}-deg" in REPRESENTATIONS:
        form += "-deg"
    if (declared := recorded.get("representation", form)) != form:
        raise UsageError(
            f"{plain(table.path)}: its columns are {form}, and the metadata of the file say "
            f"{plain(declared)}; write the file again"
        )
    meaning = meaning_of(table.path, selection, recorded)
    positions = beside(match, "position")
    signal = AttitudeSignal(
        name=table.name or match.field,
        type_name=table.type or row.name,
        field=match.field,
        clock=match.stamp.clock,
        remarks=match.remarks,
        match=match,
        covariance=covariance_beside(match, provenance),
        position=positions[0].sets if len(positions) == 1 else (),
        layout=(match.layout or BY_NAME) if form == "quaternion" else "",
        meaning=meaning,
        provenance=provenance,
        representation=form,
        rotation_columns=_rotation_columns(table, form),
    )
    remarks = (
        [Remark("frames-by-type", f"by its type {row.frames}")]
        if table.is_typed and row.frames
        else []
    )
    placeholder = (
        table.is_typed
        and row.rate != ""
        and bool(beside(match, "rate"))
        and are_all((np.abs(wxyz) for _, wxyz in signal.first()), IDENTITY, CONSTANT_MESSAGES)
    )
    if placeholder:
        text = "it is the identity in every message: a placeholder, not an attitude"
        remarks.append(Remark("placeholder", text))
    return replace(signal, placeholder=placeholder, remarks=(*remarks, *match.remarks))


def _rotation_columns(table: Table, representation: str) -> tuple[str, ...]:
    """Return the columns of other representations of the rotation."""
    names = [column.text for column in table.columns]
    others = {
        column
        for other, form in REPRESENTATIONS.items()
        if other != representation and {*form.columns} <= {*names}
        for column in form.columns
    }
    return tuple(name for name in names if name in others)


def recorded_convention(provenance: Mapping[str, Any]) -> dict[str, str]:
    """Return the convention in the provenance of a file, as far as it is known."""
    convention = entry_of(provenance, "convention", dict)
    layout = entry_of(convention, "layout", str)
    recorded = {
        name: convention[name]
        for name in ("convention", "direction", "representation")
        if isinstance(convention.get(name), str)
    }
    if layout in LAYOUTS:
        recorded["layout"] = layout_named(layout).name
    return recorded


def meaning_of(
    path: Path | str, selection: AttitudeSelection, recorded: Mapping[str, str]
) -> AttitudeConvention:
    """Return the convention from settings or metadata, else Hamilton, body to reference."""
    return AttitudeConvention(
        _agreed(path, "convention", selection.from_convention, recorded) or "hamilton",
        _agreed(path, "direction", selection.from_direction, recorded) or "body-to-ref",
    )


def _agreed(
    path: Path | str, what: str, given: str | None, recorded: Mapping[str, str]
) -> str | None:
    stored = recorded.get(what)
    if given is not None and stored is not None and given != stored:
        raise UsageError(
            f"{plain(path)}: {Setting(f'from_{what}')} says {given}, but the metadata of the file "
            f"says {plain(stored)}; omit it"
        )
    return given or stored
