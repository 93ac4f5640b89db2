"""Propagate many logs on the workers of a Dask cluster."""

from __future__ import annotations

import ctypes
import os
import pickle
import sys
import time
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING

from quatprop.batching.entries import COMPLETE
from quatprop.batching.execution import output_size_of, propagate_log, record
from quatprop.batching.tasks import BatchResult, BatchSettings, failed
from quatprop.errors import QuatpropError, StoreError, UsageError
from quatprop.stores.objects import is_address
from quatprop.text import Setting, plain, quoted
from quatprop.version import __version__

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from distributed import Client, Future, as_completed

    from quatprop.batching.entries import ManifestEntry
    from quatprop.batching.logs import BatchTask
    from quatprop.batching.manifest import Manifest

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
