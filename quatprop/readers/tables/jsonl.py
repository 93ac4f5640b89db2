"""JSON Lines: one object per row, with fields of nested objects as ``column.field``.

Blocks are parsed by pyarrow. Times are read as decimals, never as floats, and may be quoted, as
64-bit integers often are in JSON.
"""

from __future__ import annotations

import json
import re
from contextlib import closing, suppress
from functools import reduce
from operator import getitem
from typing import TYPE_CHECKING

import pyarrow as pa

from quatprop.errors import UnsupportedLogError
from quatprop.tables.jsonl_parser import JsonRows
from quatprop.tables.leaves import Leaf, element_leaves
from quatprop.tables.text_stream import open_text, record_blocks
from quatprop.tables.typed_table import TypedTable
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from quatprop.provenance import JsonObject
    from quatprop.tables.base import Batches, TimedColumns
    from quatprop.tables.model import TableNotes

HEAD_BYTES = 1 << 16
"""Bytes of the file that are searched for columns."""

_HEAD_LINES = 100
_DATE = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d+)?)?(?P<zone>Z|[+-]\d\d:?\d\d)?")
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*")
_ROWS_IN_A_LIST = re.compile(rb"(?:\xef\xbb\xbf)?\s*\{\s*\"(\w{1,60})\"\s*:\s*\[\s*\{")
_TYPES: dict[type, pa.DataType] = {bool: pa.bool_(), float: pa.float64()}


class JsonLinesLog(TypedTable):
    """A file of JSON Lines."""

    kind = "jsonl"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with closing(open_text(path)) as text:
            self._size, head = text.size, text.read(HEAD_BYTES)
        lines = head.split(b"\n")
        if len(head) == HEAD_BYTES and len(lines) > 1:
            del lines[-1]
        self._lines = lines
        self._leaves = _leaves(lines[:_HEAD_LINES])
        rows = _ROWS_IN_A_LIST.match(head)
        if rows and all(pa.types.is_list(leaf.type) for leaf in self._leaves):
            name = rows[1].decode()
            raise UnsupportedLogError(
                path,
                f"it is one JSON object with its rows in the list {quoted(name)}; write one row "
                f"per line, for example with jq -c '.{name}[]'",
            )
        if not self._leaves:
            raise UnsupportedLogError(
                path, "its first lines are not JSON objects; write each row as one, on one line"
            )

    @property
    def notes(self) -> TableNotes:
        """The columns of dates, which are text in JSON."""
        types = {k: leaf.type for k, leaf in enumerate(self._leaves)}
        dates = {k: kind.tz is not None for k, kind in types.items() if pa.types.is_timestamp(kind)}
        return super().notes._replace(dates=dates)

    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:
        """Return cells of the first rows; see :class:`quatprop.tables.base.TableLog`."""
        return [tuple(_cell(line, self._leaves[k]) for k in columns) for line in self._lines]

    def label_columns(self) -> dict[int, bool]:
        """Return columns that may hold labels; see :class:`quatprop.tables.base.TableLog`."""
        cells = [_cell(self._lines[0], leaf) for leaf in self._leaves]
        return {
            k: isinstance(cell, str) and cell.isdecimal()
            for k, cell in enumerate(cells)
            if isinstance(cell, str | None) and not pa.types.is_timestamp(self._leaves[k].type)
        }

    def _refuse_text(self, columns: TimedColumns) -> None:
        super()._refuse_text(columns)
        if any(self._leaves[k].element is not None for k in columns.stamp.columns):
            raise UnsupportedLogError(
                self.path, "a time in a list is not read; name another column"
            )
        for leaf in (self._leaves[k] for k in columns.numbers):
            if leaf.type != pa.float64():
                raise UnsupportedLogError(
                    self.path,
                    f"column {quoted(leaf.name)} holds text, not numbers; convert it to numbers",
                )

    def _stored_rows(self, columns: TimedColumns) -> Batches:
        """Yield timestamps and numbers; see :class:`quatprop.tables.base.TableLog`."""
        self._refuse_text(columns)
        rows = JsonRows(self, columns, {k: self._leaves[k] for k in columns.used})
        with closing(open_text(self.path, self._size)) as text:
            yield from rows.batches(record_blocks(text, 1))
            if text.damage:
                self.losses.note("end of the file", text.damage)


def _leaves(lines: list[bytes]) -> list[Leaf]:
    """Return the columns of objects, in order of appearance."""
    types: dict[tuple[str, ...], pa.DataType | None] = {}
    for line in lines:
        try:
            # Only names and types are needed, and integers may have any length.
            row = json.loads(line, parse_int=float)
            if isinstance(row, dict):
                _add_fields(row, (), types)
        except (ValueError, RecursionError):
            continue
    # A name that is both a value and an object in different rows is read as the object.
    inner = {path[:depth] for path in types for depth in range(1, len(path))}
    return [
        leaf
        for path, kind in types.items()
        if path not in inner
        for leaf in (
            element_leaves(path, kind.value_type, kind.list_size)
            if kind and pa.types.is_fixed_size_list(kind)
            else [Leaf(path, kind or pa.float64())]
        )
    ]


def _cell(line: bytes, leaf: Leaf) -> object:
    """Return the value of a column in a line, or None."""
    place = leaf.path if leaf.element is None else (*leaf.path, leaf.element)
    with suppress(ValueError, RecursionError, LookupError, TypeError):
        cell: object = reduce(getitem, place, json.loads(line, parse_int=str))
        return cell
    return None


def _add_fields(
    row: JsonObject, above: tuple[str, ...], types: dict[tuple[str, ...], pa.DataType | None]
) -> None:
    for name, value in row.items():
        path = (*above, name)
        if isinstance(value, dict):
            _add_fields(value, path, types)
        else:
            # A null in one row may be a number in the next.
            types[path] = types.get(path) or _type(value)


def _type(value: object) -> pa.DataType | None:
    """Return the type of a value; None for null."""
    if value is None:
        return None
    if isinstance(value, list):
        numbers = all(isinstance(element, float) or element is None for element in value)
        return pa.list_(pa.float64() if numbers else pa.string(), len(value))
    if not isinstance(value, str):
        return _TYPES[type(value)]
    date = _DATE.fullmatch(value)
    if date:
        return pa.timestamp("ns", "UTC" if date["zone"] else None)
    return pa.decimal128(38) if _NUMBER.fullmatch(value) else pa.string()
