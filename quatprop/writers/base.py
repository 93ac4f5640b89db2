"""What every writer gives: attitudes in, a file out; beneath it tables of columns."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from quatprop.provenance import as_json

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any, Self

    from numpy.typing import NDArray

    from quatprop.conventions.layout import Layout
    from quatprop.series import AttitudeSeries


def words_of(provenance: Mapping[str, Any]) -> str:
    """Return a provenance as it is kept in files: JSON on one line, plain ASCII.

    Examples
    --------
    >>> words_of({"source": "a.bag", "samples": 1})
    '{"samples": 1, "source": "a.bag"}'
    """
    return json.dumps(as_json(provenance), sort_keys=True)


class Uncommitted(ABC):
    """A context manager that leaves no trace of what was not committed."""

    @abstractmethod
    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the file and put it in its place.

        Parameters
        ----------
        provenance
            How the content came about: convention, layout, method, q0, source, counts,
            versions; JSON-ready. Kept in the file where the format has room for it.

        Raises
        ------
        OutputError
            The file cannot be finished.
        """

    @abstractmethod
    def abort(self) -> None:
        """Remove what was not committed; harmless after a commit."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.abort()


class AttitudeWriter(Uncommitted):
    """Takes batches of attitudes in order.

    What a batch holds may be looked at until the commit: nobody changes it meanwhile.
    """

    @abstractmethod
    def write(self, series: AttitudeSeries) -> None:
        """Append a batch.

        Raises
        ------
        OutputError
            The disk is full, or the target is otherwise gone.
        BrokenPipeError
            Whoever read the output has gone.
        """


class Table(Uncommitted):
    """A file of named columns: int64 stamps ``t_ns`` first, float64 after it."""

    @abstractmethod
    def write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows: stamps and as many columns as were named, all of one length."""


class AttitudeTable(AttitudeWriter):
    """Attitudes as a table: the stamps and four components in the order of a layout.

    Parameters
    ----------
    table
        A table with the columns of `layout`.
    layout
        Order of the components.
    """

    def __init__(self, table: Table, layout: Layout) -> None:
        self._table = table
        self._order = layout.order

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch."""
        self._table.write(series.t_ns, [series.wxyz[:, place] for place in self._order])

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the file and put it in its place."""
        self._table.commit(provenance)

    def abort(self) -> None:
        """Remove what was not committed."""
        self._table.abort()
