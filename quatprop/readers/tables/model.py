"""The common model of logs of all formats: named tables of columns.

A topic is a table with the flattened fields of its message definition as columns; a file of rows is
one table; a list of transforms is a table of its elements. The meaning of columns is in
:mod:`quatprop.readers.vocabulary`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeAlias, TypeVar

import numpy as np

from quatprop.base.errors import Losses, MessageError
from quatprop.base.text import quoted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from fractions import Fraction
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.base.arrays import Float64
    from quatprop.base.provenance import JsonObject
    from quatprop.base.text import Remark
    from quatprop.readers.tables.turns import WatchedColumn
    from quatprop.stores.objects import StoredLog

    Convert = Callable[["RowBatch"], "RowBatch"]
    Within: TypeAlias = "TimeRange | frozenset[int] | None"
    _Waiting = tuple[int, int, int, "RowBatch"]
    """First log time, stream and arrival of a held-back batch, its sort key; and the batch."""


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
    `watched`: columns of labels that must not take turns in these rows, or of their numbers
    `is_summed`: whether the column holds the intervals since the row before
    """

    columns: Group = ()
    units: tuple[str, ...] = ()
    clock: str = "header"
    sample_rate: Fraction | float | None = None
    utc_offset_ns: int = 0
    series: tuple[tuple[int, str], ...] = ()
    watched: tuple[WatchedColumn, ...] = ()
    is_summed: bool = False


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
    `packed`: names of columns with several samples a row, which are not read
    `unfit`: how the header does not fit the rows, so that its names are not used; ``""``: it does
    """

    sample_rate: float | None = None
    units: Mapping[int, str] = MappingProxyType({})
    rate_scale: float = 1.0
    title: str = ""
    mount: str = ""
    packed: tuple[str, ...] = ()
    dates: Mapping[int, bool] = MappingProxyType({})
    texts: frozenset[int] = frozenset()
    unfit: str = ""


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

    def are_decoded_with(self, columns: Group, others: Group) -> bool:  # noqa: ARG002  # of messages
        """Return whether columns can be decoded wherever others can."""
        return False

    def may_contain(self, types: Iterable[str]) -> bool:  # noqa: ARG002  # of some tables
        """Return whether one of some types may be among its parts, by a fast test."""
        return True

    def transforms(self, remedy: str) -> Iterator[tuple[tuple[str, str], Float64]]:  # noqa: ARG002
        """Yield the frames (parent, child) and the rotation of each transform in the table."""
        return iter(())

    def of_series(
        self,
        series: str | None,  # noqa: ARG002  # of messages
        frame: str | None,  # noqa: ARG002
        field: str,  # noqa: ARG002
    ) -> Table:
        """Return the rows of one series, such as the transforms between two frames.

        `series`: for messages, their frames or publishers, joined by commas; None: the only series
        `frame`: for transforms ``"child"`` or ``"parent:child"``
        `field`: the quantity that is read, whose header has the frame
        """
        return self

    def label_columns(self) -> Mapping[int, bool]:
        """Return the columns that begin with text or an integer, and whether it is an integer."""
        return {}

    def are_of_same_rows(self, columns: Sequence[int]) -> bool:  # noqa: ARG002  # of some tables
        """Return whether columns can be read together."""
        return True

    def head(self, columns: Sequence[int]) -> list[tuple[object, ...]]:  # noqa: ARG002
        """Return the cells of the first rows of a file; empty if they cannot be read."""
        return []

    def holds_text(self, group: Group) -> bool:  # noqa: ARG002  # of JSON
        """Return whether the numbers of some columns are written as text."""
        return False

    def frame_fields(self, field: str) -> tuple[str, ...]:  # noqa: ARG002  # of messages
        """Return the columns of the frames around a field: its own, and that of its body."""
        return ()

    def texts(self, name: str) -> list[str]:  # noqa: ARG002  # of some tables
        """Return the values of a text field in the first rows; empty if it cannot be read."""
        return []

    @abstractmethod
    def read(  # noqa: PLR0913, PLR0917  # what is read, and of which rows
        self,
        stamp: Stamp,
        groups: Sequence[Group],
        convert: Convert,
        within: Within = None,
        watched: str = "",
        beside: Group = (),
    ) -> Iterator[RowBatch]:
        """Yield batches with timestamps, ns, and groups of columns as values, after conversion.

        Rows that cannot be decoded or converted are noted as losses.

        `within`: a range of :meth:`recorded_span`, or some of the parts of :meth:`spans`; None: all
        `watched`: the quantity whose frames and publishers must not take turns; ``""``: none
        `beside`: columns that are read as the last group, NaN in rows where they do not fit
        """

    def recorded_span(self) -> TimeRange | None:
        """Return the range of log times, if the log has an index of them; else None."""
        return None

    def row_count(self) -> int | None:
        """Return the approximate number of rows; None if unknown before reading."""
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

    def remark_on_fraction(self, name: str, remedy: str) -> None:
        """Remark on a fraction of a second, in the field or column `name`, that exceeds one."""
        self.remark(
            "beyond-a-second",
            f"{quoted(name)}, the fraction of a second, reaches a second or more, and is added as "
            f"it is; if it is something else, choose other timestamps with {remedy}",
        )


# Base class of logs: tables and losses.


class SeriesRead(NamedTuple):
    """The messages read of the series of a topic.

    `messages`: how many of the chosen ones
    `frames`: their frames, in order of appearance
    `known`: the names of all series, also of those that were not chosen
    """

    messages: int
    frames: Sequence[str]
    known: Sequence[str]


class Log(ABC):
    """A log of any kind, open for reading; closed when its ``with`` block ends.

    `kind`: the key in :data:`quatprop.stores.kinds.READERS`
    `losses`: parts that could not be read so far
    `remarks`: possible problems found so far
    `definition_files`: files next to the log with message definitions
    `damage`: why the log ends early, if this is known when it is opened
    `unchecked_chunks`: number of chunks read in part, so without verifying their checksum
    `stored`: identity in an object store; None for a local file
    `joined`: the logs of all files that are read as one log; empty: only this one
    `series_read`: which series were read, by topic and by the names of chosen ones
    """

    kind: str
    joined: Sequence[Log] = ()
    series_read: Mapping[tuple[str, tuple[str, ...]], SeriesRead] = MappingProxyType({})
    stored: StoredLog | None = None
    remarks: Sequence[Remark] = ()
    definition_files: Sequence[Path] = ()
    damage: str = ""
    unchecked_chunks: int = 0

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses = Losses()

    @abstractmethod
    def tables(self, topic: str | None = None) -> Sequence[Table]:
        """Return the topics with messages, or a file as the only table, without a name.

        `topic`: name of the topics to return; None: all
        """

    def confirm(self) -> None:
        """Raise an error if the log was replaced in its store since it was opened."""
        if self.stored is not None:
            self.stored.confirm()

    def close(self) -> None:  # noqa: B027  # nothing to do where files are open only while read
        """Release files and temporary copies."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


