"""A whole batch: what is to be done, done, and recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.batching.planning import Plan, deleted, plan
from quatprop.concurrency.threads import available_cores

if TYPE_CHECKING:
    from collections.abc import Generator

    from quatprop.batching.logs import BatchTask, LogSearch
    from quatprop.batching.manifest import Manifest
    from quatprop.batching.tasks import BatchResult, BatchSettings


class Batch:
    """Logs that were found, and what of them is to be done.

    `search`, `logs`: the search, and its logs or a part of them; both are emptied of logs
    `part`: which part, ``"I/N"``; None for all
    `skip`, `verify`: whether outputs that are up to date are kept, and their digests compared
    """

    def __init__(  # noqa: PLR0913  # what the command line gives
        self,
        search: LogSearch,
        logs: list[BatchTask],
        settings: BatchSettings,
        manifest: Manifest,
        *,
        part: str | None = None,
        skip: bool = False,
        verify: bool = False,
    ) -> None:
        self._settings, self._manifest = settings, manifest
        self.gone = deleted(manifest, search.logs, search.searched, part)
        search.logs.clear()
        self.plan: Plan = plan(logs, settings, manifest, skip=skip, verify=verify)
        logs.clear()

    def results(
        self, processes: int | None = None, dask: str | None = None, *, isolated: bool = True
    ) -> Generator[tuple[int, BatchResult]]:
        """Yield the index and the result of each log as soon as it is done and recorded.

        `isolated`: whether a single process is another one than this
        """
        from quatprop.batching.cluster import on_a_cluster
        from quatprop.batching.execution import on_this_machine

        tasks, settings, manifest = self.plan.tasks, self._settings, self._manifest
        if not tasks and not self.gone:
            return
        manifest.prepare()
        for entry in self.gone:
            manifest.record(entry)
        if dask is not None:
            yield from on_a_cluster(tasks, settings, dask, manifest)
        else:
            count = processes or available_cores()
            yield from on_this_machine(tasks, settings, count, manifest, isolated=isolated)
        manifest.collect()
