"""Run a batch on any executor: propagate where it runs, prove and record here."""

from __future__ import annotations

import os
import pickle
import time
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from quatprop.base.errors import OutputError, QuatpropError, StoreError, UsageError
from quatprop.base.places import is_address
from quatprop.base.processes import KILLED, KilledError, map_on, own_executor
from quatprop.base.text import Setting, plain, quoted, spelling
from quatprop.base.threads import available_cores
from quatprop.propagation.recording import open_recording
from quatprop.stores.objects import find, list_objects
from quatprop.stores.remote import move
from quatprop.tools.batch.manifest import COMPLETE, ManifestEntry
from quatprop.tools.batch.planning import (
    EVERY_TOPIC,
    REQUESTS,
    BatchResult,
    BatchSettings,
    Plan,
    Shard,
    deleted,
    failed,
    output_size,
    plan,
    refuse_shared_names,
    with_topic,
)
from quatprop.tools.batch.worker import Call, versions
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from quatprop.tools.batch.log_search import LogSearch
    from quatprop.tools.batch.manifest import Manifest
    from quatprop.tools.batch.tasks import BatchTask


def _topics(log: BatchTask, settings: BatchSettings) -> list[BatchTask]:
    """Return a task for each topic with rates; errors are reported when the log is propagated."""
    from quatprop.readers.rate_signals import present_rates, rate_candidates

    if log.topic:
        return [log]
    chosen = with_topic(settings.job, "").settings
    try:
        with open_recording([log.path], chosen.selection, chosen.kind) as recording:
            every = rate_candidates(recording.tables, chosen.selection)
            found, _ = present_rates(every, chosen.selection)
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
        if verify and not skip:
            raise UsageError(f"{Setting('verify')} requires {Setting('skip_existing')}")
        self._settings, self._manifest = settings, manifest
        found = search.take()
        refuse_shared_names(found, settings.folder)
        logs = [log for log in found if part.has(log)]
        if settings.job.settings.selection.topic == EVERY_TOPIC:
            logs = [task for log in logs for task in _topics(log, settings)]
            refuse_shared_names(logs, settings.folder)
        self.gone = deleted(manifest, found, search.searched, part)
        del found
        self.plan: Plan = plan(logs, settings, manifest, skip=skip, verify=verify)

    def results(
        self,
        executor: Executor | None = None,
        processes: int | None = None,
        *,
        isolated: bool = True,
    ) -> Generator[tuple[int, BatchResult]]:
        """Yield the index and the result of each log as soon as it is done and recorded.

        `executor`: where to run; None: processes of our own, as many as the cores or `processes`
        `isolated`: use a child process even if there is only one
        """
        tasks, settings, manifest = self.plan.tasks, self._settings, self._manifest
        if not (tasks or self.gone):
            return
        manifest.prepare()
        if self.gone:
            manifest.record(*self.gone)
        ahead, threads, is_own = AHEAD, 1, executor is None
        if executor is None:
            count = processes or available_cores()
            executor, ahead = own_executor(count, len(tasks), isolated=isolated)
            threads = max(1, available_cores() // max(1, min(count, len(tasks))))
        work = _Run(tasks, settings.with_threads(threads), manifest, executor, is_own=is_own)
        yield from map_on(
            executor, work.submit, tasks, work.settle, ahead=ahead, retries=settings.retries
        )
        tasks.clear()  # to merge entries takes memory, too
        manifest.collect()


STALE = "_stale"
"""Folder for earlier outputs of logs that now fail; readers of datasets skip it."""

AHEAD = 1000
"""Maximum number of logs submitted to a given executor but not yet done."""

NOT_SEEN = (
    "its worker has written an output that is not visible here; give workers the same output folder"
)

PATIENCE_S, LOOK_S = 10.0, 0.5
"""Total time to wait for outputs of other machines to become visible, and between looks, s."""


class _Run:
    """Submits logs to an executor, and proves and records their results.

    `is_own`: whether the executor is one of our own
    """

    def __init__(
        self,
        tasks: Sequence[BatchTask],
        settings: BatchSettings,
        manifest: Manifest,
        executor: Executor,
        *,
        is_own: bool,
    ) -> None:
        self._tasks, self._settings, self._manifest = tasks, settings, manifest
        self._executor, self._is_own = executor, is_own
        if not is_own:  # workers may run in another folder
            settings = settings._replace(folder=_absolute(settings.folder))
        self._packed = pickle.dumps((settings, {} if is_own else versions()))
        self._before: dict[str, object] = {}
        self._left_s = 0.0 if is_own else PATIENCE_S

    def submit(self, task: BatchTask) -> Future[Any]:
        """Submit a log."""
        self._before[task.name] = _state_of(self._settings.output_of(task))
        there = task if self._is_own else task._replace(root=_absolute(task.root))
        try:
            return self._executor.submit(pickle.loads, pickle.dumps(Call(there, self._packed)))
        except RuntimeError as error:  # it was shut down, or is broken
            if self._is_own:
                raise
            raise _lost(error) from error

    def settle(self, ended: list[tuple[int, Future[Any]]]) -> list[tuple[int, BatchResult]]:
        """Return results of logs that have ended, once their outputs are seen and recorded.

        If an output is there no more, or the log failed, an earlier output is withdrawn.
        """
        lost = [future for _, future in ended if _is_lost(future)]
        ended = [(index, future) for index, future in ended if future not in lost]
        tasks = [self._tasks[index] for index, _ in ended]
        with spelling(self._settings.spelling):
            results = list(map(self._result, tasks, [future for _, future in ended]))
            proved = []
            for place, seen in enumerate(self._looked_for(tasks, results)):
                task, result = tasks[place], results[place]
                try:
                    if reason := self._why_not_seen(task, result.entry, seen):
                        results[place] = result = failed(task, f"{plain(task.shown)}: {reason}")
                    if result.entry.state not in COMPLETE:
                        _withdraw(self._settings.output_of(task), task, self._settings)
                    proved.append(place)
                except (OutputError, StoreError) as error:
                    results[place] = failed(task, error.text)
            try:
                entries = [results[place].entry for place in proved]
                entries = self._manifest.record(*entries) if entries else []
                for place, entry in zip(proved, entries, strict=True):
                    results[place] = results[place]._replace(entry=entry)
            except (OutputError, StoreError) as error:  # the store is gone, or the disk is full
                for place in proved:
                    results[place] = failed(tasks[place], error.text)
        if lost:
            raise _lost("cancelled" if lost[0].cancelled() else lost[0].exception())
        return [(index, result) for (index, _), result in zip(ended, results, strict=True)]

    def _result(self, task: BatchTask, future: Future[Any]) -> BatchResult:
        error = future.exception()
        if error is None:
            return future.result()  # type: ignore[no-any-return]
        if isinstance(error, KilledError):
            reason = KILLED
        elif self._is_own:
            raise error
        elif isinstance(error, ImportError):
            reason = f"its worker cannot import quatprop ({plain(error)}); install it there"
        else:  # whatever is raised on other machines
            reason = f"its worker failed ({type(error).__name__}: {plain(error)})"
        return failed(task, f"{plain(task.shown)}: {reason}")

    def _looked_for(
        self, tasks: Sequence[BatchTask], results: Sequence[BatchResult]
    ) -> list[int | StoreError | None]:
        """Return the size of each output, None if there is none, or the error of its store."""
        outputs = [
            self._settings.output_of(task) if result.entry.state in COMPLETE else ""
            for task, result in zip(tasks, results, strict=True)
        ]
        if not is_address(self._settings.folder):
            return [*map(output_size, outputs)]
        with ThreadPoolExecutor(REQUESTS) as pool:
            return [*pool.map(_size_in_store, outputs)]

    def _why_not_seen(
        self, task: BatchTask, entry: ManifestEntry, size: int | StoreError | None
    ) -> str:
        """Return why an output is not visible as written; empty if it is, or there is none.

        On a shared file system, it may become visible late.
        """
        output, before = self._settings.output_of(task), self._before.pop(task.name)
        while entry.state in COMPLETE:
            if size == entry.output_bytes and (is_address(output) or _state_of(output) != before):
                break
            if self._left_s <= 0:
                if isinstance(size, StoreError):
                    raise size
                return "its output was changed" if self._is_own else NOT_SEEN
            time.sleep(LOOK_S)
            self._left_s -= LOOK_S
            size = _size_in_store(output) if is_address(output) else output_size(output)
        return ""


def _is_lost(future: Future[Any]) -> bool:
    return future.cancelled() or isinstance(future.exception(), BrokenExecutor)


def _lost(why: object) -> QuatpropError:
    return QuatpropError(
        f"the executor has ended ({plain(why)}); finished logs are recorded: continue with "
        f"{Setting('skip_existing')}"
    )


def _state_of(output: str) -> tuple[int, ...] | None:
    """Return the identity of a local output, to detect that it was replaced; else None."""
    try:
        status = os.stat(output)
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_ctime_ns


def _size_in_store(output: str) -> int | StoreError | None:
    """Return the size of an output in a store, None if there is none, or the store's error."""
    try:
        if not output:
            return None
        _, found = find(output)
        if found.is_file:
            return int(found.size)
        return sum(int(info.size) for info in list_objects(output).values())
    except StoreError as error:
        return None if isinstance(error.__cause__, FileNotFoundError) else error


def _withdraw(output: str, task: BatchTask, settings: BatchSettings) -> None:
    """Move away an earlier output of a log that now fails, so that it does not look current."""
    if not is_address(output):
        if not os.path.lexists(output):
            return
        refuse_outside(os.path.dirname(output), settings.folder)
    move(
        output,
        settings.output_of(task._replace(log=f"{STALE}/{task.log}", suffix=f"{task.suffix}.old")),
    )


def _absolute(path: str) -> str:
    return path if is_address(path) else os.path.abspath(path)


# The workers of a Dask cluster.


ANSWER_S, WORKERS_S = 10, 30
"""Timeout of the scheduler, and for the first worker, s."""


@contextmanager
def dask_executor(scheduler: str) -> Iterator[Executor]:
    """Connect to a Dask cluster, and yield its workers as an executor.

    `scheduler`: address of the cluster's scheduler, such as ``"tcp://10.0.0.5:8786"``
    """
    try:
        from distributed import Client
        from distributed.comm.addressing import resolve_address
    except ImportError as error:
        raise UsageError(
            "a Dask cluster needs distributed, which is not installed; pip install distributed"
        ) from error
    try:
        # A client that has refused an address waits for itself for 20 s when it is let go.
        resolve_address(scheduler)
        client = Client(scheduler, timeout=f"{ANSWER_S}s", set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise UsageError(
            f"no Dask scheduler answers at {quoted(scheduler)} ({error}); check the address"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError as error:
            raise UsageError(
                f"the Dask cluster at {quoted(scheduler)} has no workers; start some, and try again"
            ) from error
        yield client.get_executor(pure=False)  # type: ignore[no-untyped-call]
