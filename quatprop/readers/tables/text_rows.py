"""Rows of a text table: parse whole blocks, and split blocks with rows that do not fit."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from quatprop.concurrency.threads import thread_count
from quatprop.errors import UnsupportedLogError
from quatprop.tables import timestamps
from quatprop.tables.typed_table import BatchRows, batch_rows
from quatprop.text import Setting

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from quatprop.arrays import Float64, Int64
    from quatprop.tables.base import Batches, TableLog, TimedColumns
    from quatprop.tables.leaves import Leaf
    from quatprop.tables.log import Losses
    from quatprop.tables.text_stream import TextBlock

_LOSSES_A_BLOCK = 8


class RowMisfitError(ValueError):
    """A row that pyarrow cannot safely parse, or would wrongly accept."""


MISFITS = (
    *(pa.ArrowInvalid, pa.ArrowNotImplementedError, UnicodeDecodeError),
    *(timestamps.TimestampRangeError, RowMisfitError),
)
"""Exceptions for text with a row that does not fit."""


class TextRows(ABC):
    """One reading of a text table; subclasses parse and split the blocks of a format.

    `leaves`: the columns to read, by index
    `task_bytes`: bytes that one thread of pyarrow parses at a time
    """

    task_bytes: int

    def __init__(self, log: TableLog, columns: TimedColumns, leaves: Mapping[int, Leaf]) -> None:
        self.log = log
        self.columns = columns
        self.leaves = leaves
        self.rejected = RejectedRows(log.path, log.losses)
        # Spare places, for times finer than 1 ns, are only used once they are needed.
        self._spare = 0 if columns.stamp.columns else timestamps.SPARE_PLACES

    @abstractmethod
    def parse(self, block: TextBlock, task_bytes: int, spare: int) -> pa.Table:
        """Return all rows of a block, with spare decimal places for times; raise one of MISFITS."""

    @abstractmethod
    def apart(self, block: TextBlock) -> Batches:
        """Yield the rows of a block that fit, and note the others."""

    def batches(self, blocks: Iterable[TextBlock]) -> Batches:
        """Yield timestamps, ns, ``(N,)``, and numbers, ``(N, k)``, of the rows that fit."""
        for block in blocks:
            try:
                t_ns, numbers = self.whole(block)
            except MISFITS:
                none = (np.empty(0, np.int64), np.empty((0, len(self.columns.numbers))))
                parts = zip(none, *self.apart(block), strict=True)
                t_ns, numbers = map(np.concatenate, parts)
            self.rejected.refuse_if_most()
            if len(t_ns):
                yield t_ns, numbers

    def whole(self, block: TextBlock, task_bytes: int = 0) -> tuple[Int64, Float64]:
        """Return timestamps and numbers of a block in which all rows fit."""
        task_bytes = task_bytes or self.task_bytes
        try:
            rows = self._rows(block, task_bytes, self._spare)
        except MISFITS:
            if self._spare:
                raise
            rows = self._rows(block, task_bytes, timestamps.SPARE_PLACES)
            self._spare = timestamps.SPARE_PLACES
        rows.note(self.log, self.rejected.count)
        self.rejected.count += rows.total
        return rows.t_ns, rows.numbers

    def _rows(self, block: TextBlock, task_bytes: int, spare: int) -> BatchRows:
        table = self.parse(block, task_bytes, spare)
        return batch_rows(table, self.leaves, self.columns, self.rejected.count)


def use_threads(data: bytes | memoryview, task_bytes: int) -> bool:
    """Return whether a text is large enough for several threads."""
    return len(data) > task_bytes and thread_count() > 1


class RejectedRows:
    """Notes rows of a text table that do not fit as losses; refuses the table if most do not.

    `count`: number of rows read so far, including those that do not fit
    """

    def __init__(self, path: Path, losses: Losses) -> None:
        self.count = 0
        self._path = path
        self._losses = losses
        self._first = (0, "")
        self._rejected = 0

    def note(self, rows: list[tuple[int, str]]) -> None:
        """Note the line numbers and reasons of rejected rows in a block, as one loss if many."""
        if not rows:
            return
        if not self._rejected:
            self._first = rows[0]
        self._rejected += len(rows)
        if len(rows) <= _LOSSES_A_BLOCK:
            for line, reason in rows:
                self._losses.note(f"line {line}", reason, 1)
            return
        reason = f"{len(rows)} of these rows do not fit; the first: {rows[0][1]}"
        self._losses.note(f"lines {rows[0][0]} to {rows[-1][0]}", reason, len(rows))

    def refuse_if_most(self) -> None:
        """Refuse a table if more than half of its rows were rejected."""
        if 2 * self._rejected > self.count:
            line, reason = self._first
            raise UnsupportedLogError(
                self._path,
                f"{self._rejected} of its first {self.count} rows do not fit (line {line}: "
                f"{reason}); check the columns and units, such as {Setting('time_unit')}, or "
                "whether it is one table",
            )
