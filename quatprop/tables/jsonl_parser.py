"""Parse blocks of JSON Lines, and bisect blocks with lines that do not fit."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

import pyarrow as pa
from pyarrow import json as arrow_json

from quatprop.series.arrow_arrays import nested_schema, readable
from quatprop.tables import timestamps
from quatprop.tables.text_rows import MISFITS, RowMisfitError, TextRows, use_threads
from quatprop.tables.text_stream import TextBlock
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.tables.base import Batches

_MANY_REJECTED = 1000
_TOP_LEVEL_NULL = re.compile(rb"(?:\A|[}\n\r\xbf])\s*null")


class JsonRows(TextRows):
    """One reading of a table of JSON Lines."""

    task_bytes = 1 << 20

    def _schema(self, spare: int) -> pa.Schema:
        fields = {
            leaf.path: leaf.type if leaf.element is None else pa.list_(leaf.type)
            for leaf in self.leaves.values()
        }
        for k, unit in zip(self.columns.stamp.columns, self.columns.stamp.units, strict=True):
            leaf = self.leaves[k]
            is_date = pa.types.is_timestamp(leaf.type)
            fields[leaf.path] = leaf.type if is_date else timestamps.decimal_type(unit, spare)
        return nested_schema(fields)

    def parse(self, block: TextBlock, task_bytes: int, spare: int) -> pa.Table:
        """Return all rows of whole lines."""
        text = bytes(block.data)
        try:
            timestamps.refuse_tiny_numbers(text)
        except timestamps.TimestampRangeError:
            # In other columns than the time it is harmless.
            for stamp in self._stamps(text):
                timestamps.refuse_tiny_numbers(stamp.encode())
        # The test for one letter is much faster.
        if b"u" in text and b"null" in text and _TOP_LEVEL_NULL.search(text):
            for line in text.split(b"\n"):
                # A null at top level crashes pyarrow.
                if _TOP_LEVEL_NULL.search(line) and not _is_object(line):
                    raise RowMisfitError
        return arrow_json.read_json(
            readable(text),
            read_options=arrow_json.ReadOptions(
                use_threads=use_threads(text, task_bytes), block_size=task_bytes
            ),
            parse_options=arrow_json.ParseOptions(
                explicit_schema=self._schema(spare), unexpected_field_behavior="ignore"
            ),
        )

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
            # Bisection is slow: a file that is no such table is refused early.
            if len(misfits) > _MANY_REJECTED and 2 * len(misfits) > self.rejected.count:
                self.rejected.note(misfits)
                self.rejected.refuse_if_most()


def _is_object(line: bytes) -> bool:
    try:
        return isinstance(json.loads(line), dict)
    except (ValueError, RecursionError):
        return False


def _reason(error: Exception) -> str:
    if isinstance(error, RowMisfitError) or "Column() changed" in str(error):
        return "it is not a JSON object"
    if isinstance(error, timestamps.TimestampRangeError):
        return str(error) or "its time does not fit in int64 ns"
    return re.sub(r"^JSON parse error: | in row \d+$", "", plain(error))
