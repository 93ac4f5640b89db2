"""A signal of a log: body rates or attitudes, their time base, and how to read them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

from quatprop.conventions import HAMILTON
from quatprop.errors import LogError
from quatprop.logs.signals.reading import attitudes_of, rates_of
from quatprop.series import GyroSeries
from quatprop.settings.choices import CORRECT_CONING
from quatprop.tables.batches import merge_by_time
from quatprop.text import Remark, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.arrays import Float64, Int64
    from quatprop.conditioning.time_range import PartReader
    from quatprop.conventions import AttitudeConvention
    from quatprop.logs.matching.find import Match
    from quatprop.logs.signals.attitude_covariance import CovarianceColumns
    from quatprop.provenance import JsonObject
    from quatprop.tables.batches import RowBatch
    from quatprop.tables.model import Group, Within

    Rows: TypeAlias = Iterator[
        tuple[Int64, Float64, Float64 | None, Float64 | None, *tuple[Any, ...]]
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signal:
    """One series of samples in a log.

    `name`: the topic, or the names of the columns
    `type_name`: the message type, or the dialect of a table; ``""`` where there is none
    `field`: the message field, the columns, or the frames
    `clock`: time base: ``"header"``, ``"log"``, ``"publish"``, or the name of a column
    """

    name: str
    type_name: str
    field: str
    clock: str
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateSignal(Signal):
    """Body rates of a log; takes the parameters of :class:`Signal` too.

    `unit`: unit in which they are stored, ``"rad/s"`` or ``"deg/s"``
    `unit_is_given`: whether it is the user who says so
    `method`: the integration rule that fits the sensor, where the definition of its messages says
        it
    `increments`: whether samples are increments, which the sensor has integrated
    `matches`: where they are in the log: one, or one for each definition that a topic was recorded
        with; none in memory
    `series`: the rates in memory
    `is_logged`: whether they are read as a whole, with the log times of their messages
    """

    unit: str
    unit_is_given: bool = False
    method: str | None = None
    increments: bool = False
    matches: tuple[Match, ...] = ()
    series: GyroSeries | None = None
    is_logged: bool = False

    def rows(self, within: Within = None, *, at_first: bool = False) -> Iterator[RowBatch]:
        """Read the samples: values are the first arguments of :class:`quatprop.series.GyroSeries`.

        `within`: some parts of the log; None is all
        `at_first`: to look at the beginning, of which what is decoded is shared
        """
        readings = map(rates_of, self.matches)
        streams = [one.first() if at_first else one.rows(within) for one in readings]
        return streams[0] if len(streams) == 1 else merge_by_time(streams)

    def batches(self, within: Within = None, *, at_first: bool = False) -> Iterator[GyroSeries]:
        """Read the samples, rad/s and ns, in batches in the order of the log."""
        if self.series is not None:
            yield self.series
        for rows in self.rows(within, at_first=at_first):
            t_ns, rate, *spans = rows.values
            log_ns = rows.log_ns if self.is_logged else None
            yield GyroSeries(t_ns, rate, spans[0] if spans else None, self.method == "end", log_ns)

    def part_reader(self) -> PartReader | None:
        """Return what reads parts of the log; None where it can only be read as a whole."""
        if self.is_logged or len(self.matches) != 1:
            return None
        from quatprop.logs.signals.range_readers import RangeReader, TableRangeReader

        table = self.matches[0].table
        if spans := table.spans(self.matches[0].stamp):
            return TableRangeReader(spans, self.batches)
        span = table.recorded_span()
        return None if span is None else RangeReader(span, self.rows, self.batches)

    def with_log_times(self) -> RateSignal:
        """Return the same rates with the log times of their messages."""
        return replace(self, is_logged=any(match.table.is_typed for match in self.matches))

    @property
    def samples(self) -> str:
        """What the samples are: ``"rates"``, ``"averages"`` or ``"increments"``."""
        if self.increments:
            return "increments"
        return "averages" if self.method == "end" else "rates"

    def method_used(self, wanted: str | None) -> tuple[str, str]:
        """Return the integration rule, and where it comes from.

        `wanted`: the method that the user has chosen; None: what the log says, or else ``"start"``
        """
        if self.increments and wanted in {None, "start", "mean"}:
            # Where the rate was known in between is lost: all three are the increment itself.
            return "end", "log"
        if wanted is not None:
            return wanted, "given"
        return (self.method, "log") if self.method else ("start", "default")

    def method_remarks(self, wanted: str | None) -> list[Remark]:
        """Return the remarks on a method that the user has chosen for this signal."""
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
    """Attitudes of a log; takes the parameters of :class:`Signal` too.

    `match`, `covariance`, `position`: where they are in the log, and what is beside them
    `layout`: how they are stored, ``"scalar-first"`` or ``"scalar-last"``; ``"by name"`` where the
        components have names and no such order; ``""`` for other representations
    `meaning`: what the stored numbers mean
    `provenance`: how the attitudes were made, as their file says
    `representation`: ``"quaternion"`` or a key of
        :data:`quatprop.conventions.representations.REPRESENTATIONS`
    `placeholder`: whether it is the identity in every message of a sensor: never set
    `rotation_columns`: columns of a table that hold the same attitudes in other representations
    """

    match: Match
    covariance: CovarianceColumns
    position: tuple[Group, ...]
    layout: str
    meaning: AttitudeConvention
    provenance: JsonObject
    representation: str = "quaternion"
    placeholder: bool = False
    rotation_columns: tuple[str, ...] = ()

    @property
    def has_positions(self) -> bool:
        """Whether positions are beside them."""
        return bool(self.position)

    @property
    def may_have_covariances(self) -> bool:
        """Whether covariances are beside them, unless they turn out not to be known."""
        return bool(self.covariance.columns) and self.meaning == HAMILTON

    @property
    def sigma_axes(self) -> str | None:
        """The axes of standard deviations beside them; None where a table has none."""
        return self.covariance.axes if self.covariance.are_sigmas else None

    def first(self) -> Iterator[tuple[Int64, Float64]]:
        """Read stamps and quaternions for who looks at the beginning alone."""
        for rows in attitudes_of(self.match).first():
            yield rows.values[0], self.meaning.converted(rows.values[1])

    def read(
        self, *, positions: bool = False, covariances: bool = False, logged: bool = False
    ) -> Rows:
        """Read the arguments of :class:`quatprop.series.AttitudeSeries`, batch after batch.

        They are in the order of the log, and not checked: see
        :mod:`quatprop.logs.signals.quaternion_check`. What is not wanted is None; those of messages
        go up to their log times if these are wanted.
        """
        wanted = (
            *(self.position if positions else ()),
            *(self.covariance.columns if covariances else ()),
        )
        batches = ((rows.log_ns, *rows.values) for rows in attitudes_of(self.match, wanted).rows())
        read: Iterator[tuple[Any, ...]] = (
            (t_ns, self.meaning.converted(wxyz), log_ns, *others)
            for log_ns, t_ns, wxyz, *others in batches
        )
        if covariances:
            read = self.covariance.in_body_axes(read)
        for t_ns, wxyz, log_ns, *others in read:
            of_position = others[0] if positions else None
            row = t_ns, wxyz, of_position, others[-1] if covariances else None
            yield (*row, None, log_ns) if logged and self.match.table.is_typed else row

    def rows(self) -> Iterator[tuple[Int64, Float64]]:
        """Read stamps and quaternions alone."""
        return ((t_ns, wxyz) for t_ns, wxyz, *_ in self.read())

    def refuse_placeholder(self, path: Path | str, way_out: str) -> None:
        """Refuse an orientation that was never set, in a log at a path."""
        if self.placeholder:
            raise LogError(
                path,
                f"the orientation of {quoted(self.name)} is the identity in every message: a "
                f"placeholder, not an attitude; {way_out}",
            )
