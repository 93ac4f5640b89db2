"""Run a whole batch: plan, propagate, record."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.batching.dataset import merge_parts, with_parts
from quatprop.batching.planning import Plan, Shard, deleted, plan
from quatprop.batching.tasks import EVERY_TOPIC, with_topic
from quatprop.concurrency.threads import available_cores
from quatprop.errors import QuatpropError, UsageError
from quatprop.text import Setting

if TYPE_CHECKING:
    from collections.abc import Generator

    from quatprop.batching.logs import BatchTask, LogSearch
    from quatprop.batching.manifest import Manifest
    from quatprop.batching.tasks import BatchResult, BatchSettings


def _topics(log: BatchTask, settings: BatchSettings) -> list[BatchTask]:
    """Return a task for each topic with rates; errors are reported when the log is propagated."""
    from quatprop.logs.joined import open_logs
    from quatprop.logs.signals.rates import rate_candidates

    chosen = with_topic(settings.job, "").settings
    try:
        with open_logs([log.path], chosen.kind, msg_path=chosen.selection.msg_path) as opened:
            found = rate_candidates(opened, chosen.selection)
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
        self._settings, self._manifest, self._part = settings, manifest, part
        found = search.take()
        logs = [log for log in found if part.has(log)]
        if settings.job.settings.selection.topic == EVERY_TOPIC:
            if settings.files:
                raise UsageError(
                    f"{Setting('topic', EVERY_TOPIC)} gives several series of a log, and "
                    f"{Setting('dataset')} has one; name a topic"
                )
            logs = [task for log in logs for task in _topics(log, settings)]
        if settings.files:
            logs = with_parts(logs, settings.files)
        self.gone = deleted(manifest, found, search.searched, part)
        del found
        self.plan: Plan = plan(logs, settings, manifest, skip=skip, verify=verify)

    def results(
        self, processes: int | None = None, dask: str | None = None, *, isolated: bool = True
    ) -> Generator[tuple[int, BatchResult]]:
        """Yield the index and the result of each log as soon as it is done and recorded.

        `isolated`: use a child process even if there is only one
        """
        from quatprop.batching.cluster import on_a_cluster
        from quatprop.batching.execution import on_this_machine

        settings, manifest = self._settings, self._manifest
        count = processes or available_cores()
        if self.plan.tasks or self.gone:
            manifest.prepare()
            for entry in self.gone:
                manifest.record(entry)
            if dask is not None:
                yield from on_a_cluster(self.plan.tasks, settings, dask, manifest)
            else:
                yield from on_this_machine(
                    self.plan.tasks, settings, count, manifest, isolated=isolated
                )
            self.plan.tasks.clear()  # to merge entries takes memory, too
            manifest.collect()
        if settings.files:
            merge_parts(settings.folder, self._part.has_file, count)
