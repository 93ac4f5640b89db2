"""Plan a batch: the logs to propagate, and the names of their outputs."""

from __future__ import annotations

import hashlib
import os
import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from quatprop.base import __version__
from quatprop.base.errors import StoreError, UsageError
from quatprop.base.places import is_address, without_secret
from quatprop.base.provenance import digest_of
from quatprop.base.text import Setting, in_python, quoted, spelled
from quatprop.base.times import NS_PER_S
from quatprop.settings import in_options
from quatprop.stores.objects import exists, list_objects, objects_of
from quatprop.stores.remote import get
from quatprop.tools.batch.manifest import COMPLETE, ManifestEntry, as_text, bucket_of, hash_of
from quatprop.tools.batch.tasks import BatchTask, absolute, changed_ns, origin_of, place_below, real
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from datetime import datetime

    from quatprop.base.errors import Loss
    from quatprop.base.text import Spelling
    from quatprop.propagation.job import Job
    from quatprop.tools.batch.manifest import Manifest
    from quatprop.tools.check.expect import Expectations


# Settings and results of the tasks of a batch.


EVERY_TOPIC = "*"
"""Topic that selects all topics with rates."""


def with_topic(job: Job, topic: str) -> Job:
    """Return a job for the topic of a task; ``""``: the one of the job, if it names one."""
    settings = job.settings
    named = settings.selection.topic
    if topic and named not in {None, EVERY_TOPIC, topic}:
        raise UsageError(f"another topic is given, {quoted(named)}, than {quoted(topic)}; name one")
    wanted = topic or ("" if named == EVERY_TOPIC else named)
    selection = replace(settings.selection, topic=wanted or None)
    return job._replace(settings=replace(settings, selection=selection))


class BatchSettings(NamedTuple):
    """Settings of a batch, common to all logs.

    `job`: how logs are propagated; its paths are ignored
    `folder`: folder or address of the outputs
    `options`: digest of all settings without paths, and of the files that they name
    `reports`: whether results include the reports of the runs
    `retries`: number of retries if a store does not answer
    `expect`: what each log must have; None: nothing is expected
    `is_library`: whether errors spell settings as keywords instead of options
    """

    job: Job
    folder: str
    options: str
    reports: bool = False
    retries: int = 0
    is_library: bool = False
    expect: Expectations | None = None

    @classmethod
    def for_job(
        cls, job: Job, folder: str, expect: Expectations | None = None, **others: Any
    ) -> BatchSettings:
        """Return the settings of a batch, with the digest."""
        settings = job.settings
        named = [*settings.inputs.values(), *filter(None, [settings.selection.msg_path])]
        files = []
        for file in named:
            with suppress(OSError, StoreError):  # each log says so
                files.append(origin_of(file))
        text = repr((settings, job.output._replace(path=""), files))
        text += f"{expect}" if expect else ""
        digest = hashlib.sha256(text.encode()).hexdigest()
        return cls(job, folder, digest, expect=expect, **others)

    def output_of(self, task: BatchTask) -> str:
        """Return the path or address of the output of a log."""
        return place_below(self.folder, task.name)

    @property
    def spelling(self) -> Spelling:
        """How errors spell settings."""
        return in_python if self.is_library else in_options

    def with_threads(self, count: int) -> BatchSettings:
        """Return the same with so many threads, unless the settings say how many."""
        settings = self.job.settings
        settings = replace(settings, threads=settings.threads or count)
        return self._replace(job=self.job._replace(settings=settings))


class BatchResult(NamedTuple):
    """The result of one log.

    `report`: report of the run, as JSON; None if not requested, or without attitudes
    """

    entry: ManifestEntry
    losses: tuple[Loss, ...] = ()
    report: Any = None


def failed(task: BatchTask, error: str, state: str = "failed") -> BatchResult:
    """Return the result of a log without attitudes."""
    entry = ManifestEntry(state, absolute(task.root), task.log, task.name, error=spelled(error))
    return BatchResult(entry._replace(samples=0) if task.standing == "done" else entry)


def output_size(path: str) -> int | None:
    """Return the size of a local output, a file or a folder, bytes; None: no output."""
    if os.path.isdir(path):
        return sum(entry.stat().st_size for entry in os.scandir(path))
    try:
        return os.stat(path).st_size
    except OSError:
        return None


REQUESTS = 32
"""Number of concurrent requests to an object store."""

