"""Signals of a log, body rates or attitudes, and the choice of one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeAlias, TypeVar

from quatprop.base.errors import (
    AmbiguousTopicError,
    LogError,
    NoAttitudesError,
    NoRatesError,
    NoSuchTopicError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.base.text import Remark, Setting, did_you_mean, listed, plain, quoted
from quatprop.kinematics.conventions import HAMILTON
from quatprop.kinematics.series import GyroSeries
from quatprop.readers.column_readings import attitudes_of, in_order, may_wrap, rates_of
from quatprop.readers.matching import Found, find
from quatprop.readers.tables.model import RowBatch, merge_by_time
from quatprop.readers.tables.running_times import periods_of
from quatprop.settings.quantities import CORRECT_CONING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from quatprop.base.arrays import Float64, Int64
    from quatprop.base.provenance import JsonObject
    from quatprop.kinematics.conventions import AttitudeConvention
    from quatprop.readers.attitude_quality import CovarianceColumns
    from quatprop.readers.matching import Match
    from quatprop.readers.tables.model import Group, Log, Within
    from quatprop.settings.reading import SignalSelection
    from quatprop.timeline.time_range import PartReader

    Rows: TypeAlias = Iterator[
        tuple[Int64, Float64, Float64 | None, Float64 | None, *tuple[Any, ...]]
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signal:
    """One series of samples in a log.

    `name`: topic, or names of columns
    `type_name`: message type, or program that wrote a table; may be ``""``
    `field`: message field, columns, or frames
    `clock`: ``"header"``, ``"log"``, ``"publish"``, or the name of a column
    `matches`: columns in the log, one match for each message definition of the topic and each
        file; none in memory
    `in_sequence`: whether several files are set one after another instead of merged by time
    """

    name: str
    type_name: str
    field: str
    clock: str
    matches: tuple[Match, ...] = ()
    remarks: tuple[Remark, ...] = ()
    in_sequence: bool = False

    @property
    def meant(self) -> tuple[object, ...]:
        """Properties that must be equal in series that are read as one."""
        return ()

    def row_count(self) -> int:
        """Return the approximate number of samples; 0 if unknown before reading."""
        return sum(match.table.row_count() or 0 for match in self.matches)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateSignal(Signal):
    """Body rates of a log; see also :class:`Signal`.

    `unit`: stored unit, ``"rad/s"`` or ``"deg/s"``
    `unit_is_given`: whether the user gave the unit
    `method`: the integration rule that the message definition implies, if any
    `increments`: whether samples are increments, integrated by the sensor
    `series`: the rates in memory
    """

    unit: str
    unit_is_given: bool = False
    method: str | None = None
    increments: bool = False
    series: GyroSeries | None = None

    @property
    def meant(self) -> tuple[object, ...]:
        """Properties that must be equal in series that are read as one."""
        return self.method, self.increments

    def rows(
        self, within: Within = None, *, at_first: bool = False, beside: Sequence[Group] = ()
    ) -> Iterator[RowBatch]:
        """Read the samples; values are the first arguments of :class:`.GyroSeries`.

        `within`: parts of the log; None: all
        `at_first`: read the beginning for checks, which share the decoded rows
        `beside`: columns, of each match, that are read as well, as the last value
        """
        readings = [*map(rates_of, self.matches, beside or [()] * len(self.matches))]
        if at_first:
            streams = [one.first() for one in readings]
            return streams[0] if len(streams) == 1 else merge_by_time(streams)
        return in_order(readings, self.matches, within, in_sequence=self.in_sequence)

    def batches(
        self,
        within: Within = None,
        *,
        at_first: bool = False,
        watch: Callable[[RowBatch], object] = len,
        beside: Sequence[Group] = (),
    ) -> Iterator[GyroSeries]:
        """Read the samples, rad/s and ns, in batches, in the order of the log; see :meth:`rows`.

        `watch`: receives the rows before
        """
        if self.series is not None:
            yield self.series
        for rows in self.rows(within, at_first=at_first, beside=beside):
            watch(rows)
            t_ns, rate, *spans = rows.values[: -1 if beside else None]
            yield GyroSeries(t_ns, rate, spans[0] if spans else None, self.method == "end")

    def part_reader(
        self, batches: Callable[[Within], Iterator[GyroSeries]] | None = None
    ) -> PartReader | None:
        """Return the reader of parts of the log; None if it can only be read as a whole.

        `batches`: reads the samples of parts; default: :meth:`batches`
        """
        if len(self.matches) != 1:
            return None
        from quatprop.readers.range_readers import RangeReader, TableRangeReader

        batches = batches or self.batches
        table = self.matches[0].table
        if spans := table.spans(self.matches[0].stamp):
            return TableRangeReader(spans, self.rows, batches)
        span = table.recorded_span()
        if span is None:
            return None
        match = self.matches[0]
        periods = periods_of(match.stamp.units[0]) if may_wrap(match) else ()
        return RangeReader(span, self.rows, batches, periods)

    @property
    def samples(self) -> str:
        """Kind of samples: ``"rates"``, ``"averages"`` or ``"increments"``."""
        if self.increments:
            return "increments"
        return "averages" if self.method == "end" else "rates"

    def method_used(self, wanted: str | None) -> tuple[str, str]:
        """Return the integration rule, and its origin: ``"given"``, ``"log"`` or ``"default"``.

        `wanted`: the user's method; None: that of the log, else ``"start"``
        """
        if self.increments and wanted in {None, "start", "mean"}:
            # For increments these rules are the same: the increment itself.
            return "end", "log"
        if wanted is not None:
            return wanted, "given"
        return (self.method, "log") if self.method else ("start", "default")

    def method_remarks(self, wanted: str | None) -> list[Remark]:
        """Return remarks on the user's method for this signal."""
        samples = self.samples
        if samples == "rates" or wanted in {None, "end"}:
            return []
        if wanted in CORRECT_CONING:
            remark = (
                f"method {wanted} adds to {samples} the coning that a sensor leaves out; method "
                "end fits sensors that correct for it themselves, such as those of PX4"
            )
            return [Remark("coning-added", remark)]
        if self.increments:
            remark = f"samples are increments, to which method {wanted} does not apply; end is used"
            return [Remark("method-unused", remark)]
        remark = (
            "each rate is the average over the interval before its timestamp, which is what method "
            f"{self.method} assumes; method {wanted} was used"
        )
        return [Remark("method-differs", remark)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttitudeSignal(Signal):
    """Attitudes of a log; see also :class:`Signal`.

    `covariance`, `position`: columns next to them
    `layout`: stored layout, ``"scalar-first"`` or ``"scalar-last"``; ``"by name"`` if named
        components are in another order; ``""`` for other representations
    `meaning`: convention of the stored numbers
    `provenance`: provenance in the metadata of the file
    `representation`: ``"quaternion"`` or a key of
        :data:`quatprop.kinematics.conventions.REPRESENTATIONS`
    `placeholder`: whether it is the identity in every message, so never set
    `rotation_columns`: columns of a table with the same attitudes in other representations
    """

    covariance: CovarianceColumns
    position: tuple[Group, ...]
    layout: str
    meaning: AttitudeConvention
    provenance: JsonObject
    representation: str = "quaternion"
    placeholder: bool = False
    rotation_columns: tuple[str, ...] = ()

    @property
    def match(self) -> Match:
        """Columns of the attitudes, of the first definition and file."""
        return self.matches[0]

    @property
    def meant(self) -> tuple[object, ...]:
        """Properties that must be equal in series that are read as one."""
        columns = tuple(column.text for column in self.match.table.columns)
        return self.representation, self.layout, self.meaning, self.covariance[1:], columns

    @property
    def has_positions(self) -> bool:
        """Whether the log has positions for the attitudes."""
        return bool(self.position)

    @property
    def may_have_covariances(self) -> bool:
        """Whether there are columns of covariances, which may still be unknown."""
        return bool(self.covariance.columns) and self.meaning == HAMILTON

    @property
    def sigma_axes(self) -> str | None:
        """Axes of the standard deviations in a table; None if it has none."""
        return self.covariance.axes if self.covariance.are_sigmas else None

    def first(self) -> Iterator[tuple[Int64, Float64]]:
        """Read timestamps and quaternions at the beginning, for checks."""
        for rows in attitudes_of(self.match).first():
            yield rows.values[0], self.meaning.converted(rows.values[1])

    def read(
        self, *, positions: bool = False, covariances: bool = False, others: Group = ()
    ) -> Rows:
        """Read the arguments of :class:`quatprop.kinematics.series.AttitudeSeries`, batch by batch.

        They are in the order of the log, and not validated: see
        :mod:`quatprop.readers.attitude_quality`. Columns not requested are None.

        `others`: further columns of numbers
        """
        wanted = (
            *([others] if others else ()),
            *(self.position if positions else ()),
            *(self.covariance.columns if covariances else ()),
        )
        readings = [attitudes_of(match, wanted) for match in self.matches]
        ordered = in_order(readings, self.matches, in_sequence=self.in_sequence)
        batches = (rows.values for rows in ordered)
        read: Iterator[tuple[Any, ...]] = (
            (t_ns, self.meaning.converted(wxyz), *others) for t_ns, wxyz, *others in batches
        )
        if covariances:
            read = self.covariance.in_body_axes(read)
        for t_ns, wxyz, *rest in read:
            carried = rest.pop(0).reshape(len(t_ns), -1) if others else None
            position = rest[0] if positions else None
            row = t_ns, wxyz, position, rest[-1] if covariances else None
            yield row if carried is None else (*row, None, None, carried)

    def group_of(self, names: Iterable[str]) -> Group:
        """Return the columns of these names, which hold numbers."""
        table, found = self.match.table, list[int]()
        for name in names:
            group = table.columns_of(name)
            if group is None:
                table.refuse_unknown(name)
                hint = did_you_mean(
                    name,
                    [column.text for column in table.columns],
                    f"the columns are {listed(column.text for column in table.columns)}",
                )
                raise UsageError(
                    f"{plain(table.path)}: {Setting('keep')}: no column {quoted(name)}{hint}"
                )
            found += group
        return tuple(found)

    def rows(self) -> Iterator[tuple[Int64, Float64]]:
        """Read timestamps and quaternions."""
        return ((t_ns, wxyz) for t_ns, wxyz, *_ in self.read())

    def refuse_placeholder(self, path: Path | str, remedy: str) -> None:
        """Refuse an orientation that was never set."""
        if self.placeholder:
            raise LogError(
                path,
                f"the orientation of {quoted(self.name)} is the identity in every message: a "
                f"placeholder, not an attitude; {remedy}",
            )


# Choose a signal among the candidates in a log.
#
# Nothing is guessed silently: inferences are in the remarks of the signal, and ambiguities are
# refused, with the setting that resolves them.


TABLE_SETTINGS = (
    "rate_cols",
    "quat_cols",
    "time_col",
    "sample_rate",
    "from_angle_unit",
    "from_euler",
)
"""Settings that apply only to files of rows."""

MESSAGE_SETTINGS = ("topic", "rate_field", "time_field", "quat_field", "frame")
"""Settings that apply only to logs of messages."""

SignalT = TypeVar("SignalT", bound=Signal)
SelectionT = TypeVar("SelectionT", bound="SignalSelection")


class Candidate(NamedTuple, Generic[SignalT]):
    """A possible signal in a log.

    `signal`: returns it, or raises a LogError or UsageError if something is not declared
    `preferred`: whether it takes precedence: measured over estimated and commanded rates, the
        attitude of a vehicle over those of its estimators
    """

    found: Found
    signal: Callable[[], SignalT]
    preferred: bool = True

    @property
    def topic(self) -> str:
        """The topic; ``""`` in a file."""
        return self.found.table.name

    @property
    def field(self) -> str:
        """The field; ``""`` in a file."""
        return self.found.field


class SignalKind(NamedTuple):
    """A kind of signal, rates or attitudes, for error messages.

    `name`: such as ``"body rates"``
    `secondary`: name of candidates that are not preferred
    `field`: the setting for the message field
    `none`: the error for a log without this kind
    """

    quantity: str
    name: str
    secondary: str
    field: str
    none: type[NoRatesError | NoAttitudesError]


BODY_RATES = SignalKind("rate", "body rates", "estimated body rates", "rate_field", NoRatesError)
ATTITUDES = SignalKind("quat", "attitudes", "secondary attitudes", "quat_field", NoAttitudesError)


def choose(log: Log, candidates: Sequence[Candidate[SignalT]], kind: SignalKind) -> SignalT:
    """Return the only signal among candidates."""
    preferred = [candidate for candidate in candidates if candidate.preferred] or candidates
    topics = [candidate.topic for candidate in preferred]
    if len(set(topics)) > 1:
        raise AmbiguousTopicError(
            log.path,
            f"several topics carry {kind.name}: {listed(topics)}; choose one with "
            f"{Setting('topic')}",
        )
    fields = list(dict.fromkeys(candidate.field for candidate in preferred))
    if len(fields) > 1:
        raise UsageError(
            f"{plain(log.path)}: messages of topic {quoted(topics[0])} carry several {kind.name}: "
            f"{listed(fields)}; choose one with {Setting(kind.field)}"
        )
    signal = preferred[0].signal()
    if len(preferred) > 1:
        signal = _joined(log, [signal, *(candidate.signal() for candidate in preferred[1:])])
    ignored = [candidate.topic for candidate in candidates if candidate not in preferred]
    if not ignored:
        return signal
    remark = Remark("ignored-signals", f"ignored {kind.secondary}: {listed(ignored)}")
    return replace(signal, remarks=(*signal.remarks, remark))


def _joined(log: Log, signals: list[SignalT]) -> SignalT:
    """Return the signal of a topic recorded with several message definitions, or in several files.

    Samples are merged by log time. Attitudes with several definitions are refused.
    """
    from quatprop.readers import several_files

    first = signals[0]
    matches = tuple(match for one in signals for match in one.matches)
    files = {match.table.path for match in matches}
    if len(files) == len(signals):
        several = f"{len(files)} files"
        text = f"{several} are read as one log, in the order of their times"
        if isinstance(first, RateSignal):
            several_files.refuse_other_columns(matches)
        if first.in_sequence:
            text = (
                f"{several} are read one after another, each from one interval after the end of "
                "the one before; how much time was between them is not known"
                f"{several_files.unlike_their_numbers(matches)}"
            )
        remark = Remark("several-files", text)
    else:
        several = f"{len(signals)} different message definitions"
        remark = Remark(
            "several-definitions",
            f"topic {quoted(first.name)} was recorded with {several}, each of which was read by "
            "its own",
        )
    what = f"topic {quoted(first.name)} was recorded with {several}"
    if any(one.meant != first.meant for one in signals):
        raise UnsupportedLogError(
            log.path,
            f"{what}, which cannot be merged; write the messages of each to a log of its "
            "own, by their times with `mcap filter`, or with `rosbag filter`",
        )
    rates = [match.stamp.sample_rate for match in matches]
    if len({*rates}) > 1 and None not in rates:
        if not first.in_sequence:
            each = listed(dict.fromkeys(f"{float(rate or 0):g} Hz" for rate in rates))
            raise UnsupportedLogError(
                log.path,
                f"{what}, at sample rates of {each}; name one file, or if they follow each other, "
                f"name them in order, with {Setting('in_sequence')}",
            )
    elif len(clocks := {s.clock for s in signals}) > 1:
        if not clocks & {"header", "log", "publish"}:
            raise UnsupportedLogError(
                log.path,
                f"{what}, with times in {listed(sorted(clocks))}; rename the columns of times so "
                "that they are named alike, or name one file",
            )
        raise UnsupportedLogError(
            log.path,
            f"{what}, and some have no header timestamp; choose {Setting('clock', 'log')}",
        )
    return replace(first, matches=matches, remarks=(*first.remarks, remark))


def candidates(log: Log, selection: SignalSelection, kind: SignalKind) -> list[Found]:
    """Return where a log has signals of a kind that match a selection, at least one.

    The columns of a file are matched later, by :attr:`Candidate.signal`.
    """
    tables = log.tables(selection.topic)
    field = getattr(selection, kind.field)
    is_file = any(not table.is_typed for table in tables or log.tables())
    why = "is for tables, and this log holds messages"
    if is_file:
        columns = Setting(f"{kind.quantity}_cols")
        why = "is for logs of messages and this is a table; choose columns with "
        why += f"{columns} and {Setting('time_col')}"
    if is_file and len(tables) > 1 and kind is BODY_RATES:
        from quatprop.readers import several_files

        several_files.refuse_parts_without_header(tables)
    for name in MESSAGE_SETTINGS if is_file else TABLE_SETTINGS:
        if getattr(selection, name, None) is not None:
            raise UsageError(f"{plain(log.path)}: {Setting(name)} {why}")
    for by_key in (False, True):
        found = (find(table, kind.quantity, field, by_key=by_key) for table in tables)
        if every := [*chain.from_iterable(found)]:
            return every
    if tables and field is not None:
        known = [
            f"{one.field} ({table.name})" for table in tables for one in find(table, kind.quantity)
        ]
        there = f"the {kind.name} that are recognised are {listed(known)}"
        if not known:
            if len(tables) == 1:
                # The error lists the fields of the message definition, if there is one.
                for part in field.split(","):
                    tables[0].refuse_unknown(part.strip())
                raise kind.none(log.path, map(str, tables))
            there = f"the topics are {listed(map(str, tables))}"
        raise UsageError(f"{plain(log.path)}: no message has a field {quoted(field)}; {there}")
    every_table = log.tables()
    carrying = [table.name for table in every_table if find(table, kind.quantity)]
    if selection.topic is None or not carrying:
        raise kind.none(log.path, map(str, every_table))
    choices = f"choose one of {listed(carrying)}"
    choices += did_you_mean(selection.topic, carrying) if len(carrying) > 1 else ""
    raise NoSuchTopicError(
        log.path, f"no topic {quoted(selection.topic)} that carries {kind.name}; {choices}"
    )
