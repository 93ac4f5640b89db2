"""Many logs, each propagated by itself: on the cores of this machine, or on a Dask cluster."""

from __future__ import annotations

import os
import re
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING

from quatprop.batch.entries import COMPLETE, ManifestEntry
from quatprop.batch.manifest import log_name
from quatprop.batch.tasks import BatchResult, BatchSettings, BatchTask, failed
from quatprop.concurrency.processes import KILLED, map_processes
from quatprop.concurrency.threads import available_cores
from quatprop.errors import (
    NoRatesError,
    OutputError,
    QuatpropError,
    UnknownFormatError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.errors.third_party import as_user_error
from quatprop.pipeline.job import Job, run
from quatprop.provenance import digest_of
from quatprop.settings.spelling import in_options
from quatprop.stores.objects import below, is_address, without_secret
from quatprop.stores.temp_files import temp_folder
from quatprop.stores.transfers import upload
from quatprop.text import Setting, plain, quoted, spelled, spelling
from quatprop.writers.targets import refuse_outside, refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Sequence

    from quatprop.batch.logs import FoundLog
    from quatprop.batch.manifest import Manifest

REQUESTS = 32
"""Logs in an object store about which it is asked at a time."""


OTHER_OUTPUT = (
    f"keep their folders in the names with {Setting('root', 'DIR')}, a folder above both, or "
    "write to another folder"
)
"""The way out where two logs have the same output."""


def output_paths(logs: Iterable[FoundLog], folder: str, suffix: str) -> list[str]:
    """Return the path of the output of each log."""
    paths: list[str] = []
    owners: dict[str, FoundLog] = {}
    for log in logs:
        name = log.name + suffix
        paths.append(below(folder, name) if is_address(folder) else os.path.join(folder, name))  # noqa: PTH118
        owner = owners.setdefault(log.name.lower(), log)
        if owner is not log:
            one, other, both = (
                quoted(without_secret(path)) for path in (owner.path, log.path, paths[-1])
            )
            folders = {os.path.dirname(path) for path in (owner.path, log.path)}  # noqa: PTH120
            way_out = OTHER_OUTPUT if len(folders) > 1 else "rename one of them"
            raise UsageError(f"{one} and {other} would both be written to {both}; {way_out}")
    return paths


def shard(logs: Iterable[FoundLog], text: str) -> list[FoundLog]:
    """Return one part of N of the logs: that of one machine of many, as in an array job.

    `text`: ``"I/N"``, the I-th part, from 1 to N
    """
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
    part, parts = map(int, match.groups()) if match else (0, 0)
    if not 1 <= part <= parts:
        raise UsageError(f"{quoted(text)} is not I/N, from 1/N to N/N, for {Setting('shard')}")
    return sorted(logs, key=lambda log: log.name)[part - 1 :: parts]


def plan(
    logs: Sequence[FoundLog], job: Job, folder: str, suffix: str, manifest: Manifest
) -> list[BatchTask]:
    """Return a task for each log."""
    paths = output_paths(logs, folder, suffix)
    inputs = [*(log.path for log in logs), *job.settings.inputs.values()]
    if not is_address(folder):
        usable = [path for log, path in zip(logs, paths, strict=True) if not log.refused]
        refuse_overlap(inputs, [*usable, *manifest.files])
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
                f"{quoted(log_name(log.path))}; {OTHER_OUTPUT}"
            )
        tasks.append(BatchTask(log.path, path, name, log.maybe, log.refused))
    return tasks


def outdated(
    tasks: Iterable[BatchTask], settings: BatchSettings, manifest: Manifest
) -> list[BatchTask]:
    """Return the tasks whose outputs are not there, or were made from something else."""
    entries, is_there = manifest.entries(), manifest.existing_outputs()

    def is_current(task: BatchTask) -> bool:
        entry = entries.get(task.name)
        if entry is None or entry["state"] not in COMPLETE or entry.get("origin") is None:
            return False
        if not is_there(task.name):
            return False
        return bool(entry["origin"] == settings.origin(task))

    tasks = list(tasks)
    if not any(is_address(task.path) for task in tasks):
        return [task for task in tasks if not is_current(task)]
    with ThreadPoolExecutor(REQUESTS) as pool:
        current = pool.map(is_current, tasks)
        return [task for task, is_done in zip(tasks, current, strict=True) if not is_done]