SAME_S = 60
"""Tolerance for different clocks of store and machine, s."""

OTHER_OUTPUT = (
    f"keep their folders in the names with {Setting('root', 'DIR')}, a folder above both, or "
    "write to another folder"
)
"""Advice if two logs have the same output."""


class Known(NamedTuple):
    """The fields of a manifest entry that a plan needs."""

    state: str
    root: str
    log: str
    samples: int | None
    quatprop: str
    options: str | None
    origin: str
    log_etag: str | None
    output_bytes: int | None
    output_sha256: str | None
    time: datetime
    seconds: float
    unmet: list[str] | None


class Plan(NamedTuple):
    """The tasks of a batch.

    `skipped`: number of logs with an up-to-date output
    `lost`, `unexpected`: number of these with losses, and of those that are not as expected
    `of_topics`: whether logs are read by topic, so that one log has several outputs
    """

    tasks: list[BatchTask]
    skipped: int = 0
    lost: int = 0
    unexpected: int = 0
    of_topics: bool = False


class Shard(NamedTuple):
    """One of N parts of the logs, for one machine of several, as in an array job.

    The part of a log depends on nothing but its name.

    `number`: index, from 0
    """

    number: int
    parts: int

    def has(self, log: BatchTask) -> bool:
        """Return whether a log is in this part."""
        return hash_of(as_text(log.log)) % self.parts == self.number


def shard(text: str | None) -> Shard:
    """Return the part for a setting.

    `text`: ``"I/N"``, the I-th part, from 1 to N; None: all logs
    """
    if text is None:
        return Shard(0, 1)
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
    part, parts = map(int, match.groups()) if match else (0, 0)
    if not 1 <= part <= parts:
        raise UsageError(f"{quoted(text)} is not I/N, from 1/N to N/N, for {Setting('shard')}")
    return Shard(part - 1, parts)


def refuse_shared_names(tasks: Iterable[BatchTask], folder: str) -> None:
    """Refuse two logs with one output; where a disk ignores case, names that differ in it only."""
    fold = str.lower if _ignores_case(folder) else str
    # Hashes, to save memory with a million names.
    seen, twice = set[int](), set[int]()
    for task in tasks:
        number = hash(fold(task.name))
        (twice if number in seen else seen).add(number)
    owners: dict[str, BatchTask] = {}
    for task in tasks if twice else ():
        if hash(name := fold(task.name)) in twice:
            owner = owners.setdefault(name, task)
            if owner is not task:
                raise _shared(task, owner.path, folder)


def _ignores_case(folder: str) -> bool:
    """Return whether names in a local folder that differ in case only are one."""
    place = real(folder)
    while not is_address(folder) and place and not os.path.exists(place):
        place = os.path.dirname(place)
    above, name = os.path.split(place)
    other = os.path.join(above, name.swapcase())
    return other != place and os.path.exists(other) and os.path.samefile(place, other)


def _shared(task: BatchTask, owner: str, folder: str) -> UsageError:
    names = (quoted(without_secret(name)) for name in (owner, task.path))
    output = quoted(without_secret(place_below(folder, task.name)))
    return UsageError(f"{' and '.join(names)} would have one output, {output}; {OTHER_OUTPUT}")


def plan(
    tasks: list[BatchTask],
    settings: BatchSettings,
    manifest: Manifest,
    *,
    skip: bool,
    verify: bool,
) -> Plan:
    """Return the tasks of all logs or, with `skip`, of those without an up-to-date output."""
    _refuse_replaced(tasks, settings)
    buckets = np.array([bucket_of(task.name) for task in tasks], np.uint8)
    is_due, lost, unexpected = np.ones(len(tasks), bool), 0, 0
    size_of = _sizes(settings.folder) if skip else None
    for part, entries in manifest.slices(Known._fields):
        places = np.flatnonzero((buckets >= part.start) & (buckets < part.stop)).tolist()
        known = {
            place: Known(*entries[name])
            for place in places
            if (name := as_text(tasks[place].name)) in entries
        }
        for place, entry in known.items():
            task = tasks[place]
            if (owner := _other_owner(task, entry)) is not None:
                raise _shared(task, owner, settings.folder)
            if entry.state in COMPLETE or entry.samples == 0:
                # It is a log, and without rates it is damaged.
                tasks[place] = task._replace(standing="done")
        if size_of is None:
            continue

        def is_current(one: tuple[int, Known]) -> bool:
            task, entry = tasks[one[0]], one[1]
            if not _is_current(task, entry, settings):
                return False
            return size_of(task.name) == entry.output_bytes and (
                not verify or entry.output_sha256 == _sha256(settings.output_of(task))
            )

        is_near = not any(is_address(tasks[place].path) for place in known)
        with ThreadPoolExecutor(REQUESTS) as pool:
            every = (map if is_near else pool.map)(is_current, known.items())
            for place, current in zip(known, every, strict=True):
                is_due[place] = not current
                lost += current and known[place].state == "data lost"
                unexpected += current and bool(known[place].unmet)
    due = [task for task, wanted in zip(tasks, is_due.tolist(), strict=True) if wanted]
    of_topics = any(task.topic for task in tasks)
    return Plan(due, len(tasks) - len(due), lost, unexpected, of_topics)


