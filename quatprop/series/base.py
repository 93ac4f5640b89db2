"""What series of rates and of attitudes have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from quatprop.errors import UsageError
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import pyarrow as pa

    from quatprop.arrays import AnyArray, Bool, Float64, Int64, Intp


@dataclass(frozen=True, slots=True, repr=False)
class Series:
    """Columns with a row for each stamp."""

    t_ns: Int64
    _rows: ClassVar[str]

    def _keep(self, **columns: AnyArray | None) -> None:
        """Keep columns as read-only arrays."""
        for name, values in columns.items():
            if values is not None:
                view = values.view()
                view.setflags(write=False)
                object.__setattr__(self, name, view)

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, chosen: slice | Bool | Intp) -> Self:
        """Return some rows: views for a slice, copies for a mask or positions."""

        def column(name: str) -> Any:
            values = getattr(self, name)
            return values[chosen] if isinstance(values, np.ndarray) else values

        columns = map(column, self.__match_args__)
        return self._of(columns) if isinstance(chosen, slice) else type(self)(*columns)

    @classmethod
    def _of(cls, columns: Iterable[Any]) -> Self:
        """Return a series of columns that are known to fit each other."""
        series = object.__new__(cls)
        for name, values in zip(cls.__match_args__, columns, strict=True):
            if isinstance(values, np.ndarray):
                values.setflags(write=False)
            object.__setattr__(series, name, values)
        return series

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return series, at least one and all with the same columns, as one."""
        if len(parts) == 1:
            return parts[0]

        def column(name: str) -> Any:
            values = [getattr(part, name) for part in parts]
            return np.concatenate(values) if isinstance(values[0], np.ndarray) else values[0]

        return cls._of(map(column, cls.__match_args__))

    def __repr__(self) -> str:
        name, t_ns = type(self).__name__, self.t_ns
        if not len(t_ns):
            return f"<{name}: no {self._rows}>"
        span = duration_text(int(t_ns[-1]) - int(t_ns[0]))
        return f"<{name}: {len(t_ns):,} {self._rows} over {span} from t = {t_ns[0]} ns>"

    def _table(self, columns: Mapping[str, Float64]) -> pa.Table:
        """Return a table of the stamps and of columns."""
        import pyarrow as pa

        from quatprop.series.arrow_arrays import series_schema, to_arrow

        arrays = [to_arrow(values) for values in (self.t_ns, *columns.values())]
        return pa.table(arrays, schema=series_schema(columns))

    @staticmethod
    def _data_frame(table: pa.Table) -> Any:
        try:
            import pandas  # noqa: F401, ICN001  # only whether it is there
        except ImportError as error:
            raise UsageError(
                "to_pandas() needs pandas; install it with pip install pandas"
            ) from error
        return table.to_pandas()
