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
from pyarrow import json as arrow_json

from quatprop.base.arrow_arrays import nested_schema, readable
from quatprop.base.errors import UnsupportedLogError
from quatprop.base.text import plain, quoted
from quatprop.readers.tables.exact_times import (
    TimestampRangeError,
    decimal_type,
    refuse_tiny_numbers,
)
from quatprop.readers.tables.text_rows import (
    MISFITS,
    RowMisfitError,
    TextBlock,
    TextRows,
    open_text,
    record_blocks,
    use_threads,
)
from quatprop.readers.tables.typed_table import (
    Leaf,
    TypedTable,
    element_leaves,
    is_number,
    values_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.base.provenance import JsonObject
    from quatprop.readers.tables.model import Group, TableNotes
    from quatprop.readers.tables.table_log import Batches, TimedColumns


# Parse blocks of JSON Lines, and bisect blocks with lines that do not fit.


_MANY_REJECTED = 1000
_TOP_LEVEL_NULL = re.compile(rb"(?:\A|[}\n\r\xbf])\s*null")


class JsonRows(TextRows):
    """One reading of a table of JSON Lines."""

    task_bytes = 1 << 20

    def _schema(self, spare: int) -> pa.Schema:
        fields = {
            leaf.path: kind if leaf.element is None else pa.list_(kind)
            for leaf in self.leaves.values()
            for kind in [pa.string() if pa.types.is_decimal(leaf.type) else leaf.type]
        }
        for k, unit in zip(self.columns.stamp.columns, self.columns.stamp.units, strict=True):
            leaf = self.leaves[k]
            is_date = pa.types.is_timestamp(leaf.type)
            fields[leaf.path] = leaf.type if is_date else decimal_type(unit, spare)
        return nested_schema(fields)

    def parse(self, block: TextBlock, task_bytes: int, spare: int) -> pa.Table:
        """Return all rows of whole lines."""
        text = bytes(block.data)
        try:
            refuse_tiny_numbers(text)
        except TimestampRangeError:
            # In other columns than the time it is harmless.
            for stamp in self._stamps(text):
                refuse_tiny_numbers(stamp.encode())
        # The test for one letter is much faster.
        if b"u" in text and b"null" in text and _TOP_LEVEL_NULL.search(text):
            for line in text.split(b"\n"):
                # A null at top level crashes pyarrow.
                if _TOP_LEVEL_NULL.search(line) and not _is_object(line):
                    raise RowMisfitError
        try:
            return self._parsed(text, task_bytes, spare)
        except pa.ArrowInvalid:
            if self.leaves.keys() <= self.columns.used:
                raise
            every, self.leaves = self.leaves, {k: self.leaves[k] for k in self.columns.used}
            try:
                table = self._parsed(text, task_bytes, spare)
            except pa.ArrowInvalid:
                self.leaves = every
                raise
            # A column of text and of other values holds no labels, nor numbers.
            self.columns = self.columns._replace(watch=None, beside=())
            return table

    def _parsed(self, text: bytes, task_bytes: int, spare: int) -> pa.Table:
        return arrow_json.read_json(
            readable(text),
            read_options=arrow_json.ReadOptions(
                use_threads=use_threads(text, task_bytes), block_size=task_bytes
            ),
            parse_options=arrow_json.ParseOptions(
                explicit_schema=self._schema(spare), unexpected_field_behavior="ignore"
            ),
        )

    def of_own_kind(self, table: pa.Table, block: TextBlock) -> pa.Table:
        """Return the rows of lines with the name of a number to read."""
        leaves = [self.leaves[k] for k in self.columns.numbers]
        if not leaves or not values_of(table, leaves[0]).null_count:
            return table
        lines = [line for line in bytes(block.data).split(b"\n") if line.strip()]
        paths = {leaf.path for leaf in leaves}
        wanted = [[_spellings(name) for name in path] for path in paths]
        is_own = [
            any(all(any(name in line for name in names) for names in path) for path in wanted)
            # Any letter of a name may be escaped, as pandas does with slashes.
            or (b"\\" in line and any(_has_place(line, path) for path in paths))
            for line in lines
        ]
        return table.filter(pa.array(is_own)) if len(lines) == len(table) else table

    def _stamps(self, text: bytes) -> Iterator[str]:
        """Yield the text of the times in whole lines."""
        for line in text.split(b"\n"):
            try:
                row = json.loads(line, parse_int=str, parse_float=str)
            except (ValueError, RecursionError):
                continue
            for k in self.columns.stamp.columns:
                value = row
                for name in self.leaves[k].path:
                    value = value.get(name) if isinstance(value, dict) else None
                if isinstance(value, str):
                    yield value

    def apart(self, block: TextBlock) -> Batches:
        """Yield rows by bisection, and note lines that do not fit."""
        misfits: list[tuple[int, str]] = []
        yield from self._by_halves(bytes(block.data).split(b"\n"), block.line, misfits)
        self.rejected.note(misfits)

    def _by_halves(self, lines: list[bytes], first: int, misfits: list[tuple[int, str]]) -> Batches:
        if not any(map(bytes.strip, lines)):
            return
        try:
            yield self.whole(TextBlock(first, memoryview(b"\n".join(lines)), quoted=True))
        except MISFITS as error:
            if len(lines) > 1:
                middle = len(lines) // 2
                yield from self._by_halves(lines[:middle], first, misfits)
                yield from self._by_halves(lines[middle:], first + middle, misfits)
                return
            misfits.append((first, _reason(error)))
            self.rejected.count += 1
            self.rejected.untimed += not lines[0].lstrip().startswith(b"{")
            # Bisection is slow: a file that is no such table is refused early.
            if len(misfits) > _MANY_REJECTED and 2 * len(misfits) > self.rejected.count:
                self.rejected.note(misfits)
                self.rejected.refuse_if_most()


def _spellings(name: str) -> tuple[bytes, bytes]:
    """Return a name as it may stand in a line."""
    return json.dumps(name).encode(), json.dumps(name, ensure_ascii=False).encode()


def _has_place(line: bytes, path: Sequence[str]) -> bool:
    """Return whether an object has a value, or null, at a path."""
    try:
        reduce(getitem, path, json.loads(line))
    except (ValueError, RecursionError, LookupError, TypeError):
        return False
    return True


def _is_object(line: bytes) -> bool:
    try:
        return isinstance(json.loads(line), dict)
    except (ValueError, RecursionError):
        return False


def _reason(error: Exception) -> str:
    if isinstance(error, RowMisfitError) or "Column() changed" in str(error):
        return "it is not a JSON object"
    if isinstance(error, TimestampRangeError):
        return str(error) or "its time does not fit in int64 ns"
    return re.sub(r"^JSON parse error: | in row \d+$", "", plain(error))


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
            self.damage = text.damage
        lines = head.split(b"\n")
        if len(head) == HEAD_BYTES and len(lines) > 1:
            del lines[-1]
        self._lines = [line for line in lines if line.strip()]
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
        """The columns of dates, which are text in JSON, and of several samples a row."""
        types = {k: leaf.type for k, leaf in enumerate(self._leaves)}
        dates = {k: kind.tz is not None for k, kind in types.items() if pa.types.is_timestamp(kind)}
        packed = tuple(
            name
            for name, leaf in zip(self.names, self._leaves, strict=True)
            if pa.types.is_nested(leaf.type) and self._lines and _holds_rows(self._lines[0], leaf)
        )
        return super().notes._replace(dates=dates, packed=packed)

    def holds_text(self, group: Group) -> bool:
        """Return whether the numbers of some columns are written as text."""
        return any(pa.types.is_decimal(self._leaves[k].type) for k in group)

    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:
        """Return cells of the first rows; see :class:`.TableLog`."""
        return [tuple(_cell(line, self._leaves[k]) for k in columns) for line in self._lines]

    def label_columns(self) -> dict[int, bool]:
        """Return columns that may hold labels; see :class:`.TableLog`."""
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

    def _stored_rows(self, columns: TimedColumns) -> Batches:
        """Yield timestamps and numbers; see :class:`quatprop.readers.tables.table_log.TableLog`."""
        self._refuse_text(columns)
        rows = JsonRows(self, columns, {k: self._leaves[k] for k in columns.read})
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


def _holds_rows(line: bytes, leaf: Leaf) -> bool:
    """Return whether a column has a list of lists or objects in a line."""
    cell = _cell(line, leaf)
    return isinstance(cell, list) and bool(cell) and isinstance(cell[0], list | dict)


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
        kinds = {_type(element) for element in value} - {None}
        kind = kinds.pop() if len(kinds) == 1 else pa.string() if kinds else pa.float64()
        return pa.list_(kind if is_number(kind) else pa.string(), len(value))
    if not isinstance(value, str):
        return _TYPES.get(type(value), pa.string())
    date = _DATE.fullmatch(value)
    if date:
        return pa.timestamp("ns", "UTC" if date["zone"] else None)
    return pa.decimal128(38) if _NUMBER.fullmatch(value) else pa.string()
