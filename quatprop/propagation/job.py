"""Make one attitude file from one log, for the command line, batches and suites alike."""

from __future__ import annotations

import os
import time
from contextlib import closing, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from quatprop.base.errors import ReplacedError, UsageError
from quatprop.base.provenance import background_digest
from quatprop.base.text import Setting
from quatprop.base.threads import in_background, use_threads
from quatprop.propagation.attitude_stream import AttitudeStream
from quatprop.propagation.recording import Recording, open_recording
from quatprop.propagation.report import ReportFile, RunReport, digests_of_inputs
from quatprop.propagation.settings import OutputSettings, PropagationSettings, propagation_settings
from quatprop.readers.open_log import is_stream
from quatprop.settings.parsers import resolve_paths
from quatprop.stores.objects import split_topics
from quatprop.writers import open_writer
from quatprop.writers.formats import format_remarks, layout_of
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from quatprop.base.provenance import JsonObject
    from quatprop.propagation.attitude_stream import Observer
    from quatprop.writers.base import FileWriter


ATTEMPTS = 3
"""How often a log is read if it is replaced meanwhile."""

SMALL_BYTES = 1 << 18
"""Logs below this size, bytes, are processed without further threads."""


class Job(NamedTuple):
    """A log, the settings of its propagation, and its output.

    `log`: path of the log, or ``"-"`` for CSV on stdin
    `more`: further files of the same recording, read as one log with it
    `display_names`: returns the names of files in the output, the first of which is the log, so
        that the output does not depend on their location; None for their paths, with digests
    """

    log: str
    output: OutputSettings
    settings: PropagationSettings = PropagationSettings()
    more: tuple[str, ...] = ()
    display_names: Callable[[Sequence[str]], list[str]] | None = None

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        values: Mapping[str, Any],
        output: OutputSettings,
        folder: Path | None = None,
    ) -> Self:
        """Return the job for the files of a log, ``LOG`` or ``LOG:TOPIC``, and settings by name.

        `values`: keys of :data:`quatprop.settings.PROPAGATE`; None for not given
        `folder`: to which the paths in settings are relative; None for the current one
        """
        logs, topic = split_topics(names, values.get("topic"))
        values = {**values, "topic": topic}
        settings = propagation_settings(values if folder is None else resolve_paths(values, folder))
        return cls(logs[0], output, settings, tuple(logs[1:]))

    @property
    def paths(self) -> tuple[str, ...]:
        """All files that are read as one log."""
        return (self.log, *self.more)

    @property
    def name(self) -> str:
        """The name of the log in errors and reports."""
        return " + ".join(self.paths)


def run(job: Job, observer: Observer | None = None, *, summary: bool = True) -> RunReport:
    """Propagate one log and write its attitude series; try again if it is replaced meanwhile."""
    for _ in range(ATTEMPTS - 1):
        with suppress(ReplacedError):
            return _run(job, observer, summary=summary)
    return _run(job, observer, summary=summary)


def _run(job: Job, observer: Observer | None, *, summary: bool) -> RunReport:
    began = time.perf_counter()
    settings = job.settings
    _refuse_contradictions(job)
    with (
        use_threads(1 if _is_small(job.log) else settings.threads),
        open_recording(job.paths, settings.selection, settings.kind) as recording,
    ):
        output = with_format(job.output)
        job = job._replace(output=output)
        stream = AttitudeStream(
            recording,
            settings,
            observer=observer,
            sensitivity=summary or output.keeps_report,
            rate=output.message is not None and "rate" in output.message.definition.parts,
        )
        with (
            ReportFile(output.report) as report_file,
            open_output(output, settings.errors.columns_axes) as writer,
        ):
            report = _write_attitudes(stream, writer, job, recording)
            # Everything that can fail precedes the publication of the first output.
            writer.finish(_provenance(report, job))
            report = replace(report, seconds=time.perf_counter() - began)
            if output.report is not None:
                report_file.finish(report.as_json())
            if observer is not None:
                observer.draw(report)
            recording.confirm()
            writer.publish()
            report_file.publish()
    return report


def _provenance(report: RunReport, job: Job) -> JsonObject:
    """Return the provenance that the output contains."""
    if job.display_names is None:
        return report.as_json()
    named = filter(None, [*job.settings.inputs.values(), job.settings.selection.msg_path])
    paths = sorted({*report.files, *map(str, named)})
    log, *names = job.display_names([job.log, *paths])
    return report.with_display_names(log, dict(zip(paths, names, strict=True)))


def _write_attitudes(
    stream: AttitudeStream, writer: FileWriter, job: Job, recording: Recording
) -> RunReport:
    """Write the attitudes of a log and return the report on them."""
    output = job.output
    inputs = {**job.settings.inputs, **({path: path for path in job.paths} if job.more else {})}
    with (
        background_digest(
            job.log, hashed=output.keeps_report and stream.reads_all and not job.more
        ) as digest,
        closing(in_background(stream)) as attitudes,
    ):
        for series in attitudes:
            writer.write(series)
        stored = recording.stored_digest
        report = stream.report(layout=output.layout, digest=stored or digest())
    return replace(
        report,
        settings={**report.settings, **output.given},
        files=digests_of_inputs(inputs, recording.log) if output.keeps_report else {},
        remarks=(*report.remarks, *format_remarks(output.path, output.to)),
    )


def with_format(output: OutputSettings) -> OutputSettings:
    """Return the settings of an output with its format and the order of its columns."""
    return output._replace(to=output.kind, layout=layout_of(output.kind, output.layout).name)


def _is_small(log: str) -> bool:
    """Return whether reading a log takes less time than starting threads."""
    return os.path.isfile(log) and os.path.getsize(log) < SMALL_BYTES  # noqa: PTH113, PTH202


def open_output(output: OutputSettings, sigma: str | None = None) -> FileWriter:
    """Open a file of attitudes."""
    return open_writer(
        output.path,
        output.to,
        layout=output.layout,
        message=output.message,
        comment=output.comment,
        sigma=sigma,
        extra_columns=output.extra_columns,
    )


def _refuse_contradictions(job: Job) -> None:
    settings, output = job.settings, job.output
    layout_of(output.kind, output.layout)
    if job.display_names is None:  # a batch has checked all its logs and outputs together
        refuse_overlap([*job.paths, *settings.inputs.values()], [output.path, output.report])
    if settings.needs_second_read and is_stream(job.log):
        raise UsageError(
            f"{'stdin' if job.log == '-' else 'a pipe'} can be read only once; "
            f"{Setting('bias', 'static')}, {Setting('q0', 'level|log')} and relative "
            f"{Setting('start')} and {Setting('end')} need a file"
        )
