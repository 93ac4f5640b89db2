"""Blocks of text to stamps and numbers: as a whole, and piece by piece around damage."""

from __future__ import annotations

import io
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from quatprop.concurrency.threads import thread_count
from quatprop.series.arrow_arrays import readable, to_arrow, to_numpy
from quatprop.tables import timestamps
from quatprop.tables.csv.row_parser import MISFITS, ParsedRows, RowParser, date_type, squeeze_blanks
from quatprop.tables.text_stream import RejectedRows, TextBlock, TextStream, record_blocks

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from quatprop.arrays import Float64, Int64
    from quatprop.tables.base import TimedColumns
    from quatprop.tables.csv.headers import CsvLayout


_LABELS = pa.dictionary(pa.int32(), pa.string())
_TASK_BYTES = 1 << 19  # what one thread of pyarrow parses at a time
_PIECE_BYTES = 1 << 16
_ENOUGH_ROWS = 100_000
"""Rows after which a table is refused, of which most do not fit."""


class BlockReader:
    """One reading of a table, which counts rows from block to block.

    `rejected`: where rows that do not fit are noted
    `layout`: how it is laid out
    `columns`: which columns to read
    `other_rows`: how many rows of other series were passed over
    """

    def __init__(
        self, rejected: RejectedRows, path: Path, layout: CsvLayout, columns: TimedColumns
    ) -> None:
        self._rejected = rejected
        self._layout = layout
        self._columns = columns
        self._row_parser = RowParser(path, layout, columns)
        self.other_rows = 0
        # Stamps finer than ns are tried for once; without stamps there is nothing to try.
        self._spare = 0 if columns.stamp.columns else timestamps.SPARE_PLACES

    def read(self, block: TextBlock) -> tuple[Int64, Float64]:
        """Return stamps, shape ``(N,)``, ns, and numbers, ``(N, k)``, of the rows that fit."""
        try:
            parts = [self._parse(block.data, quoted=block.quoted)]
        except MISFITS:
            parts = list(self._piecewise(block))
        self.other_rows += sum(rows.others for rows in parts)
        stamps = [self._stamps(rows) for rows in parts]
        if len(parts) == 1:
            return stamps[0], parts[0].numbers
        return np.concatenate(stamps), np.concatenate([rows.numbers for rows in parts])

    def _parse(
        self, data: bytes | memoryview, *, quoted: bool, task: int = _TASK_BYTES
    ) -> ParsedRows:
        """Return all rows of whole records, none of which is longer than `task` bytes."""
        line_breaks = quoted and self._row_parser.has_line_breaks_in_cells(data)
        if self._layout.delimiter == " ":
            data = squeeze_blanks(data)
        parse = partial(self._parse_all, data, line_breaks, task)
        rows, self._spare = timestamps.with_spare_places(parse, self._spare, MISFITS)
        return rows

    def _parse_all(
        self, data: bytes | memoryview, line_breaks: bool, task: int, spare: int
    ) -> ParsedRows:
        if self._columns.stamp.columns:
            timestamps.refuse_tiny_numbers(data)
        types = {str(k): pa.float64() for k in self._columns.numbers}
        for k, unit in zip(self._columns.stamp.columns, self._columns.stamp.units, strict=True):
            types[str(k)] = date_type(self._layout, k) or timestamps.decimal_type(unit, spare)
        types |= {str(k): _LABELS for k, _ in self._columns.series}
        read = partial(
            arrow_csv.read_csv,
            readable(data),
            read_options=arrow_csv.ReadOptions(
                column_names=list(map(str, range(len(self._layout.names)))),
                block_size=task,
                use_threads=len(data) > task and thread_count() > 1,
            ),
            parse_options=arrow_csv.ParseOptions(
                delimiter=self._layout.delimiter, newlines_in_values=line_breaks
            ),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types, include_columns=list(types), decimal_point=self._layout.decimal
            ),
        )
        if threading.current_thread() is threading.main_thread():
            table = _other_thread(os.getpid()).submit(read).result()
        else:
            table = read()
        rows = table.num_rows
        if self._columns.series:
            table = table.filter(_own_rows(table, self._columns.series))
        numbers = np.empty((table.num_rows, len(self._columns.numbers)))
        for place, k in enumerate(self._columns.numbers):
            numbers[:, place] = to_numpy(table.column(str(k)))
        others = rows - table.num_rows
        return ParsedRows(self._times(table), numbers, table.num_rows, others=others)

    def _times(self, table: pa.Table) -> Int64 | None:
        if not self._columns.stamp.columns:
            return None
        columns = [table.column(str(k)) for k in self._columns.stamp.columns]
        if any(column.null_count for column in columns):
            raise pa.ArrowInvalid("a row without a time")
        return timestamps.sum_parts(map(timestamps.nanoseconds, columns, self._columns.stamp.units))

    def _piecewise(self, block: TextBlock) -> Iterator[ParsedRows]:
        """Read a block in which something does not fit, piece by piece."""
        text = io.BytesIO(self._layout.without_headers(bytes(block.data)))
        pieces = TextStream(text, may_be_compressed=False)
        rejected: list[tuple[int, str]] = []
        count = 0
        for piece in record_blocks(pieces, block.line, _PIECE_BYTES):
            try:
                rows = self._parse(piece.data, quoted=piece.quoted, task=len(piece.data))
            except MISFITS:
                rows = self._row_parser.parse(bytes(piece.data), piece.line)
                rejected += rows.rejected
            yield rows
            count += rows.total
            if count > _ENOUGH_ROWS and 2 * len(rejected) > self._rejected.count + count:
                break  # it will be refused: nobody waits for the rest
        self._rejected.note(rejected)

    def _stamps(self, rows: ParsedRows) -> Int64:
        t_ns = rows.t_ns
        if t_ns is None:
            t_ns = timestamps.row_stamps(
                self._rejected.count, rows.total, self._columns.stamp.sample_rate or 1.0
            )
            t_ns = t_ns if rows.kept is None else t_ns[rows.kept]
        self._rejected.count += rows.total
        return t_ns


def _own_rows(table: pa.Table, series: Iterable[tuple[int, str]]) -> pa.ChunkedArray:
    """Return which rows are of a series, by the labels that they have in some columns."""
    own = np.ones(table.num_rows, np.bool_)
    for k, label in series:
        chunks = []
        for chunk in table.column(str(k)).chunks:
            texts = [(text or "").strip() for text in chunk.dictionary.to_pylist()]
            wanted = np.array([*(text == label for text in texts), False])
            # No cell at all has the index of the last one.
            chunks.append(wanted[to_numpy(chunk.indices.fill_null(len(texts)))])
        own &= np.concatenate(chunks) if chunks else own
    return to_arrow(own)


@lru_cache(maxsize=1)
def _other_thread(_process: int) -> ThreadPoolExecutor:
    """Return a thread of this process; one that was forked has none of the threads before.

    In the main thread pyarrow would take over the handling of Ctrl-C and SIGTERM while it reads,
    and a process that is told to end at that moment aborts.
    """
    return ThreadPoolExecutor(1)
