"""The model of a log: named tables of columns, whatever its format.

A topic is a table whose message definition is flattened to columns; a file of rows is one table; a
list of transforms is a table of its elements. What a column means is said in
:mod:`quatprop.logs.vocabulary.sources`, not here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from fractions import Fraction
    from pathlib import Path

    from quatprop.arrays import Float64
    from quatprop.provenance import JsonObject
    from quatprop.tables.batches import RowBatch

    Convert = Callable[[RowBatch], RowBatch]
    Within: TypeAlias = "TimeRange | frozenset[int] | None"

Group: TypeAlias = tuple[int, ...]
"""Columns read together, by number: ``(N, k)`` of float64; a single one ``(N,)`` as stored."""


class Column(NamedTuple):
    """A column of a table.

    `text`: its name as the log spells it; of a message the dotted path of the field
    `key`: in lower case, words joined by ``_``, levels by ``.``, without its unit
    `unit`: the unit that its name declares; ``""`` where it declares none
    `code`: numpy's type string without byte order, where the definition says it
    """

    text: str
    key: str
    unit: str = ""
    code: str = ""


class TablePart(NamedTuple):
    """A struct in every message, or all of a file: a type and where it is.

    `prefix`: what the names of its columns begin with: ``""``, or ``"imu."``
    `type`: its type; ``""`` of a file
    `begin`, `end`: its columns are ``columns[begin:end]``
    """

    prefix: str
    type: str
    begin: int
    end: int


class Stamp(NamedTuple):
    """What the time of a row is, and of which rows; a table turns it into exact int64 ns.

    `columns`: one column, or those of seconds and of their fraction; none for the log's own times
    `units`: the unit of each
    `clock`: ``"header"``, ``"log"``, ``"publish"``, or the names of columns
    `sample_rate`: rows a second, Hz, where they are counted instead, or what a counter counts a
        second
    `utc_offset_ns`: by how much the time is ahead of UTC, ns, where the header says so
    `series`: columns of a file and the labels that the rows to read have in them; none for all rows
    """

    columns: Group = ()
    units: tuple[str, ...] = ()
    clock: str = "header"
    sample_rate: Fraction | float | None = None
    utc_offset_ns: int = 0
    series: tuple[tuple[int, str], ...] = ()


class TableNotes(NamedTuple):
    """What a table declares besides its column names.

    `sample_rate`: rows a second, Hz, if the lines before the header declare it
    `units`: units by position that a column's type or the lines before the header declare
    `rate_scale`: what stored rates are multiplied by
    `title`: the first line, where lines come before the header
    `mount`: how the sensor is mounted, as signed axes such as ``"y,-x,z"``, if the lines before the
        header declare it; ``""`` where they do not, or where it is not turned
    """

    sample_rate: float | None = None
    units: Mapping[int, str] = MappingProxyType({})
    rate_scale: float = 1.0
    title: str = ""
    mount: str = ""
    dates: Mapping[int, bool] = MappingProxyType({})
    texts: frozenset[int] = frozenset()


class Span(NamedTuple):
    """The stamps of a part of a table.

    `first_ns`, `last_ns`: the earliest and the latest, ns
    """

    first_ns: int
    last_ns: int
    rows: int


class TimeRange(NamedTuple):
    """A range of time, ends included.

    `first_ns`, `last_ns`: its ends, ns
    """

    first_ns: int
    last_ns: int

    @property
    def length_ns(self) -> int:
        """Its length, ns."""
        return self.last_ns - self.first_ns

    def overlaps(self, first_ns: int, last_ns: int) -> bool:
        """Return whether it has a moment in common with another range, given by its ends."""
        return first_ns <= self.last_ns and self.first_ns <= last_ns


class Table(ABC):
    """Rows of named columns in a log.

    `name`: the topic; ``""`` of a file
    `type`: the message type; ``""`` of a file
    `log_clocks`: the times that the log itself has of each row: ``"log"``, ``"publish"``
    `is_decodable`: whether its rows can be read
    `is_typed`: whether its columns are of message types; else their names are all that there is
    `is_secondary`: whether it has the rows of another, main table
    `matches`: the columns whose names fit a pattern, and sets of them, once somebody has requested
        them; tables with the same columns share it
    `first`: the first rows, held until rows are read for good
    """

    name: str
    type: str
    path: Path
    matches: dict[object, Any]
    first: object = None
    kind = ""
    log_clocks: tuple[str, ...] = ()
    is_typed = False
    is_decodable = True
    is_secondary = False

    @property
    def notes(self) -> TableNotes:
        """What a file declares besides the names of its columns."""
        return TableNotes()

    @property
    @abstractmethod
    def columns(self) -> Sequence[Column]:
        """The columns, in the order of the definition or of the file."""

    @property
    @abstractmethod
    def parts(self) -> Sequence[TablePart]:
        """Every struct that each row has exactly once, outermost first."""

    @abstractmethod
    def columns_of(self, name: str) -> Group | None:
        """Return the numbers that a field or a column consists of; None where it is not there."""

    def field_of(self, group: Group) -> str:
        """Return columns as settings name them."""
        return ",".join(self.columns[k].text for k in group)

    def refuse_unknown(self, name: str) -> None:  # noqa: B027  # of some tables
        """Refuse a field that is not there, with what there is."""

    def may_contain(self, types: Iterable[str]) -> bool:  # noqa: ARG002  # of some tables
        """Tell cheaply whether one of some types may be among its parts."""
        return True

    def transforms(self, way_out: str) -> Iterator[tuple[tuple[str, str], Float64]]:  # noqa: ARG002
        """Yield parent and child frame and the rotation of each transform, of a table of them."""
        return iter(())

    def of_series(self, labels: Sequence[str]) -> Table:  # noqa: ARG002  # of messages
        """Return the rows of one series, such as those between two frames.

        `labels`: of transforms ``"child"`` or ``"parent:child"``; none for the only series
        """
        return self

    def label_columns(self) -> Mapping[int, bool]:
        """Return the columns that begin with text or a whole number, and whether it is a number."""
        return {}

    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:  # noqa: ARG002
        """Return cells of the first rows of a file; empty where they cannot be read."""
        return []

    def texts(self, name: str) -> list[str]:  # noqa: ARG002  # of some tables
        """Return what a text is in the first rows; nothing where it cannot be read."""
        return []

    @abstractmethod
    def read(
        self,
        stamp: Stamp,
        groups: Sequence[Group],
        convert: Convert,
        within: Within = None,
    ) -> Iterator[RowBatch]:
        """Yield batches of rows whose values are their times, ns, and the groups, converted.

        Rows that cannot be decoded, or that `convert` refuses by their positions, are left out and
        noted among the losses of the log.

        `within`: only the parts of the log with a range of :meth:`recorded_span`, or some of the
            parts of :meth:`spans`; None is all
        """

    def recorded_span(self) -> TimeRange | None:
        """Return when rows were recorded by an index that says it of each part of the log."""
        return None

    def spans(self, stamp: Stamp) -> Sequence[Span] | None:  # noqa: ARG002  # of some tables
        """Return which stamps each part of the log has; None where nothing says it."""
        return None

    @abstractmethod
    def peek(
        self, stamps: Sequence[Stamp], groups: Sequence[Group], *, is_strict: bool = False
    ) -> Iterator[RowBatch]:
        """Yield times, ns, and groups of columns, the first rows first; nothing is noted.

        Rows that do not fit are left out, or refused where it `is_strict`.
        """

    def in_order(self, batches: Iterable[RowBatch]) -> Iterator[RowBatch]:
        """Return rows in the order in which they are read."""
        return iter(batches)

    def provenance(self) -> JsonObject:
        """Return how the rows were made, as written beside them; empty where it is not."""
        return {}

    @abstractmethod
    def remark(self, code: str, text: str) -> None:
        """Add a remark on the log, once however often its rows are read."""
