"""Attitudes of a log: their columns, and their values as wxyz with timestamps in ns.

The layout is taken from names, definitions or metadata, or else has to be given.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import LogError, NoAttitudesError, UndeclaredError, UsageError
from quatprop.base.provenance import entry_of
from quatprop.base.text import Remark, Setting, listed, plain, quoted
from quatprop.kinematics.conventions import (
    REPRESENTATIONS,
    SCALAR_FIRST,
    SCALAR_LAST,
    AttitudeConvention,
    layout_named,
)
from quatprop.kinematics.quaternion import IDENTITY
from quatprop.readers.attitude_quality import CONSTANT_MESSAGES, covariance_beside
from quatprop.readers.matching import ColumnMatcher, Found, Match, marks_of, same_message_signals
from quatprop.readers.rate_names import role_in
from quatprop.readers.row_stamps import are_all, choose_time
from quatprop.readers.signal import ATTITUDES, AttitudeSignal, Candidate, candidates, choose
from quatprop.readers.tables.table_log import (
    ANGLE_UNITS,
    EULER,
    EULER_NUMBERED,
    contradicting_units,
)
from quatprop.readers.vocabulary import COMPONENT, GENERIC, PARTS, QUATERNION_PARTS, ROTATIONS
from quatprop.settings.parsers import MATRIX_COLUMNS
from quatprop.settings.quantities import LAYOUTS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path
    from typing import Any

    from quatprop.readers.tables.model import Group, Log, Table
    from quatprop.settings.reading import AttitudeSelection

    Rotation = tuple[str, str, Sequence[str]]


# Match the columns of attitudes: quaternions, or in files also other representations.


def match_attitudes(found: Found, selection: AttitudeSelection, recorded: str | None) -> Match:
    """Return the attitudes of a table, with layout or unit and timestamp.

    `recorded`: the layout in the metadata of the log, if any
    """
    matcher = ColumnMatcher(found, selection, "quat_cols")
    form, row = "quaternion", found.row
    stored = tuple(sorted(found.sets[0])) if found.sets else ()
    if not found.sets:
        row = matcher.row("quat")
        form, found, stored = _in_file(matcher, selection)
    field = found.sets[0] if found.field else tuple(sorted(stored))
    unit = layout = ""
    remarks: tuple[Remark, ...] = ()
    if form == "quaternion":
        wxyz = _in_order(matcher, selection, found, stored, recorded)
        found = found._replace(sets=(wxyz,))
        layout = _layout(sorted(wxyz), wxyz)
    else:
        row = found.row
        unit = _angle_unit(matcher, selection.from_angle_unit, form, stored, row.angle_unit)
        if not form.startswith("euler-"):
            text = "which of q and -q is meant is not stored: each row has its own sign"
            remarks = (Remark("sign-unstored", text),)
        else:
            first, second, third = tuple(form.removeprefix("euler-"))
            text = f"the angles turn about {first}, the new {second}, and the newest {third}"
            remarks = (Remark("angle-sequence", text),)
    matcher.remark_on_text(stored)
    marks = marks_of(found)
    stamp, table = choose_time(matcher, found, marks, row)
    return Match(
        *found._replace(table=table, field=table.field_of(field)),
        stamp,
        marks=marks,
        remarks=(*matcher.remarks, *remarks),
        unit=unit,
        representation=form,
        layout=layout,
    )


def _in_file(matcher: ColumnMatcher, selection: AttitudeSelection) -> tuple[str, Found, Group]:
    """Return the representation and the columns of the attitude in a file, and their stored order.

    A quaternion has priority. It has no set if names do not tell which component is the scalar.
    """
    row, named = matcher.row("quat"), selection.quat_cols
    sets = matcher.sets(QUATERNION_PARTS, row.quat)
    is_matrix = len(named or ()) in MATRIX_COLUMNS
    if selection.from_euler is not None or is_matrix or not (sets or named):
        return _rotation(matcher, selection)
    if selection.from_angle_unit is not None:
        raise UsageError(
            f"{plain(matcher.path)}: {Setting('from_angle_unit')} is about angles, and this table "
            "has a quaternion; omit it"
        )
    if named is None:
        of_body = sets if row is not GENERIC else _of_body(matcher, sets)
        wxyz = matcher.only_set(of_body, "quaternion", "scalar")
        return "quaternion", matcher.found(row, (wxyz,)), tuple(sorted(wxyz))
    stored = matcher.named(named)
    if len(stored) < len(QUATERNION_PARTS):
        raise UndeclaredError(
            matcher.path,
            f"which sequence of angles {matcher.names(stored)} are, if they are angles (a "
            "quaternion has four columns),",
            Setting("from_euler", "xyz"),
        )
    known = (*sets, *matcher.sets(QUATERNION_PARTS, GENERIC.quat, COMPONENT))
    by_name = tuple(wxyz for wxyz in known if {*wxyz} == {*stored})[:1]
    own = row if {*by_name} & {*sets} else GENERIC
    return "quaternion", matcher.found(own, by_name), stored


def _of_body(
    matcher: ColumnMatcher, sets: Sequence[Group], form: str = "quaternion"
) -> list[Group]:
    """Return the sets of columns that are no command or deviation by name; refuse these alone."""
    roles = {one: role_in([matcher.columns[k].key for k in one]) for one in sets}
    own = [one for one in sets if not roles[one]]
    if sets and not own:
        first = sets[0]
        remedy = matcher.setting_for(first)
        if form == "rotvec":
            remedy = "other names in the header"
        elif form.startswith("euler-"):
            remedy += f" and {Setting('from_euler', form.removeprefix('euler-'))}"
        raise UndeclaredError(
            matcher.path,
            f"whether {matcher.names(first)} are the attitude of the body ({quoted(roles[first])} "
            "does not tell)",
            f"{remedy} if they are",
        )
    return own


# Quaternions.


def _in_order(
    matcher: ColumnMatcher,
    selection: AttitudeSelection,
    found: Found,
    stored: Group,
    recorded: str | None,
) -> Group:
    """Return the columns of w, x, y, z, by names or definition, else by setting or metadata."""
    given = selection.from_layout and layout_named(selection.from_layout).name
    wxyz = _defined(found)
    if wxyz is None:
        if layout := given or recorded:
            return _ordered(stored, layout)
        raise UndeclaredError(
            matcher.path,
            f"which of the columns {matcher.names(stored)} is the scalar",
            Setting("from_layout", "scalar-first|scalar-last"),
        )
    own = _layout(stored, wxyz)
    if selection.quat_cols is not None:
        recorded = None  # columns named by the user take precedence
    if (given or recorded) not in {None, own}:
        is_by_definition = found.table.type != ""
        what = f"the columns {matcher.names(stored)} are {own or 'in no layout'} by name"
        if is_by_definition:
            what = f"{quoted(found.field)} of {quoted(found.table.type)} is {own} by definition"
        source = f"{Setting('from_layout')} says {given}"
        way = "omit it" if is_by_definition else "omit it, or rename the columns if they are wrong"
        if given is None:
            source = f"the metadata say {recorded}"
            settled = Setting("from_layout", own) if own else Setting("quat_cols", "A,B,C,D")
            way = f"settle it with {settled}"
        raise UsageError(f"{plain(matcher.path)}: {source}, but {what}; {way}")
    return wxyz


def _defined(found: Found) -> Group | None:
    """Return the columns of w, x, y, z if names, type or program define their order, else None."""
    for group in found.sets:
        w, x = (found.table.columns[k].key for k in group[:2])
        is_numbered = any(a != b and (a + b).isdecimal() for a, b in zip(w, x, strict=False))
        if not is_numbered:
            return group
        if layout := found.row.layout or (SCALAR_LAST.name if found.row.types else ""):
            return _ordered(group, layout)
    return None


def _ordered(stored: Group, layout: str) -> Group:
    order = layout_named(layout).order
    return tuple(stored[order.index(component)] for component in range(4))


def _layout(stored: Sequence[int], wxyz: Group) -> str:
    """Return the layout of columns in stored order; ``""`` if neither scalar-first nor -last."""
    order = tuple(wxyz.index(k) for k in stored)
    return next((known.name for known in (SCALAR_FIRST, SCALAR_LAST) if known.order == order), "")


# Other representations.


def _rotation(matcher: ColumnMatcher, selection: AttitudeSelection) -> tuple[str, Found, Group]:
    """Return the only rotation that is not a quaternion."""
    sequence, named = selection.from_euler, selection.quat_cols
    own = matcher.row("angles")
    rotations = _matches(matcher, _rotations(sequence))
    if not rotations and own.angles and sequence in {None, "zyx"}:
        rotations = _matches(matcher, [("euler-zyx", own.angles, PARTS["angles"])])
    if sequence is not None and named is not None:
        if len(named) != len(sequence):
            raise UsageError(
                f"{Setting('from_euler')} is about three angles, and {Setting('quat_cols')} names "
                f"{len(named)} columns"
            )
        rotations = [(f"euler-{sequence}", matcher.named(named))]
    elif named is not None:
        columns = matcher.named(named)
        width = len(columns) // len(PARTS["angles"])
        rows = (columns[k : k + 3] for k in range(0, len(columns), width))
        rotations = [("matrix", tuple(chain.from_iterable(rows)))]
    if not rotations:
        if sequence is not None:
            _refuse_other_sequence(matcher, sequence)
            _refuse_quaternion(matcher)
        raise NoAttitudesError(matcher.path, matcher.seen(), "columns")
    form, columns = rotations[0]
    for name in ("from_layout", "from_convention"):
        if getattr(selection, name) is not None:
            raise UsageError(
                f"{plain(matcher.path)}: {Setting(name)} does not apply to {form}; omit it"
            )
    if named is None and own.name == "":
        kept = _of_body(matcher, [columns for _, columns in rotations], form)
        rotations = [one for one in rotations if one[1] in kept]
        form, columns = rotations[0]
    if rotations[1:]:
        names = listed(matcher.columns[first].text for _, (first, *_) in rotations)
        raise UndeclaredError(
            matcher.path,
            f"which rotation to use (their first columns are {names})",
            "a table that holds one of them",
        )
    row = own if form == "euler-zyx" and named is None else GENERIC
    return form, matcher.found(row, (columns,)), columns


def _matches(matcher: ColumnMatcher, rotations: Iterable[Rotation]) -> list[tuple[str, Group]]:
    """Return each complete set of columns of the given rotations."""
    return [
        (form, columns)
        for form, pattern, parts in rotations
        for columns in matcher.sets(parts, pattern)
    ]


def _refuse_other_sequence(matcher: ColumnMatcher, chosen: str) -> None:
    """Refuse a sequence of angles if the names of columns declare another one."""
    for form, columns in _matches(matcher, ROTATIONS):
        if form.startswith("euler-"):
            axes = ", ".join(form.removeprefix("euler-"))
            raise UsageError(
                f"{plain(matcher.path)}: {Setting('from_euler', chosen)} contradicts the columns "
                f"{matcher.names(columns)}, which by their names are angles about {axes}; if it "
                f"is right, name the columns too, with {Setting('quat_cols', 'A,B,C')}",
            )


def _refuse_quaternion(matcher: ColumnMatcher) -> None:
    """Refuse to read angles from a table whose columns hold a quaternion."""
    if matcher.sets(QUATERNION_PARTS, matcher.row("quat").quat):
        raise UsageError(
            f"{plain(matcher.path)}: {Setting('from_euler')} is about angles, and this table has a "
            "quaternion; omit it"
        )


def _rotations(sequence: str | None) -> Iterable[Rotation]:
    """Return the rows of :data:`ROTATIONS`, or for a given sequence, its angles."""
    if sequence is None:
        return ROTATIONS
    numbered = (f"euler-{sequence}", EULER_NUMBERED.format(sequence), "123")
    names = [{"x": "roll", "y": "pitch", "z": "yaw"}[axis] for axis in sequence]
    is_proper = sequence[0] == sequence[2]
    return [numbered] if is_proper else [(f"euler-{sequence}", EULER, names), numbered]


def _angle_unit(
    matcher: ColumnMatcher, chosen: str | None, form: str, columns: Group, by_row: str
) -> str:
    names = matcher.names(columns)
    if form == "matrix":
        if chosen is not None:
            raise UsageError(
                f"{plain(matcher.path)}: {Setting('from_angle_unit')} is about angles, and "
                f"{names} are a matrix; omit it",
            )
        return ""
    declared = matcher.declared(columns) or by_row
    if both := contradicting_units(declared):
        declared = chosen if chosen in both else declared
        matcher.refuse_unknown(columns, declared, ANGLE_UNITS, "from_angle_unit")
    matcher.refuse_unknown(columns, declared, ANGLE_UNITS)
    if chosen is not None and declared not in {"", chosen}:
        raise UsageError(
            f"{plain(matcher.path)}: {Setting('from_angle_unit')} says {chosen}, but by their "
            f"names {names} are in {declared}; omit the option",
        )
    if not (chosen or declared):
        setting = Setting("from_angle_unit", "|".join(ANGLE_UNITS))
        matcher.unknown.append((f"the unit of the angles {names}", setting))
    return chosen or declared


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
    positions = same_message_signals(match, "position")
    signal = AttitudeSignal(
        name=table.name or match.field,
        type_name=table.type or row.name,
        field=match.field,
        clock=match.stamp.clock,
        remarks=match.remarks,
        matches=(match,),
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
        and bool(same_message_signals(match, "rate"))
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
