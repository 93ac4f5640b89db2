"""The columns of attitudes in a file of rows: quaternions, or other representations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.conventions.layout import SCALAR_FIRST, SCALAR_LAST, layout_named
from quatprop.errors import NoAttitudesError, UndeclaredError, UsageError
from quatprop.logs.matcher import ColumnMatcher
from quatprop.logs.matching import Found, Match, marks_of
from quatprop.logs.names import COMPONENT, ROTATIONS
from quatprop.logs.rows import QUATERNION_PARTS
from quatprop.logs.time_columns import choose_time
from quatprop.logs.vocabulary import GENERIC
from quatprop.tables.column_names import ANGLE_UNITS, EULER, EULER_NUMBERED
from quatprop.text import Setting, listed, plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from quatprop.logs.rows import Row
    from quatprop.settings.selection import AttitudeSelection
    from quatprop.tables.model import Table


def match_attitudes(table: Table, selection: AttitudeSelection, recorded: str | None) -> Match:
    """Return the columns of the attitude, a quaternion before any other rotation.

    `recorded`: the layout, where the metadata of the file declare it
    """
    try:
        match = match_quaternion(table, selection, recorded)
    except NoAttitudesError:
        rotation = match_rotation(table, selection)
        if rotation is None:
            raise
        for name in ("from_layout", "from_convention"):
            if getattr(selection, name) is not None:
                raise UsageError(
                    f"{plain(table.path)}: {Setting(name)} is about quaternions, and this table "
                    f"has {rotation.representation}; leave it out"
                ) from None
        return rotation
    if selection.from_angle_unit is not None:
        raise UsageError(
            f"{plain(table.path)}: {Setting('from_angle_unit')} is about angles, and this table "
            "has a quaternion; leave it out"
        )
    return match


def match_quaternion(
    table: Table, selection: AttitudeSelection, recorded: str | None = None
) -> Match:
    """Return which columns hold the time and the quaternion.

    The layout comes from the names of the columns, from the metadata of the file, or from the
    user; where two of these contradict each other nothing is read.
    """
    layout = selection.from_layout and layout_named(selection.from_layout).name
    matcher = ColumnMatcher(table, selection, "quat_cols", QUATERNION_PARTS)
    row = matcher.row("quat")
    sets = matcher.sets(row.quat)
    if selection.from_euler is not None or (selection.quat_cols is None and not sets):
        raise NoAttitudesError(table.path, [column.text for column in table.columns], "columns")
    if selection.quat_cols is not None:
        # Who names the columns knows better than the metadata, but need not repeat it.
        wxyz = _named_quaternion(matcher, row, selection.quat_cols, layout, recorded)
    else:
        wxyz = matcher.only_set(sets, "quaternion", "scalar")
        _refuse_contradiction(matcher, sorted(wxyz), wxyz, layout, recorded)
    found = Found(
        table,
        row if wxyz in sets else GENERIC,
        table.parts[0],
        (wxyz,),
        matcher.spelled(sorted(wxyz)),
    )
    marks = marks_of(found)
    stamp, rows = choose_time(matcher, (*wxyz, *marks), row)
    return Match(
        found._replace(table=rows),
        stamp,
        marks=marks,
        remarks=tuple(matcher.remarks),
        layout=_layout(sorted(wxyz), wxyz),
    )


def _named_quaternion(
    matcher: ColumnMatcher,
    row: Row,
    quat_cols: Sequence[str],
    layout: str | None,
    recorded: str | None,
) -> tuple[int, ...]:
    """Return the columns that the user names, in the order w, x, y, z."""
    stored = matcher.named(quat_cols)
    if len(stored) < len(QUATERNION_PARTS):
        raise UndeclaredError(
            matcher.path,
            f"which sequence of angles {matcher.names(stored)} are, if they are angles (a "
            "quaternion has four columns),",
            Setting("from_euler", "xyz"),
        )
    for wxyz in matcher.sets(row.quat, GENERIC.quat, COMPONENT):
        if set(wxyz) == set(stored):
            _refuse_contradiction(matcher, stored, wxyz, layout)
            return wxyz
    layout = layout or recorded
    if layout is None:
        raise UndeclaredError(
            matcher.path,
            f"which of the columns {matcher.names(stored)} is the scalar",
            Setting("from_layout", "scalar-first|scalar-last"),
        )
    order = layout_named(layout).order
    return tuple(stored[order.index(component)] for component in range(4))


def _refuse_contradiction(
    matcher: ColumnMatcher,
    stored: Sequence[int],
    wxyz: tuple[int, ...],
    layout: str | None,
    recorded: str | None = None,
) -> None:
    """Refuse a layout, of the user or recorded, that is not the one of the names."""
    given = _layout(stored, wxyz)
    setting = f"{Setting('from_layout')}"
    for source, declared in ((setting, layout), ("the metadata of the file", recorded)):
        if declared not in (None, given):
            raise UsageError(
                f"{plain(matcher.path)}: the columns {matcher.names(stored)} are "
                f"{given or 'in no layout, but named'}, and {source} says {declared}; settle it by "
                f"naming them as stored, with {Setting('quat_cols', 'A,B,C,D')} and without "
                f"{setting}"
            )


def _layout(stored: Sequence[int], wxyz: tuple[int, ...]) -> str:
    """Return the layout of columns in their order of storage; ``""`` where it is neither."""
    order = tuple(wxyz.index(position) for position in stored)
    return next((known.name for known in (SCALAR_FIRST, SCALAR_LAST) if known.order == order), "")


def match_rotation(table: Table, selection: AttitudeSelection) -> Match | None:
    """Return which columns hold the time and a rotation that is no quaternion.

    None where no columns look like one.
    """
    chosen, named = selection.from_euler, selection.quat_cols
    matches = _matches(table, selection, _rotations(chosen))
    if chosen is not None and named is not None:
        if len(named) != len(chosen):
            raise UsageError(
                f"{Setting('from_euler')} is about three angles, and {Setting('quat_cols')} names "
                f"{len(named)} columns"
            )
        matcher = ColumnMatcher(table, selection, "quat_cols", chosen)
        matches = [(f"euler-{chosen}", matcher, matcher.named(named))]
    if not matches:
        if chosen is not None:
            _refuse_other_sequence(table, selection, chosen)
        return None
    if len(matches) > 1:
        names = listed(matcher.columns[columns[0]].text for _, matcher, columns in matches)
        raise UndeclaredError(
            table.path,
            f"which rotation to use (their first columns are {names})",
            "a table that holds one of them",
        )
    representation, matcher, columns = matches[0]
    row = matcher.row("angles") if representation == "euler-zyx" and named is None else GENERIC
    unit = _angle_unit(matcher, representation, columns, selection.from_angle_unit, row.angle_unit)
    found = Found(table, row, table.parts[0], (columns,), matcher.spelled(sorted(columns)))
    stamp, rows = choose_time(matcher, columns, row)
    remarks = (
        *matcher.remarks,
        "which of q and -q is meant is not stored: signs are those of each row by itself",
    )
    if representation.startswith("euler-"):
        first, second, third = tuple(representation.removeprefix("euler-"))
        remarks += (f"the angles turn about {first}, the new {second}, and the newest {third}",)
    return Match(
        found._replace(table=rows),
        stamp,
        remarks=remarks,
        unit=unit,
        representation=representation,
    )


def _matches(
    table: Table, selection: AttitudeSelection, rotations: Iterable[tuple[str, str, Sequence[str]]]
) -> list[tuple[str, ColumnMatcher, tuple[int, ...]]]:
    """Return each complete set of columns that one of some rotations has."""
    matches = []
    for representation, pattern, parts in rotations:
        matcher = ColumnMatcher(table, selection, "quat_cols", parts)
        matches += [(representation, matcher, columns) for columns in matcher.sets(pattern)]
    return matches


def _refuse_other_sequence(table: Table, selection: AttitudeSelection, chosen: str) -> None:
    """Refuse a sequence of angles where columns are by their names those of another one."""
    for representation, matcher, columns in _matches(table, selection, ROTATIONS):
        if representation.startswith("euler-"):
            axes = ", ".join(representation.removeprefix("euler-"))
            raise UsageError(
                f"{plain(table.path)}: {Setting('from_euler', chosen)} contradicts the columns "
                f"{matcher.names(columns)}, which by their names are angles about {axes}; if it "
                f"is right, name the columns too, with {Setting('quat_cols', 'A,B,C')}",
            )


def _rotations(sequence: str | None) -> Iterable[tuple[str, str, Sequence[str]]]:
    """Return the rows of :data:`ROTATIONS`, or those of angles in a sequence that is known."""
    if sequence is None:
        return ROTATIONS
    numbered = (f"euler-{sequence}", EULER_NUMBERED.format(sequence), "123")
    names = [{"x": "roll", "y": "pitch", "z": "yaw"}[axis] for axis in sequence]
    is_proper = sequence[0] == sequence[2]
    return [numbered] if is_proper else [(f"euler-{sequence}", EULER, names), numbered]


def _angle_unit(
    matcher: ColumnMatcher,
    representation: str,
    columns: tuple[int, ...],
    chosen: str | None,
    by_row: str,
) -> str:
    names = matcher.names(columns)
    if representation == "matrix":
        if chosen is not None:
            raise UsageError(
                f"{plain(matcher.path)}: {Setting('from_angle_unit')} is about angles, and "
                f"{names} are a matrix; leave it out",
            )
        return ""
    declared = matcher.declared(columns) or by_row
    matcher.refuse_unknown(columns, declared, ANGLE_UNITS)
    if chosen is not None and declared not in {"", chosen}:
        raise UsageError(
            f"{plain(matcher.path)}: {Setting('from_angle_unit')} says {chosen}, but by their "
            f"names {names} are in {declared}; leave the option out",
        )
    if not (chosen or declared):
        setting = Setting("from_angle_unit", "|".join(ANGLE_UNITS))
        matcher.unknown.append((f"the unit of the angles {names}", setting))
    return chosen or declared
