"""Attitude series as CSV: ``t_ns`` and four components, one header line, no quotes.

Each number is the shortest decimal that reads back as the same float64. CSV has no room for
provenance; the columns' names tell the layout.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.csv

from quatprop.writers.atomic import Output, reported
from quatprop.writers.base import AttitudeWriter

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.layout import Layout
    from quatprop.series import AttitudeSeries


class CsvWriter(AttitudeWriter):
    """Write attitudes as CSV.

    Parameters
    ----------
    target
        A path, or ``"-"`` for stdout.
    layout
        Order of the four components.
    """

    def __init__(self, target: Path | str, layout: Layout) -> None:
        self._layout = layout
        self._output = Output(target)
        names = ("t_ns", *layout.columns)
        self._schema = pa.schema(
            [(name, pa.int64() if name == "t_ns" else pa.float64()) for name in names]
        )
        with reported(target):
            # pyarrow would put the names in quotes.
            self._output.stream.write((",".join(names) + "\n").encode())
            self._csv = pyarrow.csv.CSVWriter(
                self._output.stream,
                self._schema,
                write_options=pyarrow.csv.WriteOptions(include_header=False),
            )

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch."""
        columns = [series.t_ns, *(series.wxyz[:, place] for place in self._layout.order)]
        batch = pa.record_batch([pa.array(column) for column in columns], schema=self._schema)
        with reported(self._output.target):
            self._csv.write_batch(batch)

    def commit(self, provenance: Mapping[str, Any]) -> None:  # noqa: ARG002  # no room for it
        """Finish the file and put it in its place."""
        with reported(self._output.target):
            self._csv.close()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._output.discard()
