"""Tables written by Arrow, in groups of rows with provenance in the metadata; Arrow IPC files.

Arrow IPC files, also known as Feather, are not compressed: attitudes hardly shrink, and an
uncompressed file can be memory-mapped.
"""

from __future__ import annotations

from abc import abstractmethod
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import pyarrow as pa

from quatprop.base.arrow_arrays import series_arrays, series_schema
from quatprop.base.provenance import METADATA_KEY
from quatprop.writers.atomic import OutputFile, scratch_file
from quatprop.writers.base import TableWriter, block_slices, provenance_json

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray

    Facts: TypeAlias = Mapping[str, Mapping[str, str]]

NOTHING: Facts = MappingProxyType({})

GROUP_ROWS = 1 << 18
"""Rows that are written together: 10 MiB of attitudes."""


def metadata(provenance: Mapping[str, object]) -> dict[bytes, bytes]:
    """Return a file's metadata with its provenance."""
    return {METADATA_KEY: provenance_json(provenance).encode()}


class ArrowTable(TableWriter):
    """A table that is written in groups of rows.

    `names`: names of the float64 columns that follow ``t_ns``
    `facts`: unit, frame and convention of columns, by name, for the metadata of their fields
    """

    def __init__(self, target: Path | str, names: Sequence[str], facts: Facts = NOTHING) -> None:
        self._schema = series_schema(names, facts)
        super().__init__(OutputFile(target))
        self._parts: list[list[AnyArray]] = []
        self._filled = 0

    @abstractmethod
    def _write_group(self, group: pa.RecordBatch) -> None:
        """Write a group."""

    def _write(self, t_ns: AnyArray, columns: Sequence[AnyArray]) -> None:
        for rows, place in block_slices(len(t_ns), self._filled, GROUP_ROWS):
            self._parts.append([t_ns[rows], *(column[rows] for column in columns)])
            self._filled = place.stop
            if self._filled == GROUP_ROWS:
                self._flush()

    def _flush(self) -> None:
        """Write the collected rows."""
        if self._parts:
            columns = [np.concatenate(parts) for parts in zip(*self._parts, strict=True)]
            arrays = series_arrays(self._schema, columns)
            self._write_group(pa.record_batch(arrays, schema=self._schema))
        self._parts, self._filled = [], 0


class FeatherTable(ArrowTable):
    """An Arrow IPC file.

    It begins with its metadata, which are complete only at the end, so the rows are kept in a
    temporary file until then.

    `names`, `facts`: see :class:`ArrowTable`
    """

    def __init__(self, target: Path | str, names: Sequence[str], facts: Facts = NOTHING) -> None:
        super().__init__(target, names, facts)
        self._body = scratch_file(target)
        with self._opening():
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
        """Discard uncommitted output."""
        self._body.close()
        super().abort()

    def _write_group(self, group: pa.RecordBatch) -> None:
        self._rows.write(group)
