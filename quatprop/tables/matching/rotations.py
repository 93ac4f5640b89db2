"""The columns of attitudes that are not quaternions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.errors import UndeclaredError, UsageError
from quatprop.tables.matching.choose import ColumnMatch
from quatprop.tables.matching.column_names import ANGLE_UNITS
from quatprop.tables.matching.columns import TableColumns
from quatprop.tables.matching.dialects import EULER, EULER_NUMBERED, GENERIC, ROTATIONS
from quatprop.tables.matching.matcher import ColumnMatcher
from quatprop.text import Setting, listed, plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from quatprop.selection import AttitudeSelection
    from quatprop.tables.base import TableLog


def match_rotation(log: TableLog, selection: AttitudeSelection) -> ColumnMatch | None:
    """Return which columns hold the time and a rotation that is no quaternion.

    Parameters
    ----------
    log
        The table.
    selection
        What the user chose.

    Returns
    -------
    ColumnMatch or None
        None where no columns look like one.

    Raises
    ------
    UndeclaredError
        The unit, the time or its unit is not declared, or there are several rotations.
    UsageError
        The user contradicts the names.
    """
    chosen, named = selection.from_euler, selection.quat_cols
    matches = _matches(log, selection, _rotations(chosen))
    if chosen is not None and named is not None:
        if len(named) != len(chosen):
            raise UsageError(
                f"{Setting('from_euler')} is about three angles, and {Setting('quat_cols')} names "
                f"{len(named)} columns"
            )
        matcher = ColumnMatcher(log, selection, "quat_cols", chosen)
        matches = [(f"euler-{chosen}", matcher, matcher.named(named))]
    if not matches:
        if chosen is not None:
            _refuse_other_sequence(log, selection, chosen)
        return None
    if len(matches) > 1:
        names = listed(matcher.columns[columns[0]].text for _, matcher, columns in matches)
        raise UndeclaredError(
            log.path,
            f"which rotation to use (their first columns are {names})",
            "a table that holds one of them",
        )
    representation, matcher, columns = matches[0]
    dialect = GENERIC
    if representation == "euler-zyx" and named is None:
        dialect = matcher.dialect("angles")
    unit = _angle_unit(
        matcher, representation, columns, selection.from_angle_unit, dialect.angle_unit
    )
    found = matcher.timed_and_named(columns, dialect, sorted(columns))
    remarks = tuple(matcher.overruled)
    return ColumnMatch(*found, unit, dialect.name, representation=representation, remarks=remarks)


def _matches(
    log: TableLog, selection: AttitudeSelection, rotations: Iterable[tuple[str, str, Sequence[str]]]
) -> list[tuple[str, ColumnMatcher, tuple[int, ...]]]:
    """Return each complete set of columns that one of some rotations has."""
    matches = []
    columns = TableColumns(log, selection)
    for representation, pattern, parts in rotations:
        if len(columns.matching(pattern)) < len(parts):
            continue
        matcher = ColumnMatcher(log, selection, "quat_cols", parts)
        matches += [(representation, matcher, columns) for columns in matcher.sets(pattern)]
    return matches


def _refuse_other_sequence(log: TableLog, selection: AttitudeSelection, chosen: str) -> None:
    """Refuse a sequence of angles where columns are by their names those of another one."""
    for representation, matcher, columns in _matches(log, selection, ROTATIONS):
        if representation.startswith("euler-"):
            axes = ", ".join(representation.removeprefix("euler-"))
            raise UsageError(
                f"{plain(log.path)}: {Setting('from_euler', chosen)} contradicts the columns "
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
    convention: str = "",
) -> str:
    names = matcher.names(columns)
    if representation == "matrix":
        if chosen is not None:
            raise UsageError(
                f"{plain(matcher.path)}: {Setting('from_angle_unit')} is about angles, and "
                f"{names} are a matrix; leave it out",
            )
        return ""
    declared = matcher.declared(columns) or convention
    matcher.refuse_unknown(columns, declared, ANGLE_UNITS)
    if chosen is not None and declared not in {"", chosen}:
        raise UsageError(
            f"{plain(matcher.path)}: {Setting('from_angle_unit')} says {chosen}, but by their "
            f"names {names} are in {declared}; leave the option out",
        )
    if not (chosen or declared):
        matcher.undeclared(
            f"the unit of the angles {names}", Setting("from_angle_unit", "|".join(ANGLE_UNITS))
        )
    return chosen or declared
