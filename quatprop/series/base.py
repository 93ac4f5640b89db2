"""The base class of series of rates and of attitudes."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any, ClassVar, Self, SupportsIndex

import numpy as np

from quatprop.errors import UsageError
from quatprop.settings.parsers import moment
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from datetime import datetime

    import pyarrow as pa
    from numpy.typing import DTypeLike

    from quatprop.arrays import AnyArray, Bool, Float64, Int64, Intp


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

        The layout in which they were read does not matter.
        """
        if not isinstance(other, Series) or self.__match_args__ != other.__match_args__:
            return NotImplemented
        pairs = ((getattr(self, name), getattr(other, name)) for name in self.__match_args__)
        return all(_same(mine, theirs) for mine, theirs in pairs)

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
            An argument is not a time.
        """
        chosen = np.ones(len(self), bool)
        for limit, keep in ((start, np.greater_equal), (end, np.less_equal)):
            if limit is not None and len(self):
                wanted = moment(limit)
                origin = {"clock": 0, "first": int(self.t_ns[0]), "last": int(self.t_ns[-1])}
                chosen &= keep(self.t_ns, origin[wanted.origin] + wanted.ns)
        return self[chosen]

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> AnyArray:
        """Return the rates, shape ``(N, 3)``, rad/s, or the quaternions, ``(N, 4)``, wxyz."""
        columns: Sequence[str] = self.__match_args__
        values: AnyArray = getattr(self, columns[1])
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
    def gathered(cls, parts: Iterable[Self]) -> Self:
        """Concatenate a stream of series, at least one, that all have the same columns.

        The columns grow in place, so that all parts and the result are never in memory together.
        """
        stream = iter(parts)
        first, second = next(stream), next(stream, None)
        if second is None:
            return first
        values = [getattr(first, name) for name in cls.__match_args__]
        columns = [one.copy() if isinstance(one, np.ndarray) else one for one in values]
        rows = len(first)
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

        from quatprop.series.arrow_arrays import series_schema, to_arrow

        arrays = [to_arrow(values) for values in (self.t_ns, *columns.values())]
        return pa.table(arrays, schema=series_schema(columns))

    @staticmethod
    def _data_frame(table: pa.Table) -> Any:
        try:
            import pandas  # noqa: F401, ICN001  # only to test that it is installed
        except ImportError as error:
            raise UsageError(
                "to_pandas() needs pandas; install it with pip install pandas"
            ) from error
        return table.to_pandas()


def _resize(column: AnyArray, rows: int) -> None:
    # Operating systems remap the pages of large arrays, without a copy.
    column.resize((rows, *column.shape[1:]), refcheck=False)


def _same(mine: Any, theirs: Any) -> bool:
    if isinstance(mine, str | None) and isinstance(theirs, str | None):
        return True
    if isinstance(mine, np.ndarray) and isinstance(theirs, np.ndarray):
        return np.array_equal(mine, theirs, equal_nan=True)
    return bool(mine is theirs or (type(mine) is type(theirs) is bool and mine == theirs))
