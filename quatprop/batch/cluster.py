"""Many logs, propagated by the workers of a Dask cluster."""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from quatprop import __version__
from quatprop.batch.run import failed, propagate_log
from quatprop.containers.stores import is_address
from quatprop.errors import UsageError
from quatprop.pipeline.job import Job
from quatprop.text import plain, quoted

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from distributed import Future

    from quatprop.batch.manifest import Manifest
    from quatprop.batch.run import BatchResult, BatchTask

AHEAD = 1000
"""Logs that are submitted to a cluster before the first of them is done."""


def on_a_cluster(
    tasks: Sequence[BatchTask], scheduler: str, manifest: Manifest, retries: int = 0
) -> Generator[tuple[int, BatchResult]]:
    """Yield the index and the result of each log, propagated by the workers of a Dask cluster.

    Parameters
    ----------
    tasks
        One for each log; the workers must see the same paths, and have the same quatprop.
    scheduler
        Address of the cluster's scheduler, such as ``"tcp://10.0.0.5:8786"``.
    manifest
        Where results are recorded.
    retries
        How often a log is tried again whose worker raised an error.

    Raises
    ------
    UsageError
        The package is missing, or there is no scheduler at the address.
    """
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise UsageError(
            "a Dask cluster needs the package distributed; install it with "
            "pip install 'quatprop[dask]'"
        ) from error
    try:
        client = Client(scheduler, timeout="10s", set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise UsageError(
            f"no Dask scheduler answers at {quoted(scheduler)} ({error}); check the address"
        ) from error
    with client:
        waiting = enumerate(tasks)
        futures: dict[int, Future[BatchResult]] = {}

        def submit(count: int) -> None:
            for index, task in islice(waiting, count):
                futures[index] = client.submit(
                    propagate_on_worker,
                    _absolute(task).with_threads(1),
                    __version__,
                    pure=False,
                    retries=retries,
                )

        submit(AHEAD)
        for index, task in enumerate(tasks):
            try:
                result = futures.pop(index).result()
                result = replace(result, log=task.log, output=task.job.output.path)
            except KilledWorker:
                reason = "the workers that ran it were killed; do they have enough memory?"
                result = failed(task, f"{plain(task.log)}: {reason}")
            except Exception as error:  # noqa: BLE001  # whatever is raised on other machines
                reason = f"the cluster failed ({type(error).__name__}: {plain(error)})"
                result = failed(task, f"{plain(task.log)}: {reason}")
            submit(1)
            manifest.append(result.entry)
            yield index, result


def propagate_on_worker(task: BatchTask, version: str) -> BatchResult:
    """Propagate one log in a worker, which must have the same version of quatprop."""
    if version != __version__:
        reason = f"its worker has quatprop {__version__}, not {version}; install the same version"
        return failed(task, f"{plain(task.log)}: {reason}")
    return propagate_log(task)


def _absolute(task: BatchTask) -> BatchTask:
    """Return a task whose paths do not depend on the current folder."""
    job, settings = task.job, task.job.settings
    if settings.q0.source in settings.inputs:
        source = _absolute_path(settings.q0.source)
        settings = replace(settings, q0=replace(settings.q0, source=source))
    settings = replace(settings, at=settings.at and _absolute_path(settings.at))
    if settings.conditioning.calibration is not None:
        calibration = _absolute_path(settings.conditioning.calibration)
        conditioning = replace(settings.conditioning, calibration=calibration)
        settings = replace(settings, conditioning=conditioning)
    output = replace(job.output, path=_absolute_path(job.output.path))
    return replace(task, job=Job(_absolute_path(job.log), output, settings))


def _absolute_path(path: str) -> str:
    return path if is_address(path) else os.path.abspath(path)  # noqa: PTH100
