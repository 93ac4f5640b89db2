"""Attitude series as Parquet: ``t_ns`` int64, four float64 components, provenance beside them.

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

from quatprop.writers.atomic import Output, reported
from quatprop.writers.base import AttitudeWriter

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.layout import Layout
    from quatprop.series import AttitudeSeries

ROW_GROUP = 1 << 18
"""Rows in a group: 10 MiB in memory, and the bytes never depend on the batches handed in."""

METADATA_KEY = b"quatprop"
"""Key of the file's metadata that holds the provenance, as JSON."""


class ParquetWriter(AttitudeWriter):
    """Write attitudes as Parquet.

    Parameters
    ----------
    target
        A path.
    layout
        Order of the four components.
    """

    def __init__(self, target: Path | str, layout: Layout) -> None:
        self._layout = layout
        self._output = Output(target)
        self._schema = pa.schema(
            [("t_ns", pa.int64()), *((name, pa.float64()) for name in layout.columns)]
        )
        self._t_ns = np.empty(ROW_GROUP, np.int64)
        self._columns = np.empty((4, ROW_GROUP), np.float64)
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
                    **dict.fromkeys(layout.columns, "BYTE_STREAM_SPLIT"),
                },
            )

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch."""
        done = 0
        while done < len(series):
            take = min(len(series) - done, ROW_GROUP - self._filled)
            rows, place = slice(done, done + take), slice(self._filled, self._filled + take)
            self._t_ns[place] = series.t_ns[rows]
            for column, component in zip(self._columns, self._layout.order, strict=True):
                column[place] = series.wxyz[rows, component]
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
        group = pa.record_batch(
            [pa.array(self._t_ns[rows]), *(pa.array(column[rows]) for column in self._columns)],
            schema=self._schema,
        )
        with reported(self._output.target):
            self._parquet.write_batch(group, row_group_size=ROW_GROUP)
        self._filled = 0
