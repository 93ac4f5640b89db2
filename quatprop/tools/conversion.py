"""Convert an attitude series."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.base import __version__
from quatprop.base.errors import Loss, OutputError, UsageError
from quatprop.base.places import without_secret
from quatprop.base.provenance import Digest, as_json, background_digest, entry_of
from quatprop.base.text import Remark, Setting, listed, quoted
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.conventions import (
    HAMILTON,
    NEAR_LOCK_DEG,
    QUATERNION,
    REPRESENTATIONS,
    AttitudeConvention,
    Signs,
)
from quatprop.kinematics.series import SIGMA_COLUMNS, AttitudeSeries, GyroSeries
from quatprop.propagation.attitude_input import (
    AttitudeInput,
    RecordedAttitudes,
    Resampling,
    open_attitudes,
)
from quatprop.propagation.job import open_output, with_format
from quatprop.propagation.report import ReportFile
from quatprop.stores.objects import split_topic
from quatprop.tools.attitude_changes import (
    RATE_COLUMNS,
    RATES,
    AxisChange,
    RelativeTo,
    rate_batches,
)
from quatprop.writers import holds_covariances, open_table, refuse_message
from quatprop.writers.base import FileWriter, attitude_table, column_table
from quatprop.writers.formats import WRITERS, format_remarks, layout_of
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from fractions import Fraction

    from quatprop.base.provenance import JsonObject
    from quatprop.kinematics.conventions import Layout
    from quatprop.propagation.settings import OutputSettings
    from quatprop.readers.attitude_quality import QuaternionCounts
    from quatprop.readers.signal import AttitudeSignal
    from quatprop.writers.base import Columns, TableWriter


# The destination of converted attitudes: a table, or a file of attitudes.


def kept_sigma(job: Conversion, source: AttitudeSignal, stored: str | None) -> str | None:
    """Return the axes of the stored standard deviations if they are kept, else None.

    They are kept if the output can store them, and both sides are Hamilton and body to reference:
    another direction or convention has them about other axes, and those about rotated axes cannot
    be computed from three standard deviations.
    """
    axes = source.sigma_axes
    mixes = job.axes is not None and axes is not None and job.axes.mixes(axes)
    if mixes or job.relative_to is not None:
        return None
    has_place = holds_covariances(job.output.kind, job.output.message)
    is_plain = job.meaning == HAMILTON and job.representation == QUATERNION
    return stored if has_place and is_plain and source.may_have_covariances else None


def open_destination(job: Conversion, sigma: str | None) -> FileWriter:
    """Open the writer of the output, which takes attitudes, or rates if the output is rates."""
    output = job.output
    if job.representation == QUATERNION:
        if job.meaning == HAMILTON and not job.more:
            return open_output(output, sigma)
        if job.meaning != HAMILTON:
            _refuse_other_conventions(job)
    _refuse_more(job)
    table = open_table(
        output.path,
        job.table_columns(sigma),
        output.to,
        comment=output.comment,
        facts=_facts_of(job, sigma),
    )
    table = _table_of(job, table, sigma)
    if job.more:
        table.rows = MoreColumns(job, table.rows)
    return table


def _facts_of(job: Conversion, sigma: str | None) -> dict[str, Mapping[str, str]]:
    """Return what the columns of a table are; of those that are carried along nothing is known."""
    from quatprop.kinematics.column_facts import column_facts

    own = job.columns(sigma)
    facts = column_facts(own, job.meaning, sigma)
    if job.list_column is not None:
        alike = job.representation != QUATERNION or own == job.layout.columns
        listed_facts = {job.list_column: facts[own[0]]} if alike else {}
        facts = {"t_ns": facts["t_ns"], **listed_facts}
    return {**facts, "seconds": {"unit": "s"}} if job.seconds else facts


class MoreColumns:
    """Adds further columns before and after those of the attitude."""

    def __init__(self, job: Conversion, rows: Callable[[Any], Columns]) -> None:
        self._job, self._rows = job, rows
        self._first_ns: int | None = None

    def __call__(self, series: AttitudeSeries | GyroSeries) -> Columns:
        """Return the seconds, the columns of the attitude, and those that are carried along."""
        t_ns, columns = self._rows(series)
        if self._first_ns is None and len(series):
            self._first_ns = int(series.t_ns[0])
        elapsed = [(series.t_ns - (self._first_ns or 0)) / NS_PER_S] if self._job.seconds else []
        others = getattr(series, "others", None)
        carried = () if others is None else map(np.ascontiguousarray, others.T)
        return t_ns, [*elapsed, *columns, *carried]


def _refuse_more(job: Conversion) -> None:
    """Refuse columns that the output, or the conversion, has no place for."""
    for name in job.more:
        able = [kind for kind, one in WRITERS.items() if (one.lists, one.columns)[name in TABLES]]
        if job.output.kind not in able:
            raise UsageError(
                f"{Setting(name)}: {job.output.kind} has no place for it; choose {listed(able)}"
            )
        if name == "keep" and (job.rate is not None or job.representation in RATES):
            other = Setting("rate") if job.rate is not None else job.representation
            raise UsageError(
                f"{Setting(name)} is for rows that are as in the source, not for {other}"
            )
    names = [*job.table_columns("body"), "t_ns"]
    twice = [name for name in job.keep if names.count(name) > 1]
    if twice or {"seconds", "t_ns"} & {job.list_column}:
        raise UsageError(
            f"{quoted((*twice, job.list_column)[0] or '')} is the name of another column of the "
            "output; name others"
        )


TABLES = ("keep", "seconds")
"""Settings that any table has a place for."""


def _table_of(job: Conversion, table: TableWriter, sigma: str | None) -> TableWriter:
    """Return the writer of attitudes to a table."""
    if job.representation == QUATERNION and job.meaning == HAMILTON:
        extra = job.output.extra_columns
        return attitude_table(table, job.layout, sigma, REPRESENTATIONS[extra] if extra else None)
    if job.representation in RATES:
        return column_table(table, lambda series: series.rate)
    if job.representation in REPRESENTATIONS:
        form = REPRESENTATIONS[job.representation]
        return column_table(table, lambda series: form.values(series.wxyz), form.locked)
    order = list(job.layout.order)
    return column_table(table, lambda series: series.wxyz[:, order])


def _refuse_other_conventions(job: Conversion) -> None:
    """Refuse formats that prescribe a convention."""
    output, kind = job.output, job.output.kind
    if not WRITERS[kind].columns:
        raise OutputError(
            output.path,
            f"kind {quoted(kind)} holds Hamilton quaternions body to reference by its own "
            f"definition; omit {Setting('convention')} and {Setting('direction')}, or choose "
            f"{listed(name for name, known in WRITERS.items() if known.columns)}",
        )
    refuse_message(kind, output.message)
    if output.extra_columns is not None:
        raise UsageError(
            f"{Setting('extra_columns')} requires Hamilton quaternions body to reference; omit "
            f"{Setting('convention')} and {Setting('direction')}"
        )


def remarks_on(
    job: Conversion,
    singular: int,
    *,
    positions_lost: bool,
    sigma_lost: bool,
    lost_columns: Sequence[str],
) -> Iterator[Remark]:
    """Yield remarks on the output.

    `positions_lost`: whether the source has positions and the output none
    `sigma_lost`: whether the source has standard deviations or covariances and the output none
    """
    yield from format_remarks(
        job.output.path, job.output.to, positions_lost=positions_lost, sigma_lost=sigma_lost
    )
    if lost_columns:
        yield Remark(
            "columns-lost",
            f"columns {listed(lost_columns)} are not kept; "
            f"{Setting('extra_columns')} writes such ones",
        )
    if singular:
        form = REPRESENTATIONS[job.representation]
        first, second, third = (name.rpartition("_")[0] for name in form.columns)
        yield Remark(
            "gimbal-lock",
            f"{singular} rows are within {NEAR_LOCK_DEG} deg of {second} "
            f"{' or '.join(map(str, form.lock_deg))} deg (gimbal lock), where only the sum or the "
            f"difference of {first} and {third} is determined; the attitude itself is correct",
        )
    output, meaning = job.output, job.meaning
    if meaning != HAMILTON and not output.keeps_provenance:
        yield Remark(
            "convention-unstated",
            f"the file does not record that it is {meaning.convention} {meaning.direction}; add "
            f"{Setting('header_comment')} or write Parquet",
        )


# The settings of a conversion, its report, and the provenance of its output.


@dataclass(frozen=True, slots=True)
class Conversion:
    """The settings of the conversion of one attitude series.

    `output`: target, format and layout
    `sign`: ``"keep"``, ``"continuous"`` or ``"positive"``. Rotation vectors of ``"keep"`` are the
        short ones, up to half a turn
    `representation`: ``"quaternion"``, a key of :data:`REPRESENTATIONS`, or of
        :data:`quatprop.tools.conversion.RATES`
    `left`, `right`: rotations of the reference axes and of the body axes to those of the output, in
        the notation of :func:`quatprop.kinematics.conventions.mounting`; None for no rotation
    `rate`: rate of interpolated attitudes, Hz; None for the attitudes of the source
    `relative_to`: the log of another body, to which attitudes are made relative before other steps
    `keep`: names of columns of the source that are carried along
    `seconds`: whether to write the time since the first attitude, s, in a column
    `list_column`: name of one column of lists for the attitude; None for a column each
    """

    source: AttitudeInput
    output: OutputSettings
    meaning: AttitudeConvention = HAMILTON
    sign: str = "keep"
    representation: str = QUATERNION
    left: str | None = None
    right: str | None = None
    rate: Fraction | None = None
    relative_to: str | None = None
    keep: tuple[str, ...] = ()
    seconds: bool = False
    list_column: str | None = None

    @property
    def axes(self) -> AxisChange | None:
        """The change of axes; None for no change."""
        unchanged = self.left is None and self.right is None
        return None if unchanged else AxisChange.from_settings(self.left, self.right)

    @property
    def layout(self) -> Layout:
        """The layout of quaternions, if the output is quaternions."""
        return layout_of(self.output.kind, self.output.layout)

    @property
    def applied_sign(self) -> str:
        """The sign that is applied: a rotation vector has no sign to keep, and is the short one."""
        if self.representation in REPRESENTATIONS and self.sign == "keep":
            return "positive"
        return self.sign

    @property
    def more(self) -> tuple[str, ...]:
        """The settings that are given about further columns of a table."""
        return tuple(name for name in (*TABLES, "list_column") if getattr(self, name))

    def table_columns(self, sigma: str | None) -> tuple[str, ...]:
        """Return the names of all columns of a table; that of lists is repeated."""
        own = self.columns(sigma)
        names = own if self.list_column is None else (self.list_column,) * len(own)
        return (*(["seconds"] if self.seconds else []), *names, *self.keep)

    def columns(self, sigma: str | None) -> tuple[str, ...]:
        """Return the column names except timestamps; `sigma`: axes of the sigmas, or None."""
        if self.representation in RATES:
            return RATE_COLUMNS[self.representation]
        if self.representation != QUATERNION:
            return REPRESENTATIONS[self.representation].columns
        columns, extra_columns = self.layout.columns, self.output.extra_columns
        if extra_columns is not None:
            columns += REPRESENTATIONS[extra_columns].columns
        return columns + (SIGMA_COLUMNS if sigma and WRITERS[self.output.kind].columns else ())


def terms_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of a :class:`Conversion` on conventions and axes from settings."""
    meaning = AttitudeConvention(
        values.get("convention") or HAMILTON.convention,
        values.get("direction") or HAMILTON.direction,
    )
    names = ("left", "right", "rate", "relative_to", "list_column")
    return {
        "meaning": meaning,
        "sign": values.get("sign") or "keep",
        "keep": values.get("keep") or (),
        "seconds": bool(values.get("seconds")),
        **{name: values.get(name) for name in names},
    }


