"""Propagate many logs on the cores of this machine, and record their results."""

from __future__ import annotations

import os
import time
from functools import partial
from typing import TYPE_CHECKING

from quatprop.batching.entries import COMPLETE, ManifestEntry
from quatprop.batching.logs import BatchTask, absolute
from quatprop.batching.origins import origin_of_read
from quatprop.batching.tasks import BatchResult, BatchSettings, failed, output_size, with_topic
from quatprop.concurrency.processes import KILLED, map_processes
from quatprop.concurrency.threads import available_cores
from quatprop.errors import (
    NoRatesError,
    OutputError,
    QuatpropError,
    ReplacedError,
    StoreError,
    UnknownFormatError,
    UnsupportedLogError,
)
from quatprop.errors.third_party import as_user_error
from quatprop.pipeline.job import ATTEMPTS, run
from quatprop.provenance import Digest, digest_of
from quatprop.settings.spelling import in_options
from quatprop.stores.objects import find, is_address, is_transient, list_objects
from quatprop.stores.temp_files import temp_folder
from quatprop.stores.transfers import move, upload
from quatprop.text import in_python, plain, spelled, spelling
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from quatprop.batching.manifest import Manifest
    from quatprop.pipeline.report import RunReport

STALE = "_stale"
"""Folder for earlier outputs of logs that now fail; readers of datasets skip it."""

MAX_PAUSE_S = 30.0
"""Maximum pause before a retry, s."""


def propagate_log(task: BatchTask, settings: BatchSettings) -> BatchResult:
    """Propagate one log; errors are returned as results."""
    with spelling(in_python if settings.is_library else in_options):
        return _propagated_log(task, settings)


def _propagated_log(task: BatchTask, settings: BatchSettings) -> BatchResult:
    began = time.perf_counter()
    attempt = 0
    while True:
        try:
            result = _done(task, settings)
        except QuatpropError as error:
            if is_transient(error) and attempt < settings.retries:
                time.sleep(min(2.0**attempt, MAX_PAUSE_S))
                attempt += 1
                continue
            no_log = task.maybe and isinstance(error, NoRatesError | UnknownFormatError)
            result = failed(task, error.text, "no rates" if no_log else "failed")
        except Exception as error:
            if (user_error := as_user_error(error)) is None:
                raise
            result = failed(task, f"{plain(task.shown)}: {user_error.text}")
        break
    seconds = time.perf_counter() - began
    entry = result.entry._replace(seconds=seconds, options=settings.options)
    return result._replace(entry=entry)


def _done(task: BatchTask, settings: BatchSettings) -> BatchResult:
    """Propagate one log; an output for an object store is written locally, then uploaded."""
    if task.refused:
        raise UnsupportedLogError(task.shown, task.refused)
    output = settings.output_of(task)
    if not is_address(output):
        refuse_outside(output, settings.folder)
        os.makedirs(os.path.dirname(output) or ".", exist_ok=True)  # noqa: PTH103, PTH120
        return _propagated(task, settings, output)
    temp = temp_folder()
    try:
        local = str(temp.path / os.path.basename(task.name))  # noqa: PTH119
        result = _propagated(task, settings, local)
        upload(temp.path / os.path.basename(task.name), output)  # noqa: PTH119
    finally:
        temp.remove()
    return result


def _propagated(task: BatchTask, settings: BatchSettings, path: str) -> BatchResult:
    """Propagate one log into a local file."""
    job = settings.job
    names, output = partial(known_as, task), job.output._replace(path=path)
    job = with_topic(job, task.topic)._replace(log=task.path, known_as=names, output=output)
    for _ in range(ATTEMPTS):
        origin = task.origin if is_address(task.path) else task.origin_now()
        report = run(job, summary=False)
        # For a log in a store, the reader has verified that it was not replaced.
        if is_address(task.path) or origin == task.origin_now():
            break
    else:
        raise ReplacedError(
            f"{plain(task.path)}: it was written to while it was read; try again when it is "
            "complete"
        )
    log = report.source.digest
    if log.sha256 is None and not is_address(task.path):
        log = digest_of(task.path)
    origin = origin or origin_of_read(task.path, log)
    entry = _entry(task, report, log, digest_of(path))._replace(origin=origin)
    json = report.as_json() if settings.reports else None
    return BatchResult(entry, losses=report.losses, report=json)


