"""Many logs, each propagated by itself: on the cores of this machine, or on a Dask cluster."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.batch.manifest import COMPLETE, ManifestEntry, log_name, options_digest, origin_digest
from quatprop.batch.outputs import OTHER_OUTPUT, output_paths
from quatprop.concurrency.processes import KILLED, map_processes
from quatprop.concurrency.threads import available_cores
from quatprop.containers.stores import is_address, without_secret
from quatprop.containers.transfers import upload
from quatprop.errors import NoRatesError, OutputError, QuatpropError, UnknownFormatError, UsageError
from quatprop.pipeline.job import Job, run
from quatprop.provenance import digest_of
from quatprop.temp_files import temp_folder
from quatprop.text import Text, plain, quoted
from quatprop.third_party_errors import as_user_error
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Sequence

    from quatprop.batch.logs import FoundLog
    from quatprop.batch.manifest import Manifest
    from quatprop.pipeline.report import RunReport

REQUESTS = 32
"""Logs in an object store about which it is asked at a time."""


@dataclass(frozen=True, slots=True)
class BatchTask:
    """One log of a batch.

    Parameters
    ----------
    job
        How it is propagated, and where its output goes.
    name
        Path of the output in the folder of the batch.
    maybe
        As for :class:`quatprop.batch.logs.FoundLog`.
    """

    job: Job
    name: str
    maybe: bool = False

    def with_threads(self, count: int) -> BatchTask:
        """Return the task with so many threads, unless its settings say how many."""
        settings = self.job.settings
        settings = replace(settings, threads=settings.threads or count)
        return replace(self, job=replace(self.job, settings=settings))

    @property
    def log(self) -> str:
        """The log as it may be shown."""
        return without_secret(self.job.log)


@dataclass(frozen=True, slots=True)
class BatchResult:
    """The result of one log.

    Parameters
    ----------
    log, output
        The log, and where its attitudes are.
    entry
        What the manifest records.
    error
        Why there are no attitudes; empty where there are.
    report
        The report of the run; None where there are no attitudes.
    """

    log: str
    output: str
    entry: ManifestEntry
    error: str | Text = ""
    report: RunReport | None = None


def plan(
    logs: Sequence[FoundLog], job: Job, folder: str, suffix: str, manifest: Manifest
) -> list[BatchTask]:
    """Return a task for each log.

    Parameters
    ----------
    logs
        The logs.
    job
        The settings, which all logs share; its paths are ignored.
    folder, suffix
        As for :func:`quatprop.batch.outputs.output_paths`.
    manifest
        The manifest in that folder.

    Raises
    ------
    UsageError
        An output is, or would be, that of two logs.
    OutputError
        An output would replace a log.
    """
    paths = output_paths(logs, folder, suffix)
    inputs = [*(log.path for log in logs), *job.settings.inputs.values()]
    if not is_address(folder):
        refuse_overlap(inputs, [*paths, *manifest.files])
    elif replaced := {log_name(name) for name in inputs} & {log_name(path) for path in paths}:
        raise OutputError(min(replaced), "this is an input of the run; choose another output")
    owners = manifest.entries()
    tasks = []
    for log, path in zip(logs, paths, strict=True):
        name = f"{log.name}{suffix}".replace(os.sep, "/")
        owner = owners[name]["log"] if name in owners else log_name(log.path)
        if owner != log_name(log.path):
            raise UsageError(
                f"{quoted(path)} was made from {quoted(owner)}, not from "
                f"{quoted(log_name(log.path))}; ",
                OTHER_OUTPUT,
            )
        output = replace(job.output, path=path)
        tasks.append(BatchTask(replace(job, log=log.path, output=output), name, log.maybe))
    return tasks


def outdated(tasks: Iterable[BatchTask], manifest: Manifest) -> list[BatchTask]:
    """Return the tasks whose outputs are not there, or were made from something else."""
    entries, is_there = manifest.entries(), manifest.existing_outputs()

    def is_current(task: BatchTask) -> bool:
        entry = entries.get(task.name)
        if entry is None or entry["state"] not in COMPLETE or entry.get("origin") is None:
            return False
        if not is_there(task.name):
            return False
        return bool(entry["origin"] == origin_digest(task.job, options_digest(task.job)))

    tasks = list(tasks)
    if not any(is_address(task.job.log) for task in tasks):
        return [task for task in tasks if not is_current(task)]
    with ThreadPoolExecutor(REQUESTS) as pool:
        current = pool.map(is_current, tasks)
        return [task for task, is_done in zip(tasks, current, strict=True) if not is_done]


def propagate_log(task: BatchTask) -> BatchResult:
    """Propagate one log; an error becomes its result."""
    began = time.perf_counter()
    # Before the log is read: if it changes meanwhile, the next batch propagates it again.
    options = options_digest(task.job)
    origin = origin_digest(task.job, options)
    try:
        result = _done(task)
    except QuatpropError as error:
        no_log = task.maybe and isinstance(error, NoRatesError | UnknownFormatError)
        result = failed(task, error.text, "no rates" if no_log else "failed")
    except Exception as error:
        if (user_error := as_user_error(error)) is None:
            raise
        result = failed(task, Text(f"{plain(task.log)}: ", user_error.text))
    seconds = time.perf_counter() - began
    entry = replace(result.entry, seconds=seconds, options=options, origin=origin)
    return replace(result, entry=entry)


def _done(task: BatchTask) -> BatchResult:
    """Propagate one log; an output for an object store is made here, and copied there."""
    job = task.job
    path = job.output.path
    if not is_address(path):
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        report = run(job, summary=False)
        return BatchResult(task.log, path, _entry_of(task, report, path), report=report)
    temp = temp_folder()
    try:
        local = temp.path / os.path.basename(path.partition("?")[0])  # noqa: PTH119
        report = run(replace(job, output=replace(job.output, path=str(local))), summary=False)
        entry = _entry_of(task, report, str(local))
        upload(local, path)
    finally:
        temp.remove()
    return BatchResult(task.log, without_secret(path), entry, report=report)


def _entry_of(task: BatchTask, report: RunReport, path: str) -> ManifestEntry:
    log, result = report.source.digest, report.result
    if log.sha256 is None and not is_address(task.job.log):
        log = digest_of(task.job.log)
    output = digest_of(path)
    return ManifestEntry(
        state="data lost" if report.data_lost else "done",
        log=log_name(task.job.log),
        output=task.name,
        samples=result.samples,
        rows=result.rows,
        span_s=result.span_s,
        sample_rate_hz=result.sample_rate_hz,
        method=report.convention.method,
        final_wxyz=tuple(map(float, result.final_wxyz)),
        remarks=tuple(map(str, report.remarks)),
        losses=tuple(f"{loss.place}: {loss.reason}" for loss in report.losses),
        log_bytes=log.bytes,
        log_sha256=log.sha256,
        log_etag=log.etag,
        output_bytes=output.bytes,
        output_sha256=output.sha256,
    )


def failed(task: BatchTask, error: str | Text, state: str = "failed") -> BatchResult:
    """Return the result of a log without attitudes."""
    entry = ManifestEntry(state, log_name(task.job.log), task.name, error=str(error))
    return BatchResult(task.log, task.job.output.path, entry, error)


def propagate_and_record(task: BatchTask, manifest: Manifest) -> BatchResult:
    """Propagate one log, and record it at once: nothing complete is done again after a kill."""
    result = propagate_log(task)
    try:
        manifest.append(result.entry)
    except OutputError as error:  # the store has gone
        return failed(task, error.text)
    return result


def on_this_machine(
    tasks: Sequence[BatchTask], processes: int, manifest: Manifest, retries: int = 0
) -> Generator[tuple[int, BatchResult]]:
    """Yield the index and the result of each log as soon as it is done.

    Parameters
    ----------
    tasks
        One for each log.
    processes
        Number of logs at a time.
    manifest
        Where results are recorded.
    retries
        How often a log is tried again whose process was killed.
    """

    def on_killed(task: BatchTask) -> BatchResult:
        result = failed(task, f"{plain(task.log)}: {KILLED}")
        manifest.append(result.entry)
        return result

    threads = max(1, available_cores() // max(1, min(processes, len(tasks))))
    tasks = [task.with_threads(threads) for task in tasks]
    work = partial(propagate_and_record, manifest=manifest)
    return map_processes(work, tasks, processes, on_killed, isolated=True, retries=retries)