@dataclass(frozen=True, slots=True)
class ConversionReport:
    """The report on a conversion; the result of :func:`quatprop.convert`.

    Parameters
    ----------
    job
        The settings of the conversion.
    path, kind, digest
        The input file, its format, and its size and SHA-256.
    signal
        The attitudes in the file, their storage and their provenance.
    columns
        Names of the output columns besides the timestamps.
    counts
        Rows that were read, used, normalized, and omitted, by reason.
    written
        Rows of the output.
    outside
        Rows before and after the time range.
    losses
        Parts of the file that could not be read.
    remarks
        Further remarks.
    """

    job: Conversion
    path: str
    kind: str
    digest: Digest
    signal: AttitudeSignal
    columns: tuple[str, ...]
    counts: QuaternionCounts
    written: int
    outside: tuple[int, int]
    losses: tuple[Loss, ...]
    remarks: tuple[Remark, ...]

    def __repr__(self) -> str:
        path = self.job.output.path
        return (
            f"<ConversionReport: {self.written:,} of {self.counts.samples_read:,} rows in {path}>"
        )

    @property
    def data_lost(self) -> bool:
        """Whether data could not be read or were omitted."""
        return bool(self.losses or self.counts.invalid)

    def provenance(self) -> Mapping[str, Any]:
        """Return the provenance of the output, JSON-ready."""
        job, signal, history = self.job, self.signal, self.signal.provenance
        source = {
            "path": self.path,
            "kind": self.kind,
            "name": signal.name,
            "type": signal.type_name,
            "clock": signal.clock,
            **self.digest.as_json(),
        }
        is_quaternion = job.representation == QUATERNION
        terms = {
            "representation": job.representation,
            **asdict(job.meaning),
            **({"layout": job.layout.name} if is_quaternion else {}),
            **{
                name: turn
                for name in ("relative_to", "left", "right")
                if (turn := getattr(job, name)) is not None
            },
            **({} if job.rate is None else {"rate_hz": str(job.rate)}),
            "columns": list(self.columns),
            "sign": job.applied_sign,
        }
        step = {
            "quatprop": __version__,
            "source": source,
            "from": {
                "representation": signal.representation,
                "layout": signal.layout,
                **asdict(signal.meaning),
                "field": signal.field,
            },
            "to": terms,
            **self._time_range(),
            "normalize": job.source.normalize,
            "counts": as_json(self.counts),
            "losses": as_json(self.losses),
            "remarks": as_json(self.remarks),
        }
        convention = entry_of(history, "convention", dict)
        hamilton = job.meaning.convention == "hamilton"
        return {
            **history,
            "quatprop": __version__,
            "source": history.get("source", source),
            "convention": {
                "time": "int64 nanoseconds",
                **{name: value for name, value in convention.items() if name != "layout"},
                "product": "Hamilton, ij = k" if hamilton else "JPL, ij = -k",
                "attitude": job.meaning.description,
                **terms,
            },
            "conversions": [*entry_of(history, "conversions", list), step],
            "data_lost": bool(history.get("data_lost") or self.data_lost),
        }

    def _time_range(self) -> JsonObject:
        part = self.job.source.part
        if part.start is None and part.end is None:
            return {}
        start, end = (None if one is None else str(one) for one in (part.start, part.end))
        before, after = self.outside
        return {"time_range": {"start": start, "end": end, "before": before, "after": after}}


