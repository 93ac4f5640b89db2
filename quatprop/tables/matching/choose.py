"""The columns of rates and of quaternions; other rotations are in ``rotations.py``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from quatprop.conditioning.mounting import mounting
from quatprop.conventions.layout import SCALAR_FIRST, SCALAR_LAST, layout_named
from quatprop.errors import LogError, NoAttitudesError, NoRatesError, UndeclaredError, UsageError
from quatprop.settings.quantities import SCALED_RATE_UNITS
from quatprop.tables.matching.column_names import RATE_UNITS
from quatprop.tables.matching.dialects import (
    AXIS_FIRST,
    BARE_RATES,
    BESIDE_BARE_RATES,
    COMPONENT,
    COVARIANCE,
    GENERIC,
    QUATERNION_PARTS,
    RATE_PARTS,
    WITH_RATE_UNIT,
)
from quatprop.tables.matching.matcher import ColumnMatcher
from quatprop.text import Setting, Text, plain

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.selection import AttitudeSelection, RateSelection
    from quatprop.tables.base import TableLog, TimedColumns
    from quatprop.tables.matching.dialects import Dialect


@dataclass(frozen=True, slots=True)
class ColumnMatch:
    """The columns of one quantity in a table, and what their numbers are.

    Parameters
    ----------
    timed
        What to read: the components in order (x, y, z; w, x, y, z; as in
        :data:`quatprop.conventions.representations.REPRESENTATIONS`), after a quaternion or rates
        the marks where they are absent, and the time.
    name
        The names of the components as the table spells them: rates in order, attitudes as stored.
    clock
        The names of the time columns, or the sample rate.
    unit
        ``"rad/s"`` or ``"deg/s"`` of rates, ``"rad"`` or ``"deg"`` of angles, ``""`` of the rest.
    dialect
        The convention that was recognised, such as ``"EuRoC"``, or ``""``.
    representation
        Of an attitude: ``"quaternion"``, ``"rotvec"``, ``"matrix"``, ``"euler-zyx"`` and the like.
    layout
        ``"scalar-first"`` or ``"scalar-last"``; ``""`` where their names say which is which.
    scale
        What stored rates are multiplied by to be in `unit`.
    method
        The integration rule that fits the samples, where the convention defines it.
    remarks
        What the user should know of the choice.
    """

    timed: TimedColumns
    name: str
    clock: str
    unit: str = ""
    dialect: str = ""
    representation: str = ""
    layout: str = ""
    scale: float = 1.0
    method: str | None = None
    remarks: tuple[str | Text, ...] = ()


def match_rates(log: TableLog, selection: RateSelection) -> ColumnMatch:
    """Return which columns hold time and rates, and their units.

    Parameters
    ----------
    log
        The table.
    selection
        What the user chose.

    Raises
    ------
    NoRatesError
        No columns look like body rates and the user names none.
    UndeclaredError
        A unit, the time, or one of several sets is declared neither by the header nor by the user.
    UnsupportedLogError
        The header declares a unit that is not supported.
    UsageError
        The user names what is not there, or contradicts the header.
    """
    matcher = ColumnMatcher(log, selection, "rate_cols", RATE_PARTS)
    dialect = matcher.dialect("rate")
    by_convention = matcher.sets(dialect.rate)
    # Axes whose unit says that they are rates are no less a gyroscope than those that are named so.
    units = {**RATE_UNITS, **SCALED_RATE_UNITS}
    by_unit = (k for k in matcher.sets(*WITH_RATE_UNIT) if matcher.declared(k) in units)
    sets = [*dict.fromkeys((*by_convention, *matcher.sets(AXIS_FIRST), *by_unit))]
    sets = sets or _bare_sets(matcher)
    if selection.rate_cols is not None:
        rate = matcher.named(selection.rate_cols)
    elif not sets:
        raise _no_rates(matcher, log)
    else:
        rate = matcher.only_set(sets, "set of rates", "x")
    convention = dialect if rate in by_convention else GENERIC
    declared = matcher.unit("rate", rate, units, convention.rate_unit)
    unit, scale = SCALED_RATE_UNITS.get(declared, (declared, 1.0))
    absence = _absence(matcher, rate[0], "angular_velocity")
    return ColumnMatch(
        *matcher.timed_and_named((*rate, *absence), dialect, rate),
        unit,
        convention.name,
        scale=scale * log.notes.rate_scale,
        method=convention.method,
        remarks=tuple(_remarks(matcher, dialect, declared)),
    )


def _no_rates(matcher: ColumnMatcher, log: TableLog) -> LogError:
    """Return the error for a table without rates, or with some whose axes nobody knows."""
    if angles := matcher.matching(r"(?:.*[._])?(?:roll|pitch|yaw)_?rate")[:3]:
        return UndeclaredError(
            log.path,
            f"about which axes {matcher.names(angles)} turn (those of the body, or others, as in "
            "OpenRocket)",
            Text(f"{Setting('rate_cols', 'X,Y,Z')} if they are those of the body"),
        )
    return NoRatesError(log.path, log.columns(), "columns")


def _bare_sets(matcher: ColumnMatcher) -> list[tuple[int, ...]]:
    """Return gx or p and the like, whose unit the user has to declare.

    They are rates unless the table has axes of something else: beside those, gx may be gravity.
    """
    sets = matcher.sets(*WITH_RATE_UNIT)
    others = {k for columns in sets for k in columns} - {*matcher.matching(BESIDE_BARE_RATES)}
    return [columns for columns in matcher.sets(*BARE_RATES) if others == {*columns}]


def _remarks(matcher: ColumnMatcher, dialect: Dialect, unit: str) -> Iterator[str | Text]:
    yield from matcher.overruled
    if unit in SCALED_RATE_UNITS:
        read_as, scale = SCALED_RATE_UNITS[unit]
        yield f"the rates are in {unit}, which is read as {scale:.4g} {read_as}"
    if matcher.notes.mount:
        yield _mount_remark(matcher.notes.mount)
    if unused := matcher.unused_stamps(dialect):
        sample_rate = Setting("sample_rate", f"{float(matcher.selection.sample_rate or 0):g}")
        names = matcher.names(unused)
        yield Text(f"{sample_rate} counts {matcher.counted}; the stamps in {names} are not used")


def _mount_remark(mount: str) -> Text:
    """Return the remark on a file that says how its sensor is mounted."""
    try:
        mounting(mount)
        way_out = f"to turn them into the camera's axes use {Setting('mount', mount)}"
    except UsageError:
        way_out = f"as the mounting {mount} is left-handed, it cannot be right"
    taken = "the file says how its sensor is mounted, and rates are taken as they are"
    return Text(f"{taken}; {way_out}")


def match_quaternion(
    log: TableLog, selection: AttitudeSelection, recorded: str | None = None
) -> ColumnMatch:
    """Return which columns hold the time and the quaternion.

    The layout comes from the names of the columns, from the metadata of the file, or from the
    user; where two of these contradict each other nothing is read.

    Parameters
    ----------
    log
        The table.
    selection
        What the user chose.
    recorded
        The layout, where the metadata of the file declare it.

    Raises
    ------
    NoAttitudesError
        No columns look like a quaternion and the user names none.
    UndeclaredError
        The order, the time or its unit is not declared, or there are several quaternions.
    UsageError
        The user names what is not there; or names, metadata and user contradict each other.
    """
    layout = selection.from_layout and layout_named(selection.from_layout).name
    matcher = ColumnMatcher(log, selection, "quat_cols", QUATERNION_PARTS)
    dialect = matcher.dialect("quaternion")
    sets = matcher.sets(dialect.quaternion)
    if selection.from_euler is not None or (selection.quat_cols is None and not sets):
        raise NoAttitudesError(log.path, log.columns(), "columns")
    if selection.quat_cols is not None:
        # Who names the columns knows better than the metadata, but need not repeat it.
        wxyz = _named_quaternion(matcher, dialect, selection.quat_cols, layout, recorded)
    else:
        wxyz = matcher.only_set(sets, "quaternion", "scalar")
        _refuse_contradiction(matcher, sorted(wxyz), wxyz, layout, recorded)
    return ColumnMatch(
        *matcher.timed_and_named(
            (*wxyz, *_absence(matcher, wxyz[0], "orientation")), dialect, sorted(wxyz)
        ),
        dialect=dialect.name if wxyz in sets else "",
        representation="quaternion",
        layout=_layout(sorted(wxyz), wxyz),
        remarks=tuple(matcher.overruled),
    )


def _named_quaternion(
    matcher: ColumnMatcher,
    dialect: Dialect,
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
    for wxyz in matcher.sets(dialect.quaternion, GENERIC.quaternion, COMPONENT):
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


def _absence(matcher: ColumnMatcher, component: int, quantity: str) -> list[int]:
    """Return the column that marks a ROS orientation or rate as absent, if there is one."""
    prefix, is_ros, _ = matcher.columns[component].key.rpartition(f"{quantity}.")
    return matcher.matching(re.escape(prefix + quantity) + COVARIANCE)[:1] if is_ros else []
