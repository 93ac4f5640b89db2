"""Many logs, each propagated by itself: on the cores of this machine, or on a Dask cluster."""

from __future__ import annotations

import os
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.errors import OutputError, QuatpropError, UsageError, plain, quoted
from quatprop.job import run
from quatprop.parallel import KILLED, each

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.job import Job


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one log.

    Parameters
    ----------
    log, output
        What was read, and where its attitudes are.
    error
        Why there are none, in a sentence; ``""`` where there are.
    report
        That of :func:`quatprop.job.run`; empty where there are no attitudes.
    seconds
        How long it took.
    """

    log: str
    output: str
    error: str = ""
    report: dict[str, Any] | None = None
    seconds: float = 0.0

    @property
    def data_lost(self) -> bool:
        """Whether something of the log was lost on the way."""
        return bool(self.report and self.report["data_lost"])


def outputs(logs: Sequence[str], folder: Path, suffix: str) -> list[Path]:
    """Return where the attitudes of each log go.

    Parameters
    ----------
    logs
        Paths of logs.
    folder
        Where all outputs are.
    suffix
        Of every output, with its dot; empty for folders.

    Returns
    -------
    list of Path
        ``folder/NAME.suffix`` where all logs have different names. Where some have the same, as
        in a folder for each run, the folders below the one that all logs share are kept.

    Raises
    ------
    UsageError
        A log is named twice, or two would go to the same place.

    Examples
    --------
    >>> [path.as_posix() for path in outputs(["a/imu.bag", "b/gyro.csv"], Path("out"), ".npy")]
    ['out/imu.npy', 'out/gyro.npy']
    >>> [path.as_posix() for path in outputs(["a/imu.bag", "b/imu.bag"], Path("out"), ".npy")]
    ['out/a/imu.npy', 'out/b/imu.npy']
    """
    places = [Path(os.path.abspath(log)) for log in logs]  # noqa: PTH100  # links stay as named
    for place, count in Counter(places).items():
        if count > 1:
            raise UsageError(f"{quoted(place)} is named {count} times; name each log once")
    names = [Path(_stem(place)) for place in places]
    if len({str(name).lower() for name in names}) < len(names):
        shared = Path(os.path.commonpath([place.parent for place in places]))
        names = [place.parent.relative_to(shared) / _stem(place) for place in places]
    for name, count in Counter(str(name).lower() for name in names).items():
        if count > 1:
            raise UsageError(
                f"{count} logs would go to {quoted(folder / (name + suffix))}; "
                "propagate them apart, or rename one"
            )
    return [folder / f"{name}{suffix}" for name in names]


def _stem(place: Path) -> str:
    """Return the name of a log without its suffixes: those of its packing, too."""
    if place.is_dir():
        return place.name
    packed = place.suffix.lower() in {".gz", ".zst", ".zstd", ".lz4", ".bz2", ".active"}
    return Path(place.stem).stem if packed else place.stem


def propagated(job: Job) -> Outcome:
    """Propagate one log; what goes wrong is its outcome."""
    began = time.perf_counter()
    try:
        Path(job.output).parent.mkdir(parents=True, exist_ok=True)
        report = run(job)
    except QuatpropError as error:
        return Outcome(job.log, job.output, str(error), None, time.perf_counter() - began)
    except OSError as error:
        reason = str(OutputError(job.output, error.strerror or str(error)))
        return Outcome(job.log, job.output, reason, None, time.perf_counter() - began)
    return Outcome(job.log, job.output, "", report, time.perf_counter() - began)


def on_this_machine(jobs: Sequence[Job], processes: int) -> Iterator[Outcome]:
    """Yield what comes of each log, in their order.

    Parameters
    ----------
    jobs
        One for each log.
    processes
        How many at a time.
    """
    return each(propagated, jobs, processes, _killed)


def _killed(job: Job) -> Outcome:
    return Outcome(job.log, job.output, f"{plain(job.log)}: {KILLED}")


def on_a_cluster(jobs: Sequence[Job], scheduler: str) -> Iterator[Outcome]:
    """Yield what comes of each log, in their order, propagated by the workers of a Dask cluster.

    Parameters
    ----------
    jobs
        One for each log; the workers have to see the same paths, and have quatprop installed.
    scheduler
        Address of the cluster's scheduler, such as ``"tcp://10.0.0.5:8786"``.

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
        futures = client.map(propagated, jobs, pure=False)
        for job, future in zip(jobs, futures, strict=True):
            try:
                yield future.result()
            except KilledWorker:
                reason = "the workers that ran it were killed; have they enough memory?"
                yield Outcome(job.log, job.output, f"{plain(job.log)}: {reason}")
