"""Run a whole batch: plan, propagate, record."""

from __future__ import annotations

import ctypes
import os
import pickle
import sys
import time
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

from quatprop.base import __version__
from quatprop.base.errors import (
    NoRatesError,
    OutputError,
    QuatpropError,
    ReplacedError,
    StoreError,
    UnknownFormatError,
    UnsupportedLogError,
    UsageError,
    as_user_error,
)
from quatprop.base.processes import KILLED, map_processes
from quatprop.base.provenance import Digest, digest_of
from quatprop.base.text import Setting, in_python, plain, quoted, spelled, spelling
from quatprop.base.threads import available_cores
from quatprop.propagation.job import ATTEMPTS, run
from quatprop.settings import in_options
from quatprop.stores.objects import find, is_address, is_transient, list_objects
from quatprop.stores.remote import move, upload
from quatprop.stores.temp_files import temp_folder
from quatprop.tools.batch.dataset import merge_parts, with_parts
from quatprop.tools.batch.log_search import BatchTask, absolute, origin_of_read
from quatprop.tools.batch.manifest import COMPLETE, ManifestEntry
from quatprop.tools.batch.planning import (
    EVERY_TOPIC,
    BatchResult,
    BatchSettings,
    Plan,
    Shard,
    deleted,
    failed,
    output_size,
    plan,
    with_topic,
)
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from distributed import Client, Future, as_completed

    from quatprop.propagation.report import RunReport
    from quatprop.tools.batch.log_search import LogSearch
    from quatprop.tools.batch.manifest import Manifest


def _topics(log: BatchTask, settings: BatchSettings) -> list[BatchTask]:
    """Return a task for each topic with rates; errors are reported when the log is propagated."""
    from quatprop.readers.open_log import open_logs
    from quatprop.readers.rate_signals import present_rates, rate_candidates

    if log.topic:
        return [log]
    chosen = with_topic(settings.job, "").settings
    try:
        with open_logs([log.path], chosen.kind, msg_path=chosen.selection.msg_path) as opened:
            every = rate_candidates(opened, chosen.selection)
            found = present_rates(every, chosen.selection)
    except QuatpropError:
        return [log]
    return [log._replace(topic=name) for name in dict.fromkeys(one.topic for one in found)]


class Batch:
    """The plan and the execution of a batch.

    `search`: the logs that were found, which are removed from it
    `part`: the part of them for this batch
    `skip`, `verify`: whether up-to-date outputs are kept, and verified by their digests
    """

    def __init__(  # noqa: PLR0913  # options of the command
        self,
        search: LogSearch,
        settings: BatchSettings,
        manifest: Manifest,
        part: Shard,
        *,
        skip: bool,
        verify: bool,
    ) -> None:
        self._settings, self._manifest, self._part = settings, manifest, part
        found = search.take()
        logs = [log for log in found if part.has(log)]
        if settings.job.settings.selection.topic == EVERY_TOPIC:
            if settings.files:
                raise UsageError(
                    f"{Setting('topic', EVERY_TOPIC)} gives several series of a log, and "
                    f"{Setting('dataset')} has one; name a topic"
                )
            logs = [task for log in logs for task in _topics(log, settings)]
        if settings.files:
            logs = with_parts(logs, settings.files)
        self.gone = deleted(manifest, found, search.searched, part)
        del found
        self.plan: Plan = plan(logs, settings, manifest, skip=skip, verify=verify)

    def results(
        self, processes: int | None = None, dask: str | None = None, *, isolated: bool = True
    ) -> Generator[tuple[int, BatchResult]]:
        """Yield the index and the result of each log as soon as it is done and recorded.

        `isolated`: use a child process even if there is only one
        """
        settings, manifest = self._settings, self._manifest
        count = processes or available_cores()
        if self.plan.tasks or self.gone:
            manifest.prepare()
            for entry in self.gone:
                manifest.record(entry)
            if dask is not None:
                yield from on_a_cluster(self.plan.tasks, settings, dask, manifest)
            else:
                yield from on_this_machine(
                    self.plan.tasks, settings, count, manifest, isolated=isolated
                )
            self.plan.tasks.clear()  # to merge entries takes memory, too
            manifest.collect()
        if settings.files:
            merge_parts(settings.folder, self._part.has_file, count)


