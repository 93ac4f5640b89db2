"""The common model of logs of all formats: named tables of columns.

A topic is a table with the flattened fields of its message definition as columns; a file of rows is
one table; a list of transforms is a table of its elements. The meaning of columns is in
:mod:`quatprop.logs.vocabulary.sources`.
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
"""Columns read together, by index: float64, ``(N, k)``; a single one as stored, ``(N,)``."""


class Column(NamedTuple):
    """A column of a table.

    `text`: name in the log; for messages, the dotted path of the field
    `key`: name in lower case without the unit, words joined by ``_``, levels by ``.``
    `unit`: unit declared by the name; ``""``: none
    `code`: numpy's type string without byte order, if known
    """

    text: str
    key: str
    unit: str = ""
    code: str = ""


class TablePart(NamedTuple):
    """A struct of known type in each message, or the whole of a file.

    `prefix`: prefix of the names of its columns, such as ``"imu."``
    `type`: its type; ``""`` for a file
    `begin`, `end`: its columns are ``columns[begin:end]``
    """

    prefix: str
    type: str
    begin: int
    end: int


class Stamp(NamedTuple):
    """The source of the timestamps of rows, and a selection of rows.

    `columns`: one column, or two of seconds and their fraction; empty for the log's own times
    `units`: unit of each column
    `clock`: ``"header"``, ``"log"``, ``"publish"``, or names of columns
    `sample_rate`: rate of the rows, or of the counter in `columns`, Hz; None: not counted
    `utc_offset_ns`: offset of the time from UTC, ns, if the header declares one
    `series`: columns and labels of the rows to read; empty: all rows
    """

    columns: Group = ()
    units: tuple[str, ...] = ()
    clock: str = "header"
    sample_rate: Fraction | float | None = None
    utc_offset_ns: int = 0
    series: tuple[tuple[int, str], ...] = ()


class TableNotes(NamedTuple):
    """Facts that a table declares besides its column names.

    `sample_rate`: rate of the rows, Hz; None: not declared
    `units`: column index -> unit declared by its type, or before the header
    `rate_scale`: scale factor of stored rates
    `title`: first line before the header
    `mount`: mounting of the sensor as signed axes, such as ``"y,-x,z"``; ``""``: none declared, or
        not rotated
    `dates`: columns of dates, and whether they have a time zone
    `texts`: columns of text
    """

    sample_rate: float | None = None
    units: Mapping[int, str] = MappingProxyType({})
    rate_scale: float = 1.0
    title: str = ""
    mount: str = ""
    dates: Mapping[int, bool] = MappingProxyType({})
    texts: frozenset[int] = frozenset()


class Span(NamedTuple):
    """Timestamps of a part of a table.

    `first_ns`, `last_ns`: earliest and latest timestamp, ns
    `rows`: number of rows
    """

    first_ns: int
    last_ns: int
    rows: int


class TimeRange(NamedTuple):
    """A time range, ends included, ns."""

    first_ns: int
    last_ns: int

    @property
    def length_ns(self) -> int:
        """Length, ns."""
        return self.last_ns - self.first_ns

    def overlaps(self, first_ns: int, last_ns: int) -> bool:
        """Return whether it overlaps another range, ends included."""
        return first_ns <= self.last_ns and self.first_ns <= last_ns


class Table(ABC):
    """Rows of named columns in a log.

    `name`: topic; ``""`` for a file
    `type`: message type; ``""`` for a file
    `log_clocks`: times of each row that the log itself records: ``"log"``, ``"publish"``
    `is_decodable`: whether its rows can be read
    `is_typed`: whether its columns have message types; if not, only names tell their meaning
    `is_secondary`: whether its signal is also in another, main table
    `matches`: cache of columns that match a pattern, shared by tables with the same columns
    `first`: cache of the first rows
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
        """Facts that a file declares besides its column names."""
        return TableNotes()

    @property
    @abstractmethod
    def columns(self) -> Sequence[Column]:
        """The columns, in the order of the definition or of the file."""

    @property
    @abstractmethod
    def parts(self) -> Sequence[TablePart]:
        """All structs that occur exactly once per row, outermost first."""

    @abstractmethod
    def columns_of(self, name: str) -> Group | None:
        """Return the columns of a field; None if there is no such field."""

    def field_of(self, group: Group) -> str:
        """Return the names of columns for a setting."""
        return ",".join(self.columns[k].text for k in group)

    def refuse_unknown(self, name: str) -> None:  # noqa: B027  # of some tables
        """Raise an error that lists the fields, if a field does not exist."""

    def may_contain(self, types: Iterable[str]) -> bool:  # noqa: ARG002  # of some tables
        """Return whether one of some types may be among its parts, by a fast test."""
        return True

    def transforms(self, way_out: str) -> Iterator[tuple[tuple[str, str], Float64]]:  # noqa: ARG002
        """Yield the frames (parent, child) and the rotation of each transform in the table."""
        return iter(())

    def of_series(self, labels: Sequence[str]) -> Table:  # noqa: ARG002  # of messages
        """Return the rows of one series, such as the transforms between two frames.

        `labels`: for transforms ``"child"`` or ``"parent:child"``; empty: the only series
        """
        return self

    def label_columns(self) -> Mapping[int, bool]:
        """Return the columns that begin with text or an integer, and whether it is an integer."""
        return {}

    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:  # noqa: ARG002
        """Return the cells of the first rows of a file; empty if they cannot be read."""
        return []

    def texts(self, name: str) -> list[str]:  # noqa: ARG002  # of some tables
        """Return the values of a text field in the first rows; empty if it cannot be read."""
        return []

    @abstractmethod
    def read(
        self,
        stamp: Stamp,
        groups: Sequence[Group],
        convert: Convert,
        within: Within = None,
    ) -> Iterator[RowBatch]:
        """Yield batches with timestamps, ns, and groups of columns as values, after conversion.

        Rows that cannot be decoded or converted are noted as losses.

        `within`: a range of :meth:`recorded_span`, or some of the parts of :meth:`spans`; None: all
        """

    def recorded_span(self) -> TimeRange | None:
        """Return the range of log times, if the log has an index of them; else None."""
        return None

    def spans(self, stamp: Stamp) -> Sequence[Span] | None:  # noqa: ARG002  # of some tables
        """Return the timestamps of each part of the log; None without an index of them."""
        return None

    @abstractmethod
    def peek(
        self, stamps: Sequence[Stamp], groups: Sequence[Group], *, is_strict: bool = False
    ) -> Iterator[RowBatch]:
        """Yield timestamps, ns, and groups of columns from the first row on, without noting losses.

        Rows that do not fit are omitted, or refused if `is_strict`.
        """

    def in_order(self, batches: Iterable[RowBatch]) -> Iterator[RowBatch]:
        """Return batches in the order in which :meth:`read` yields rows."""
        return iter(batches)

    def provenance(self) -> JsonObject:
        """Return the provenance in the log; empty if there is none."""
        return {}

    @abstractmethod
    def remark(self, code: str, text: str) -> None:
        """Add a remark on the log, unless it is there already."""