# Merge batches of decoded rows by log time.
#
# A log may be split into files, and its chunks may overlap in time. Rows are held back only while a
# later batch may still precede them, so memory use is bounded by how far batches overlap.


Source = TypeVar("Source")
Result = TypeVar("Result")

NO_BOUND = int(np.iinfo(np.int64).min)
"""`watermark_ns` of a batch without a bound on later ones."""

_NEVER = int(np.iinfo(np.int64).max) + 1
"""Bound of a stream that has ended: after any log time."""


@dataclass(frozen=True, slots=True, eq=False)
class RowBatch:
    """Rows decoded from one block of messages.

    `log_ns`: log times, shape ``(N,)``, int64 ns
    `values`: columns of N rows each, shapes ``(N, ...)``
    `watermark_ns`: no later batch of this stream holds a row with an earlier log time
    """

    log_ns: NDArray[np.int64]
    values: tuple[NDArray[Any], ...]
    watermark_ns: int = NO_BOUND

    def __len__(self) -> int:
        return len(self.log_ns)

    def without(self, positions: Sequence[int]) -> RowBatch:
        """Return the rows except those at some positions."""
        return self.rows(np.delete(np.arange(len(self)), positions))

    def rows(self, selected: slice | NDArray[np.int64]) -> RowBatch:
        """Return selected rows: views for a slice, copies for indices."""
        return RowBatch(self.log_ns[selected], tuple(column[selected] for column in self.values))


