"""Many logs, each propagated by itself: on the cores of this machine, or on a Dask cluster."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

from quatprop import __version__
from quatprop.containers.remote import is_address, without_secret
from quatprop.errors import QuatpropError, UsageError
from quatprop.parallel import KILLED, in_order, map_processes
from quatprop.pipeline.job import run
from quatprop.text import Text, plain, quoted
from quatprop.third_party_errors import as_user_error
from quatprop.writers.atomic import OutputFile

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.pipeline.job import Job
    from quatprop.pipeline.report import RunReport


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
        That of :func:`quatprop.pipeline.job.run`; empty where there are no attitudes.
    seconds
        How long it took.
    """

    log: str
    output: str
    error: str | Text = ""
    report: RunReport | None = None
    seconds: float = 0.0

    @property
    def data_lost(self) -> bool:
        """Whether something of the log was lost on the way."""
        return bool(self.report and self.report.data_lost)


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
        in a folder for each run, the folders below the one that all logs share are kept; logs
        that differ in their own suffix alone keep that, too.

    Raises
    ------
    UsageError
        A log is named twice.

    Examples
    --------
    >>> [path.as_posix() for path in outputs(["a/imu.bag", "b/gyro.csv"], Path("out"), ".npy")]
    ['out/imu.npy', 'out/gyro.npy']
    >>> [path.as_posix() for path in outputs(["a/imu.bag", "b/imu.bag"], Path("out"), ".npy")]
    ['out/a/imu.npy', 'out/b/imu.npy']
    >>> [path.as_posix() for path in outputs(["imu.bag", "imu.csv"], Path("out"), ".npy")]
    ['out/imu.bag.npy', 'out/imu.csv.npy']
    """
    # Links stay as they are named.
    places = [Path(os.path.abspath(_object(log))) for log in logs]  # noqa: PTH100
    for place, count in Counter(places).items():
        if count > 1:
            raise UsageError(f"{quoted(place)} is named {count} times; name each log once")
    names = [Path(_stem(place)) for place in places]
    if any(_clashes(names)):
        folders = below_shared(places)
        names = [folder / _stem(place) for folder, place in zip(folders, places, strict=True)]
    names = [
        name.with_name(place.name) if clashes else name
        for name, place, clashes in zip(names, places, _clashes(names), strict=True)
    ]
    return [folder / f"{name}{suffix}" for name in names]


def _clashes(names: Sequence[Path]) -> list[bool]:
    """Tell of each name whether another is the same, on systems that do not look at case, too."""
    counts = Counter(str(name).lower() for name in names)
    return [counts[str(name).lower()] > 1 for name in names]


def below_shared(places: Sequence[PurePath]) -> list[Path]:
    """Return the folders of paths, from the one on that all of them share; without drives."""
    folders = [place.parent.relative_to(place.anchor).parts for place in places]
    shared = len(os.path.commonprefix(folders))  # noqa: RUF071  # tuples, folder by folder
    return [Path(*folder[shared:]) for folder in folders]


def _object(log: str) -> str:
    """Return a path, or an address without what it says of its store."""
    return without_secret(log).partition("?")[0] if is_address(log) else log


def _stem(place: Path) -> str:
    """Return the name of a log without its suffixes: those of its packing, too."""
    if place.is_dir():
        return place.name
    packed = place.suffix.lower() in {".gz", ".zst", ".zstd", ".lz4", ".bz2", ".active"}
    return Path(place.stem).stem if packed else place.stem


class BatchManifest:
    """What is known of the outputs in a folder: which log and which options they came from.

    Parameters
    ----------
    folder
        Where the outputs are.
    """

    NAME = ".quatprop-batch.json"

    def __init__(self, folder: Path) -> None:
        self._place = folder / self.NAME
        try:
            known = json.loads(self._place.read_text())
            self._known = dict(known) if isinstance(known, dict) else {}
        except (OSError, ValueError):
            self._known = {}

    def is_fresh(self, job: Job) -> bool:
        """Tell whether an output is there that came from this log, as it is, by these options."""
        known = self._known.get(self._key(job))
        return Path(job.output.path).exists() and known is not None and known == origin(job)

    def note(self, job: Job, came_from: str | None) -> None:
        """Note that an output was made, and from what: its :func:`origin` before it was."""
        if came_from is None:
            self._known.pop(self._key(job), None)
        else:
            self._known[self._key(job)] = came_from

    def write(self) -> None:
        """Keep what is known beside the outputs."""
        if self._known:
            output = OutputFile(self._place)
            output.stream.write(json.dumps(self._known, indent=1).encode())
            output.commit()

    def _key(self, job: Job) -> str:
        return Path(os.path.relpath(job.output.path, self._place.parent)).as_posix()


def origin(job: Job) -> str | None:
    """Return a digest of what an output comes from: version, options, and the files it reads.

    None for what may change unseen, as a log in an object store.
    """
    if is_address(job.log):
        return None
    read = [Path(name) for name in (job.log, *job.settings.inputs)]
    parts = [part for place in read for part in (sorted(place.glob("*")) or [place])]
    files = []
    for part in parts:
        with suppress(OSError):
            found = part.stat()
            files.append((part.name, found.st_size, found.st_mtime_ns))
    log = os.path.abspath(job.log)  # noqa: PTH100  # links stay what they are
    made_from = (__version__, log, job.settings, replace(job.output, path=""), files)
    return hashlib.sha256(repr(made_from).encode()).hexdigest()


def propagated(job: Job) -> Outcome:
    """Propagate one log; what goes wrong is its outcome."""
    began = time.perf_counter()
    try:
        Path(job.output.path).parent.mkdir(parents=True, exist_ok=True)
        report = run(job)
    except QuatpropError as error:
        return _failed(job, error.text, time.perf_counter() - began)
    except Exception as error:
        if (sentence := as_user_error(error)) is None:
            raise
        return _failed(job, _about(job, str(sentence)), time.perf_counter() - began)
    log = without_secret(job.log)
    return Outcome(log, job.output.path, "", report, time.perf_counter() - began)


def _failed(job: Job, error: str | Text, seconds: float = 0.0) -> Outcome:
    return Outcome(without_secret(job.log), job.output.path, error, None, seconds)


def _about(job: Job, words: str) -> str:
    return f"{plain(without_secret(job.log))}: {words}"


def on_this_machine(jobs: Sequence[Job], processes: int) -> Iterator[Outcome]:
    """Yield what comes of each log, in their order.

    Parameters
    ----------
    jobs
        One for each log.
    processes
        How many at a time.
    """
    return in_order(map_processes(propagated, jobs, processes, _killed, isolated=True))


def _killed(job: Job) -> Outcome:
    return _failed(job, _about(job, KILLED))


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
                yield _failed(job, _about(job, reason))
            except Exception as error:  # noqa: BLE001  # whatever is raised on other machines
                reason = f"the cluster did not do it ({type(error).__name__}: {plain(error)})"
                yield _failed(job, _about(job, reason))
