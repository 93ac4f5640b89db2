"""What Arrow's file formats share: rows gathered to groups, provenance in the metadata."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from quatprop.arrow_arrays import to_arrow
from quatprop.provenance import METADATA_KEY
from quatprop.writers.atomic import Output, reported
from quatprop.writers.base import Table, words_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

GROUP = 1 << 18
"""Rows that are written together: 10 MiB of attitudes, at fixed rows wherever a batch ended."""


def metadata(provenance: Mapping[str, Any]) -> dict[bytes, bytes]:
    """Return the metadata that a file keeps its provenance in."""
    return {METADATA_KEY: words_of(provenance).encode()}


class ArrowTable(Table):
    """Gather rows and write them a group at a time.

    Parameters
    ----------
    target
        A path.
    names
        Names of the float64 columns that follow ``t_ns``.
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        self._schema = pa.schema([("t_ns", pa.int64()), *((name, pa.float64()) for name in names)])
        self._output = Output(target)
        self._t_ns = np.empty(GROUP, np.int64)
        self._columns = np.empty((len(names), GROUP), np.float64)
        self._filled = 0

    @abstractmethod
    def _put(self, group: pa.RecordBatch) -> None:
        """Write a group; its memory is used again afterwards."""

    def write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows."""
        done = 0
        while done < len(t_ns):
            take = min(len(t_ns) - done, GROUP - self._filled)
            rows, place = slice(done, done + take), slice(self._filled, self._filled + take)
            self._t_ns[place] = t_ns[rows]
            for kept, column in zip(self._columns, columns, strict=True):
                kept[place] = column[rows]
            self._filled += take
            done += take
            if self._filled == GROUP:
                self._write_group()

    def _finish_rows(self) -> None:
        """Write what does not fill a group."""
        if self._filled:
            self._write_group()

    def _write_group(self) -> None:
        rows = slice(0, self._filled)
        arrays = [to_arrow(self._t_ns[rows]), *(to_arrow(kept[rows]) for kept in self._columns)]
        with reported(self._output.target):
            self._put(pa.record_batch(arrays, schema=self._schema))
        self._filled = 0
