"""What is done in a batch: the task of each log, what all of them share, and the results."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.batch.entries import ManifestEntry
from quatprop.batch.manifest import log_name, options_digest, origin_digest
from quatprop.stores.objects import without_secret
from quatprop.text import spelled

if TYPE_CHECKING:
    from quatprop.pipeline.job import Job
    from quatprop.tables.log import Loss


class BatchTask(NamedTuple):
    """One log of a batch; small, as it is sent to a process.

    `path`: the log's path or address
    `output`: the path or the address of its attitudes
    `name`: path of the output in the folder of the batch
    """

    path: str
    output: str
    name: str
    maybe: bool = False
    refused: str = ""

    @property
    def log(self) -> str:
        """The log as it may be shown."""
        return without_secret(self.path)


class BatchSettings(NamedTuple):
    """What all logs of a batch share.

    `job`: how logs are propagated; its paths are ignored
    `reports`: whether results have the reports of the runs
    """

    job: Job
    options: str
    reports: bool = False

    @classmethod
    def of(cls, job: Job, *, reports: bool = False) -> BatchSettings:
        """Return the settings of a batch, with the digest."""
        return cls(job, options_digest(job), reports)

    def with_threads(self, count: int) -> BatchSettings:
        """Return the same with so many threads, unless the settings say how many."""
        settings = self.job.settings
        settings = replace(settings, threads=settings.threads or count)
        return self._replace(job=self.job._replace(settings=settings))

    def origin(self, task: BatchTask) -> str | None:
        """Return the digest of what the output of a log is made from; None if it is not known."""
        settings = self.job.settings
        named = [*settings.inputs.values(), *filter(None, [settings.selection.msg_path])]
        return origin_digest([task.path, *named], self.options)


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
    return BatchResult(ManifestEntry(state, log_name(task.path), task.name, error=spelled(error)))
