"""Matching the columns of a table: sets of them, the time, and what the user named.

Nothing is guessed: what neither header, convention nor user declares is refused, with the setting
that settles it.
"""

from __future__ import annotations

import re
from itertools import product
from typing import TYPE_CHECKING

from quatprop.errors import UndeclaredError, UsageError
from quatprop.tables.matching.dialects import DIALECTS, GENERIC, Dialect
from quatprop.tables.matching.time_columns import TimeMatcher
from quatprop.text import Setting, listed, plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.selection import SignalSelection
    from quatprop.tables.base import TableLog

    Positions = tuple[int, ...]


class ColumnMatcher(TimeMatcher):
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
        super().__init__(log, selection, setting)
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
                and (not dialect.time or any(map(self.matching, dialect.time)))
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