# Propagate many logs on the cores of this machine, and record their results.


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
            is_other = isinstance(error, NoRatesError | UnknownFormatError)
            text = error.text
            if is_other and task.standing == "done":
                text += "; it was done in an earlier batch: is it damaged?"
            result = failed(
                task, text, "no rates" if is_other and task.standing == "table" else "failed"
            )
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
        attitudes_crc32=result.attitudes_crc32,
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


# Propagate many logs on the workers of a Dask cluster.


AHEAD = 1000
"""Maximum number of logs submitted but not yet done."""

ANSWER_S = 10
"""Timeout of the scheduler, s."""

PATIENCE_S, LOOK_S = 10.0, 0.5
"""Total time to wait for outputs of workers to become visible, and time between checks, s."""

WORKERS_S, AGAIN_S = 30, 600
"""Timeout for the first worker, and for a new one after all were lost, s."""

IDLE_S, WAKE_S = 60.0, 0.01
"""Time without results after which workers are checked, and time between checks, s."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Parameters of mallopt in the C library."""

KEPT_BYTES, MAPPED_BYTES, DEFAULT_MAPPED_BYTES = 1 << 28, 1 << 25, 1 << 17
"""Freed bytes that are kept; size from which blocks are mapped separately, and its default."""


def on_a_cluster(
    tasks: Sequence[BatchTask],
    settings: BatchSettings,
    scheduler: str,
    manifest: Manifest,
) -> Generator[tuple[int, BatchResult]]:
    """Yield the index and the result of each log, propagated by the workers of a Dask cluster.

    `scheduler`: address of the cluster's scheduler, such as ``"tcp://10.0.0.5:8786"``
    """
    try:
        from distributed import as_completed
    except ImportError as error:
        raise UsageError(
            "a Dask cluster needs distributed, which is not installed; pip install distributed"
        ) from error
    with _client(scheduler) as client:
        waiting, settings = enumerate(tasks), settings.with_threads(1)
        settings = settings._replace(folder=_absolute(settings.folder))
        indices: dict[object, tuple[int, object]] = {}
        completed = as_completed(loop=client.loop)  # type: ignore[no-untyped-call]
        looks = _Looks()

        def submit(count: int) -> None:
            for index, task in islice(waiting, count):
                there = task._replace(root=_absolute(task.root))
                # Bytes: where the package is missing, only calling it fails, and for this log.
                call = pickle.dumps(_Call(there, settings, __version__))
                before = _state_of(settings.output_of(task))
                future = client.submit(pickle.loads, call, pure=False, retries=settings.retries)
                indices[future.key] = index, before
                completed.add(future)  # type: ignore[no-untyped-call]

        submit(AHEAD)
        if not _has_workers(client, WORKERS_S):
            raise UsageError(
                f"the Dask cluster at {quoted(scheduler)} has no workers; start some, and try again"
            )
        for future in _ended(completed, client, scheduler):
            index, before = indices[future.key]
            task = tasks[index]
            try:
                result = _result(future, task)
            except TimeoutError:  # such as one lost with its worker, which is computed again
                completed.add(future)  # type: ignore[no-untyped-call]
                continue
            del indices[future.key]
            if result is None:
                raise _lost(f"the Dask scheduler at {quoted(scheduler)} no longer answers")
            submit(1)
            seen = looks.why_not_seen(settings.output_of(task), result.entry, before)
            yield index, record(task, result, settings, manifest, seen)


def _ended(
    completed: as_completed, client: Client, scheduler: str
) -> Iterator[Future[BatchResult]]:
    """Yield futures as they complete; a cluster without workers has some time to get new ones."""
    while not completed.is_empty():  # type: ignore[no-untyped-call]
        last = time.monotonic()
        while not completed.has_ready():  # type: ignore[no-untyped-call]
            if time.monotonic() - last > IDLE_S:
                if not _has_workers(client, AGAIN_S):
                    raise _lost(f"the Dask cluster at {quoted(scheduler)} has lost its workers")
                last = time.monotonic()
            time.sleep(WAKE_S)
        yield next(completed)


def _lost(what: str) -> QuatpropError:
    return QuatpropError(
        f"{what}; finished logs are recorded: continue with {Setting('skip_existing')}"
    )


