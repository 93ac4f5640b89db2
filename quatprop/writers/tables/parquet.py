"""Tables as Parquet: ``t_ns`` int64, float64 columns, provenance beside them.

Attitudes change little from sample to sample: their sign, exponent and leading bits repeat, their
trailing bits are noise. Byte-stream-split brings the bytes that repeat together, and a light zstd
folds them; dictionaries, Parquet's default, gain nothing on numbers that never recur and cost
the most time. Steady stamps have nearly constant differences, hence the delta encoding.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import pyarrow.parquet

from quatprop.writers.atomic import reported
from quatprop.writers.tables.arrow import GROUP, ArrowTable, metadata

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path
    from typing import Any

    import pyarrow as pa


class ParquetTable(ArrowTable):
    """Write columns as Parquet.

    Parameters
    ----------
    target
        A path.
    names
        Names of the float64 columns that follow ``t_ns``.
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        super().__init__(target, names)
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

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the file, with its provenance, and put it in its place."""
        self._finish_rows()
        with reported(self._output.target):
            self._parquet.add_key_value_metadata(metadata(provenance))
            self._parquet.close()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._output.discard()
        # pyarrow would finish the file when it is collected: let it fail here, unheard.
        with suppress(Exception):
            self._parquet.close()

    def _put(self, group: pa.RecordBatch) -> None:
        self._parquet.write_batch(group, row_group_size=GROUP)
