"""Tables as Parquet: ``t_ns`` int64, float64 columns, provenance in the metadata.

Attitudes change little from sample to sample: their sign, exponent and leading bits repeat, their
trailing bits are noise. Byte-stream-split groups the repeating bytes, and zstd at level -1
compresses them as well as at level 1, in less time; dictionaries, Parquet's default, gain nothing
on numbers that never recur and cost the most time. Regular timestamps have nearly constant
differences, hence the delta encoding. Only timestamps have statistics, for searches by time range.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet

from quatprop.writers.arrow import GROUP_ROWS, NOTHING, ArrowTable, metadata

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from quatprop.writers.arrow import Facts

PAGE = 1 << 16
"""Rows of a page: many small pages cost time, and so do calls that write many rows."""


class ParquetTable(ArrowTable):
    """A table in Parquet.

    `names`, `facts`: see :class:`ArrowTable`
    """

    def __init__(self, target: Path | str, names: Sequence[str], facts: Facts = NOTHING) -> None:
        super().__init__(target, names, facts)
        numbers = [
            f"{field.name}.list.element" if pa.types.is_fixed_size_list(field.type) else field.name
            for field in self._schema
            if field.name != "t_ns"
        ]
        with self._opening():
            self._parquet = pyarrow.parquet.ParquetWriter(
                self._output.stream,
                self._schema,
                compression="zstd",
                compression_level=-1,
                use_dictionary=False,
                write_statistics=["t_ns"],
                max_rows_per_page=PAGE,
                column_encoding={
                    "t_ns": "DELTA_BINARY_PACKED",
                    **dict.fromkeys(numbers, "BYTE_STREAM_SPLIT"),
                },
            )

    def _finish(self, provenance: Mapping[str, object]) -> None:
        self._flush()
        self._parquet.add_key_value_metadata(metadata(provenance))
        self._parquet.close()

    def abort(self) -> None:
        """Discard uncommitted output."""
        self._output.discard()
        # pyarrow would write the footer when it is garbage-collected: let that fail here.
        with suppress(Exception):
            self._parquet.close()

    def _write_group(self, group: pa.RecordBatch) -> None:
        self._parquet.write_batch(group, row_group_size=GROUP_ROWS)
