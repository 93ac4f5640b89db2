"""Matching the columns of a table: sets of them, the time, units, and what the user named.

Nothing is guessed: what neither header, convention nor user declares is refused, with the setting
that settles it.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING

from quatprop.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.tables.base import TimedColumns
from quatprop.tables.matching.column_names import TIME_UNITS, parse_name
from quatprop.tables.matching.dialects import DIALECTS, GENERIC, TIME_NAMES
from quatprop.text import Setting, Text, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from fractions import Fraction

    from quatprop.selection import SignalSelection
    from quatprop.tables.base import TableLog
    from quatprop.tables.matching.dialects import Dialect

    Positions = tuple[int, ...]


class ColumnMatcher:
    """Finds the columns of one quantity in a table.

    Parameters
    ----------
    log
        The table.
    selection
        What the user chose.
    setting
        The setting that names the columns of the quantity, such as ``"rate_cols"``.
    parts
        For each component, how patterns spell it, with ``|`` between spellings.
    """

    def __init__(
        self, log: TableLog, selection: SignalSelection, setting: str, parts: Sequence[str]
    ) -> None:
        self.path = log.path
        self.notes = log.notes
        self.columns = [parse_name(name) for name in log.columns()]
        self.selection = selection
        self.setting = setting
        self._count = len(parts)
        self._components = {
            spelling: component
            for component, spellings in enumerate(parts)
            for spelling in spellings.split("|")
        }
        self._undeclared: list[tuple[str, Setting]] = []
        for name in ("topic", "rate_field", "time_field", "quat_field", "frame"):
            if getattr(selection, name, None) is not None:
                raise UsageError(
                    f"{plain(self.path)}: ",
                    Setting(name),
                    " is for logs of messages and this is a table; choose columns with ",
                    Setting(setting),
                    " and ",
                    Setting("time_col"),
                )

    # Sets of columns.

    def matching(self, pattern: str) -> list[int]:
        """Return the columns whose keys match a pattern."""
        return [k for k, column in enumerate(self.columns) if re.fullmatch(pattern, column.key)]

    def sets(self, pattern: str) -> list[Positions]:
        """Return each complete set of columns whose names differ in the component alone.

        Where a name comes up twice there are two sets.
        """
        by_name: dict[str, dict[int, list[int]]] = {}
        for position, column in enumerate(self.columns):
            match = re.fullmatch(pattern, column.key) if pattern else None
            if match:
                rest = f"{column.key[: match.start('part')]}*{column.key[match.end('part') :]}"
                places = by_name.setdefault(rest, {})
                places.setdefault(self._components[match["part"]], []).append(position)
        return [
            tuple(places[component][: k + 1][-1] for component in range(self._count))
            for places in by_name.values()
            if len(places) == self._count
            for k in range(max(map(len, places.values())))
        ]

    def dialect(self, quantity: str) -> Dialect:
        """Return the convention of a table with ``"rate"`` or ``"quaternion"`` columns."""
        # rostopic marks its first column; everyone else's mark is decoration.
        names = {column.key for column in self.columns}
        names |= {column.text.strip("\ufeff ").lower() for column in self.columns}
        names.add(self.notes.title.lower())
        for dialect in DIALECTS:
            if (
                names.issuperset(dialect.needs)
                and re.search(dialect.file, self.path.name)
                and self.sets(getattr(dialect, quantity))
                and any(map(self.matching, dialect.time))
            ):
                return dialect
        return GENERIC

    def only_set(self, sets: Sequence[Positions], quantity: str, component: str) -> Positions:
        """Return the only set; refuse several.

        Parameters
        ----------
        sets
            At least one.
        quantity, component
            What each of them is, and what its first column is called.
        """
        if len(sets) > 1:
            names = [self.columns[positions[0]].text for positions in sets]
            if len(set(names)) < len(names):
                numbers = ", ".join("-".join(map(str, positions)) for positions in sets)
                reason = f"several columns have the same name; by numbers from 0: {numbers}"
            else:
                reason = f"their {component} columns are {listed(names)}"
            raise UndeclaredError(
                self.path,
                f"which {quantity} to use ({reason})",
                Setting(self.setting, "A,B,C,D" if self._count > 3 else "X,Y,Z"),  # noqa: PLR2004
            )
        return sets[0]

    # Columns that the user names.

    def named(self, names: Sequence[str]) -> Positions:
        """Return the columns that the user names."""
        positions = tuple(self._position(name, self.setting) for name in names)
        if len(set(positions)) != len(positions):
            raise UsageError(
                f"{plain(self.path)}: ", Setting(self.setting), " names a column twice"
            )
        return positions

    def _position(self, name: str, setting: str) -> int:
        """Return the column of a name: as spelled, by key, or by number from 0."""
        name, key = name.strip(), parse_name(name).key
        positions = [k for k, column in enumerate(self.columns) if column.text.strip() == name]
        positions = positions or [k for k, column in enumerate(self.columns) if column.key == key]
        if len(positions) > 1:
            raise UsageError(
                f"{plain(self.path)}: {len(positions)} columns are called {quoted(name)}; "
                "say which with its number from 0, ",
                Setting(setting),
                f" taking {positions[0]}, {positions[1]}...",
            )
        if not positions and name.isdecimal() and int(name) < len(self.columns):
            return int(name)
        if not positions:
            raise UsageError(
                f"{plain(self.path)}: ",
                Setting(setting),
                f" asks for column {quoted(name)}; "
                f"the columns are {listed(column.text for column in self.columns)}",
            )
        return positions[0]

    def names(self, positions: Collection[int]) -> str:
        """Return the names of columns, quoted."""
        return listed(self.columns[k].text.strip() for k in positions)

    def describe(self, positions: Sequence[int], timed: TimedColumns) -> tuple[str, str]:
        """Return the names of columns and of their time, or the sample rate."""
        names, time = (
            ",".join(self.columns[k].text for k in columns) for columns in (positions, timed.time)
        )
        return names, time if timed.sample_rate is None else f"{float(timed.sample_rate):g} Hz"

    # The time.

    def timed(self, numbers: Positions, dialect: Dialect) -> TimedColumns:
        """Return columns with the time of their rows.

        Raises
        ------
        UndeclaredError
            A unit or the time is not declared.
        UsageError
            The time is one of the columns.
        """
        time, sample_rate = self._time(dialect)
        if both := set(numbers) & set(time):
            raise UsageError(
                f"{plain(self.path)}: {self.names(both)} cannot be both the time and one of ",
                Setting(self.setting),
                "; name other columns, or the time with ",
                Setting("time_col"),
            )
        unit = "ns"
        if len(time) == 1:
            by_convention = any(time[0] in self.matching(pattern) for pattern in dialect.time)
            convention = dialect.time_unit if by_convention else ""
            unit = self.unit("time", time, TIME_UNITS, convention)
        elif time:
            unit = "s"
        if self._undeclared:
            unknown = " and ".join(what for what, _ in self._undeclared)
            first, *others = (setting for _, setting in self._undeclared)
            way_out = Text(first, *(part for other in others for part in (" and ", other)))
            raise UndeclaredError(self.path, unknown, way_out)
        return TimedColumns(numbers, time, unit, sample_rate)

    def unused_stamps(self, dialect: Dialect) -> Positions:
        """Return the time columns that are there although rows are counted at a sample rate."""
        if self.selection.sample_rate is None:
            return ()
        selection, self.selection = self.selection, replace(self.selection, sample_rate=None)
        try:
            return self._time(dialect)[0]
        except UndeclaredError:
            return ()
        finally:
            self.selection = selection

    def _time(self, dialect: Dialect) -> tuple[Positions, Fraction | float | None]:
        """Return the columns of the time, or none and the sample rate, Hz."""
        name, sample_rate = self.selection.time_col, self.selection.sample_rate
        if name is not None and sample_rate is not None:
            raise UsageError(
                Setting("time_col"), " and ", Setting("sample_rate"),
                " contradict each other; give one",
            )  # fmt: skip
        if name is not None:
            return self._with_nanoseconds(self._position(name, "time_col")), None
        if sample_rate is not None:
            if not (math.isfinite(sample_rate) and sample_rate > 0):
                raise UsageError(Setting("sample_rate"), f" {sample_rate} is not a rate above 0 Hz")
            return (), sample_rate
        for pattern in self._clock(dialect):
            positions = self.matching(pattern)
            if len(positions) == 1:
                return self._with_nanoseconds(positions[0]), None
            if positions:
                raise self._ambiguous_time(positions)
        if len(self.notes.units) == 1:
            return tuple(self.notes.units), None
        if self.notes.sample_rate is not None:
            return (), self.notes.sample_rate
        raise self._ambiguous_time(
            self.matching(rf".*[._](?:{TIME_NAMES})") or range(len(self.columns))
        )

    def _clock(self, dialect: Dialect) -> tuple[str, ...]:
        """Return the patterns of the time columns of the chosen clock."""
        match self.selection.clock:
            case None:
                return dialect.time
            case "header":
                return tuple(pattern for pattern in dialect.time if pattern != dialect.log_time)
            case "log" if dialect.log_time:
                return (dialect.log_time,)
            case clock:
                raise UsageError(
                    f"{plain(self.path)}: this table has no {clock} time; choose the column with ",
                    Setting("time_col"),
                )

    def _ambiguous_time(self, candidates: Sequence[int]) -> UndeclaredError:
        names = listed(self.columns[k].text for k in candidates)
        return UndeclaredError(
            self.path,
            f"which column is the time (of {names})",
            Text(Setting("time_col", "C"), ", or ", Setting("sample_rate", "HZ"),
                 " for rows at a steady rate"),
        )  # fmt: skip

    def _with_nanoseconds(self, first: int) -> Positions:
        """Return a time column with the nanoseconds that belong to it, if it is one of two."""
        match = re.fullmatch(r"(.*[._])?secs?", self.columns[first].key)
        if not match:
            return (first,)
        others = self.matching(re.escape(match[1] or "") + r"(?:nanosec|nsec)s?")
        return (first, *others[:1])

    # Units.

    def unit(
        self, quantity: str, positions: Positions, units: Collection[str], convention: str = ""
    ) -> str:
        """Return the unit of columns from user, header or convention.

        Parameters
        ----------
        quantity
            ``"rate"`` or ``"time"``.
        positions
            The columns.
        units
            The units that there are.
        convention
            The unit by convention, ``""`` where there is none.

        Returns
        -------
        str
            ``""`` where nothing declares it, which :meth:`timed` then refuses.
        """
        columns = "rate_cols" if quantity == "rate" else "time_col"
        chosen: str | None = getattr(self.selection, f"{quantity}_unit")
        declared = self.declared(positions) or convention
        if chosen is not None:
            # Who names the columns and the unit knows better than the header.
            is_named = getattr(self.selection, columns) is not None
            if declared in units and declared != chosen and not is_named:
                raise UsageError(
                    f"{plain(self.path)}: ",
                    Setting(f"{quantity}_unit"),
                    f" says {chosen}, but by header or convention {self.names(positions)} are in "
                    f"{declared}; leave the option out or, if it is right, name the columns too, "
                    "with ",
                    Setting(columns),
                )
            return chosen
        self.refuse_unknown(positions, declared, units)
        if not declared:
            what = f"{'rates' if quantity == 'rate' else quantity} {self.names(positions)}"
            self.undeclared(f"the unit of the {what}", Setting(f"{quantity}_unit", "|".join(units)))
        return declared

    def declared(self, positions: Positions) -> str:
        """Return the unit that the header declares of columns; ``""`` where it does not."""
        units = {self.notes.units.get(k, self.columns[k].unit) for k in positions}
        return units.pop() if len(units) == 1 else ""

    def refuse_unknown(self, positions: Positions, unit: str, units: Collection[str]) -> None:
        """Refuse a declared unit that is not one of those that are read."""
        if unit and unit not in units:
            raise UnsupportedLogError(
                self.path,
                f"{self.names(positions)} are declared in {quoted(unit)}; "
                f"convert them to {' or '.join(units)}",
            )

    def undeclared(self, what: str, setting: Setting) -> None:
        """Note what is not declared; all of it is refused together, in :meth:`timed`."""
        self._undeclared.append((what, setting))
