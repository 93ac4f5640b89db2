"""What is done in a batch: the task of each log, what all of them share, and the results."""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.batching.dataset import file_of
from quatprop.batching.entries import ManifestEntry
from quatprop.batching.logs import BatchTask, absolute, place_below
from quatprop.batching.origins import origin_of
from quatprop.errors import StoreError
from quatprop.text import spelled

if TYPE_CHECKING:
    from quatprop.pipeline.job import Job
    from quatprop.tables.log import Loss


EVERY_TOPIC = "*"
"""Topic that stands for all that carry rates."""


def with_topic(job: Job, topic: str) -> Job:
    """Return a job for one of the topics, if it is for every topic."""
    settings = job.settings
    if settings.selection.topic != EVERY_TOPIC:
        return job
    selection = replace(settings.selection, topic=topic or None)
    return job._replace(settings=replace(settings, selection=selection))


class BatchSettings(NamedTuple):
    """What all logs of a batch share.

    `job`: how logs are propagated; its paths are ignored
    `folder`: where the outputs go
    `options`: digest of all settings but the paths, and of the files that they name
    `reports`: whether results have the reports of the runs
    `retries`: how often a log is tried again whose store did not answer
    `files`: number of files of the dataset; None for a file a log
    `is_library`: whether sentences name keywords instead of options
    """

    job: Job
    folder: str
    options: str
    reports: bool = False
    retries: int = 0
    files: int | None = None
    is_library: bool = False

    @classmethod
    def of(cls, job: Job, folder: str, **others: Any) -> BatchSettings:
        """Return the settings of a batch, with the digest."""
        settings = job.settings
        named = [*settings.inputs.values(), *filter(None, [settings.selection.msg_path])]
        files = []
        for file in named:
            try:
                files.append(origin_of(file))
            except (OSError, StoreError):  # each log says so
                files.append("")
        text = repr((settings, job.output._replace(path=""), files))
        return cls(job, folder, hashlib.sha256(text.encode()).hexdigest(), **others)

    def output_of(self, task: BatchTask) -> str:
        """Return the path or the address of the attitudes of a log."""
        return place_below(self.folder, task.name)

    def file_of(self, task: BatchTask) -> str:
        """Return where they are when the batch has ended."""
        return place_below(self.folder, file_of(task.name)) if task.folder else self.output_of(task)

    def with_threads(self, count: int) -> BatchSettings:
        """Return the same with so many threads, unless the settings say how many."""
        settings = self.job.settings
        settings = replace(settings, threads=settings.threads or count)
        return self._replace(job=self.job._replace(settings=settings))


class BatchResult(NamedTuple):
    """The result of one log.

    `report`: the report of the run, as JSON; None if it is not wanted, or where there are no
        attitudes
    """

    entry: ManifestEntry
    losses: tuple[Loss, ...] = ()
    report: Any = None


def failed(task: BatchTask, error: str, state: str = "failed") -> BatchResult:
    """Return the result of a log without attitudes."""
    entry = ManifestEntry(state, absolute(task.root), task.log, task.name, error=spelled(error))
    return BatchResult(entry)


def output_size(path: str) -> int | None:
    """Return the bytes of an output of this machine, all files of a folder; None without one."""
    if os.path.isdir(path):
        return sum(entry.stat().st_size for entry in os.scandir(path))
    try:
        return os.stat(path).st_size
    except OSError:
        return None
