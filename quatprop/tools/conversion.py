"""Convert an attitude series."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.conventions import HAMILTON, Signs
from quatprop.conventions.representations import QUATERNION, REPRESENTATIONS
from quatprop.conversion.destination import kept_sigma, open_destination, remarks_on
from quatprop.conversion.job import Conversion, ConversionReport
from quatprop.conversion.rates import RATES, rate_batches
from quatprop.conversion.relative import RelativeTo
from quatprop.errors import NoSamplesError, UsageError
from quatprop.logs.attitude_part import AttitudePart
from quatprop.logs.open_log import open_log
from quatprop.logs.resampling import Resampling
from quatprop.logs.signals.attitudes import choose_attitudes
from quatprop.logs.signals.quaternion_check import QuaternionCheck
from quatprop.pipeline.job import with_format
from quatprop.pipeline.report import ReportFile
from quatprop.provenance import background_digest
from quatprop.stores.log_names import split_topic
from quatprop.stores.objects import without_secret
from quatprop.text import Remark, Setting, listed, quoted
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from quatprop.logs.signals.signal import AttitudeSignal
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.tables.log import Log
    from quatprop.writers.attitudes import AttitudeWriter


def convert(job: Conversion) -> ConversionReport:
    """Convert an attitude series, and return the report."""
    _refuse_contradictions(job)
    wanted, output = job.source, job.output
    read = [wanted.path, *([split_topic(job.relative_to)[0]] if job.relative_to else [])]
    refuse_overlap(read, [output.path, output.report])
    with open_log(wanted.path, wanted.kind, msg_path=wanted.selection.msg_path) as log:
        job = replace(job, output=with_format(output, log))
        source = choose_attitudes(log, wanted.selection)
        stored = _stored_sigma(source)
        with (
            ReportFile(output.report) as report_file,
            open_destination(job, log, kept_sigma(job, source, stored)) as target,
        ):
            report = _written(job, log, source, stored, target)
            provenance = report.provenance()
            target.finish(provenance)
            report_file.finish(provenance)
            target.publish()
            report_file.publish()
    return report


def _written(
    job: Conversion,
    log: Log,
    source: AttitudeSignal,
    stored: str | None,
    target: AttitudeWriter,
) -> ConversionReport:
    """Write the attitudes of a source, and return the report."""
    wanted, sigma = job.source, kept_sigma(job, source, stored)
    check = QuaternionCheck(wanted.path, normalize=wanted.normalize, drop=wanted.drop)
    order = _OrderCheck()
    # Positions are only valid relative to the reference.
    is_absolute = source.meaning.direction == HAMILTON.direction and job.relative_to is None
    keeps = target.holds_positions and is_absolute
    relative = None if job.relative_to is None else RelativeTo(job.relative_to)
    part = AttitudePart(source, wanted.part)
    resampling = None if job.rate is None else Resampling(wanted.path, job.rate)
    rows = part.read(
        positions=keeps and source.has_positions,
        covariances=sigma is not None,
        logged=job.output.into,
    )
    write: Callable[[Any], None] = target.write
    with background_digest(wanted.path, hashed=job.output.keeps_report) as digest:
        attitudes: Iterable[AttitudeSeries] = order.counted(check.apply(rows))
        if relative is not None:
            attitudes = relative.applied(attitudes)
        if job.axes is not None:
            attitudes = job.axes.applied(attitudes)
        if resampling is not None:
            attitudes = resampling.applied(attitudes)
        written = 0
        for series in _in_convention(job, attitudes):
            write(series)
            written += len(series)
        if not check.counts.used:
            raise NoSamplesError(
                wanted.path, source.name, part.outside, losses=log.losses, length=part.length
            )
        losses, columns = [*log.losses], job.columns(sigma)
        found = [*part.remarks(), *log.remarks, *order.remarks()]
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
            kind=log.kind,
            digest=digest(),
            signal=source,
            columns=columns,
            counts=check.counts,
            written=written,
            outside=(part.outside[0], part.outside[1]),
            losses=tuple(losses),
            remarks=(*source.remarks, *found, *lost),
        )


class _OrderCheck:
    """Counts timestamps that step back or are repeated."""

    def __init__(self) -> None:
        self._last = np.empty(0, np.int64)
        self._back = self._repeated = 0

    def counted(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield the batches unchanged."""
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
        raise UsageError(
            f"{Setting('direction')} is about attitudes, and {job.representation} are none"
        )
    for setting, given in (
        ("layout", job.output.layout is not None),
        ("convention", job.meaning.convention != HAMILTON.convention),
        ("sign", job.sign != "keep" and not signed),
        ("message", job.output.message is not None),
        ("extra_columns", job.output.extra_columns is not None),
    ):
        if given:
            raise UsageError(
                f"{Setting(setting)} is about quaternions and {job.representation} has none; "
                "omit it"
            )
