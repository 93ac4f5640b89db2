"""Timestamps of the row groups of a Parquet file, from the statistics in its footer."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from quatprop.tables.model import Span
from quatprop.tables.timestamps import TimestampRangeError, nanoseconds

if TYPE_CHECKING:
    from pyarrow.parquet import FileMetaData

    from quatprop.tables.leaves import Leaf

UNITS = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}
"""Parquet time unit -> Arrow time unit."""


def stamp_spans(metadata: FileMetaData, leaf: Leaf, time_unit: str) -> list[Span] | None:
    """Return the timestamps of each row group; None without statistics.

    `time_unit`: unit of a column of integers
    """
    paths = [metadata.schema.column(k).path for k in range(metadata.num_columns)]
    if leaf.name not in paths:
        return None
    place, spans = paths.index(leaf.name), []
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        try:
            extremes = _extremes(group.column(place).statistics, leaf.type)
            if extremes is None:
                return None
            first_ns, last_ns = nanoseconds(extremes, time_unit).tolist()
        except (TimestampRangeError, pa.ArrowInvalid, KeyError):
            return None
        spans.append(Span(first_ns, last_ns, group.num_rows))
    return spans


def _extremes(statistics: Any, kind: pa.DataType) -> pa.Array | None:
    """Return the smallest and the largest value of a column of integers or times, or None."""
    if statistics is None or not statistics.has_min_max:
        return None
    if pa.types.is_integer(kind):
        return pa.array([statistics.min, statistics.max], kind)
    if not pa.types.is_timestamp(kind):
        return None
    unit = UNITS[json.loads(statistics.logical_type.to_json())["timeUnit"]]
    # As numbers: the library's dates have no nanoseconds.
    raw = pa.array([statistics.min_raw, statistics.max_raw], pa.timestamp(unit))
    return raw.cast(pa.timestamp(kind.unit))
