"""Matching the columns of a table: sets of them, the time, and what the user named.

Nothing is guessed: what neither header, convention nor user declares is refused, with the setting
that settles it.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from quatprop.errors import UndeclaredError, UsageError
from quatprop.logs import vocabulary
from quatprop.logs.matching import sets_of
from quatprop.logs.time_columns import TimeMatcher
from quatprop.logs.vocabulary import GENERIC
from quatprop.text import Setting, listed, plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.logs.rows import Row
    from quatprop.settings.selection import SignalSelection
    from quatprop.tables.model import Table

    Positions = tuple[int, ...]


class ColumnMatcher(TimeMatcher):
    """Finds the columns of one quantity in a table.

    `selection`: what the user chose
    `setting`: the setting that names the columns of the quantity, such as ``"rate_cols"``
    `parts`: for each component, how patterns spell it, with ``|`` between spellings
    """

    def __init__(
        self, table: Table, selection: SignalSelection, setting: str, parts: Sequence[str]
    ) -> None:
        super().__init__(table, selection, setting)
        self._components = parts
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
        (part,) = self.table.parts
        every = (sets_of(self.table, part, self._components, pattern) for pattern in patterns)
        return [one for sets in every for one in sets]

    def row(self, quantity: str) -> Row:
        """Return the row of the vocabulary for a table with columns of a quantity."""
        # rostopic marks its first column; everyone else's mark is decoration.
        names = {column.key for column in self.columns}
        names |= {column.text.strip("\ufeff ").lower() for column in self.columns}
        names.add(self.notes.title.lower())
        for row in vocabulary.ROWS:
            if (
                row.name
                and names.issuperset(row.needs)
                and re.search(row.file, self.path.name)
                and self.sets(getattr(row, quantity))
                and (not row.stamps or any(map(self.matching, row.stamps)))
            ):
                return row
        return GENERIC

    def only_set(self, sets: Sequence[Positions], quantity: str, component: str) -> Positions:
        """Return the only set; refuse several."""
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
                Setting(self.setting, "A,B,C,D" if len(self._components) > 3 else "X,Y,Z"),  # noqa: PLR2004
            )
        return sets[0]

    # Columns that the user names.

    def named(self, names: Sequence[str]) -> Positions:
        """Return the columns that the user names."""
        positions = tuple(self.position(name, self.setting) for name in names)
        if len(set(positions)) != len(positions):
            raise UsageError(f"{plain(self.path)}: {Setting(self.setting)} names a column twice")
        return positions
