"""Settings and results of the tasks of a batch."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
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
"""Topic that selects all topics with rates."""


def with_topic(job: Job, topic: str) -> Job:
    """Return a job for one topic, if it is for every topic."""
    settings = job.settings
    if settings.selection.topic != EVERY_TOPIC:
        return job
    selection = replace(settings.selection, topic=topic or None)
    return job._replace(settings=replace(settings, selection=selection))


class BatchSettings(NamedTuple):
    """Settings of a batch, common to all logs.

    `job`: how logs are propagated; its paths are ignored
    `folder`: folder or address of the outputs
    `options`: digest of all settings without paths, and of the files that they name
    `reports`: whether results include the reports of the runs
    `retries`: number of retries if a store does not answer
    `files`: number of files of the dataset; None: one file per log
    `is_library`: whether errors spell settings as keywords instead of options
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
            with suppress(OSError, StoreError):  # each log says so
                files.append(origin_of(file))
        text = repr((settings, job.output._replace(path=""), files))
        return cls(job, folder, hashlib.sha256(text.encode()).hexdigest(), **others)

    def output_of(self, task: BatchTask) -> str:
        """Return the path or address of the output of a log."""
        return place_below(self.folder, task.name)

    def file_of(self, task: BatchTask) -> str:
        """Return the path or address with the attitudes of a log after the batch."""
        return place_below(self.folder, file_of(task.name)) if task.folder else self.output_of(task)

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
    return BatchResult(entry)


def output_size(path: str) -> int | None:
    """Return the size of a local output, a file or a folder, bytes; None: no output."""
    if os.path.isdir(path):
        return sum(entry.stat().st_size for entry in os.scandir(path))
    try:
        return os.stat(path).st_size
    except OSError:
        return None
