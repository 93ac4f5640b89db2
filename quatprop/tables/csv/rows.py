"""Rows of text to columns of numbers, whole blocks at once."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from quatprop.arrow_arrays import readable, to_numpy
from quatprop.concurrency.threads import thread_count
from quatprop.tables import timestamps

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.tables.base import TimedColumns
    from quatprop.tables.csv.headers import CsvLayout


class OpenQuoteError(ValueError):
    """A quote that is not closed where its cell should end."""


MISFITS = (pa.ArrowInvalid, timestamps.TimestampRangeError, OpenQuoteError)
"""What :class:`BlockParser` raises for a block in which a row does not fit."""

TASK_BYTES = 1 << 19  # what one thread of pyarrow parses at a time


class ParsedRows(NamedTuple):
    """Rows of a block or a piece.

    Parameters
    ----------
    t_ns
        Stamps, shape ``(N,)``, int64, ns; None for a table without time.
    numbers
        Numbers as stored, shape ``(N, k)``, float64; NaN where a cell is empty.
    total
        How many rows there were, kept and rejected.
    kept
        Which of them were kept, shape ``(N,)``, int64; None where all were.
    rejected
        Line number and reason of each row that was rejected.
    """

    t_ns: Int64 | None
    numbers: Float64
    total: int
    kept: Int64 | None = None
    rejected: tuple[tuple[int, str], ...] = ()


def date_type(layout: CsvLayout, k: int) -> pa.DataType | None:
    """Return the type of a column of dates; None for one of numbers."""
    return pa.timestamp("ns", layout.dates[k]) if k in layout.dates else None


class BlockParser:
    """Reads whole blocks, all rows at once.

    Parameters
    ----------
    layout
        How the table is laid out.
    columns
        Which columns to read.
    """

    def __init__(self, layout: CsvLayout, columns: TimedColumns) -> None:
        self.layout = layout
        self.columns = columns
        self._names = [str(k) for k in range(len(layout.names))]
        # Stamps finer than ns are tried for once; without stamps there is nothing to try.
        self._spare = 0 if columns.time else timestamps.SPARE_PLACES

    def parse(
        self, data: bytes | memoryview, *, line_breaks: bool, task: int = TASK_BYTES
    ) -> ParsedRows:
        """Return all rows of a block.

        Parameters
        ----------
        data
            Whole records.
        line_breaks
            Whether cells have line breaks.
        task
            Bytes that one thread parses at a time; no record may be longer.

        Raises
        ------
        ArrowInvalid
            A row does not have the right number of columns, or a cell is not a number.
        TimestampRangeError
            A stamp does not fit in int64 ns.
        """
        if self.layout.delimiter == " ":
            data = squeeze_blanks(data)
        parse = partial(self._parse, data, line_breaks, task)
        rows, self._spare = timestamps.with_spare_places(parse, self._spare, MISFITS)
        return rows

    def _parse(
        self, data: bytes | memoryview, line_breaks: bool, task: int, spare: int
    ) -> ParsedRows:
        if self.columns.time:
            timestamps.refuse_tiny_numbers(data)
        types = {str(k): pa.float64() for k in self.columns.numbers}
        for k, unit in zip(self.columns.time, self.columns.units, strict=True):
            types[str(k)] = date_type(self.layout, k) or timestamps.decimal_type(unit, spare)
        read = partial(
            arrow_csv.read_csv,
            readable(data),
            read_options=arrow_csv.ReadOptions(
                column_names=self._names,
                block_size=task,
                use_threads=len(data) > task and thread_count() > 1,
            ),
            parse_options=arrow_csv.ParseOptions(
                delimiter=self.layout.delimiter, newlines_in_values=line_breaks
            ),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types, include_columns=list(types), decimal_point=self.layout.decimal
            ),
        )
        if threading.current_thread() is threading.main_thread():
            table = _other_thread(os.getpid()).submit(read).result()
        else:
            table = read()
        numbers = np.empty((table.num_rows, len(self.columns.numbers)))
        for place, k in enumerate(self.columns.numbers):
            numbers[:, place] = to_numpy(table.column(str(k)))
        return ParsedRows(self._stamps(table), numbers, table.num_rows)

    def _stamps(self, table: pa.Table) -> Int64 | None:
        if not self.columns.time:
            return None
        columns = [table.column(str(k)) for k in self.columns.time]
        if any(column.null_count for column in columns):
            raise pa.ArrowInvalid("a row without a time")
        return timestamps.sum_parts(map(timestamps.nanoseconds, columns, self.columns.units))


@lru_cache(maxsize=1)
def _other_thread(_process: int) -> ThreadPoolExecutor:
    """Return a thread of this process; one that was forked has none of the threads before.

    In the main thread pyarrow would take over the handling of Ctrl-C and SIGTERM while it reads,
    and a process that is told to end at that moment aborts.
    """
    return ThreadPoolExecutor(1)


def squeeze_blanks(data: bytes | memoryview) -> bytes:
    """Return rows whose cells are separated by runs of blanks with one space for each run."""
    text = bytes(data).replace(b"\t", b" ")
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    text = b"\n" + text
    while b"  " in text:
        text = text.replace(b"  ", b" ")
    return text.replace(b"\n ", b"\n").replace(b" \n", b"\n")[1:].rstrip(b" ")
