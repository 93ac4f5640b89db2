"""Tables as text, formatted in threads; CSV and TSV.

Finding the shortest decimal of a float64 costs more than propagating it. pyarrow does it without
holding the interpreter lock, so other rows are propagated or formatted meanwhile.
"""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.csv

from quatprop.base.arrow_arrays import to_arrow
from quatprop.base.provenance import COMMENT
from quatprop.base.threads import OrderedThreadPool
from quatprop.writers.atomic import OutputFile, scratch_file
from quatprop.writers.base import TableWriter, provenance_json

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray

    Formatter = Callable[[list[AnyArray]], pa.Buffer]

PIECE = 1 << 14
"""Rows formatted in one call: enough to make calls cheap, few enough to keep threads busy."""


class TextTable(TableWriter):
    """A table of lines of text.

    `target`: a path, or ``"-"`` for stdout
    `header`: text before the rows, such as a line of names. It is written with the first rows, so
        that a run that fails earlier writes nothing to a pipe
    `formatter`: returns the lines of some rows, given their timestamps and columns
    `comment`: begin with the provenance in a comment. It is complete only at the end, so the rows
        are kept in a temporary file until then
    """

    def __init__(
        self, target: Path | str, header: str, formatter: Formatter, *, comment: bool = False
    ) -> None:
        super().__init__(OutputFile(target))
        self._body = scratch_file(target) if comment else self._output.stream
        self._header = header.encode()
        self._pool = OrderedThreadPool(formatter, self._write_text)

    def _write(self, t_ns: AnyArray, columns: Sequence[AnyArray]) -> None:
        for begin in range(0, len(t_ns), PIECE):
            rows = slice(begin, begin + PIECE)
            piece = [t_ns[rows], *(column[rows] for column in columns)]
            self._pool.submit(piece)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        self._pool.drain()
        self._pool.shutdown()
        self._write_text(b"")
        if self._body is not self._output.stream:
            with self._body as body:
                self._output.stream.write(COMMENT + provenance_json(provenance).encode() + b"\n")
                body.seek(0)
                shutil.copyfileobj(body, self._output.stream, 1 << 20)

    def abort(self) -> None:
        """Discard uncommitted output."""
        self._pool.shutdown()
        if self._body is not self._output.stream:
            self._body.close()
        super().abort()

    def _write_text(self, text: pa.Buffer | bytes) -> None:
        header, self._header = self._header, b""
        self._body.write(header)
        self._body.write(text)


def delimited(separator: str) -> Formatter:
    """Return a formatter of columns as separated values.

    Each number is the shortest decimal that reads back as the same float64.
    """
    options = pyarrow.csv.WriteOptions(
        include_header=False, delimiter=separator, quoting_style="none"
    )

    def formatter(columns: list[Any]) -> pa.Buffer:
        arrays = [one if isinstance(one, pa.Array) else to_arrow(one) for one in columns]
        batch = pa.record_batch(arrays, names=list(map(str, range(len(arrays)))))
        lines = pa.BufferOutputStream()
        pyarrow.csv.write_csv(batch, lines, options)
        return lines.getvalue()

    return formatter


class CsvTable(TextTable):
    """A table in CSV: one header line, no quotes, a newline after every row.

    The provenance may be in a comment before the header line, for readers that skip comments.

    `target`: a path, or ``"-"`` for stdout
    `names`: names of the float64 columns that follow ``t_ns``
    """

    separator = ","

    def __init__(self, target: Path | str, names: Sequence[str], *, comment: bool = False) -> None:
        header = self.separator.join(("t_ns", *names)) + "\n"
        super().__init__(target, header, delimited(self.separator), comment=comment)


class TsvTable(CsvTable):
    """A table of tab-separated values; parameters as for CSV."""

    separator = "\t"
