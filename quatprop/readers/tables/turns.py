"""Columns watched from the first row to the last, and labels: series that take turns.

The beginning of a log is checked before it is read; a second sensor may begin later.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    import pyarrow as pa

    from quatprop.base.arrays import Bool, Float64, Intp


class Run(NamedTuple):
    """Successive rows with one label.

    `begin`: the first of them, counted from 0 in the whole table
    """

    label: str
    rows: int
    begin: int


ALL = "all"
"""The choice that reads the rows of all series as one."""

WINDOW = 4096
"""Rows that are judged together, wherever batches end."""

EVERY = 64
"""Of so many rows, the first is compared."""

_MOST_KNOWN = 64
"""A column with more texts holds no labels."""


class WatchedColumn(Protocol):
    """A column to watch while a table is read."""

    @property
    def column(self) -> int:
        """Its index."""

    def watch(self, rows: RowWatch) -> ColumnWatch:
        """Return what watches it in one reading of the table."""


class ColumnWatch(ABC):
    """Watches one column from the first row to the last.

    `is_over`: whether the column needs no more watching
    `of_whole_rows`: whether it is shown only the rows that have all numbers to read
    """

    is_over = False
    of_whole_rows = True

    @abstractmethod
    def see_values(self, values: pa.Array | pa.ChunkedArray, places: Intp) -> None:
        """Add cells of further rows.

        `places`: the rows in the whole table, counted from 0, shape ``(N,)``
        """

    @abstractmethod
    def finish(self) -> None:
        """Judge the last rows."""


class Watched(NamedTuple):
    """A column of labels to watch while a table is read.

    `column`: its index
    `turns`: returns the labels that take turns in some runs, given with their numbers of rows
    `found`: called once, with labels that take turns and the row from which on, counted from 1;
        raises an error, unless all series are wanted
    `changed`: called once, at the end, if a label follows another: with both, and the first row of
        the second, counted from 1
    """

    column: int
    turns: Callable[[Sequence[tuple[str, int]]], tuple[str, ...]]
    found: Callable[[tuple[str, ...], int], None]
    changed: Callable[[str, str, int], None] | None = None

    def watch(self, rows: RowWatch) -> LabelWatch:  # noqa: ARG002  # as of other columns
        """Return what watches it in one reading of the table."""
        return LabelWatch(self)


def bare_frame(frame: str) -> str:
    """Return the name of a frame in tf2, without the leading slash of tf."""
    return frame.removeprefix("/")


def alternating(runs: Iterable[tuple[str, int]]) -> tuple[str, ...]:
    """Return the labels that take turns with each other, sorted; empty if there are none."""
    # Values of counters, of consecutive blocks and of damaged cells occur in one run only.
    times = Counter(label for label, _ in runs)
    turns = sorted(label for label, count in times.items() if count > 1)
    return tuple(turns) if len(turns) > 1 else ()


class LabelWatch(ColumnWatch):
    """Watches the labels of one column, and reports where series take turns.

    Rows are judged in windows. Another one begins with each new label, so that a series that begins
    late is not lost among the many rows before it.
    """

    def __init__(self, watched: Watched) -> None:
        self._watched = watched
        self._known: set[str] = set()
        self._runs: list[tuple[str, int]] = []
        self._last: tuple[str, ...] = ()
        self._begin = self._rows = 0
        self._change: tuple[str, str, int] | None = None

    def see_values(self, values: pa.Array | pa.ChunkedArray, places: Intp) -> None:
        """Add cells of further rows."""
        self.see(_runs_in(values, places))

    def finish(self) -> None:
        """Judge the last rows."""
        self.judge()
        if self._change and self._watched.changed:
            self._watched.changed(*self._change)

    def see(self, runs: Iterable[Run]) -> None:
        """Add the runs of further rows."""
        for label, rows, begin in runs:
            if label not in self._known:
                self.judge()
                if all((label, *self._last)) and self._last and self._change is None:
                    self._change = self._last[0], label, begin + 1
                self._known.add(label)
                self.is_over |= len(self._known) > _MOST_KNOWN
                # The row before is of the series that the new one takes turns with.
                self._runs, self._begin = [(name, 1) for name in self._last], begin
                self._rows = len(self._runs)
            self._last = (label,)
            if self.is_over:
                return
            left = rows
            while left:
                if not self._rows:
                    self._begin = begin + rows - left
                added = min(left, WINDOW - self._rows)
                same = self._runs.pop()[1] if self._runs and self._runs[-1][0] == label else 0
                self._runs.append((label, same + added))
                self._rows += added
                left -= added
                if self._rows == WINDOW:
                    self.judge()

    def judge(self) -> None:
        """Report labels that take turns in the window, and begin the next one."""
        runs, self._runs, self._rows = self._runs, [], 0
        if len(runs) > 1 and not self.is_over and (labels := self._watched.turns(runs)):
            self.is_over = True
            self._watched.found(labels, self._begin + 1)


class CellSamples(ColumnWatch):
    """Keeps the cells of every :data:`EVERY`-th row, from the first to the last."""

    of_whole_rows = False

    def __init__(self) -> None:
        self.places: list[int] = []
        self.cells: list[object] = []

    def see_values(self, values: pa.Array | pa.ChunkedArray, places: Intp) -> None:
        """Add cells of further rows."""
        kept = np.flatnonzero(places % EVERY == 0)
        if len(kept):
            self.places += places[kept].tolist()
            self.cells += map(_text, cells_of(values.take(kept)))

    def finish(self) -> None:
        """Judge nothing: what compares the cells does."""


class Shown(NamedTuple):
    """Cells of a watched column.

    `places`: their rows in the whole table, counted from 0, shape ``(N,)``
    `of_whole_rows`: whether they are only of rows that have all numbers to read
    """

    column: int
    values: pa.Array | pa.ChunkedArray
    places: Intp
    of_whole_rows: bool


class RowWatch:
    """Watches columns in one reading of a table."""

    def __init__(self, watched: Sequence[WatchedColumn]) -> None:
        self._columns: dict[int, list[ColumnWatch]] = {}
        self._sampled: dict[int, CellSamples] = {}
        for each in watched:
            self._columns.setdefault(each.column, []).append(each.watch(self))

    def sampled(self, column: int) -> CellSamples:
        """Return the cells of a column that are kept of a few rows, and keep them from now on."""
        if column not in self._sampled:
            self._sampled[column] = CellSamples()
            self._columns.setdefault(column, []).append(self._sampled[column])
        return self._sampled[column]

    def columns(self, *, of_whole_rows: bool | None = None) -> list[int]:
        """Return the columns that are still watched, of the rows that they are shown; None: all."""
        return [k for k in self._columns if self._watches(k, of_whole_rows)]

    def _watches(self, column: int, of_whole_rows: bool | None) -> list[ColumnWatch]:
        return [
            watch
            for watch in self._columns[column]
            if not watch.is_over and of_whole_rows in {None, watch.of_whole_rows}
        ]

    def shown(
        self, numbers: Float64, places: Intp, values: Callable[[int], pa.Array | pa.ChunkedArray]
    ) -> Iterator[Shown]:
        """Yield the cells of the columns that are still watched.

        `numbers`: all numbers to read of some rows, NaN if absent, shape ``(N, k)``
        `values`: returns the cells of a column in these rows
        """
        for k in self.columns(of_whole_rows=False):
            yield Shown(k, values(k), places, of_whole_rows=False)
        if not (labels := self.columns(of_whole_rows=True)):
            return
        from quatprop.base.arrow_arrays import to_arrow  # pyarrow is slow to import

        is_whole: Bool = np.logical_not(np.isnan(numbers).any(axis=1))
        for k in labels:
            cells = values(k) if is_whole.all() else values(k).filter(to_arrow(is_whole))
            yield Shown(k, cells, places[is_whole], of_whole_rows=True)

    def see(self, shown: Iterable[Shown]) -> None:
        """Add cells of further rows."""
        for column, values, places, of_whole_rows in shown:
            for watch in self._watches(column, of_whole_rows):
                watch.see_values(values, places)

    def finish(self) -> None:
        """Judge the last rows."""
        for watch in chain.from_iterable(self._columns.values()):
            watch.finish()


def _runs_in(values: pa.Array | pa.ChunkedArray, places: Intp) -> list[Run]:
    """Return the runs of a column of text or integers; a missing value is ``""``.

    `places`: the rows of the values in the whole table, shape ``(N,)``
    """
    import pyarrow as pa
    import pyarrow.compute as pc  # slow to import, and not needed without labels

    runs: list[Run] = []
    begin = 0
    for chunk in values.chunks if isinstance(values, pa.ChunkedArray) else [values]:
        if not len(chunk):
            continue
        encoded = pc.run_end_encode(chunk)
        ends = encoded.run_ends.to_numpy()
        begins = np.concatenate([[0], ends[:-1]])
        counts, at = (ends - begins).tolist(), places[begin + begins].tolist()
        for cell, rows, place in zip(encoded.values.to_pylist(), counts, at, strict=True):
            runs.append(Run(_label(cell), rows, place))
        begin += len(chunk)
    return runs


def _label(cell: object) -> str:
    if isinstance(cell, bytes):
        return cell.decode(errors="replace").strip()
    # JSON does not tell integers from floats.
    whole = int(cell) if isinstance(cell, float) and cell.is_integer() else cell
    return "" if whole is None else f"{whole}".strip()


def cells_of(values: pa.Array | pa.ChunkedArray) -> list[object]:
    """Return values as Python has them; its own times have no nanoseconds."""
    import pyarrow as pa

    if pa.types.is_timestamp(values.type):
        values = values.cast(pa.int64())
    elif pa.types.is_time(values.type):
        values = values.cast(pa.string())
    cells: list[object] = values.to_pylist()
    return cells


def _text(cell: object) -> object:
    text = cell.decode(errors="replace") if isinstance(cell, bytes) else cell
    return text.strip() if isinstance(text, str) else text