def without_misfits(
    convert: Callable[[Source], Result],
    source: Source,
    leave_out: Callable[[Source, MessageError], Source],
) -> Result:
    """Convert rows or blocks of messages, leaving out those that `convert` refuses."""
    try:
        return convert(source)
    except MessageError as error:
        return without_misfits(convert, leave_out(source, error), leave_out)


def joined_rows(batches: Sequence[RowBatch]) -> RowBatch:
    """Return batches of one stream, at least one, as one batch."""
    if len(batches) == 1:
        return batches[0]
    columns = zip(*(batch.values for batch in batches), strict=True)
    values = tuple(np.concatenate(column) for column in columns)
    log_ns = np.concatenate([batch.log_ns for batch in batches])
    return RowBatch(log_ns, values, batches[-1].watermark_ns)


def merge_by_time(streams: Sequence[Iterable[RowBatch]]) -> Iterator[RowBatch]:
    """Merge streams of batches into one in order of log time.

    The result is a stable sort of all rows by log time, with equal times in order of stream and
    then of arrival, provided that no batch precedes the bound of its stream.

    A batch without a bound (:data:`.NO_BOUND`) is assumed to end before the
    next one of its stream begins, so its stream is not held in memory. Rows that precede the bound
    are yielded as soon as they are read, out of order.
    """
    iterators = [iter(stream) for stream in streams]
    bounds = [NO_BOUND] * len(iterators)
    waiting: list[_Waiting] = []
    for arrival in count():
        bound = min(bounds, default=_NEVER)
        if bound == _NEVER:
            return
        stream = bounds.index(bound)
        batch = next(iterators[stream], None)
        if batch is None:
            bounds[stream] = _NEVER
        elif len(batch) == 0:
            bounds[stream] = max(bound, batch.watermark_ns)
        else:
            batch = _sorted(batch)
            is_bounded = batch.watermark_ns != NO_BOUND
            later_ns = batch.watermark_ns if is_bounded else int(batch.log_ns[-1])
            bounds[stream] = max(bound, later_ns)
            heappush(waiting, (int(batch.log_ns[0]), stream, arrival, batch))
        if ready := _ready(waiting, bounds):
            yield _merged(ready)


def _ready(waiting: list[_Waiting], bounds: list[int]) -> list[_Waiting]:
    """Remove and return the held-back rows that no later row can precede.

    Rows at the lowest bound are ready unless its stream precedes theirs, and may still have rows of
    this time.
    """
    bound = min(bounds)
    holding = bounds.index(bound)
    ready = []
    while waiting and waiting[0][:2] <= (bound, holding):
        first_ns, stream, arrival, batch = heappop(waiting)
        if (int(batch.log_ns[-1]), stream) > (bound, holding):
            size = int(batch.log_ns.searchsorted(bound, "right" if stream <= holding else "left"))
            rest = batch.rows(slice(size, None))
            heappush(waiting, (int(rest.log_ns[0]), stream, arrival, rest))
            batch = batch.rows(slice(size))
        ready.append((first_ns, stream, arrival, batch))
    return ready


def _sorted(batch: RowBatch) -> RowBatch:
    """Return a batch sorted by log time; it usually is already."""
    if (batch.log_ns[1:] >= batch.log_ns[:-1]).all():
        return batch
    rows = batch.rows(np.argsort(batch.log_ns, kind="stable"))
    return RowBatch(rows.log_ns, rows.values, batch.watermark_ns)


def _merged(waiting: list[_Waiting]) -> RowBatch:
    """Return batches as one, with equal times in order of stream, then of arrival."""
    if len(waiting) == 1:
        part = waiting[0][3]
        log_ns, values = part.log_ns, part.values
    else:
        parts = [part for *_, part in sorted(waiting, key=lambda entry: entry[1:3])]
        log_ns = np.concatenate([part.log_ns for part in parts])
        order = np.argsort(log_ns, kind="stable")
        log_ns = log_ns[order]
        columns = zip(*(part.values for part in parts), strict=True)
        values = tuple(np.concatenate(column)[order] for column in columns)
    return RowBatch(log_ns, values, int(log_ns[-1]))
