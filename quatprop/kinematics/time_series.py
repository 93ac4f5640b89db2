"""Columns with one row per timestamp, and blocks of them.

Series are frozen, and hold read-only arrays. A whole log and a batch of it have the same type:
readers yield many short series in order, writers take them in order.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, fields
from itertools import chain, repeat, tee, zip_longest
from typing import TYPE_CHECKING, Any, ClassVar, Self, SupportsIndex, TypeVar, cast

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.times import duration_text
from quatprop.settings.parsers import moment

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from datetime import datetime

    import pyarrow as pa
    from numpy.typing import DTypeLike

    from quatprop.base.arrays import AnyArray, Bool, Float64, Int64, Intp


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Series:
    """Columns with one row per timestamp."""

    t_ns: Int64
    _rows: ClassVar[str]

    def _keep(self, **columns: AnyArray | None) -> None:
        """Store columns as read-only arrays."""
        for name, values in columns.items():
            if values is not None:
                view = values.view()
                view.setflags(write=False)
                object.__setattr__(self, name, view)

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, chosen: SupportsIndex | slice | Bool | Intp) -> Self:
        """Return some rows: a view for an index or a slice, a copy for a mask or positions."""
        if not isinstance(chosen, slice | np.ndarray | list):
            row = range(len(self))[chosen]
            chosen = slice(row, row + 1)

        def column(name: str) -> Any:
            values = getattr(self, name)
            return values[chosen] if isinstance(values, np.ndarray) else values

        columns = map(column, self.__match_args__)
        return self._of(columns) if isinstance(chosen, slice) else type(self)(*columns)

    def __iter__(self) -> Iterator[Self]:
        """Yield series of one row each."""
        return (self[row] for row in range(len(self)))

    def __eq__(self, other: object) -> bool:
        """Return whether all columns of two series are equal; NaN equals NaN.

        How they were stored or made does not matter.
        """
        if not isinstance(other, Series) or self.__match_args__ != other.__match_args__:
            return NotImplemented
        apart = {each.name for each in fields(cast("Any", self)) if not each.compare}
        names = [name for name in self.__match_args__ if name not in apart]
        return all(_same(getattr(self, name), getattr(other, name)) for name in names)

    __hash__ = None  # type: ignore[assignment]  # arrays are not hashable

    def between(
        self, start: str | int | datetime | None = None, end: str | int | datetime | None = None
    ) -> Self:
        """Return the rows of a time range, both ends included.

        Parameters
        ----------
        start, end
            As for :func:`quatprop.propagate`: RFC 3339, ns, a date, ``"+10s"`` from the first or
            ``"-30s"`` from the last row; None for no limit.

        Raises
        ------
        UsageError
            An argument is not a time, or the start is after the end.
        """
        given = [None if limit is None else moment(limit) for limit in (start, end)]
        if not len(self):
            return self[:]
        origin = {"clock": 0, "first": int(self.t_ns[0]), "last": int(self.t_ns[-1])}
        first_ns, last_ns = (
            None if limit is None else origin[limit.origin] + limit.ns for limit in given
        )
        if first_ns is not None and last_ns is not None and first_ns > last_ns:
            raise UsageError(
                f"the start is {duration_text(first_ns - last_ns)} after the end; swap them, or "
                "check units"
            )
        chosen = np.ones(len(self), bool)
        for limit_ns, keep in ((first_ns, np.greater_equal), (last_ns, np.less_equal)):
            if limit_ns is not None:
                chosen &= keep(self.t_ns, limit_ns)
        return self[chosen]

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> AnyArray:
        """Return the rates, shape ``(N, 3)``, rad/s, or the quaternions, ``(N, 4)``, wxyz."""
        columns: Sequence[str] = self.__match_args__
        values: AnyArray = getattr(self, columns[1])
        if copy is None:
            return np.asarray(values, dtype)
        return np.array(values, dtype, copy=copy)

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Export the table of :meth:`to_arrow` to pandas, polars, DuckDB and others."""
        return self.to_arrow().__arrow_c_stream__(requested_schema)

    @abstractmethod
    def to_arrow(self) -> pa.Table:
        """Return a table of the timestamps and the columns."""

    def _repr_html_(self) -> str:
        """Return the first and the last rows, for notebooks."""
        table, few = self.to_arrow(), 3
        rows = [*range(min(few, len(self))), *range(max(few, len(self) - few), len(self))]
        cells = [[f"{column[row].as_py():.9g}" for column in table.columns[1:]] for row in rows]
        names = "".join(f"<th>{name}</th>" for name in table.column_names)
        lines = [
            f"<tr><td>{self.t_ns[row]}</td><td>{'</td><td>'.join(line)}</td></tr>"
            for row, line in zip(rows, cells, strict=True)
        ]
        if len(self) > 2 * few:
            lines.insert(few, f'<tr><td colspan="{len(table.column_names)}">...</td></tr>')
        title = repr(self).strip("<>")
        return f"<p>{title}</p><table><tr>{names}</tr>{''.join(lines)}</table>"

    @classmethod
    def _of(cls, columns: Iterable[Any]) -> Self:
        """Return a series of columns that are known to be valid."""
        series = object.__new__(cls)
        for name, values in zip(cls.__match_args__, columns, strict=True):
            if isinstance(values, np.ndarray):
                values.setflags(write=False)
            object.__setattr__(series, name, values)
        return series

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Concatenate series, at least one, that all have the same columns."""
        if len(parts) == 1:
            return parts[0]

        def column(name: str) -> Any:
            values = [getattr(part, name) for part in parts]
            return np.concatenate(values) if isinstance(values[0], np.ndarray) else values[0]

        return cls._of(map(column, cls.__match_args__))

    @classmethod
    def gathered(cls, parts: Iterable[Self], expected: int = 0) -> Self:
        """Concatenate a stream of series, at least one, that all have the same columns.

        The columns grow in place, so that all parts and the result are never in memory together.

        `expected`: number of rows, if it is known; NumPy fills what it adds to an array with zeros
        """
        stream = iter(parts)
        first, second = next(stream), next(stream, None)
        if second is None:
            return first
        values = [getattr(first, name) for name in cls.__match_args__]
        rows = len(first)
        # A damaged log may state any number.
        room = max(rows, min(expected, _MOST_ROOM * rows))
        columns = [_copy(one, room) if isinstance(one, np.ndarray) else one for one in values]
        for part in chain([second], stream):
            start, rows = rows, rows + len(part)
            for name, column in zip(cls.__match_args__, columns, strict=True):
                if isinstance(column, np.ndarray):
                    if rows > len(column):
                        _resize(column, rows + rows // 8)
                    column[start:rows] = getattr(part, name)
        for column in columns:
            if isinstance(column, np.ndarray):
                _resize(column, rows)
        return cls._of(columns)

    def __repr__(self) -> str:
        name, t_ns = type(self).__name__, self.t_ns
        if not len(t_ns):
            return f"<{name}: no {self._rows}>"
        span = duration_text(int(t_ns[-1]) - int(t_ns[0]))
        return f"<{name}: {len(t_ns):,} {self._rows} over {span} from t = {t_ns[0]} ns>"

    def _table(self, columns: Mapping[str, Float64]) -> pa.Table:
        """Return a table of the timestamps and of columns."""
        import pyarrow as pa

        from quatprop.base.arrow_arrays import series_schema, to_arrow
        from quatprop.kinematics.column_facts import column_facts

        arrays = [to_arrow(values) for values in (self.t_ns, *columns.values())]
        facts = column_facts([*columns], sigma_axes=getattr(self, "sigma_axes", None))
        return pa.table(arrays, schema=series_schema(columns, facts))

    @staticmethod
    def _data_frame(table: pa.Table) -> Any:
        try:
            import pandas  # noqa: F401, ICN001  # only to test that it is installed
        except ImportError as error:
            raise UsageError(
                "to_pandas() needs pandas; install it with pip install pandas"
            ) from error
        return table.to_pandas()


_MOST_ROOM = 1 << 8
"""Largest ratio of the room that is made ahead to the first part of a series."""


def _copy(column: AnyArray, rows: int) -> AnyArray:
    """Return a copy with room for a number of rows, which takes no memory before it is used."""
    copy = np.empty((rows, *column.shape[1:]), column.dtype)
    copy[: len(column)] = column
    return copy


def _resize(column: AnyArray, rows: int) -> None:
    # Operating systems remap the pages of large arrays, without a copy.
    column.resize((rows, *column.shape[1:]), refcheck=False)


def _same(mine: Any, theirs: Any) -> bool:
    if isinstance(mine, np.ndarray) and isinstance(theirs, np.ndarray):
        return np.array_equal(mine, theirs, equal_nan=True)
    return bool(mine is theirs or (type(mine) is type(theirs) is bool and mine == theirs))


# Blocks of fixed size, so that results do not depend on the sizes of batches.


Item = TypeVar("Item")
Samples = TypeVar("Samples", bound=Series)

BLOCK = 131_072
"""Samples in a block of :func:`reblock`: 4 MiB of rates, enough to amortise calls."""


IN_CACHE = 8192
"""Rows whose temporary arrays stay in the cache of a processor."""


def blocks(rows: int, size: int = BLOCK) -> Iterator[slice]:
    """Yield slices of `size` rows, to bound the memory of computations on them."""
    for start in range(0, rows, size):
        yield slice(start, start + size)


def rms(error: Float64) -> float:
    """Return the root of the mean square."""
    squares = sum(float((error[rows] ** 2).sum()) for rows in blocks(len(error)))
    return math.sqrt(squares / len(error))


def reblock(batches: Iterable[Samples], size: int = BLOCK) -> Iterator[Samples]:
    """Split a stream of samples at fixed sample indices, whatever its batches.

    Results of block-wise computations then have the same bits for all sizes of batches.
    """
    held: list[Samples] = []
    count = 0
    for batch in batches:
        start = 0
        while count + len(batch) - start >= size:
            stop = start + size - count
            yield batch.joined([*held, batch[start:stop]])
            held, count, start = [], 0, stop
        if start < len(batch):
            held.append(batch[start:])
            count += len(batch) - start
    if count:
        yield held[0].joined(held)


def with_next(items: Iterable[Item], *, look_ahead: bool) -> Iterator[tuple[Item, Item | None]]:
    """Yield each item with the next one; None after the last.

    `look_ahead`: whether to wait for the next one; otherwise it is always None
    """
    if not look_ahead:
        yield from zip(items, repeat(None), strict=False)
        return
    these, following = tee(items)
    next(following, None)
    yield from zip_longest(these, following)
