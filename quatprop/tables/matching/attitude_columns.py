"""Choosing the columns of a table that are a quaternion, and in which order they stand.

The layout comes from the names of the columns, from what was written beside them, or from the
user; where two of these contradict each other nothing is read, and where none says it, neither.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from quatprop.conventions.layout import SCALAR_FIRST, SCALAR_LAST, layout_named
from quatprop.errors import NoAttitudesError, UndeclaredError, UsageError
from quatprop.tables.base import TimedColumns
from quatprop.tables.matching.attitude_dialects import (
    ABSENT,
    ATTITUDE_DIALECTS,
    ATTITUDE_GENERIC,
    PARTS,
    AttitudeDialect,
)
from quatprop.tables.matching.column_matcher import Chooser
from quatprop.tables.matching.rate_dialects import TIME_UNITS, column
from quatprop.text import listed, plain

if TYPE_CHECKING:
    from quatprop.selection import SignalSelection
    from quatprop.tables.base import TableLog

OPTION = "--quat-cols"


@dataclass(frozen=True, slots=True)
class QuaternionColumns:
    """Which columns of a table are an attitude.

    Parameters
    ----------
    timed
        What to read: the components in the order w, x, y, z, then the mark of absence if there is
        one, and the time.
    layout
        The order in which they are stored, ``"scalar-first"`` or ``"scalar-last"``; ``""`` where
        it is neither and their names tell the components.
    dialect
        The convention that was recognised, or ``""``.
    """

    timed: TimedColumns
    layout: str
    dialect: str = ""


def choose_quaternion(
    log: TableLog,
    selection: SignalSelection,
    *,
    quat_cols: tuple[str, ...] | None = None,
    layout: str | None = None,
    recorded: str | None = None,
) -> QuaternionColumns:
    """Return which columns hold the time and the quaternion.

    Parameters
    ----------
    log
        The table.
    selection
        The options about the time.
    quat_cols
        The four columns as stored, by name or number from 0.
    layout
        What the user says about their order.
    recorded
        What the file's own metadata says about it.

    Raises
    ------
    NoAttitudesError
        No columns look like a quaternion and the options name none.
    UndeclaredError
        The order, the time or its unit is said nowhere, or there are several quaternions.
    UsageError
        Options name what is not there; or names, metadata and options contradict each other.
    """
    columns = [column(name) for name in log.columns()]
    chooser = _Chooser(log.path, columns, selection, log.notes)
    return chooser.choose(quat_cols, layout and layout_named(layout).name, recorded)


class _Chooser(Chooser):
    __slots__ = ()

    def choose(
        self, quat_cols: tuple[str, ...] | None, layout: str | None, recorded: str | None
    ) -> QuaternionColumns:
        self.refuse_topics(OPTION)
        dialect = self._dialect()
        if quat_cols is None:
            wxyz = self._named_by_header(dialect)
            self._refuse_contradiction(wxyz, layout, recorded)
        else:
            # Who names the columns knows better than the metadata, but need not repeat it.
            wxyz = self._named_by_user(dialect, quat_cols, layout, recorded)
        stored = _layout_of(wxyz)
        time, sample_rate = self.time(dialect)
        time_unit = self.time_unit(dialect, time)
        if not time_unit:
            raise UndeclaredError(
                self.path,
                f"the unit of the time {self.names(time)}",
                f"--time-unit {'|'.join(TIME_UNITS)}",
            )
        conventional = wxyz in self._quaternions(dialect.quaternion)
        return QuaternionColumns(
            TimedColumns((*wxyz, *self._absent(wxyz)), time, time_unit, sample_rate),
            stored,
            dialect.name if conventional else "",
        )

    def _dialect(self) -> AttitudeDialect:
        keys = self.keys()
        for dialect in ATTITUDE_DIALECTS:
            if (
                keys.issuperset(dialect.needs)
                and re.search(dialect.file, self.path.name)
                and self._quaternions(dialect.quaternion)
                and any(self.matching(pattern) for pattern in dialect.time)
            ):
                return dialect
        return ATTITUDE_GENERIC

    def _quaternions(self, pattern: str) -> list[tuple[int, ...]]:
        """Return each set of w, x, y, z columns whose names differ in the component alone."""
        sets: dict[str, dict[int, int]] = {}
        for position, one in enumerate(self.columns):
            match = re.fullmatch(pattern, one.key)
            if match:
                rest = one.key[: match.start("part")] + "*" + one.key[match.end("part") :]
                sets.setdefault(rest, {})[PARTS[match["part"]]] = position
        return [
            tuple(found[part] for part in range(4))
            for found in sets.values()
            if len(found) == len("wxyz")
        ]

    def _named_by_header(self, dialect: AttitudeDialect) -> tuple[int, ...]:
        found = self._quaternions(dialect.quaternion)
        if not found:
            raise NoAttitudesError(self.path, [one.name for one in self.columns], "columns")
        if len(found) > 1:
            first = listed(self.columns[wxyz[0]].name for wxyz in found)
            raise UndeclaredError(
                self.path,
                f"which quaternion to use (their scalar columns are {first})",
                f"{OPTION} A,B,C,D",
            )
        return found[0]

    def _named_by_user(
        self,
        dialect: AttitudeDialect,
        quat_cols: tuple[str, ...],
        layout: str | None,
        recorded: str | None,
    ) -> tuple[int, ...]:
        places = tuple(self.position(name, OPTION) for name in quat_cols)
        if len(set(places)) != len(places):
            raise UsageError(f"{plain(self.path)}: {OPTION} names a column twice")
        for pattern in (dialect.quaternion, ATTITUDE_GENERIC.quaternion):
            for wxyz in self._quaternions(pattern):
                if set(wxyz) == set(places):
                    given = _order_of(places, wxyz)
                    if layout not in (None, given):
                        raise UsageError(
                            f"{plain(self.path)}: {OPTION} gives {self.names(places)}, which by "
                            f"their names are {given or 'in no layout'}, but --from-layout says "
                            f"{layout}; leave it out"
                        )
                    return wxyz
        layout = layout or recorded
        if layout is None:
            raise UndeclaredError(
                self.path,
                f"which of the columns {self.names(places)} is the scalar",
                "--from-layout scalar-first|scalar-last",
            )
        order = layout_named(layout).order
        return tuple(places[order.index(part)] for part in range(4))

    def _refuse_contradiction(
        self, wxyz: tuple[int, ...], layout: str | None, recorded: str | None
    ) -> None:
        stored = _layout_of(wxyz)
        shown = self.names(sorted(wxyz))
        for who, said in (("--from-layout", layout), ("the metadata of the file", recorded)):
            if said not in (None, stored):
                raise UsageError(
                    f"{plain(self.path)}: the columns {shown} are "
                    f"{stored or 'in no layout, but named'}, and {who} says {said}; "
                    f"settle it by naming them as stored, with {OPTION} A,B,C,D"
                )

    def _absent(self, wxyz: tuple[int, ...]) -> tuple[int, ...]:
        """Return the column that marks a ROS orientation as absent, if there is one."""
        key = self.columns[wxyz[0]].key
        if not key.endswith("orientation.w"):
            return ()
        return tuple(self.matching(re.escape(key.removesuffix("orientation.w")) + ABSENT)[:1])


def _layout_of(wxyz: tuple[int, ...]) -> str:
    """Return the layout of columns from where they stand in the file."""
    return _order_of(sorted(wxyz), wxyz)


def _order_of(places: tuple[int, ...] | list[int], wxyz: tuple[int, ...]) -> str:
    order = tuple(wxyz.index(place) for place in places)
    return next((one.name for one in (SCALAR_FIRST, SCALAR_LAST) if one.order == order), "")
