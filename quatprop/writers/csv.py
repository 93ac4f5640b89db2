"""Tables as CSV: one header line, no quotes, a newline after every row.

Each number is the shortest decimal that reads back as the same float64. CSV has no room for
provenance; the names of the columns tell the layout.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.csv

from quatprop.writers.atomic import Output, reported
from quatprop.writers.base import AttitudeTable, Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

    from quatprop.layout import Layout


def attitudes(target: Path | str, layout: Layout) -> AttitudeTable:
    """Open a CSV file of attitudes; ``"-"`` is stdout."""
    return AttitudeTable(CsvTable(target, layout.columns), layout)


class CsvTable(Table):
    """Write columns as CSV.

    Parameters
    ----------
    target
        A path, or ``"-"`` for stdout.
    names
        Names of the float64 columns that follow ``t_ns``.
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        self._schema = pa.schema([("t_ns", pa.int64()), *((name, pa.float64()) for name in names)])
        self._output = Output(target)
        with reported(target):
            # pyarrow would put the names in quotes.
            self._output.stream.write((",".join(self._schema.names) + "\n").encode())
            self._csv = pyarrow.csv.CSVWriter(
                self._output.stream,
                self._schema,
                write_options=pyarrow.csv.WriteOptions(include_header=False),
            )

    def write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows."""
        arrays = [pa.array(column) for column in (t_ns, *columns)]
        with reported(self._output.target):
            self._csv.write_batch(pa.record_batch(arrays, schema=self._schema))

    def commit(self, provenance: Mapping[str, Any]) -> None:  # noqa: ARG002  # no room for it
        """Finish the file and put it in its place."""
        with reported(self._output.target):
            self._csv.close()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._output.discard()
