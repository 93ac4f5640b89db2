"""Which stamps the row groups of a Parquet file have, by the statistics in its footer."""

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
"""Units of times in a Parquet file -> those of Arrow."""


def stamp_spans(metadata: FileMetaData, leaf: Leaf, time_unit: str) -> list[Span] | None:
    """Return the stamps of each row group.

    `time_unit`: its unit, where it has whole numbers
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
        except (TimestampRangeError, pa.ArrowInvalid):
            return None
        spans.append(Span(first_ns, last_ns, group.num_rows))
    return spans


def _extremes(statistics: Any, kind: pa.DataType) -> pa.Array | None:
    """Return the smallest and the largest value of a column of whole numbers or times."""
    if statistics is None or not statistics.has_min_max:
        return None
    if pa.types.is_integer(kind):
        return pa.array([statistics.min, statistics.max], kind)
    if not pa.types.is_timestamp(kind):
        return None
    unit = UNITS.get(json.loads(statistics.logical_type.to_json()).get("timeUnit"))
    if unit is None:
        return None
    # As numbers: the library's dates have no nanoseconds.
    raw = pa.array([statistics.min_raw, statistics.max_raw], pa.timestamp(unit))
    return raw.cast(pa.timestamp(kind.unit))
