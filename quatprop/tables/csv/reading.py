"""Blocks of text to stamps and numbers: as a whole, and piece by piece around damage."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from quatprop.tables.csv.row_parser import RowParser
from quatprop.tables.csv.rows import MISFITS, TASK_BYTES, BlockParser, ParsedRows
from quatprop.tables.text_stream import RejectedRows, TextBlock, TextStream, record_blocks
from quatprop.tables.timestamps import row_stamps

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.arrays import Float64, Int64
    from quatprop.tables.base import TimedColumns
    from quatprop.tables.csv.headers import CsvLayout


_PIECE_BYTES = 1 << 16
_ENOUGH_ROWS = 100_000
"""Rows after which a table is refused, of which most do not fit."""


class BlockReader:
    """One reading of a table, which counts rows from block to block.

    Parameters
    ----------
    rejected
        Where rows that do not fit are noted.
    path
        The table.
    layout
        How it is laid out.
    columns
        Which columns to read.
    """

    def __init__(
        self, rejected: RejectedRows, path: Path, layout: CsvLayout, columns: TimedColumns
    ) -> None:
        self._rejected = rejected
        self._layout = layout
        self._columns = columns
        self._block_parser = BlockParser(layout, columns)
        self._row_parser = RowParser(path, layout, columns)

    def read(self, block: TextBlock) -> tuple[Int64, Float64]:
        """Return stamps, shape ``(N,)``, ns, and numbers, ``(N, k)``, of the rows that fit."""
        try:
            parts = [self._parse(block.data, quoted=block.quoted)]
        except MISFITS:
            parts = list(self._piecewise(block))
        stamps = [self._stamps(rows) for rows in parts]
        if len(parts) == 1:
            return stamps[0], parts[0].numbers
        return np.concatenate(stamps), np.concatenate([rows.numbers for rows in parts])

    def _parse(
        self, data: bytes | memoryview, *, quoted: bool, task: int = TASK_BYTES
    ) -> ParsedRows:
        line_breaks = quoted and self._row_parser.has_line_breaks_in_cells(data)
        return self._block_parser.parse(data, line_breaks=line_breaks, task=task)

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
            t_ns = row_stamps(self._rejected.count, rows.total, self._columns.sample_rate or 1.0)
            t_ns = t_ns if rows.kept is None else t_ns[rows.kept]
        self._rejected.count += rows.total
        return t_ns
