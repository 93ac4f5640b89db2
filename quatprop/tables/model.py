"""The model of a log: named tables of columns, whatever its format.

A topic is a table whose message definition is flattened to columns; a file of rows is one table; a
list of transforms is a table of its elements. What a column means is said in
:mod:`quatprop.logs.vocabulary`, not here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from fractions import Fraction
    from pathlib import Path

    from quatprop.arrays import Int64
    from quatprop.containers.merge import Columns
    from quatprop.containers.time_range import TimeRange
    from quatprop.provenance import JsonObject

    Convert = Callable[[Columns], Columns]

Group: TypeAlias = tuple[int, ...]
"""Columns that are read together: rows ``(N, k)`` of float64; of one column ``(N,)`` as stored."""


class Column(NamedTuple):
    """A column of a table.

    Parameters
    ----------
    text
        Its name as the log spells it; of a message the dotted path of the field.
    key
        In lower case, words joined by ``_``, levels by ``.``, without its unit.
    unit
        The unit that its name declares; ``""`` where it declares none.
    code
        numpy's type string without byte order, where the definition says it.
    """

    text: str
    key: str
    unit: str = ""
    code: str = ""


class Part(NamedTuple):
    """A struct in every message, or all of a file: a type and where it is.

    Parameters
    ----------
    prefix
        What the names of its columns begin with: ``""``, or ``"imu."``.
    type
        Its type; ``""`` of a file.
    begin, end
        Its columns are ``columns[begin:end]``.
    """

    prefix: str
    type: str
    begin: int
    end: int


class Stamp(NamedTuple):
    """What the time of a row is; a table turns it into exact int64 ns.

    Parameters
    ----------
    columns
        One column, or those of seconds and of their fraction; none for the log's own times.
    units
        The unit of each.
    clock
        ``"header"``, ``"log"``, ``"publish"``, or the names of columns.
    sample_rate
        Rows a second, Hz, where they are counted instead.
    """

    columns: Group = ()
    units: tuple[str, ...] = ()
    clock: str = "header"
    sample_rate: Fraction | float | None = None


class Table(ABC):
    """Rows of named columns in a log.

    Attributes
    ----------
    name
        The topic; ``""`` of a file.
    type
        The message type; ``""`` of a file.
    path
        The log.
    """

    name: str
    type: str
    path: Path

    @property
    @abstractmethod
    def columns(self) -> Sequence[Column]:
        """The columns, in the order of the definition or of the file."""

    @property
    @abstractmethod
    def parts(self) -> Sequence[Part]:
        """Every struct that each row has exactly once, outermost first."""

    @abstractmethod
    def read(
        self,
        stamp: Stamp,
        groups: Sequence[Group],
        convert: Convert,
        within: TimeRange | None = None,
    ) -> Iterator[Columns]:
        """Yield batches of rows whose values are their times, ns, and the groups, converted.

        Rows that cannot be decoded, or that `convert` refuses by their positions, are left out and
        noted among the losses of the log.
        """

    @abstractmethod
    def times(self, stamp: Stamp) -> Iterator[Int64]:
        """Yield the times of all rows, ns, in no order; nothing is noted."""

    @abstractmethod
    def provenance(self) -> JsonObject:
        """Return how the rows were made, as written beside them; empty where it is not."""

    @abstractmethod
    def remark(self, text: str) -> None:
        """Add a remark on the log, once however often its rows are read."""