def known_as(task: BatchTask, paths: Sequence[str]) -> list[str]:
    """Return the names of a log and of other inputs in its output, the same on any machine.

    Inputs below the root have their path there, others their file name, with as many folders as
    make it unique.
    """
    above = os.path.join(absolute(task.root), "")  # noqa: PTH118
    full = [absolute(path) for path in paths]
    inside = [path.startswith(above) for path in full]
    places = [path.removeprefix(above).replace(os.sep, "/") for path in full]
    for depth in range(1, 2 + max(place.count("/") for place in places)):
        tails = ("/".join(place.split("/")[-depth:]) for place in places)
        names = [each[not own] for own, *each in zip(inside, places, tails, strict=True)]
        if len({*names}) == len({*full}):
            break
    return [task.log, *names[1:]]


def _entry(task: BatchTask, report: RunReport, log: Digest, output: Digest) -> ManifestEntry:
    result = report.result
    return ManifestEntry(
        state="data lost" if report.data_lost else "done",
        root=absolute(task.root),
        log=task.log,
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


def record(
    task: BatchTask,
    result: BatchResult,
    settings: BatchSettings,
    manifest: Manifest,
    seen: str | None = None,
) -> BatchResult:
    """Check the output of a log, and record its result; if it failed, set an earlier output aside.

    `seen`: why the output is not visible, or ``""``; None: check here
    """
    try:
        if seen is None and result.entry.state in COMPLETE:
            size = output_size_of(settings.output_of(task))
            seen = "" if size == result.entry.output_bytes else "its output was changed"
        if seen:
            result = failed(task, f"{plain(task.shown)}: {seen}")
        if task.name:
            if result.entry.state not in COMPLETE:
                _set_aside(task, settings)
            result = result._replace(entry=manifest.record(result.entry))
    except (OutputError, StoreError) as error:  # the store is gone, or the disk is full
        return failed(task, error.text)
    return result


def output_size_of(output: str) -> int | None:
    """Return the size of an output, bytes; None if there is none."""
    if not is_address(output):
        return output_size(output)
    try:
        _, found = find(output)
        if found.is_file:
            return int(found.size)
        return sum(int(info.size) for info in list_objects(output).values())
    except StoreError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise


def _set_aside(task: BatchTask, settings: BatchSettings) -> None:
    """Move away an earlier output of a log that now fails, so that it does not look current.

    In a dataset, an empty part removes its rows.
    """
    output = settings.output_of(task)
    if task.folder:
        if not is_address(output):
            refuse_outside(output, settings.folder)
            os.makedirs(os.path.dirname(output), exist_ok=True)  # noqa: PTH103, PTH120
        with open_atomic(output):
            pass
    elif is_address(output) or os.path.lexists(output):
        move(output, settings.output_of(task._replace(named=f"{STALE}/{task.name}.old")))


def propagate_and_record(
    task: BatchTask, settings: BatchSettings, manifest: Manifest
) -> BatchResult:
    """Propagate one log, and record it at once, so that it is not repeated after a kill."""
    return record(task, propagate_log(task, settings), settings, manifest)


def on_this_machine(
    tasks: Sequence[BatchTask],
    settings: BatchSettings,
    processes: int,
    manifest: Manifest,
    *,
    isolated: bool,
) -> Generator[tuple[int, BatchResult]]:
    """Yield the index and the result of each log as soon as it is done.

    `isolated`: use a child process even if there is only one
    """

    def on_killed(task: BatchTask) -> BatchResult:
        result = failed(task, f"{plain(task.shown)}: {KILLED}")
        return record(task, result, settings, manifest)

    threads = max(1, available_cores() // max(1, min(processes, len(tasks))))
    retries, settings = settings.retries, settings.with_threads(threads)
    work = partial(propagate_and_record, settings=settings, manifest=manifest)
    return map_processes(work, tasks, processes, on_killed, isolated=isolated, retries=retries)
