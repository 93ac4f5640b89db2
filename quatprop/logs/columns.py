"""The columns of a table by name, by number and by pattern, and the units that are declared."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING

from quatprop.errors import UnsupportedLogError, UsageError
from quatprop.logs.matching import matching
from quatprop.settings.quantities import SCALED_RATE_UNITS
from quatprop.tables.column_names import TIME_UNITS, parse_name, whole_key
from quatprop.tables.timestamps import from_text
from quatprop.text import Setting, did_you_mean, listed, plain, quoted
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Collection

    from quatprop.settings.selection import SignalSelection
    from quatprop.tables.model import Table

    Positions = tuple[int, ...]


class TableColumns:
    """The columns of a table, and what is declared about them.

    `selection`: what the user chose
    """

    def __init__(self, table: Table, selection: SignalSelection) -> None:
        self.table = table
        self.path = table.path
        self.notes = table.notes
        self.head = table.head
        self.may_choose_series = True
        self.columns = table.columns
        self.selection = selection
        self.unknown: list[tuple[str, str]] = []
        self.overruled: list[str] = []

    def matching(self, pattern: str) -> list[int]:
        """Return the columns whose names match a pattern."""
        return [k for k, _ in matching(self.table, self.table.parts[0], pattern)]

    def position(self, name: str, setting: str) -> int:
        """Return the column of a name: as spelled, by key, or by number from 0."""
        name, key = name.strip(), parse_name(name).key
        positions = [k for k, column in enumerate(self.columns) if column.text.strip() == name]
        positions = positions or [
            k
            for k, column in enumerate(self.columns)
            if column.key == key or column.text.strip().lower() == name.lower()
        ]
        if len(positions) > 1:
            raise UsageError(
                f"{plain(self.path)}: {len(positions)} columns are called {quoted(name)}; "
                f"say which with its number from 0, {Setting(setting)} taking {positions[0]}, "
                f"{positions[1]}..."
            )
        if not positions and name.isdecimal() and int(name) < len(self.columns):
            return int(name)
        if not positions:
            names = [column.text for column in self.columns]
            raise UsageError(
                f"{plain(self.path)}: {Setting(setting)} asks for column {quoted(name)}; the "
                f"columns are {listed(names)}{did_you_mean(name, names)}"
            )
        return positions[0]

    def spelled(self, positions: Collection[int]) -> str:
        """Return the names of columns as settings take them."""
        return ",".join(self.columns[k].text for k in positions)

    def names(self, positions: Collection[int]) -> str:
        """Return the names of columns, quoted."""
        return listed(self.columns[k].text.strip() for k in positions)

    def unit(
        self, quantity: str, positions: Positions, units: Collection[str], convention: str = ""
    ) -> str:
        """Return the unit of columns from user, header or convention.

        `quantity`: ``"rate"`` or ``"time"``
        `units`: the units that there are
        `convention`: the unit by convention, ``""`` where there is none
        """
        chosen: str | None = getattr(self.selection, f"{quantity}_unit")
        stated = {k: self.declared((k,)) or convention for k in positions}
        found = [unit for unit in dict.fromkeys(stated.values()) if unit in units]
        facts = []
        for unit in found:
            these = [k for k in positions if stated[k] == unit]
            facts.append(f"{self.names(these)} {'is' if len(these) == 1 else 'are'} in {unit}")
        by_header = f"by header or convention {' and '.join(facts)}"
        if chosen is not None:
            # Who gives a unit knows better than the header.
            if {*found} - {chosen}:
                given = f"{Setting(f'{quantity}_unit')} says {chosen}"
                self.overruled.append(f"{given}, but {by_header}; read in {chosen}, as asked for")
            return chosen
        if facts[1:]:
            raise UsageError(f"{plain(self.path)}: {by_header}; convert them to one unit")
        declared = self.declared(positions) or convention
        self.refuse_unknown(positions, declared, units)
        if not declared:
            what = f"{'rates' if quantity == 'rate' else quantity} {self.names(positions)}"
            self.undeclared(
                f"the unit of the {what}", Setting(f"{quantity}_unit", "|".join(_choices(units)))
            )
        return declared

    def declared(self, positions: Positions) -> str:
        """Return the unit that the header declares of columns; ``""`` where it does not."""
        units = {self.notes.units.get(k, self.columns[k].unit) for k in positions}
        return units.pop() if len(units) == 1 else ""

    def are_two_clocks(self, seconds: int, part: int) -> bool:
        """Return whether one is a whole stamp by itself: seconds with decimals, or parts for 1 s.

        In odd messages of ROS the nanoseconds go on a little beyond a second.
        """
        unit = self.fraction_unit(part)
        limit = (2 if unit == "ns" else 1) * NS_PER_S
        for cells in self.head((seconds, part)):
            with suppress(ValueError):
                whole, fraction = from_text(f"{cells[0]}", "s"), from_text(f"{cells[1]}", unit)
                if whole % NS_PER_S or fraction >= limit:
                    return True
        return False

    def fraction_unit(self, k: int) -> str:
        """Return the unit of the second column of a stamp; ns, as in ROS, if nothing says it."""
        word = re.split(r"[._]", whole_key(self.columns[k].text))[-1]
        declared = self.declared((k,))
        units = (u for u, names in TIME_UNITS.items() if u == declared or word in names)
        return next(units, "ns")

    def refuse_unknown(self, positions: Positions, unit: str, units: Collection[str]) -> None:
        """Refuse a declared unit that is not one of those that are read."""
        if unit and unit not in units:
            raise UnsupportedLogError(
                self.path,
                f"{self.names(positions)} are declared in {quoted(unit)}; "
                f"convert them to {' or '.join(_choices(units))}",
            )

    def undeclared(self, what: str, setting: str) -> None:
        """Note what is not declared; all of it is refused together, in :meth:`timed_and_named`."""
        self.unknown.append((what, setting))


def _choices(units: Collection[str]) -> list[str]:
    """Return the units that a user may name."""
    return [unit for unit in units if unit not in SCALED_RATE_UNITS]
