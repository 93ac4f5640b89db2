"""Tables as Parquet: ``t_ns`` int64, float64 columns, provenance beside them.

Attitudes change little from sample to sample: their sign, exponent and leading bits repeat, their
trailing bits are noise. Byte-stream-split brings the bytes that repeat together, and a light zstd
folds them; dictionaries, Parquet's default, gain nothing on numbers that never recur and cost
the most time. Steady stamps have nearly constant differences, hence the delta encoding.
"""

from __future__ import annotations

import json
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from quatprop.provenance import METADATA_KEY
from quatprop.writers.atomic import Output, reported
from quatprop.writers.base import AttitudeTable, Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

    from quatprop.layout import Layout

ROW_GROUP = 1 << 18
"""Rows in a group: 10 MiB of attitudes, at fixed rows wherever a batch happened to end."""


def attitudes(target: Path | str, layout: Layout) -> AttitudeTable:
    """Open a Parquet file of attitudes."""
    return AttitudeTable(ParquetTable(target, layout.columns), layout)


class ParquetTable(Table):
    """Write columns as Parquet.

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
        self._t_ns = np.empty(ROW_GROUP, np.int64)
        self._columns = np.empty((len(names), ROW_GROUP), np.float64)
        self._filled = 0
        with reported(target):
            self._parquet = pyarrow.parquet.ParquetWriter(
                self._output.stream,
                self._schema,
                compression="zstd",
                compression_level=1,
                use_dictionary=False,
                column_encoding={
                    "t_ns": "DELTA_BINARY_PACKED",
                    **dict.fromkeys(names, "BYTE_STREAM_SPLIT"),
                },
            )

    def write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows."""
        done = 0
        while done < len(t_ns):
            take = min(len(t_ns) - done, ROW_GROUP - self._filled)
            rows, place = slice(done, done + take), slice(self._filled, self._filled + take)
            self._t_ns[place] = t_ns[rows]
            for kept, column in zip(self._columns, columns, strict=True):
                kept[place] = column[rows]
            self._filled += take
            done += take
            if self._filled == ROW_GROUP:
                self._write_group()

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the file, with its provenance, and put it in its place."""
        if self._filled:
            self._write_group()
        words = json.dumps(provenance, sort_keys=True, ensure_ascii=False)
        with reported(self._output.target):
            self._parquet.add_key_value_metadata({METADATA_KEY: words.encode()})
            self._parquet.close()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._output.discard()
        # pyarrow would finish the file when it is collected: let it fail here, unheard.
        with suppress(Exception):
            self._parquet.close()

    def _write_group(self) -> None:
        rows = slice(0, self._filled)
        arrays = [pa.array(self._t_ns[rows]), *(pa.array(kept[rows]) for kept in self._columns)]
        with reported(self._output.target):
            self._parquet.write_batch(
                pa.record_batch(arrays, schema=self._schema), row_group_size=ROW_GROUP
            )
        self._filled = 0
