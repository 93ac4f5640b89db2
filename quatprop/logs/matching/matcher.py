"""Match the columns of a table: sets of columns, columns named by the user, and units.

Nothing is guessed: what neither the header, a convention nor the user declares is refused, and the
error names the setting that declares it.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from quatprop.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.logs.matching.find import Found, matching, sets_of
from quatprop.logs.vocabulary import sources
from quatprop.logs.vocabulary.rows import PARTS
from quatprop.logs.vocabulary.sources import GENERIC
from quatprop.settings.quantities import SCALED_RATE_UNITS
from quatprop.tables.column_names import as_option, parse_name
from quatprop.text import Remark, Setting, did_you_mean, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from quatprop.logs.vocabulary.rows import Row
    from quatprop.settings.selection import SignalSelection
    from quatprop.tables.model import Group

FIRST_ROWS = 1000
"""Number of rows over which clocks are compared."""


class ColumnMatcher:
    """Finds the columns of one quantity in a table.

    `setting`: the setting for these columns, such as ``"rate_cols"``
    `remarks`: remarks on the choice
    `unknown`: undeclared facts and the settings that declare them, which are refused together
    """

    def __init__(self, found: Found, selection: SignalSelection, setting: str) -> None:
        self.table = found.table
        self.part = found.part
        self.path = found.table.path
        self.notes = found.table.notes
        self.columns = found.table.columns
        self.selection = selection
        self.setting = setting
        self.remarks: list[Remark] = []
        self.unknown: list[tuple[str, str]] = []

    def matching(self, pattern: str) -> list[int]:
        """Return the columns whose names match a pattern."""
        return [k for k, _ in matching(self.table, self.part, pattern)]

    def seen(self) -> list[str]:
        """Return the names of columns for an error, with the first cells if names are numbers."""
        names = [column.text for column in self.columns]
        if names == [*map(str, range(len(names)))] and (rows := self.table.head(range(len(names)))):
            return [f"{k}: {cell}" for k, cell in enumerate(rows[0])]
        return names

    def has(self, name: str) -> bool:
        """Return whether a column has this exact name."""
        return any(column.text.strip() == name for column in self.columns)

    def position(self, name: str, setting: str) -> int:
        """Return the index of a column, by its exact name, key or number from 0."""
        name, key = name.strip(), parse_name(name).key
        texts = [column.text.strip() for column in self.columns]
        positions = [k for k, text in enumerate(texts) if text == name] or [
            k
            for k, column in enumerate(self.columns)
            if column.key == key or texts[k].lower() == name.lower()
        ]
        if len(positions) > 1:
            raise UsageError(
                f"{plain(self.path)}: {len(positions)} columns are called {quoted(name)}; "
                f"choose one by its number from 0: {Setting(setting)} takes {positions[0]}, "
                f"{positions[1]}..."
            )
        if positions:
            return positions[0]
        if name.isdecimal() and int(name) < len(self.columns):
            return int(name)
        names = [column.text for column in self.columns]
        raise UsageError(
            f"{plain(self.path)}: {Setting(setting)} asks for column {quoted(name)}; the "
            f"columns are {listed(names)}{did_you_mean(name, names)}"
        )

    def first_rows(self, columns: Sequence[int]) -> list[tuple[object, ...]]:
        """Return the cells of the rows over which clocks are compared."""
        return self.table.head(columns)[:FIRST_ROWS]

    def as_option(self, k: int) -> str:
        """Return the name of a column for an option."""
        return as_option([column.text for column in self.columns], k)

    def spelled(self, positions: Collection[int]) -> str:
        """Return the names of columns for a setting."""
        return ",".join(self.columns[k].text for k in positions)

    def names(self, positions: Collection[int]) -> str:
        """Return the names of columns, quoted."""
        return listed(self.columns[k].text.strip() for k in positions)

    def unit(
        self, quantity: str, positions: Group, units: Collection[str], convention: str = ""
    ) -> str:
        """Return the unit of columns, from the user, the header or a convention.

        `quantity`: ``"rate"`` or ``"time"``
        `convention`: the unit by convention; ``""``: none
        """
        chosen: str | None = getattr(self.selection, f"{quantity}_unit")
        stated = {k: self.declared((k,)) or convention for k in positions}
        found = [unit for unit in dict.fromkeys(stated.values()) if unit in units]
        facts = []
        for unit in found:
            these = [k for k in positions if stated[k] == unit]
            facts.append(f"{self.names(these)} {'is' if len(these) == 1 else 'are'} in {unit}")
        source = "definition" if self.table.is_typed else "header or convention"
        by_header = f"by {source} {' and '.join(facts)}"
        if chosen is not None:
            # The user's unit takes precedence over the header.
            if {*found} - {chosen}:
                given = f"{Setting(f'{quantity}_unit')} says {chosen}"
                text = f"{given}, but {by_header}; read in {chosen}, as requested"
                self.remark("unit-overruled", text)
            return chosen
        if facts[1:]:
            raise UsageError(f"{plain(self.path)}: {by_header}; convert them to one unit")
        declared = self.declared(positions) or convention
        self.refuse_unknown(positions, declared, units)
        if not declared:
            what = f"{'rates' if quantity == 'rate' else quantity} {self.names(positions)}"
            setting = Setting(f"{quantity}_unit", "|".join(_choices(units)))
            self.unknown.append((f"the unit of the {what}", setting))
        return declared

    def declared(self, positions: Group) -> str:
        """Return the unit that the header declares for columns; ``""``: none, or several."""
        units = {self.notes.units.get(k, self.columns[k].unit) for k in positions}
        return units.pop() if len(units) == 1 else ""

    def refuse_undeclared(self) -> None:
        """Raise an error for all undeclared facts."""
        if self.unknown:
            unknown, ways = (
                " and ".join(f"{part}" for part in parts)
                for parts in zip(*self.unknown, strict=True)
            )
            raise UndeclaredError(self.path, unknown, ways, several=len(self.unknown) > 1)

    def refuse_unknown(self, positions: Group, unit: str, units: Collection[str]) -> None:
        """Refuse a declared unit that is not supported."""
        if unit and unit not in units:
            raise UnsupportedLogError(
                self.path,
                f"{self.names(positions)} are declared in {quoted(unit)}; "
                f"convert them to {' or '.join(_choices(units))}",
            )

    def remark(self, code: str, text: str) -> None:
        """Add a remark on the choice."""
        self.remarks.append(Remark(code, text))

    # Sets of columns.

    def found(self, row: Row, sets: tuple[Group, ...]) -> Found:
        """Return a quantity found by the names of columns."""
        return Found(self.table, row, self.part, sets)

    def sets(self, components: Sequence[str], *patterns: str) -> list[Group]:
        """Return each complete set of columns whose names differ only in the component."""
        every = (sets_of(self.table, self.part, components, pattern) for pattern in patterns)
        return [one for sets in every for one in sets]

    def row(self, quantity: str) -> Row:
        """Return the row of the vocabulary for a table with columns of a quantity."""
        # Only rostopic needs its comment mark; others are decoration, so names also count without.
        names = {column.key for column in self.columns}
        names |= {column.text.strip("\ufeff ").lower() for column in self.columns}
        names.add(self.notes.title.lower())
        for row in sources.ROWS:
            if (
                row.name
                and names.issuperset(row.needs)
                and re.search(row.file, self.path.name)
                and self.sets(PARTS[quantity], getattr(row, quantity))
                and (not row.stamps or any(map(self.matching, row.stamps)))
            ):
                return row
        return GENERIC

    def only_set(self, sets: Sequence[Group], quantity: str, component: str) -> Group:
        """Return the only set; refuse several."""
        if len(sets) > 1:
            names = [self.columns[positions[0]].text for positions in sets]
            if len(set(names)) < len(names):
                numbers = ", ".join("-".join(map(str, positions)) for positions in sets)
                reason = f"several columns have the same name; by numbers from 0: {numbers}"
            else:
                reason = f"their {component} columns are {listed(names)}"
            way = "a table that holds one of them"
            if self.setting != "bias":
                way = Setting(self.setting, "A,B,C,D" if sets[0][3:] else "X,Y,Z")
            raise UndeclaredError(self.path, f"which {quantity} to use ({reason})", way)
        return sets[0]

    # Columns that the user names.

    def named(self, names: Sequence[str]) -> Group:
        """Return the columns that the user names."""
        positions = tuple(self.position(name, self.setting) for name in names)
        if len(set(positions)) != len(positions):
            raise UsageError(f"{plain(self.path)}: {Setting(self.setting)} names a column twice")
        return positions


def _choices(units: Collection[str]) -> list[str]:
    """Return the units that a user may name."""
    return [unit for unit in units if unit not in SCALED_RATE_UNITS]