def convert(job: Conversion) -> ConversionReport:
    """Convert an attitude series, and return the report."""
    _refuse_contradictions(job)
    wanted, output = job.source, job.output
    read = [wanted.path, *([split_topic(job.relative_to)[0]] if job.relative_to else [])]
    refuse_overlap(read, [output.path, output.report])
    with open_attitudes(wanted) as attitudes:
        job = replace(job, output=with_format(output))
        stored = _stored_sigma(attitudes.signal)
        with (
            ReportFile(output.report) as report_file,
            open_destination(job, kept_sigma(job, attitudes.signal, stored)) as target,
        ):
            report = _write_converted(job, attitudes, stored, target)
            provenance = report.provenance()
            target.finish(provenance)
            report_file.finish(provenance)
            target.publish()
            report_file.publish()
    return report


def _write_converted(
    job: Conversion, attitudes: RecordedAttitudes, stored: str | None, target: FileWriter
) -> ConversionReport:
    """Write attitudes, and return the report."""
    wanted, source = job.source, attitudes.signal
    sigma, order = kept_sigma(job, source, stored), _OrderCheck()
    # Positions are only valid relative to the reference.
    is_absolute = source.meaning.direction == HAMILTON.direction and job.relative_to is None
    keeps = target.holds_positions and is_absolute
    relative = None if job.relative_to is None else RelativeTo(job.relative_to, wanted)
    resampling = None if job.rate is None else Resampling(wanted.path, job.rate)
    write: Callable[[Any], None] = target.write
    with background_digest(wanted.path, hashed=job.output.keeps_report) as digest:
        batches: Iterable[AttitudeSeries] = order.count(
            attitudes.batches(
                positions=keeps and source.has_positions,
                covariances=sigma is not None,
                others=source.group_of(job.keep),
            )
        )
        if relative is not None:
            batches = relative.applied(batches)
        if job.axes is not None:
            batches = job.axes.applied(batches)
        if resampling is not None:
            batches = resampling.applied(batches)
        written = 0
        for series in _in_convention(job, batches):
            write(series)
            written += len(series)
        facts = attitudes.facts()
        losses, columns = [*facts.losses], tuple(dict.fromkeys(job.table_columns(sigma)))
        found = [*order.remarks()]
        if resampling is not None:
            found += resampling.remarks()
        if relative is not None:
            losses, found = [*losses, *relative.losses], [*found, *relative.remarks()]
        lost = remarks_on(
            job,
            target.locked_rows,
            positions_lost=source.has_positions and not keeps,
            sigma_lost=stored is not None and sigma is None,
            lost_columns=[name for name in source.rotation_columns if name not in columns],
        )
        return ConversionReport(
            job=job,
            path=without_secret(wanted.path),
            kind=facts.kind,
            digest=digest(),
            signal=source,
            columns=columns,
            counts=facts.counts,
            written=written,
            outside=attitudes.range.outside,
            losses=tuple(losses),
            remarks=(*facts.signal.remarks, *found, *lost),
        )


