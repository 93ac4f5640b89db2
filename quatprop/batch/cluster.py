"""Many logs, propagated by the workers of a Dask cluster."""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING

from quatprop.batch.execution import propagate_log
from quatprop.batch.tasks import BatchResult, BatchSettings, BatchTask, failed
from quatprop.errors import QuatpropError, UsageError
from quatprop.stores.objects import is_address
from quatprop.text import Setting, plain, quoted
from quatprop.version import __version__

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from distributed import Client, Future

    from quatprop.batch.manifest import Manifest

AHEAD = 1000
"""Logs that are submitted to a cluster before the first of them is done."""

ANSWER_S = 10
"""Seconds in which a scheduler must answer."""

WORKERS_S = 30
"""Seconds in which a cluster must have a worker."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Parameters of mallopt, as the C library has them."""

KEPT_BYTES, MAPPED_BYTES, DEFAULT_MAPPED_BYTES = 1 << 28, 1 << 25, 1 << 17
"""Freed bytes that are kept; bytes of a block from which it is mapped by itself, and as usual."""


def on_a_cluster(
    tasks: Sequence[BatchTask],
    settings: BatchSettings,
    scheduler: str,
    manifest: Manifest,
    retries: int = 0,
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
        indices: dict[str, int] = {}
        completed = as_completed(loop=client.loop)  # type: ignore[no-untyped-call]

        def submit(count: int) -> None:
            for index, task in islice(waiting, count):
                future = client.submit(
                    propagate_on_worker,
                    _absolute(task),
                    settings,
                    __version__,
                    pure=False,
                    retries=retries,
                )
                indices[future.key] = index
                completed.add(future)  # type: ignore[no-untyped-call]

        submit(AHEAD)
        _wait_for_workers(client, scheduler)
        for future in completed:
            index = indices.pop(future.key)
            result = _result(future, tasks[index])
            if result is None:
                raise QuatpropError(
                    f"the Dask scheduler at {quoted(scheduler)} no longer answers; what is done "
                    f"is recorded: go on with {Setting('skip_existing')}"
                )
            submit(1)
            manifest.record(result.entry)
            yield index, result


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


def _wait_for_workers(client: Client, scheduler: str) -> None:
    """Wait for the first worker: a cluster may start them when there is something to do."""
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError as error:
        raise UsageError(
            f"the Dask cluster at {quoted(scheduler)} has no workers; start some, and try again"
        ) from error


def _result(future: Future[BatchResult], task: BatchTask) -> BatchResult | None:
    """Return the result of a log, which may be an error; None where the cluster has gone."""
    from distributed.client import FutureCancelledError
    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except KilledWorker:
        reason = "the workers that ran it were killed; do they have enough memory?"
    except FutureCancelledError:
        return None
    except Exception as error:  # noqa: BLE001  # whatever is raised on other machines
        reason = f"the cluster failed ({type(error).__name__}: {plain(error)})"
    return failed(task, f"{plain(task.log)}: {reason}")


def propagate_on_worker(task: BatchTask, settings: BatchSettings, version: str) -> BatchResult:
    """Propagate one log in a worker, which must have the same version of quatprop."""
    if version != __version__:
        reason = f"its worker has quatprop {__version__}, not {version}; install the same version"
        return failed(task, f"{plain(task.log)}: {reason}")
    with _freed_memory_kept():
        return propagate_log(task, settings)


@contextmanager
def _freed_memory_kept() -> Iterator[None]:
    """Let freed memory be used again in this block, which Dask's nanny turns off by a variable.

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


def _absolute(task: BatchTask) -> BatchTask:
    """Return a task whose log and output do not depend on the current folder."""
    return task._replace(path=_absolute_path(task.path), output=_absolute_path(task.output))


def _absolute_path(path: str) -> str:
    return path if is_address(path) else os.path.abspath(path)  # noqa: PTH100
