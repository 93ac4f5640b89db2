"""One log to one attitude file; the command line, batches and suites all come through here."""

from __future__ import annotations

import os
import time
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from quatprop.concurrency.threads import in_background, use_threads
from quatprop.containers.stores import digest_of_object, is_address
from quatprop.errors import UsageError
from quatprop.formats import open_log
from quatprop.pipeline.attitude_stream import AttitudeStream
from quatprop.pipeline.report import ReportFile, digests_of_inputs
from quatprop.pipeline.settings import OutputSettings, PropagationSettings
from quatprop.provenance import DigestThread
from quatprop.signals.rates import choose_rates
from quatprop.text import Setting
from quatprop.writers import format_remarks, keeps_provenance, kind_of, layout_of, open_writer
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.pipeline.attitude_stream import Observer
    from quatprop.pipeline.report import RunReport
    from quatprop.tables.base import AnyLog
    from quatprop.writers.attitudes import AttitudeWriter

    Stamps = Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]


SMALL_BYTES = 1 << 18
"""A smaller log is not worth a thread."""


@dataclass(frozen=True, slots=True)
class Job:
    """What to do with one log.

    Parameters
    ----------
    log
        Path of the log, or ``"-"`` for CSV on stdin.
    output
        Where its attitudes go.
    settings
        How it is propagated.
    """

    log: str
    output: OutputSettings
    settings: PropagationSettings = field(default_factory=PropagationSettings)


def run(
    job: Job,
    observer: Observer | None = None,
    *,
    summary: bool = True,
    before_publish: Callable[[RunReport], None] = lambda _report: None,
) -> RunReport:
    """Propagate one log and write its attitude series.

    Parameters
    ----------
    job
        What to do.
    observer
        Looks at rates and attitudes as they pass.
    summary
        Whether somebody reads the report that is returned. What is only for a reader, and is kept
        in no file, is not computed otherwise.
    before_publish
        Called with the report when everything is written and nothing is in its place; where it
        fails, no output is replaced.

    Returns
    -------
    RunReport
        What was read, done, counted and lost.

    Raises
    ------
    LogError
        The log cannot be used as asked.
    OutputError
        The result cannot be written.
    """
    began = time.perf_counter()
    settings = job.settings
    _refuse_contradictions(job)
    stored = digest_of_object(job.log) if is_address(job.log) else None
    with (
        use_threads(1 if _is_small(job.log) else settings.threads),
        open_log(
            job.log, settings.kind, msg_path=settings.selection.msg_path, copied=job.output.into
        ) as log,
    ):
        output = _with_layout(job.output, log)
        source = choose_rates(log, settings.selection)
        # Where no file keeps it, reading the source once more is not worth its time.
        kept = output.report is not None or keeps_provenance(
            output.path, output.to, comment=output.comment
        )
        stream = AttitudeStream(
            job.log,
            source,
            settings,
            log,
            observer=observer,
            sensitivity=summary or kept,
            rate=output.message is not None and "rate" in output.message.definition.parts,
        )
        with (
            ReportFile(output.report) as report_file,
            open_output(
                output,
                log,
                lambda again: choose_rates(again, settings.selection).stamps(),
                settings.errors.columns_axes,
            ) as writer,
            DigestThread(job.log, hashed=kept and stream.reads_all) as digest,
            closing(in_background(stream)) as attitudes,
        ):
            for series in attitudes:
                writer.write(series)
            report = stream.report(layout=output.layout, digest=stored or digest.result())
            report = replace(
                report,
                settings={**report.settings, **output.given},
                files=digests_of_inputs(settings.inputs, log) if kept else {},
                remarks=(*report.remarks, *format_remarks(output.path, output.to)),
            )
            # Everything that can fail comes before the first output is put in its place.
            writer.finish(report.as_json())
            report = replace(report, seconds=time.perf_counter() - began)
            if output.report is not None:
                report_file.finish(report.as_json())
            before_publish(report)
            writer.publish()
            report_file.publish()
    return report


def _with_layout(output: OutputSettings, log: AnyLog) -> OutputSettings:
    """Return where attitudes go, with the format and the order of its columns."""
    if output.into:
        from quatprop.into import copy_kind

        kind = copy_kind(log, output.path, output.to)
    else:
        kind = kind_of(output.path, output.to)
    return replace(output, to=kind, layout=layout_of(kind, output.layout).name)


def _is_small(log: str) -> bool:
    """Tell whether a log is read before other threads would have started."""
    return os.path.isfile(log) and os.path.getsize(log) < SMALL_BYTES  # noqa: PTH113, PTH202


def open_output(
    output: OutputSettings,
    log: AnyLog,
    stamps: Callable[[AnyLog], Stamps],
    sigma: str | None = None,
) -> AttitudeWriter:
    """Open a file of attitudes, or a copy of the log to which they are added.

    Parameters
    ----------
    output
        Where and how.
    log
        The log that the attitudes come from.
    stamps
        As for :func:`quatprop.into.open_into`.
    sigma
        As for :func:`quatprop.writers.open_writer`.
    """
    options: dict[str, Any] = {
        "layout": output.layout,
        "message": output.message,
        "comment": output.comment,
        "sigma": sigma,
        "beside": output.beside,
    }
    if not output.into:
        return open_writer(output.path, output.to, **options)
    from quatprop.into import open_into

    return open_into(log, output.path, stamps, **options)


def _refuse_contradictions(job: Job) -> None:
    settings, output = job.settings, job.output
    if not output.into:
        layout_of(kind_of(output.path, output.to), output.layout)
    refuse_overlap([job.log, *settings.inputs.values()], [output.path, output.report])
    if job.log == "-" and settings.needs_second_read:
        raise UsageError(
            *("stdin can be read only once; ", Setting("bias", "static"), ", "),
            *(Setting("q0", "level|log"), " and relative ", Setting("start"), " and "),
            *(Setting("end"), " need a file"),
        )
