"""Lines of JSON to columns: whole blocks at once, and by halves around a line that does not fit."""

from __future__ import annotations

import json
import re
from functools import partial
from typing import TYPE_CHECKING

import pyarrow as pa
from pyarrow import json as arrow_json

from quatprop.concurrency.threads import thread_count
from quatprop.series.arrow_arrays import nested_schema, readable
from quatprop.tables import timestamps
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.tables.text_stream import RejectedRows
    from quatprop.tables.typed_table import Leaf

_TASK_BYTES = 1 << 20  # what one thread of pyarrow parses at a time


class _NotAnObjectError(ValueError):
    """A row that pyarrow must not parse: a null at top level ends the process."""


_MISFITS = (
    *(pa.ArrowInvalid, pa.ArrowNotImplementedError, UnicodeDecodeError),
    *(timestamps.TimestampRangeError, _NotAnObjectError),
)
_MANY_REJECTED = 1000
_TOP_LEVEL_NULL = re.compile(rb"(?:\A|[}\n\r\xbf])\s*null")


class LineParser:
    """Parses lines of one table.

    `rejected`: where rows that do not fit are noted
    `numbers`: columns of numbers
    `time`: the columns of the time and their units
    """

    def __init__(
        self, rejected: RejectedRows, numbers: Sequence[Leaf], time: Sequence[tuple[Leaf, str]]
    ) -> None:
        self._rejected = rejected
        self._numbers = numbers
        self._time = time
        # Stamps finer than ns are tried for once; without stamps there is nothing to try.
        self._spare = 0 if time else timestamps.SPARE_PLACES

    def _schema(self, spare: int) -> pa.Schema:
        fields = {
            leaf.path: leaf.type if leaf.element is None else pa.list_(leaf.type)
            for leaf in self._numbers
        }
        for leaf, unit in self._time:
            is_date = pa.types.is_timestamp(leaf.type)
            fields[leaf.path] = leaf.type if is_date else timestamps.decimal_type(unit, spare)
        return nested_schema(fields)

    def parse(self, data: bytes | memoryview, line: int) -> Iterator[pa.RecordBatch | int]:
        """Yield the rows of a block that begins with a line; for rejected rows, how many."""
        try:
            yield from self._whole(data)
        except _MISFITS:
            misfits: list[tuple[int, str]] = []
            yield from self._by_halves(bytes(data).split(b"\n"), line, misfits)
            self._rejected.note(misfits)
        self._rejected.refuse_if_most()

    def _whole(self, data: bytes | memoryview) -> list[pa.RecordBatch]:
        parse = partial(self._batches, data)
        batches, self._spare = timestamps.with_spare_places(parse, self._spare, _MISFITS)
        return batches

    def _batches(self, data: bytes | memoryview, spare: int) -> list[pa.RecordBatch]:
        try:
            timestamps.refuse_tiny_numbers(data)
        except timestamps.TimestampRangeError:
            # It may be in another column, where it does no harm.
            for stamp in self._stamps(data):
                timestamps.refuse_tiny_numbers(stamp.encode())
        text = bytes(data)
        if b"null" in text and _TOP_LEVEL_NULL.search(text):
            for line in text.split(b"\n"):
                if _TOP_LEVEL_NULL.search(line) and not _is_object(line):
                    raise _NotAnObjectError
        table = arrow_json.read_json(
            readable(data),
            read_options=arrow_json.ReadOptions(
                use_threads=len(data) > _TASK_BYTES and thread_count() > 1, block_size=_TASK_BYTES
            ),
            parse_options=arrow_json.ParseOptions(
                explicit_schema=self._schema(spare), unexpected_field_behavior="ignore"
            ),
        )
        self._rejected.count += table.num_rows
        batches: list[pa.RecordBatch] = table.combine_chunks().to_batches()
        return batches

    def _stamps(self, data: bytes | memoryview) -> Iterator[str]:
        """Yield the times of whole lines as they are written."""
        for line in bytes(data).split(b"\n"):
            try:
                row = json.loads(line, parse_int=str, parse_float=str)
            except (ValueError, RecursionError):
                continue
            for leaf, _ in self._time:
                value = row
                for name in leaf.path:
                    value = value.get(name) if isinstance(value, dict) else None
                if isinstance(value, str):
                    yield value

    def _by_halves(
        self, lines: list[bytes], first: int, misfits: list[tuple[int, str]]
    ) -> Iterator[pa.RecordBatch | int]:
        if not any(map(bytes.strip, lines)):
            return
        try:
            yield from self._whole(b"\n".join(lines))
        except _MISFITS as error:
            if len(lines) > 1:
                middle = len(lines) // 2
                yield from self._by_halves(lines[:middle], first, misfits)
                yield from self._by_halves(lines[middle:], first + middle, misfits)
                return
            misfits.append((first, _reason(error)))
            self._rejected.count += 1
            # Line by line is slow: what is no such table must not take forever.
            if len(misfits) > _MANY_REJECTED and 2 * len(misfits) > self._rejected.count:
                self._rejected.note(misfits)
                self._rejected.refuse_if_most()
            yield 1


def _is_object(line: bytes) -> bool:
    try:
        return isinstance(json.loads(line), dict)
    except (ValueError, RecursionError):
        return False


def _reason(error: Exception) -> str:
    if isinstance(error, _NotAnObjectError) or "Column() changed" in str(error):
        return "it is not a JSON object"
    if isinstance(error, timestamps.TimestampRangeError):
        return "its time is a number below 1e-39"
    if isinstance(error, UnicodeDecodeError):
        return "it is not UTF-8"
    return re.sub(r"^JSON parse error: | in row \d+$", "", plain(error))