class _Call:
    """Propagates a log when it is unpickled."""

    def __init__(self, *arguments: object) -> None:
        self._arguments = arguments

    def __reduce__(self) -> tuple[object, ...]:
        return propagate_on_worker, self._arguments


def _state_of(output: str) -> tuple[int, ...] | None:
    """Return the identity of a local output, to detect that it was replaced; else None."""
    try:
        status = os.stat(output)  # noqa: PTH116
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_ctime_ns


class _Looks:
    """Waits for outputs of workers, which on a shared file system may become visible late."""

    def __init__(self) -> None:
        self._left_s = PATIENCE_S

    def why_not_seen(self, output: str, entry: ManifestEntry, before: object) -> str:
        """Return why the output of a result is not visible as written; empty if it is."""
        if entry.state not in COMPLETE:
            return ""
        while True:
            try:
                is_there = output_size_of(output) == entry.output_bytes
            except StoreError:
                is_there = False  # the store may answer at the next look
            if is_there and (is_address(output) or _state_of(output) != before):
                return ""
            if self._left_s <= 0:
                return (
                    "its worker has written an output that is not visible here; give workers "
                    "the same "
                    "output folder"
                )
            time.sleep(LOOK_S)
            self._left_s -= LOOK_S


def _client(scheduler: str) -> Client:
    """Connect to a cluster."""
    from distributed import Client
    from distributed.comm.addressing import resolve_address

    try:
        # A client that has refused an address waits for itself for 20 s when it is let go.
        resolve_address(scheduler)
        return Client(scheduler, timeout=f"{ANSWER_S}s", set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise UsageError(
            f"no Dask scheduler answers at {quoted(scheduler)} ({error}); check the address"
        ) from error


def _has_workers(client: Client, patience_s: float) -> bool:
    """Wait for a worker, which a cluster may start on demand; return whether there is one."""
    try:
        client.wait_for_workers(1, timeout=patience_s)
    except TimeoutError:
        return False
    return True


def _result(future: Future[BatchResult], task: BatchTask) -> BatchResult | None:
    """Return the result of a log, which may be an error; None if the cluster is gone.

    Raises TimeoutError if the result does not arrive.
    """
    from distributed.client import FutureCancelledError
    from distributed.scheduler import KilledWorker

    try:
        return future.result(timeout=IDLE_S)
    except ImportError as error:
        reason = f"its worker cannot import quatprop ({plain(error)}); install it there"
    except KilledWorker:
        reason = "the workers that ran it were killed; do they have enough memory?"
    except FutureCancelledError:
        return None
    except Exception as error:  # whatever is raised on other machines
        if isinstance(error, TimeoutError) and future.status != "error":
            raise
        reason = f"the cluster failed ({type(error).__name__}: {plain(error)})"
    return failed(task, f"{plain(task.shown)}: {reason}")


def propagate_on_worker(task: BatchTask, settings: BatchSettings, version: str) -> BatchResult:
    """Propagate one log in a worker, which must have the same version of quatprop."""
    if version != __version__:
        reason = f"its worker has quatprop {__version__}, not {version}; install the same version"
        return failed(task, f"{plain(task.shown)}: {reason}")
    with _freed_memory_kept():
        return propagate_log(task, settings)


@contextmanager
def _freed_memory_kept() -> Iterator[None]:
    """Keep freed memory in this block, which Dask's nanny turns off by an environment variable.

    Where the system clears every page anew, propagation takes up to three times as long.
    """
    threshold = os.environ.get("MALLOC_TRIM_THRESHOLD_", "")
    libc = ctypes.CDLL(None) if sys.platform == "linux" else None
    if not threshold.isdecimal() or not hasattr(libc, "mallopt"):
        yield
        return
    mallopt = libc.mallopt  # type: ignore[union-attr]
    mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES)
    mallopt(_M_MMAP_THRESHOLD, MAPPED_BYTES)
    try:
        yield
    finally:
        mallopt(_M_TRIM_THRESHOLD, int(threshold))
        mallopt(_M_MMAP_THRESHOLD, DEFAULT_MAPPED_BYTES)


def _absolute(path: str) -> str:
    return path if is_address(path) else os.path.abspath(path)  # noqa: PTH100
