"""Tables as Arrow IPC files, also known as Feather.

They are not compressed: attitudes hardly shrink, and an uncompressed file can be memory-mapped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pyarrow as pa

from quatprop.writers.atomic import scratch_file
from quatprop.writers.tables.arrow import ArrowTable, metadata

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path


class FeatherTable(ArrowTable):
    """Write columns as an Arrow IPC file.

    It begins with its metadata, which is complete only at the end: the rows are kept in a
    temporary file until then.

    Parameters
    ----------
    target
        A path.
    names
        Names of the float64 columns that follow ``t_ns``.
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        super().__init__(target, names)
        self._body = scratch_file(target)
        with self._errors():
            self._rows = pa.ipc.new_stream(self._body, self._schema)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        self._flush()
        schema = self._schema.with_metadata(metadata(provenance))
        with self._body as body:
            self._rows.close()
            body.seek(0)
            with pa.ipc.new_file(self._output.stream, schema) as file:
                for group in pa.ipc.open_stream(body):
                    file.write(group.replace_schema_metadata(schema.metadata))

    def abort(self) -> None:
        """Remove what was not committed."""
        self._body.close()
        super().abort()

    def _write_group(self, group: pa.RecordBatch) -> None:
        self._rows.write(group)
