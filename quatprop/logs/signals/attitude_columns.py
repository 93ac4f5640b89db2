"""Match the columns of attitudes: quaternions, or in files also other representations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.conventions.layout import SCALAR_FIRST, SCALAR_LAST, layout_named
from quatprop.errors import NoAttitudesError, UndeclaredError, UsageError
from quatprop.logs.clocks.stamps import choose_time
from quatprop.logs.matching.find import Found, Match, marks_of
from quatprop.logs.matching.matcher import ColumnMatcher
from quatprop.logs.vocabulary.names import COMPONENT, ROTATIONS
from quatprop.logs.vocabulary.rows import PARTS, QUATERNION_PARTS
from quatprop.logs.vocabulary.sources import GENERIC
from quatprop.tables.column_names import ANGLE_UNITS, EULER, EULER_NUMBERED
from quatprop.text import Remark, Setting, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from quatprop.settings.selection import AttitudeSelection
    from quatprop.tables.model import Group

    Rotation = tuple[str, str, Sequence[str]]


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
        text = "which of q and -q is meant is not stored: each row has its own sign"
        remarks = (Remark("sign-unstored", text),)
        if form.startswith("euler-"):
            first, second, third = tuple(form.removeprefix("euler-"))
            text = f"the angles turn about {first}, the new {second}, and the newest {third}"
            remarks += (Remark("angle-sequence", text),)
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
    if selection.from_euler is not None or not (sets or named):
        return _rotation(matcher, selection)
    if selection.from_angle_unit is not None:
        raise UsageError(
            f"{plain(matcher.path)}: {Setting('from_angle_unit')} is about angles, and this table "
            "has a quaternion; omit it"
        )
    if named is None:
        wxyz = matcher.only_set(sets, "quaternion", "scalar")
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
        is_numbered = any(a == "0" and b == "1" for a, b in zip(w, x, strict=False))
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
    if not rotations:
        if sequence is not None:
            _refuse_other_sequence(matcher, sequence)
        raise NoAttitudesError(matcher.path, matcher.seen(), "columns")
    form, columns = rotations[0]
    for name in ("from_layout", "from_convention"):
        if getattr(selection, name) is not None:
            raise UsageError(
                f"{plain(matcher.path)}: {Setting(name)} is about quaternions, and this table has "
                f"{form}; omit it"
            )
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
