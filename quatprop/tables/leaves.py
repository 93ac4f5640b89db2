"""Columns of values: fields of structs and elements of short lists are separate columns."""

from __future__ import annotations

from typing import NamedTuple

import pyarrow as pa

_LONGEST_LIST = 16


class Leaf(NamedTuple):
    """A column of values.

    `path`: name of the column, followed by the fields of a struct
    `element`: index in a list; None if it is not a list
    """

    path: tuple[str, ...]
    type: pa.DataType
    element: int | None = None

    @property
    def column(self) -> str:
        """Name of the column with its fields."""
        return ".".join(self.path)

    @property
    def name(self) -> str:
        """Name for the user."""
        return self.column if self.element is None else f"{self.column}[{self.element}]"


def element_leaves(path: tuple[str, ...], kind: pa.DataType, length: int) -> list[Leaf]:
    """Return a column of lists as one column for each element, if the lists are short."""
    if is_number(kind) and 1 < length <= _LONGEST_LIST:
        return [Leaf(path, kind, index) for index in range(length)]
    return [Leaf(path, pa.list_(kind))]


def values_of(batch: pa.RecordBatch | pa.Table, leaf: Leaf) -> pa.Array | pa.ChunkedArray:
    """Return the values of a column; null if a list is too short."""
    column = batch.column(leaf.path[0])
    if leaf.path[1:] or leaf.element is not None:
        import pyarrow.compute as pc  # slow to import, and not needed for CSV
    if leaf.path[1:]:
        column = pc.struct_field(column, list(leaf.path[1:]))
    if leaf.element is not None:
        is_short = pc.less_equal(pc.list_value_length(column), leaf.element)
        column = pc.list_element(pc.if_else(is_short, None, column), leaf.element)
    return column.dictionary_decode() if pa.types.is_dictionary(column.type) else column


def is_number(kind: pa.DataType) -> bool:
    """Return whether values are numbers."""
    return bool(
        pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal128(kind)
    )


def is_text(kind: pa.DataType) -> bool:
    """Return whether values are text."""
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def is_whole(kind: pa.DataType) -> bool:
    """Return whether values are integers."""
    return bool(pa.types.is_integer(kind) or (pa.types.is_decimal128(kind) and kind.scale == 0))
