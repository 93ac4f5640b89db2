"""Choosing the columns of a table: from the options, the header and the known conventions.

Nothing is guessed: what neither header, convention nor option says is refused, with the option
that settles it.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import NoRatesError, UndeclaredError
from quatprop.tables.base import TableColumns
from quatprop.tables.matching.column_matcher import Chooser, Notes
from quatprop.tables.matching.rate_dialects import (
    AXES,
    DIALECTS,
    GENERIC,
    RATE_UNITS,
    TIME_UNITS,
    Dialect,
    column,
)
from quatprop.text import listed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.selection import RateSelection


def choose(
    path: Path, names: Sequence[str], selection: RateSelection, notes: Notes | None = None
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


class _Chooser(Chooser):
    __slots__ = ()

    selection: RateSelection

    def choose(self) -> TableColumns:
        self.refuse_topics("--rate-cols")
        dialect = self._dialect()
        rate = self._rate(dialect)
        conventional = rate in self._triples(dialect.rate)
        rate_unit = self.unit(
            "rate", rate, RATE_UNITS, dialect.rate_unit if conventional else "", self._named_rates()
        )
        time, sample_rate = self.time(dialect)
        time_unit = self.time_unit(dialect, time)
        self._refuse_undeclared(rate, rate_unit, time, time_unit)
        return TableColumns(
            rate,
            rate_unit,
            time,
            time_unit or "ns",
            sample_rate,
            dialect.name if conventional else "",
            self.notes.rate_scale,
            dialect.method if conventional else None,
            tuple(self._remarks(dialect)),
        )

    def _remarks(self, dialect: Dialect) -> Iterator[str]:
        if self.notes.mount:
            yield (
                "the file says how its sensor sits, and rates are taken as they are; "
                f"to turn them into the camera's axes say --mount {self.notes.mount}"
            )
        if self.selection.sample_rate is None:
            return
        try:
            stamps, _ = replace(self, selection=replace(self.selection, sample_rate=None)).time(
                dialect
            )
        except UndeclaredError:
            return
        if stamps:
            yield (
                f"--sample-rate {self.selection.sample_rate:g} counts the rows; the stamps in "
                f"{self.names(stamps)} are not used"
            )

    # The convention.

    def _dialect(self) -> Dialect:
        keys = self.keys()
        for dialect in DIALECTS:
            if (
                keys.issuperset(dialect.needs)
                and re.search(dialect.file, self.path.name)
                and self._triples(dialect.rate)
                and any(self.matching(pattern) for pattern in dialect.time)
            ):
                return dialect
        return GENERIC

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
            x, y, z = (self.position(name, "--rate-cols") for name in self.selection.rate_cols)
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

    def _refuse_undeclared(
        self, rate: tuple[int, ...], rate_unit: str, time: tuple[int, ...], time_unit: str
    ) -> None:
        unknown, options = [], []
        if not rate_unit:
            unknown.append(f"the unit of the rates {self.names(rate)}")
            options.append(f"--rate-unit {'|'.join(RATE_UNITS)}")
        if not time_unit:
            unknown.append(f"the unit of the time {self.names(time)}")
            options.append(f"--time-unit {'|'.join(TIME_UNITS)}")
        if unknown:
            raise UndeclaredError(self.path, " and ".join(unknown), " and ".join(options))
