"""What a table is: named or numbered columns, and which of them to read."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeGuard

from quatprop.containers.base import Log

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.base import MessageLog
    from quatprop.selection import RateSelection
    from quatprop.series import GyroSeries
    from quatprop.tables.matching.column_matcher import Notes

    Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TimedColumns:
    """Which columns of a table to read as numbers, and which as the time.

    Parameters
    ----------
    numbers
        Positions of the columns of numbers.
    time
        Positions of the time column; of seconds and nanoseconds where they are two; empty where
        rows are counted at `sample_rate`.
    time_unit
        ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; of the first column where they are two.
    sample_rate
        Rows a second, Hz, where there is no time column.
    """

    numbers: tuple[int, ...]
    time: tuple[int, ...]
    time_unit: str = "ns"
    sample_rate: float | None = None


@dataclass(frozen=True, slots=True)
class TableColumns:
    """Which columns of a table are the time and the rates, and in what units.

    Parameters
    ----------
    rate
        Positions of the x, y and z rate columns.
    rate_unit
        ``"rad/s"`` or ``"deg/s"``.
    time
        Positions of the time column; of seconds and nanoseconds where they are two; empty where
        rows are counted at `sample_rate`.
    time_unit
        ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; of the first column where they are two.
    sample_rate
        Rows a second, Hz, where there is no time column.
    dialect
        The convention that was recognised, such as ``"EuRoC"``, or ``""`` where options said all.
    rate_scale
        What stored rates are multiplied by to be in `rate_unit`.
    method
        The method that fits what the sensor does, where the convention says it.
    remarks
        What the user should know of the choice.
    """

    rate: tuple[int, int, int]
    rate_unit: str
    time: tuple[int, ...]
    time_unit: str = "ns"
    sample_rate: float | None = None
    dialect: str = ""
    rate_scale: float = 1.0
    method: str | None = None
    remarks: tuple[str, ...] = ()

    @property
    def timed(self) -> TimedColumns:
        """The columns to read, whatever their numbers mean."""
        return TimedColumns(self.rate, self.time, self.time_unit, self.sample_rate)


class TableLog(Log):
    """Rows of named or numbered columns: CSV, Parquet, Feather."""

    @property
    @abstractmethod
    def notes(self) -> Notes:
        """What is known besides the column names."""

    @abstractmethod
    def columns(self) -> list[str]:
        """Return the column names in order; ``"0"``, ``"1"``... for a table without a header."""

    def provenance(self) -> dict[str, Any]:
        """Return how the content came about, as written beside it; empty where it is not.

        Raises
        ------
        DamagedLogError
            What is written there is not what this package writes.
        """
        return {}

    @abstractmethod
    def choose(self, selection: RateSelection) -> TableColumns:
        """Return which columns hold time and rates, from the options and the header.

        Raises
        ------
        NoRatesError
            No columns look like body rates and the options name none.
        UndeclaredError
            A unit or the time is said neither by the header nor by an option.
        """

    @abstractmethod
    def series(self, columns: TableColumns) -> Iterator[GyroSeries]:
        """Yield the chosen columns as rates in rad/s and stamps in ns, batch after batch."""

    @abstractmethod
    def rows(self, columns: TimedColumns) -> Iterator[tuple[NDArray[np.int64], Numbers]]:
        """Yield stamps in ns, shape ``(N,)``, and numbers as stored, shape ``(N, k)``."""


def is_table(log: MessageLog | TableLog) -> TypeGuard[TableLog]:
    """Tell a table from a container of messages."""
    return isinstance(log, TableLog)
