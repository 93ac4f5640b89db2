"""What every choice of a table's columns shares: their names, the time, the units.

Nothing is guessed: what neither header, convention nor option says is refused, with the option
that settles it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from quatprop.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.tables.matching.rate_dialects import TIME_NAMES, TIME_UNITS, Column, column
from quatprop.text import listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from quatprop.selection import SignalSelection


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
    mount
        How the lines before the header say that the sensor sits, as signed axes such as
        ``"y,-x,z"``; ``""`` where they say nothing, or that nothing is turned.
    """

    sample_rate: float | None = None
    declared: Mapping[int, str] = field(default_factory=dict)
    rate_scale: float = 1.0
    title: str = ""
    mount: str = ""


class TimeConvention(Protocol):
    """How a convention calls its time."""

    @property
    def time(self) -> tuple[str, ...]:
        """Patterns of time columns, the preferred one first."""

    @property
    def time_unit(self) -> str:
        """Their unit where the header does not say it."""

    @property
    def log_time(self) -> str:
        """Pattern of the time of recording."""


@dataclass(frozen=True, slots=True)
class Chooser:
    """A table's columns, and what is said about them.

    Parameters
    ----------
    path
        The log, for errors and for conventions that need its name.
    columns
        The columns in order.
    selection
        The options of the user.
    notes
        What is known besides the header.
    """

    path: Path
    columns: list[Column]
    selection: SignalSelection
    notes: Notes

    def matching(self, pattern: str) -> list[int]:
        """Return the columns whose keys match a pattern."""
        return [k for k, one in enumerate(self.columns) if re.fullmatch(pattern, one.key)]

    def keys(self) -> set[str]:
        """Return by what a convention is told: the names, and the first line of the file."""
        # rostopic marks its first column; everyone else's mark is decoration.
        keys = {one.key for one in self.columns}
        keys |= {one.name.strip("\ufeff ").lower() for one in self.columns}
        return keys | {self.notes.title.lower()}

    # The time.

    def time(self, convention: TimeConvention) -> tuple[tuple[int, ...], float | None]:
        """Return the columns of the time, or none and the sample rate, Hz."""
        chosen = self.selection
        if chosen.time_col is not None:
            if chosen.sample_rate is not None:
                raise UsageError("--time-col and --sample-rate contradict each other; give one")
            return self._with_nanoseconds(self.position(chosen.time_col, "--time-col")), None
        if chosen.sample_rate is not None:
            if not (math.isfinite(chosen.sample_rate) and chosen.sample_rate > 0):
                raise UsageError(f"--sample-rate {chosen.sample_rate} is not a rate above 0 Hz")
            return (), chosen.sample_rate
        patterns = self._clock(convention)
        for pattern in patterns:
            found = self.matching(pattern)
            if len(found) == 1:
                return self._with_nanoseconds(found[0]), None
            if found:
                raise self._which_time(found)
        if len(self.notes.declared) == 1:
            return (next(iter(self.notes.declared)),), None
        if self.notes.sample_rate is not None:
            return (), self.notes.sample_rate
        raise self._which_time(
            self.matching(rf".*[._](?:{TIME_NAMES})") or range(len(self.columns))
        )

    def _clock(self, convention: TimeConvention) -> tuple[str, ...]:
        match self.selection.clock:
            case None:
                return convention.time
            case "header":
                return tuple(
                    pattern for pattern in convention.time if pattern != convention.log_time
                )
            case "log" if convention.log_time:
                return (convention.log_time,)
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
        found = self.matching(re.escape(match[1] or "") + r"(?:nanosec|nsec)s?")
        return (first, found[0]) if found else (first,)

    def time_unit(self, convention: TimeConvention, time: tuple[int, ...]) -> str:
        """Return the unit of the first column of a time; ``""`` where nothing says it."""
        if not time:
            return "ns"
        if len(time) > 1:
            return "s"
        by_convention = any(time[0] in self.matching(p) for p in convention.time)
        return self.unit(
            "time",
            time,
            TIME_UNITS,
            convention.time_unit if by_convention else "",
            self.selection.time_col is not None,
        )

    # The units.

    def unit(
        self,
        what: str,
        positions: tuple[int, ...],
        units: Mapping[str, object],
        convention: str,
        named: bool,
    ) -> str:
        """Return the unit from option, header or convention; ``""`` where none says it."""
        said: str | None = getattr(self.selection, f"{what}_unit", None)
        texts = {self.notes.declared.get(k, self.columns[k].unit) for k in positions}
        declared = (texts.pop() if len(texts) == 1 else "") or convention
        if said is not None:
            # Who names the columns and the unit knows better than the header.
            if declared in units and declared != said and not named:
                raise UsageError(
                    f"{plain(self.path)}: --{what}-unit says {said}, but by header or convention "
                    f"{self.names(positions)} are in {declared}; leave the option out or, "
                    f"if it is right, name the columns too, with --{what}-col"
                    + ("s" if what == "rate" else "")
                )
            return said
        if declared and declared not in units:
            raise UnsupportedLogError(
                self.path,
                f"{self.names(positions)} are declared in {quoted(declared)}; "
                f"convert them to {' or '.join(units)}",
            )
        return declared

    # Names.

    def names(self, positions: Sequence[int]) -> str:
        """Return the names of columns, quoted."""
        return listed(self.columns[k].name.strip() for k in positions)

    def position(self, wanted: str, option: str) -> int:
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

    def refuse_topics(self, option_of_columns: str) -> None:
        """Refuse the options that are for messages."""
        given = (
            ("--topic", self.selection.topic),
            ("--rate-field", getattr(self.selection, "rate_field", None)),
            ("--time-field", self.selection.time_field),
        )
        for option, value in given:
            if value is not None:
                raise UsageError(
                    f"{plain(self.path)}: {option} is for logs of messages and this is a table; "
                    f"choose columns with {option_of_columns} and --time-col"
                )