class _OrderCheck:
    """Counts timestamps that step back or are repeated."""

    def __init__(self) -> None:
        self._last = np.empty(0, np.int64)
        self._back = self._repeated = 0

    def count(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield the batches unchanged, and count timestamps out of order."""
        for series in batches:
            t_ns = np.concatenate([self._last, series.t_ns])
            self._back += int(np.count_nonzero(t_ns[1:] < t_ns[:-1]))
            self._repeated += int(np.count_nonzero(t_ns[1:] == t_ns[:-1]))
            self._last = t_ns[-1:].copy()
            yield series

    def remarks(self) -> Iterator[Remark]:
        """Yield a remark on what was counted, if there is anything."""
        if self._back or self._repeated:
            yield Remark(
                "stamps-unordered",
                f"the timestamps step back {self._back} times and repeat the one before "
                f"{self._repeated} times; all rows are written, in the order in which they are "
                "read",
            )


def _stored_sigma(source: AttitudeSignal) -> str | None:
    """Return the axes of a source's standard deviations or covariances; None without any."""
    if source.sigma_axes is not None or not source.may_have_covariances:
        return source.sigma_axes
    first = next(source.read(covariances=True), None)
    return None if first is None or first[3] is None else "body"


def _in_convention(
    job: Conversion, batches: Iterable[AttitudeSeries]
) -> Iterator[AttitudeSeries | GyroSeries]:
    """Yield rates, or attitudes in the convention and with the signs of the output."""
    if job.representation in RATES:
        yield from rate_batches(job.source.path, batches, RATES[job.representation])
        return
    signs = Signs(job.applied_sign)
    for series in batches:
        yield replace(series, wxyz=signs.applied(job.meaning.converted(series.wxyz)))


def _refuse_contradictions(job: Conversion) -> None:
    if job.representation == QUATERNION:
        return
    is_rate = job.representation in RATES
    if job.representation not in REPRESENTATIONS and not is_rate:
        raise UsageError(
            f"no representation {quoted(job.representation)}; choose one of "
            f"{listed([QUATERNION, *REPRESENTATIONS, *RATES])}"
        )
    signed = not is_rate and REPRESENTATIONS[job.representation].signed
    if is_rate and job.meaning.direction != HAMILTON.direction:
        raise UsageError(f"{Setting('direction')} does not apply to {job.representation}; omit it")
    for setting, given in (
        ("layout", job.output.layout is not None),
        ("convention", job.meaning.convention != HAMILTON.convention),
        ("sign", job.sign != "keep" and not signed),
        ("message", job.output.message is not None),
        ("extra_columns", job.output.extra_columns is not None),
    ):
        if given:
            raise UsageError(f"{Setting(setting)} does not apply to {job.representation}; omit it")
