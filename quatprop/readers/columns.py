"""Choosing the columns of a table: from the options, the header and the known conventions.

Nothing is guessed: what neither header, convention nor option says is refused, with the option
that settles it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import (
    NoRatesError,
    UndeclaredError,
    UnsupportedLogError,
    UsageError,
    listed,
    plain,
    quoted,
)
from quatprop.readers.base import TableColumns
from quatprop.readers.dialects import (
    AXES,
    DIALECTS,
    GENERIC,
    RATE_UNITS,
    TIME_NAMES,
    TIME_UNITS,
    Column,
    Dialect,
    column,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.selection import Selection


@dataclass(frozen=True, slots=True)
class Notes:
    """What is known about a table besides its header.

    Parameters
    ----------
    sample_rate
        Rows a second, Hz, if the lines before the header say so.
    declared
        Units by position that a column's type or the lines before the header declare.
    rate_scale
        What stored rates are multiplied by.
    title
        The first line, where lines come before the header.
    """

    sample_rate: float | None = None
    declared: Mapping[int, str] = field(default_factory=dict)
    rate_scale: float = 1.0
    title: str = ""


def choose(
    path: Path, names: Sequence[str], selection: Selection, notes: Notes | None = None
) -> TableColumns:
    """Return which columns hold time and rates, and their units.

    Parameters
    ----------
    path
        The log, for errors and for conventions that need its name.
    names
        The column names in order.
    selection
        The options of the user.
    notes
        What is known besides the header.

    Raises
    ------
    NoRatesError
        No columns look like body rates and the options name none.
    UndeclaredError
        A unit, the time, or one of several sets is said neither by the header nor by an option.
    UnsupportedLogError
        The header declares a unit that is not known.
    UsageError
        Options name what is not there, or contradict each other or the header.
    """
    return _Chooser(path, [column(name) for name in names], selection, notes or Notes()).choose()


def in_rad_s(rate: NDArray[np.float64], columns: TableColumns) -> NDArray[np.float64]:
    """Return stored rates in rad/s; the array is changed in place.

    Parameters
    ----------
    rate
        Rates as stored, shape ``(N, 3)``, float64.
    columns
        What they are stored in.
    """
    if columns.rate_scale != 1.0:
        rate *= columns.rate_scale
    if columns.rate_unit == "deg/s":
        rate *= np.pi / 180
    return rate


@dataclass(frozen=True, slots=True)
class _Chooser:
    path: Path
    columns: list[Column]
    selection: Selection
    notes: Notes

    def choose(self) -> TableColumns:
        self._refuse_topics()
        dialect = self._dialect()
        rate = self._rate(dialect)
        conventional = rate in self._triples(dialect.rate)
        rate_unit = self._unit(
            "rate", rate, RATE_UNITS, dialect.rate_unit if conventional else "", self._named_rates()
        )
        time, sample_rate = self._time(dialect)
        time_unit = self._time_unit(dialect, time)
        self._refuse_undeclared(rate, rate_unit, time, time_unit)
        return TableColumns(
            rate,
            rate_unit,
            time,
            time_unit or "ns",
            sample_rate,
            dialect.name if conventional else "",
            self.notes.rate_scale,
        )

    # The convention.

    def _dialect(self) -> Dialect:
        # rostopic marks its first column; everyone else's mark is decoration.
        keys = {one.key for one in self.columns}
        keys |= {one.name.strip("\ufeff ").lower() for one in self.columns}
        keys.add(self.notes.title.lower())
        for dialect in DIALECTS:
            if (
                keys.issuperset(dialect.needs)
                and re.search(dialect.file, self.path.name)
                and self._triples(dialect.rate)
                and any(self._matching(pattern) for pattern in dialect.time)
            ):
                return dialect
        return GENERIC

    def _matching(self, pattern: str) -> list[int]:
        return [k for k, one in enumerate(self.columns) if re.fullmatch(pattern, one.key)]

    def _triples(self, pattern: str) -> list[tuple[int, int, int]]:
        """Return each set of x, y, z columns whose names differ in the axis alone."""
        sets: dict[str, dict[int, int]] = {}
        for position, one in enumerate(self.columns):
            match = re.fullmatch(pattern, one.key)
            if match:
                rest = one.key[: match.start("axis")] + "*" + one.key[match.end("axis") :]
                sets.setdefault(rest, {})[AXES[match["axis"]]] = position
        return [
            (found[0], found[1], found[2]) for found in sets.values() if len(found) == len("xyz")
        ]

    # The rates.

    def _named_rates(self) -> bool:
        return self.selection.rate_cols is not None

    def _rate(self, dialect: Dialect) -> tuple[int, int, int]:
        if self.selection.rate_cols is not None:
            x, y, z = (self._position(name, "--rate-cols") for name in self.selection.rate_cols)
            return x, y, z
        triples = self._triples(dialect.rate)
        if not triples:
            raise NoRatesError(self.path, [one.name for one in self.columns], "columns")
        if len(triples) > 1:
            first = listed(self.columns[triple[0]].name for triple in triples)
            raise UndeclaredError(
                self.path,
                f"which set of rates to use (their x columns are {first})",
                "--rate-cols X,Y,Z",
            )
        return triples[0]

    # The time.

    def _time(self, dialect: Dialect) -> tuple[tuple[int, ...], float | None]:
        chosen = self.selection
        if chosen.time_col is not None:
            if chosen.sample_rate is not None:
                raise UsageError("--time-col and --sample-rate contradict each other; give one")
            return self._with_nanoseconds(self._position(chosen.time_col, "--time-col")), None
        if chosen.sample_rate is not None:
            if not (math.isfinite(chosen.sample_rate) and chosen.sample_rate > 0):
                raise UsageError(f"--sample-rate {chosen.sample_rate} is not a rate above 0 Hz")
            return (), chosen.sample_rate
        patterns = self._clock(dialect)
        for pattern in patterns:
            found = self._matching(pattern)
            if len(found) == 1:
                return self._with_nanoseconds(found[0]), None
            if found:
                raise self._which_time(found)
        if len(self.notes.declared) == 1:
            return (next(iter(self.notes.declared)),), None
        if self.notes.sample_rate is not None:
            return (), self.notes.sample_rate
        raise self._which_time(
            self._matching(rf".*[._](?:{TIME_NAMES})") or range(len(self.columns))
        )

    def _clock(self, dialect: Dialect) -> tuple[str, ...]:
        match self.selection.clock:
            case None:
                return dialect.time
            case "header":
                return tuple(pattern for pattern in dialect.time if pattern != dialect.log_time)
            case "log" if dialect.log_time:
                return (dialect.log_time,)
            case clock:
                raise UsageError(
                    f"{plain(self.path)}: this table has no {clock} time; "
                    "choose the column with --time-col"
                )

    def _which_time(self, candidates: Sequence[int]) -> UndeclaredError:
        names = listed(self.columns[k].name for k in candidates)
        return UndeclaredError(
            self.path,
            f"which column is the time (of {names})",
            "--time-col C, or --sample-rate HZ for rows at a steady rate",
        )

    def _with_nanoseconds(self, first: int) -> tuple[int, ...]:
        """Return a time column with the nanoseconds that belong to it, if it is one of two."""
        match = re.fullmatch(r"(.*[._])?secs?", self.columns[first].key)
        if not match:
            return (first,)
        found = self._matching(re.escape(match[1] or "") + r"(?:nanosec|nsec)s?")
        return (first, found[0]) if found else (first,)

    def _time_unit(self, dialect: Dialect, time: tuple[int, ...]) -> str:
        if not time:
            return "ns"
        if len(time) > 1:
            return "s"
        by_convention = any(time[0] in self._matching(p) for p in dialect.time)
        return self._unit(
            "time",
            time,
            TIME_UNITS,
            dialect.time_unit if by_convention else "",
            self.selection.time_col is not None,
        )

    # The units.

    def _unit(
        self,
        what: str,
        positions: tuple[int, ...],
        units: Mapping[str, object],
        convention: str,
        named: bool,
    ) -> str:
        """Return the unit from option, header or convention; ``""`` where none says it."""
        said = self.selection.rate_unit if what == "rate" else self.selection.time_unit
        texts = {self.notes.declared.get(k, self.columns[k].unit) for k in positions}
        declared = (texts.pop() if len(texts) == 1 else "") or convention
        if said is not None:
            # Who names the columns and the unit knows better than the header.
            if declared in units and declared != said and not named:
                raise UsageError(
                    f"{plain(self.path)}: --{what}-unit says {said}, but by header or convention "
                    f"{self._names(positions)} are in {declared}; leave the option out or, "
                    f"if it is right, name the columns too, with --{what}-col"
                    + ("s" if what == "rate" else "")
                )
            return said
        if declared and declared not in units:
            raise UnsupportedLogError(
                self.path,
                f"{self._names(positions)} are declared in {quoted(declared)}; "
                f"convert them to {' or '.join(units)}",
            )
        return declared

    def _refuse_undeclared(
        self, rate: tuple[int, ...], rate_unit: str, time: tuple[int, ...], time_unit: str
    ) -> None:
        unknown, options = [], []
        if not rate_unit:
            unknown.append(f"the unit of the rates {self._names(rate)}")
            options.append(f"--rate-unit {'|'.join(RATE_UNITS)}")
        if not time_unit:
            unknown.append(f"the unit of the time {self._names(time)}")
            options.append(f"--time-unit {'|'.join(TIME_UNITS)}")
        if unknown:
            raise UndeclaredError(self.path, " and ".join(unknown), " and ".join(options))

    # Names.

    def _names(self, positions: Sequence[int]) -> str:
        return listed(self.columns[k].name.strip() for k in positions)

    def _position(self, wanted: str, option: str) -> int:
        """Return the column that an option names: as spelled, by key, or by number from 0."""
        wanted = wanted.strip()
        found = [k for k, one in enumerate(self.columns) if one.name.strip() == wanted]
        found = found or [k for k, one in enumerate(self.columns) if one.key == column(wanted).key]
        if len(found) > 1:
            raise UsageError(
                f"{plain(self.path)}: {len(found)} columns are called {quoted(wanted)}; "
                f"say which with its number from 0, {option} taking {found[0]}, {found[1]}..."
            )
        if not found and wanted.isdecimal() and int(wanted) < len(self.columns):
            return int(wanted)
        if not found:
            raise UsageError(
                f"{plain(self.path)}: {option} asks for column {quoted(wanted)}; "
                f"the columns are {listed(one.name for one in self.columns)}"
            )
        return found[0]

    def _refuse_topics(self) -> None:
        given = (
            ("--topic", self.selection.topic),
            ("--rate-field", self.selection.rate_field),
            ("--time-field", self.selection.time_field),
        )
        for option, value in given:
            if value is not None:
                raise UsageError(
                    f"{plain(self.path)}: {option} is for logs of messages and this is a table; "
                    "choose columns with --rate-cols and --time-col"
                )
