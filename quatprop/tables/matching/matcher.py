"""Matching the columns of a table: sets of them, the time, and what the user named.

Nothing is guessed: what neither header, convention nor user declares is refused, with the setting
that settles it.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

from quatprop.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.tables.base import OTHER_DATES, TableLog, TimedColumns
from quatprop.tables.matching.column_names import TIME_UNITS
from quatprop.tables.matching.columns import TableColumns
from quatprop.tables.matching.dialects import DIALECTS, GENERIC, TIME_NAMES, Dialect
from quatprop.text import Setting, Text, listed, plain

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

    from quatprop.selection import SignalSelection

    Positions = tuple[int, ...]


_INSTANT = r"(?!.*(?:period|delta|diff|step|interval|duration|exposure|latency|delay|dt)).*"
"""Names of columns that may be the time where a unit says that they are one."""

_PARTS_OF_A_SECOND = "|".join(name for unit in ("ms", "us", "ns") for name in TIME_UNITS[unit])


class ColumnMatcher(TableColumns):
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
        super().__init__(log, selection)
        self.setting = setting
        self._count = len(parts)
        self._components = {
            spelling: component
            for component, spellings in enumerate(parts)
            for spelling in spellings.split("|")
        }
        for name in ("topic", "rate_field", "time_field", "quat_field", "frame"):
            if getattr(selection, name, None) is not None:
                raise UsageError(
                    f"{plain(self.path)}: {Setting(name)} is for logs of messages and this is a "
                    f"table; choose columns with {Setting(setting)} and {Setting('time_col')}",
                )

    # Sets of columns.

    def sets(self, *patterns: str) -> list[Positions]:
        """Return each complete set of columns whose names differ in the component alone.

        Where a name comes up twice there are two sets.
        """
        by_name: dict[tuple[str, str], dict[int, list[int]]] = {}
        for pattern, (position, column) in product(filter(None, patterns), enumerate(self.columns)):
            if match := re.fullmatch(pattern, column.key):
                rest = f"{column.key[: match.start('part')]}*{column.key[match.end('part') :]}"
                places = by_name.setdefault((pattern, rest), {})
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
        positions = tuple(self.position(name, self.setting) for name in names)
        if len(set(positions)) != len(positions):
            raise UsageError(f"{plain(self.path)}: {Setting(self.setting)} names a column twice")
        return positions

    # The time.

    def timed_and_named(
        self, numbers: Positions, dialect: Dialect, named: Sequence[int] = ()
    ) -> tuple[TimedColumns, str, str]:
        """Return columns with their time, the names of those to be named, and of the time.

        All of them are named if none are given. The time may be a sample rate.

        Raises
        ------
        UndeclaredError
            A unit or the time is not declared.
        UsageError
            The time is one of the columns.
        """
        self.refuse_several_sensors(numbers, self.setting)
        time, sample_rate = self._time(dialect, numbers)
        if both := set(numbers) & set(time):
            raise UsageError(
                f"{plain(self.path)}: {self.names(both)} cannot be both the time and one of "
                f"{Setting(self.setting)}; name other columns, or the time with "
                f"{Setting('time_col')}",
            )
        if any(self.notes.units.get(k) == OTHER_DATES for k in time):
            raise UnsupportedLogError(
                self.path,
                f"{self.names(time)} holds {OTHER_DATES}; write them as 2023-11-14T22:13:20.5, "
                f"name another column with {Setting('time_col', 'C')}, or count rows at a steady "
                f"rate with {Setting('sample_rate', 'HZ')}",
            )
        unit = fraction_unit = "ns"
        if len(time) == 1:
            by_convention = any(time[0] in self.matching(pattern) for pattern in dialect.time)
            convention = dialect.time_unit if by_convention else ""
            unit = self.unit("time", time, TIME_UNITS, convention)
        elif time:
            unit, fraction_unit = "s", self.fraction_unit(time[1])
        if self.unknown:
            unknown, ways = (" and ".join(f"{part}" for part in parts)
                             for parts in zip(*self.unknown, strict=True))  # fmt: skip
            raise UndeclaredError(self.path, unknown, ways, several=len(self.unknown) > 1)
        names, clock = (
            ",".join(self.columns[k].text for k in columns) for columns in (named or numbers, time)
        )
        if sample_rate is not None:
            clock = f"{float(sample_rate):g} Hz"
        timed = TimedColumns(numbers, time, unit, sample_rate, fraction_unit=fraction_unit)
        return timed, names, clock

    def unused_stamps(self, dialect: Dialect) -> Positions:
        """Return the time columns that are there although rows are counted at a sample rate."""
        if self.selection.sample_rate is None:
            return ()
        selection, self.selection = self.selection, replace(self.selection, sample_rate=None)
        try:
            return self._time(dialect, ())[0]
        except UndeclaredError:
            return ()
        finally:
            self.selection = selection

    def _time(
        self, dialect: Dialect, numbers: Positions
    ) -> tuple[Positions, Fraction | float | None]:
        """Return the columns of the time, or none and the sample rate, Hz."""
        name, sample_rate = self.selection.time_col, self.selection.sample_rate
        if name is not None and sample_rate is not None:
            raise UsageError(
                f"{Setting('time_col')} and {Setting('sample_rate')} contradict each other; give "
                "one",
            )  # fmt: skip
        if name is not None:
            return self._named_time(name), None
        if sample_rate is not None:
            if not (math.isfinite(sample_rate) and sample_rate > 0):
                raise UsageError(f"{Setting('sample_rate')} {sample_rate} is not a rate above 0 Hz")
            return (), sample_rate
        groups = {self.columns[k].key.rpartition(".")[0] for k in numbers} - {""}
        beside = (rf"{re.escape(group)}\.(?:{TIME_NAMES})" for group in groups)
        for pattern in (*self._clock(dialect), *beside):
            positions = self.matching(pattern)
            if len(positions) > 1:
                # T (K) beside t (s) is a temperature.
                units = {"", OTHER_DATES, *TIME_UNITS}
                positions = [k for k in positions if self.declared((k,)) in units] or positions
            if len(positions) == 1:
                return self._with_fraction(positions[0]), None
            if positions:
                raise self._ambiguous_time(positions)
        positions = list(self.notes.units)
        if len(positions) != 1:
            positions = [k for k in self.matching(_INSTANT) if self.columns[k].unit in TIME_UNITS]
        if len(positions) != 1 and self.notes.sample_rate is not None:
            return (), self.notes.sample_rate
        if len(positions) != 1:
            likely = (rf".*[._](?:{TIME_NAMES})", r".*(?:time|stamp|sec|clock|date).*", ".*")
            raise self._ambiguous_time(positions or next(filter(None, map(self.matching, likely))))
        return tuple(positions), None

    def _named_time(self, name: str) -> Positions:
        """Return the time column that the user names, or those of seconds and their fraction."""
        parts = name.split(",")
        if len(parts) == 2 and name not in (column.text.strip() for column in self.columns):  # noqa: PLR2004
            return tuple(self.position(part, "time_col") for part in parts)
        return self._with_fraction(self.position(name, "time_col"), is_named=True)

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
                    f"{plain(self.path)}: this table has no {clock} time; choose the column with "
                    f"{Setting('time_col')}",
                )

    def _ambiguous_time(self, candidates: Sequence[int]) -> UndeclaredError:
        names = listed(self.columns[k].text for k in candidates)
        return UndeclaredError(
            self.path,
            f"the time column (one of {names})",
            Text(f"{Setting('time_col', 'C')}, or {Setting('sample_rate', 'HZ')} for rows at a "
                "steady rate"),
        )  # fmt: skip

    def _with_fraction(self, first: int, *, is_named: bool = False) -> Positions:
        """Return a time column with the one of its fractions, if it is one of two."""
        match = re.fullmatch(r"(.*[._])?secs?", self.columns[first].key)
        if not match:
            return (first,)
        others = self.matching(re.escape(match[1] or "") + f"(?:{_PARTS_OF_A_SECOND})")
        if not (others and self.are_two_clocks(first, others[0])):
            return (first, *others[:1])
        if is_named:
            return (first,)
        raise self._ambiguous_time((first, others[0]))
