"""Parse blocks of text: as a whole, or piece by piece if rows do not fit."""

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

from quatprop.series.arrow_arrays import readable
from quatprop.tables import timestamps
from quatprop.tables.csv.row_parser import RowParser, date_type, squeeze_blanks
from quatprop.tables.leaves import Leaf
from quatprop.tables.text_rows import MISFITS, RowMisfitError, TextRows, use_threads
from quatprop.tables.text_stream import TextBlock, TextStream, record_blocks

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.tables.base import Batches, TableLog, TimedColumns
    from quatprop.tables.csv.headers import CsvLayout


_PIECE_BYTES = 1 << 16
_ENOUGH_ROWS = 100_000
"""Number of rows after which a table is refused if most rows do not fit."""


class CsvRows(TextRows):
    """One reading of a CSV table."""

    task_bytes = 1 << 19

    def __init__(self, log: TableLog, layout: CsvLayout, columns: TimedColumns) -> None:
        leaves = {k: Leaf((str(k),), pa.float64()) for k in columns.used}
        super().__init__(log, columns, leaves)
        self._layout = layout
        self._row_parser = RowParser(log.path, layout, columns)

    def parse(self, block: TextBlock, task_bytes: int, spare: int) -> pa.Table:
        """Return all rows of a block; no record is longer than a task."""
        data: bytes | memoryview = block.data
        line_breaks = block.quoted and self._row_parser.has_line_breaks_in_cells(data)
        if self._layout.delimiter == " ":
            data = squeeze_blanks(data)
        if self.columns.stamp.columns:
            timestamps.refuse_tiny_numbers(data)
        times = list(map(str, self.columns.stamp.columns))
        types = {str(k): pa.float64() for k in self.columns.numbers}
        for k, unit in zip(self.columns.stamp.columns, self.columns.stamp.units, strict=True):
            types[str(k)] = date_type(self._layout, k) or timestamps.decimal_type(unit, spare)
        types |= {str(k): pa.string() for k, _ in self.columns.stamp.series}
        read = partial(
            arrow_csv.read_csv,
            readable(data),
            read_options=arrow_csv.ReadOptions(
                column_names=list(map(str, range(len(self._layout.names)))),
                block_size=task_bytes,
                use_threads=use_threads(data, task_bytes),
            ),
            parse_options=arrow_csv.ParseOptions(
                delimiter=self._layout.delimiter, newlines_in_values=line_breaks
            ),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types, include_columns=list(types), decimal_point=self._layout.decimal
            ),
        )
        if threading.current_thread() is threading.main_thread():
            pool = _other_thread(os.getpid())
            try:
                reading = pool.submit(read)
            except BaseException:
                # Interrupted at its start, the thread is unknown to its pool, and would never end.
                pool.shutdown(wait=False)
                _other_thread.cache_clear()
                raise
            table = reading.result()
        else:
            table = read()
        if any(table.column(name).null_count for name in times):
            raise RowMisfitError("a row without a time")
        return table

    def apart(self, block: TextBlock) -> Batches:
        """Yield rows piece by piece; pieces with a misfit are read row by row."""
        text = io.BytesIO(self._layout.without_headers(bytes(block.data)))
        pieces = TextStream(text, may_be_compressed=False)
        rejected: list[tuple[int, str]] = []
        first = self.rejected.count
        for piece in record_blocks(pieces, block.line, _PIECE_BYTES):
            try:
                yield self.whole(piece, len(piece.data))
            except MISFITS:
                yield self._one_by_one(piece, rejected)
            count = self.rejected.count
            if count - first > _ENOUGH_ROWS and 2 * len(rejected) > count:
                break  # the table will be refused
        self.rejected.note(rejected)

    def _one_by_one(
        self, piece: TextBlock, rejected: list[tuple[int, str]]
    ) -> tuple[Int64, Float64]:
        """Return the rows of a piece that fit, and append the others to `rejected`."""
        first = self.rejected.count
        stamps: list[int] = []
        numbers: list[list[float]] = []
        kept: list[int] = []
        for line, row in self._row_parser.rows(bytes(piece.data), piece.line):
            if row is None:
                self.log.other_rows += 1
                continue
            if isinstance(row, str):
                rejected.append((line, row))
            else:
                stamps.append(row[0])
                numbers.append(row[1])
                kept.append(self.rejected.count - first)
            self.rejected.count += 1
        t_ns = np.array(stamps, np.int64)
        if not self.columns.stamp.columns:
            rate = self.columns.stamp.sample_rate or 1.0
            t_ns = timestamps.row_stamps(first, self.rejected.count - first, rate)[kept]
        return t_ns, np.array(numbers, np.float64).reshape(-1, len(self.columns.numbers))


@lru_cache(maxsize=1)
def _other_thread(_process: int) -> ThreadPoolExecutor:
    """Return a thread of this process, for each forked process a new one.

    In the main thread, pyarrow handles SIGINT and SIGTERM while it reads, and may abort the process
    instead of ending it normally.
    """
    return ThreadPoolExecutor(1)
