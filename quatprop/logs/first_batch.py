"""The first batch of a table: all columns that may be a time, a rate or an orientation.

It is decoded once, and every check of the beginning is held against it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import MessageError, SchemaError
from quatprop.logs.matching import column_beside, find, marks_of
from quatprop.tables.first_rows import FirstRows

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.containers.merge import Columns
    from quatprop.tables.model import Convert, Group, Stamp, Table


def first_rows(table: Table, stamps: Sequence[Stamp] = ()) -> FirstRows:
    """Return the first rows of a table; `stamps` are those that they may have."""
    if table.first is None:
        groups = dict.fromkeys(_candidate_groups(table)) if table.is_typed else ()
        table.first = FirstRows(table, [*stamps], [*groups])
    return table.first


def _candidate_groups(table: Table) -> Iterator[Group]:
    for quantity in ("rate", "quat"):
        try:
            found = find(table, quantity)
        except SchemaError:
            continue
        for one in found:
            beside = column_beside(table, one.part, one.row.span) or marks_of(one)
            yield from filter(None, (one.sets[0], beside))


def first_batches(
    table: Table, stamp: Stamp, groups: Sequence[Group], convert: Convert
) -> Iterator[Columns]:
    """Yield rows as they are read, the first ones first; nothing is noted."""

    def converted(rows: Columns) -> Columns:
        try:
            return convert(rows)
        except MessageError as error:
            if not error.positions:
                raise
            return converted(rows.rows(np.delete(np.arange(len(rows)), error.positions)))

    return table.in_order(map(converted, first_rows(table, [stamp]).read([stamp], groups)))
