"""Common parts of Arrow's file formats: groups of rows, provenance in the metadata."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from quatprop.arrow_arrays import to_arrow
from quatprop.provenance import METADATA_KEY
from quatprop.writers.atomic import OutputFile
from quatprop.writers.base import TableWriter, block_slices, provenance_json

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from quatprop.arrays import AnyArray


GROUP = 1 << 18
"""Rows that are written together: 10 MiB of attitudes."""


def metadata(provenance: Mapping[str, object]) -> dict[bytes, bytes]:
    """Return a file's metadata with its provenance."""
    return {METADATA_KEY: provenance_json(provenance).encode()}


class ArrowTable(TableWriter):
    """Collect rows and write them a group at a time.

    Parameters
    ----------
    target
        A path.
    names
        Names of the float64 columns that follow ``t_ns``.
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        self._schema = pa.schema([("t_ns", pa.int64()), *((name, pa.float64()) for name in names)])
        super().__init__(OutputFile(target))
        self._t_ns = np.empty(GROUP, np.int64)
        self._columns = np.empty((len(names), GROUP), np.float64)
        self._filled = 0

    @abstractmethod
    def _write_group(self, group: pa.RecordBatch) -> None:
        """Write a group; its memory is reused afterwards."""

    def _write(self, t_ns: AnyArray, columns: Sequence[AnyArray]) -> None:
        for rows, place in block_slices(len(t_ns), self._filled, GROUP):
            self._t_ns[place] = t_ns[rows]
            for buffer, column in zip(self._columns, columns, strict=True):
                buffer[place] = column[rows]
            self._filled = place.stop
            if self._filled == GROUP:
                self._flush()

    def _flush(self) -> None:
        """Write the collected rows."""
        if not self._filled:
            return
        rows = slice(0, self._filled)
        arrays = [to_arrow(self._t_ns[rows]), *(to_arrow(column[rows]) for column in self._columns)]
        self._write_group(pa.record_batch(arrays, schema=self._schema))
        self._filled = 0
