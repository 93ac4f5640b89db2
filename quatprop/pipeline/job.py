"""One recording from log to attitude file: the whole way of the data, once.

This is where all rooms meet: reader, signal, timeline, propagation, writer. The command line and
batches of logs both come through here.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from quatprop.conditioning import Conditioning, clipping_remarks, condition
from quatprop.errors import NoSamplesError, UsageError
from quatprop.formats import open_log
from quatprop.into import open_into, written_kind
from quatprop.kinematics.propagate import unit_q0
from quatprop.kinematics.resample import Listed, Steady, every
from quatprop.pipeline.initial_attitude import Recording, Start, starting
from quatprop.pipeline.plausibility import RateChecks, log_remarks
from quatprop.pipeline.report import ReportFile, RunResult, report_on
from quatprop.pipeline.segments import Segments
from quatprop.provenance import Fingerprint
from quatprop.selection import RateSelection
from quatprop.signals.interpolation import stamps_in
from quatprop.signals.rates import UNITS, choose_rates
from quatprop.timeline import Policy, Timeline
from quatprop.writers import has_room, kind_of, layout_of, open_writer
from quatprop.writers.overlap import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from fractions import Fraction

    from numpy.typing import NDArray

    from quatprop.containers.base import MessageLog
    from quatprop.kinematics.resample import Times
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.tables.base import TableLog
    from quatprop.writers.base import AttitudeWriter
    from quatprop.writers.messages.kinds import Message


@dataclass(frozen=True, slots=True)
class Job:
    """What to do with one log.

    Parameters
    ----------
    log
        Path of the log, or ``"-"``.
    output
        Path of the attitude series, or ``"-"`` for CSV on stdout.
    into
        The output is a copy of the log with the attitudes added as messages.
    kind, to
        Kind of the log and of the output; None means told by content and suffix.
    selection
        Which samples.
    policy
        What the stamps are allowed to do.
    layout
        ``"scalar-first"`` or ``"scalar-last"``: the order of the columns written; None is what
        the format prescribes, or scalar-first where it leaves the choice.
    message
        What to write the attitudes as, where they are written as messages.
    comment
        Write the report in a comment at the beginning of the output.
    method
        Which samples rule an interval: a key of :data:`quatprop.kinematics.increments.METHODS`.
    rates
        ``"body"`` or ``"inertial"``: the frame in which the rates are resolved.
    q0
        Attitude body -> reference at the first sample, or where to take it from.
    conditioning
        Bias, mounting and the part of the log to use.
    every
        Write every so-manieth attitude; None is all.
    rate
        Write attitudes so often a second, Hz, exact at those times; None is at the samples.
    at
        Write attitudes at the stamps of this series, exact at those times; None is at the samples.
    report
        Where the report goes as JSON, ``"-"`` for stdout; None is nowhere.
    """

    log: str
    output: str
    into: bool = False
    kind: str | None = None
    to: str | None = None
    selection: RateSelection = field(default_factory=RateSelection)
    policy: Policy = field(default_factory=Policy)
    layout: str | None = None
    message: Message | None = None
    comment: bool = False
    method: str = "start"
    rates: str = "body"
    q0: Start = field(default_factory=Start)
    conditioning: Conditioning = field(default_factory=Conditioning)
    every: int | None = None
    rate: Fraction | None = None
    at: str | None = None
    report: str | None = None


class Observer(Protocol):
    """Looks at what goes by, such as a picture in the making."""

    def rates(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the rates as they are, bias and mounting applied."""

    def attitudes(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield the attitudes as they are, at all samples or at the times that were asked for."""


def run(
    job: Job, tick: Callable[[int], None] = lambda _samples: None, eye: Observer | None = None
) -> dict[str, Any]:
    """Propagate one log and write its attitude series.

    Parameters
    ----------
    job
        What to do.
    tick
        Called with the number of samples written so far.
    eye
        Looks at what goes by.

    Returns
    -------
    dict
        The report: what was read, done, counted and lost; JSON-ready.

    Raises
    ------
    LogError
        The log cannot be used as asked.
    OutputError
        The result cannot be written.
    """
    began = time.perf_counter()
    _refuse_contradictions(job)
    if not job.into:
        job = replace(job, layout=layout_of(kind_of(job.output, job.to), job.layout).name)
    with open_log(job.log, job.kind) as log:
        if job.into:
            kind = written_kind(log, job.output, job.to)
            job = replace(job, to=kind, layout=layout_of(kind, job.layout).name)
        source = choose_rates(log, job.selection)
        batches, conditioned = condition(source.batches, job.conditioning, UNITS[source.unit])
        mount = conditioned["mount"] and np.array(conditioned["mount"])
        recording = Recording(log, source, job.selection, mount)
        q0, batches = starting(job.q0, recording, batches)
        timeline, watch = Timeline(job.policy, job.log), RateChecks()
        segments = Segments(
            timeline,
            q0,
            method=job.method,
            rates=job.rates,
            times=_times(job),
        )
        # Where nothing keeps it, reading the source once more is not worth its time.
        kept = job.report is not None or has_room(job.output, job.to, comment=job.comment)
        with (
            ReportFile(job.report) as report_file,
            _opened(job, log) as writer,
            Fingerprint(job.log, wanted=kept) as fingerprint,
        ):
            rows = 0
            used = watch.passing(batches)
            attitudes = segments.attitudes(used if eye is None else eye.rates(used))
            attitudes = attitudes if eye is None else eye.attitudes(attitudes)
            for series in every(attitudes, job.every or 1):
                writer.write(series)
                rows += len(series)
                tick(timeline.counts.used)
            if not timeline.counts.used:
                raise NoSamplesError(job.log, source.name, conditioned["outside"])
            findings = clipping_remarks(job.conditioning, conditioned)
            findings += watch.remarks(timeline.counts.median_dt_ns)
            if job.log != "-":
                findings += log_remarks(log, source)
            done = RunResult(
                log=log,
                source=source,
                timeline=timeline,
                conditioned=conditioned,
                q0=q0,
                final=segments.final,
                method_sensitivity_rad=segments.method_sensitivity_rad,
                rows=rows,
                remarks=findings,
                fingerprint=fingerprint.result(),
            )
            report = report_on(job, done)
            writer.commit(report)
            report["timings"] = {"seconds": time.perf_counter() - began}
            report_file.commit(report)
    return report


def _opened(job: Job, log: MessageLog | TableLog) -> AttitudeWriter:
    """Return what takes the attitudes."""
    options: dict[str, Any] = {
        "layout": job.layout,
        "message": job.message,
        "comment": job.comment,
    }
    if not job.into:
        return open_writer(job.output, job.to, **options)

    def stamps(
        again: MessageLog | TableLog,
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        return choose_rates(again, job.selection).stamps()

    return open_into(log, job.output, stamps, **options)


def _times(job: Job) -> Times | None:
    """Return when attitudes are wanted; None is at the samples."""
    if job.at is not None:
        return Listed(stamps_in(job.at))
    return None if job.rate is None else Steady(job.rate)


def _refuse_contradictions(job: Job) -> None:
    if [job.every, job.rate, job.at].count(None) < 2:  # noqa: PLR2004  # two of three
        raise UsageError("--every, --rate and --at each say which attitudes to write; choose one")
    if not job.q0.words:
        unit_q0(job.q0.wxyz)
    refuse_overlap([job.log, job.q0.words, job.at], [job.output, job.report])
    if job.log == "-" and (job.conditioning.looks_ahead or job.q0.words in {"level", "log"}):
        raise UsageError(
            "stdin can be read only once; --bias static, --q0 level|log and relative --start "
            "and --end need a file"
        )