def _refuse_replaced(tasks: Sequence[BatchTask], settings: BatchSettings) -> None:
    """Refuse outputs that would replace inputs."""
    folder = settings.folder
    top = os.path.join(absolute(folder) if is_address(folder) else os.path.realpath(folder), "")
    places: dict[str, str] = {}

    def is_inside(path: str) -> bool:
        # Links of each folder are followed once.
        if is_address(path):
            return absolute(path).startswith(top)
        above = os.path.dirname(path) or os.curdir
        if above not in places:
            places[above] = os.path.join(os.path.realpath(above), "")
        return places[above].startswith(top) or os.path.islink(path)

    inputs = [task.path for task in tasks if is_inside(task.path)]
    if inputs := [*inputs, *settings.job.settings.inputs.values()]:
        refuse_overlap(inputs, map(settings.output_of, tasks))


def _other_owner(task: BatchTask, entry: Known) -> str | None:
    """Return the log from which an output was made, if it is another one that still exists."""
    owner, own = place_below(entry.root, entry.log), absolute(task.path)
    if entry.state not in COMPLETE or owner == as_text(own):
        return None
    try:
        if is_address(owner):
            return owner if exists(owner) else None
        return owner if not os.path.samefile(owner, task.path) else None
    except OSError:
        return None
    except StoreError:
        return owner


def _is_current(task: BatchTask, entry: Known, settings: BatchSettings) -> bool:
    """Return whether an output was made by this version, with these settings, from this log."""
    if (
        entry.state not in COMPLETE
        or (entry.quatprop, entry.options) != (__version__, settings.options)
        or not entry.origin
        or entry.origin != task.origin_now()
    ):
        return False
    began_s = entry.time.timestamp() - entry.seconds
    if entry.log_etag is None or changed_ns(entry.origin) < (began_s - SAME_S) * NS_PER_S:
        return True
    # It may have been rewritten within the same second.
    try:
        return objects_of(task.path)[0].etag == entry.log_etag
    except StoreError:
        return False


def _sizes(folder: str) -> Callable[[str], int | None]:
    """Return a function that returns the size of an output, by its path in the folder."""
    if not is_address(folder):
        return lambda name: output_size(place_below(folder, name))
    sizes: dict[str, int] = {}
    for name, info in list_objects(folder, missing_ok=True).items():
        sizes[name] = info.size
        above = name.rpartition("/")[0]  # an output may be a folder
        sizes[above] = sizes.get(above, 0) + info.size
    return sizes.get


def _sha256(output: str) -> str | None:
    if not is_address(output):
        return digest_of(output).sha256
    return hashlib.sha256(get(output)).hexdigest()


def deleted(
    manifest: Manifest, logs: Iterable[BatchTask], searched: Iterable[str], part: Shard
) -> list[ManifestEntry]:
    """Return entries for logs of a part that no longer exist in the searched folders."""
    found: dict[str, set[str]] = {absolute(root): set() for root in searched}
    for log in logs:
        if (root := absolute(log.root)) in found:
            found[root].add(as_text(log.log))
    gone = []
    for _, entries in manifest.slices(("state", "root", "log")) if found else ():
        for output, (state, root, log) in entries.items():
            if state == "deleted" or log in found.get(root, {log}):
                continue
            if part.has(BatchTask(root, log)):
                place = place_below(root, log)
                if not (exists(place) if is_address(place) else os.path.lexists(place)):
                    gone.append(ManifestEntry("deleted", root, log, output))
    return gone
