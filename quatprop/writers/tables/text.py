"""Tables as text: rows become bytes in threads, piece by piece, and are written in order.

Finding the shortest decimal of a float64 costs more than propagating it. pyarrow does it without
holding the interpreter, so while one piece is formatted, the next is propagated or formatted too.
"""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.csv

from quatprop.arrow_arrays import to_arrow
from quatprop.provenance import COMMENT
from quatprop.writers.atomic import Output, reported, scratch
from quatprop.writers.base import Table, words_of
from quatprop.writers.ordered_threads import OrderedThreadPool

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

    Form = Callable[[list[NDArray[Any]]], pa.Buffer]

PIECE = 1 << 14
"""Rows that are formatted together: enough to make calls cheap, few enough to share out."""


class TextTable(Table):
    """Write columns as lines of text.

    Parameters
    ----------
    target
        A path, or ``"-"`` for stdout.
    head
        What stands before the rows, such as a line of names. It is written with the first of them,
        so that a run that fails before has said nothing to a pipe.
    form
        Gives the lines of a piece: of its stamps and columns.
    comment
        Begin with the provenance, in a comment. It is complete only at the end, so the rows wait
        in a file of their own.
    """

    def __init__(self, target: Path | str, head: str, form: Form, *, comment: bool = False) -> None:
        self._output = Output(target)
        self._body = scratch(target) if comment else self._output.stream
        self._head = head.encode()
        self._works = OrderedThreadPool(form, self._put)

    def write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows."""
        for begin in range(0, len(t_ns), PIECE):
            rows = slice(begin, begin + PIECE)
            piece = [t_ns[rows], *(column[rows] for column in columns)]
            self._works.give(piece)

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the file and put it in its place."""
        self._works.finish()
        self._works.stop()
        self._put(b"")
        if self._body is not self._output.stream:
            words = words_of(provenance)
            with reported(self._output.target), self._body as body:
                self._output.stream.write(COMMENT + words.encode() + b"\n")
                body.seek(0)
                shutil.copyfileobj(body, self._output.stream, 1 << 20)
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._works.stop()
        if self._body is not self._output.stream:
            self._body.close()
        self._output.discard()

    def _put(self, text: pa.Buffer | bytes) -> None:
        head, self._head = self._head, b""
        with reported(self._output.target):
            self._body.write(head)
            self._body.write(text)


def delimited(separator: str, names: Sequence[str]) -> Form:
    """Return what formats columns as values between separators.

    Each number is the shortest decimal that reads back as the same float64.
    """
    options = pyarrow.csv.WriteOptions(
        include_header=False, delimiter=separator, quoting_style="none"
    )

    def form(columns: list[NDArray[Any]]) -> pa.Buffer:
        batch = pa.record_batch([_arrow(column) for column in columns], names=list(names))
        lines = pa.BufferOutputStream()
        pyarrow.csv.write_csv(batch, lines, options)
        return lines.getvalue()

    return form


def _arrow(column: pa.Array | NDArray[Any]) -> pa.Array:
    return column if isinstance(column, pa.Array) else to_arrow(column)
