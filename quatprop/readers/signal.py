"""Signals of a log, body rates or attitudes, and how to read them."""

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

    `name`: topic, or names of columns
    `type_name`: message type, or program that wrote a table; may be ``""``
    `field`: message field, columns, or frames
    `clock`: ``"header"``, ``"log"``, ``"publish"``, or the name of a column
    """

    name: str
    type_name: str
    field: str
    clock: str
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateSignal(Signal):
    """Body rates of a log; see also :class:`Signal`.

    `unit`: stored unit, ``"rad/s"`` or ``"deg/s"``
    `unit_is_given`: whether the user gave the unit
    `method`: the integration rule that the message definition implies, if any
    `increments`: whether samples are increments, integrated by the sensor
    `matches`: columns in the log, one match for each message definition of the topic; none in
        memory
    `series`: the rates in memory
    `is_logged`: whether the whole log is read, with log times
    """

    unit: str
    unit_is_given: bool = False
    method: str | None = None
    increments: bool = False
    matches: tuple[Match, ...] = ()
    series: GyroSeries | None = None
    is_logged: bool = False

    def rows(self, within: Within = None, *, at_first: bool = False) -> Iterator[RowBatch]:
        """Read the samples; values are the first arguments of :class:`quatprop.series.GyroSeries`.

        `within`: parts of the log; None: all
        `at_first`: read the beginning for checks, which share the decoded rows
        """
        readings = map(rates_of, self.matches)
        streams = [one.first() if at_first else one.rows(within) for one in readings]
        return streams[0] if len(streams) == 1 else merge_by_time(streams)

    def batches(self, within: Within = None, *, at_first: bool = False) -> Iterator[GyroSeries]:
        """Read the samples, rad/s and ns, in batches, in the order of the log."""
        if self.series is not None:
            yield self.series
        for rows in self.rows(within, at_first=at_first):
            t_ns, rate, *spans = rows.values
            log_ns = rows.log_ns if self.is_logged else None
            yield GyroSeries(t_ns, rate, spans[0] if spans else None, self.method == "end", log_ns)

    def part_reader(self) -> PartReader | None:
        """Return the reader of parts of the log; None if it can only be read as a whole."""
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

    `match`, `covariance`, `position`: their columns in the log
    `layout`: stored layout, ``"scalar-first"`` or ``"scalar-last"``; ``"by name"`` if named
        components are in another order; ``""`` for other representations
    `meaning`: convention of the stored numbers
    `provenance`: provenance in the metadata of the file
    `representation`: ``"quaternion"`` or a key of
        :data:`quatprop.conventions.representations.REPRESENTATIONS`
    `placeholder`: whether it is the identity in every message, so never set
    `rotation_columns`: columns of a table with the same attitudes in other representations
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
        self, *, positions: bool = False, covariances: bool = False, logged: bool = False
    ) -> Rows:
        """Read the arguments of :class:`quatprop.series.AttitudeSeries`, batch by batch.

        They are in the order of the log, and not validated: see
        :mod:`quatprop.logs.signals.quaternion_check`. Columns not requested are None; log times are
        appended for messages if requested.
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
        """Read timestamps and quaternions."""
        return ((t_ns, wxyz) for t_ns, wxyz, *_ in self.read())

    def refuse_placeholder(self, path: Path | str, way_out: str) -> None:
        """Refuse an orientation that was never set."""
        if self.placeholder:
            raise LogError(
                path,
                f"the orientation of {quoted(self.name)} is the identity in every message: a "
                f"placeholder, not an attitude; {way_out}",
            )
