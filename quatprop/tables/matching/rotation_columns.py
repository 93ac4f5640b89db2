"""Choosing the columns of a table that are a rotation written otherwise than as a quaternion.

Names tell which rotation is meant, names or metadata in which unit; what neither says is asked
for. Yaw, pitch and roll are turns about z, then the new y, then the newest x.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from quatprop.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.tables.base import TimedColumns
from quatprop.tables.matching.column_matcher import Chooser
from quatprop.tables.matching.rate_dialects import TIME_NAMES, TIME_UNITS, column
from quatprop.text import listed, plain

if TYPE_CHECKING:
    from quatprop.selection import SignalSelection
    from quatprop.tables.base import TableLog

ANGLE_UNITS = {
    "rad": ("rad", "rads", "radian", "radians"),
    "deg": ("deg", "degs", "degree", "degrees", "\u00b0", "\u00ba"),
}
"""How names spell the units of an angle."""

OPTION = "--from-angle-unit"

_SPELLED = {spelling: unit for unit, spellings in ANGLE_UNITS.items() for spelling in spellings}
_UNIT = rf"(?:_(?P<unit>{'|'.join(map(re.escape, _SPELLED))}))?"
_NO = r"(?!.*(?:cov|std|var|noise|sigma|delta|error|setpoint|rate|speed|vel|acc))"


class _Form(NamedTuple):
    """How the columns of one representation are called; the group ``part`` tells which it is."""

    kind: str
    pattern: str
    parts: tuple[str, ...]
    has_unit: bool


_FORMS = (
    _Form(
        "rotvec",
        rf"{_NO}(?:.*[._])?(?:rotvec|rotation_?vector|rot_?vec)[._]?(?P<part>[xyz]){_UNIT}",
        ("x", "y", "z"),
        has_unit=True,
    ),
    _Form(
        "euler-zyx",
        rf"{_NO}(?:.*[._])?(?P<part>yaw|pitch|roll){_UNIT}",
        ("yaw", "pitch", "roll"),
        has_unit=True,
    ),
    *(
        _Form(
            "matrix",
            rf"{_NO}(?:.*[._])?(?:r|m|rot|rotation|matrix|dcm)_?(?P<part>[{i}]_?[{i}])",
            tuple(f"{row}{place}" for row in i for place in i),
            has_unit=False,
        )
        for i in ("123", "012")
    ),
)


@dataclass(frozen=True, slots=True)
class _Time:
    """How the time is called beside rotations."""

    time: tuple[str, ...] = (r"(?:.*\.)?header\.stamp\.secs?", r"(?:stamp[._])?secs?", TIME_NAMES)
    time_unit: str = ""
    log_time: str = ""


@dataclass(frozen=True, slots=True)
class RotationColumns:
    """Which columns of a table are an attitude that is no quaternion.

    Parameters
    ----------
    timed
        What to read: the columns in the order of
        :data:`quatprop.conventions.representations.REPRESENTATIONS`, and the time.
    representation
        Its key there, ``"euler-zyx"`` for angles in any unit.
    unit
        ``"rad"`` or ``"deg"``; ``""`` for what has none.
    """

    timed: TimedColumns
    representation: str
    unit: str


def choose_rotation(
    log: TableLog, selection: SignalSelection, unit: str | None = None
) -> RotationColumns | None:
    """Return which columns hold the time and the rotation; None where there is none.

    Parameters
    ----------
    log
        The table.
    selection
        The options about the time.
    unit
        What the user says about the unit of angles.

    Raises
    ------
    UndeclaredError
        The unit, the time or its unit is said nowhere, or there are several rotations.
    UsageError
        The user contradicts the names.
    """
    columns = [column(name) for name in log.columns()]
    return _Chooser(log.path, columns, selection, log.notes).choose(unit)


class _Chooser(Chooser):
    __slots__ = ()

    def choose(self, said: str | None) -> RotationColumns | None:
        found = [(form, places) for form in _FORMS for places in self._sets(form)]
        if not found:
            return None
        self.refuse_topics("--quat-cols")
        if len(found) > 1:
            first = listed(self.columns[places[0]].name for _, places in found)
            raise UndeclaredError(
                self.path,
                f"which rotation to use (their first columns are {first})",
                "a table that holds one of them",
            )
        form, places = found[0]
        unit = self._angle_unit(form, places, said)
        time, sample_rate = self.time(_Time())
        time_unit = self.time_unit(_Time(), time)
        if not time_unit:
            raise UndeclaredError(
                self.path,
                f"the unit of the time {self.names(time)}",
                f"--time-unit {'|'.join(TIME_UNITS)}",
            )
        timed = TimedColumns(places, time, time_unit, sample_rate)
        return RotationColumns(timed, form.kind, unit)

    def _sets(self, form: _Form) -> list[tuple[int, ...]]:
        """Return each set of columns whose names differ in the part alone."""
        sets: dict[str, dict[str, int]] = {}
        for position, one in enumerate(self.columns):
            match = re.fullmatch(form.pattern, one.key)
            if match:
                rest = one.key[: match.start("part")] + "*" + one.key[match.end("part") :]
                sets.setdefault(rest, {})[match["part"].replace("_", "")] = position
        whole = [found for found in sets.values() if len(found) == len(form.parts)]
        return [tuple(found[part] for part in form.parts) for found in whole]

    def _angle_unit(self, form: _Form, places: tuple[int, ...], said: str | None) -> str:
        if not form.has_unit:
            if said is not None:
                raise UsageError(
                    f"{plain(self.path)}: {OPTION} is about angles, and {self.names(places)} are "
                    "a matrix; leave it out"
                )
            return ""
        match = re.fullmatch(form.pattern, self.columns[places[0]].key)
        named = (match and match["unit"]) or self.columns[places[0]].unit
        declared = _SPELLED.get(named, named)
        if declared not in {"", *ANGLE_UNITS}:
            raise UnsupportedLogError(
                self.path,
                f"{self.names(places)} are declared in {declared}; convert them to rad or deg",
            )
        if said is not None and declared not in {"", said}:
            raise UsageError(
                f"{plain(self.path)}: {OPTION} says {said}, but by their names "
                f"{self.names(places)} are in {declared}; leave the option out"
            )
        if not (said or declared):
            raise UndeclaredError(
                self.path,
                f"the unit of the angles {self.names(places)}",
                f"{OPTION} {'|'.join(ANGLE_UNITS)}",
            )
        return said or declared