def with_data_lost(tasks: Iterable[BatchTask], manifest: Manifest) -> int:
    """Return in how many logs that are done data was lost."""
    entries = manifest.entries()
    return sum(entries[task.name]["state"] == "data lost" for task in tasks)


@spelling(in_options)
def propagate_log(task: BatchTask, settings: BatchSettings) -> BatchResult:
    """Propagate one log; an error becomes its result."""
    began = time.perf_counter()
    # Before the log is read: if it changes meanwhile, the next batch propagates it again.
    origin = None if task.refused else settings.origin(task)
    try:
        result = _done(task, settings)
    except QuatpropError as error:
        no_log = task.maybe and isinstance(error, NoRatesError | UnknownFormatError)
        result = failed(task, error.text, "no rates" if no_log else "failed")
    except Exception as error:
        if (user_error := as_user_error(error)) is None:
            raise
        result = failed(task, f"{plain(task.log)}: {user_error.text}")
    seconds = time.perf_counter() - began
    entry = result.entry._replace(
        seconds=seconds,
        options=settings.options,
        origin=origin,
    )
    return result._replace(entry=entry)


def _done(task: BatchTask, settings: BatchSettings) -> BatchResult:
    """Propagate one log; an output for an object store is made here, and copied there."""
    if task.refused:
        raise UnsupportedLogError(task.log, task.refused)
    if not is_address(task.output):
        refuse_outside(task.output, task.output.removesuffix(task.name))
        os.makedirs(os.path.dirname(task.output) or ".", exist_ok=True)  # noqa: PTH103, PTH120
        return _propagated(task, settings, task.output)
    temp = temp_folder()
    try:
        local = temp.path / os.path.basename(task.output.partition("?")[0])  # noqa: PTH119
        result = _propagated(task, settings, str(local))
        upload(local, task.output)
    finally:
        temp.remove()
    return result


def _propagated(task: BatchTask, settings: BatchSettings, path: str) -> BatchResult:
    """Propagate one log into a file of this machine."""
    job = settings.job
    job = job._replace(log=task.path, output=job.output._replace(path=path))
    report = run(job, summary=False)
    log, output, result = report.source.digest, digest_of(path), report.result
    if log.sha256 is None and not is_address(task.path):
        log = digest_of(task.path)
    entry = ManifestEntry(
        state="data lost" if report.data_lost else "done",
        log=log_name(task.path),
        output=task.name,
        samples=result.samples,
        rows=result.rows,
        span_s=result.span_s,
        sample_rate_hz=result.sample_rate_hz,
        method=report.convention.method,
        final_wxyz=tuple(map(float, result.final_wxyz)),
        remarks=tuple(map(spelled, report.remarks)),
        losses=tuple(f"{loss.place}: {loss.reason}" for loss in report.losses),
        log_bytes=log.bytes,
        log_sha256=log.sha256,
        log_etag=log.etag,
        output_bytes=output.bytes,
        output_sha256=output.sha256,
    )
    json = report.as_json() if settings.reports else None
    return BatchResult(entry, losses=report.losses, report=json)


def propagate_and_record(
    task: BatchTask, settings: BatchSettings, manifest: Manifest
) -> BatchResult:
    """Propagate one log, and record it at once: nothing complete is done again after a kill."""
    result = propagate_log(task, settings)
    try:
        manifest.record(result.entry)
    except OutputError as error:  # the store has gone
        return failed(task, error.text)
    return result


def on_this_machine(
    tasks: Sequence[BatchTask],
    settings: BatchSettings,
    processes: int,
    manifest: Manifest,
    retries: int = 0,
) -> Generator[tuple[int, BatchResult]]:
    """Yield the index and the result of each log as soon as it is done."""

    def on_killed(task: BatchTask) -> BatchResult:
        result = failed(task, f"{plain(task.log)}: {KILLED}")
        manifest.record(result.entry)
        return result

    threads = max(1, available_cores() // max(1, min(processes, len(tasks))))
    settings = settings.with_threads(threads)
    work = partial(propagate_and_record, settings=settings, manifest=manifest)
    return map_processes(work, tasks, processes, on_killed, isolated=True, retries=retries)
