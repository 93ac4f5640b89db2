"""Propagate many logs: what ``quatprop batch`` does."""

from __future__ import annotations

import multiprocessing
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from quatprop.api.reading import path_text, paths_of, with_keywords_of
from quatprop.errors import UsageError
from quatprop.settings import PropagateOptions
from quatprop.settings.rotations import InMemory, files_beside
from quatprop.text import Setting, listed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.api.reading import StrPath
    from quatprop.batching.entries import ManifestEntry
    from quatprop.settings.choices import Layout


@with_keywords_of(PropagateOptions, log="each log")
def batch(  # noqa: PLR0913  # one keyword for each option
    logs: StrPath | Sequence[StrPath],
    output: StrPath,
    *,
    to: str = "parquet",
    layout: Layout | None = None,
    extra_columns: str | None = None,
    root: StrPath | None = None,
    shard: str | None = None,
    processes: int | None = None,
    dask: str | None = None,
    skip_existing: bool = False,
    verify: bool = False,
    retries: int = 0,
    **options: Unpack[PropagateOptions],
) -> list[ManifestEntry]:
    """Turn the body rates of many logs into attitude series in a folder.

    Logs are propagated in processes, which import the script that calls this: call it below
    ``if __name__ == "__main__":``, or with ``processes=1``, which is this process.

    Parameters
    ----------
    logs
        Logs, folders and prefixes of stores that are searched for some, and patterns (with ``**``).
    output
        The folder, or a prefix such as ``s3://bucket/runs``.
    to, layout, extra_columns
        As for :func:`write`.
    root
        Outputs keep the path of their log below this folder.
    shard
        Only one of N parts of the logs, such as ``"1/8"``.
    processes
        Logs at a time; by default the cores.
    dask
        Address of a Dask scheduler whose workers are used instead.
    skip_existing, verify
        Leave out logs whose output is up to date; compare the digests of outputs, too.
    retries
        Try a log again so often whose process was killed or whose store did not answer.
    **options
        Which samples of each log, and how they are propagated; files, not values in memory.

    Returns
    -------
    list of ManifestEntry
        What the manifest records of each log that was propagated now: a log that cannot be used
        has the state ``"failed"`` and an `error`, and does not stop the others. Named tuples:
        ``pandas.DataFrame(entries)`` is a table of them.

    Raises
    ------
    QuatpropError
        There are no logs, or the settings cannot be used.
    """
    from quatprop.batching.logs import LogSearch
    from quatprop.batching.manifest import Manifest
    from quatprop.batching.planning import shard as part_of
    from quatprop.batching.run import Batch
    from quatprop.batching.tasks import BatchSettings
    from quatprop.pipeline.job import Job
    from quatprop.pipeline.settings import OutputSettings, propagation_settings
    from quatprop.stores.objects import without_file_scheme
    from quatprop.writers.formats import WRITERS, kind_of

    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise UsageError(
            "the processes of batch() import this script; call it below "
            "if __name__ == '__main__':, or with processes=1"
        )
    folder = without_file_scheme(path_text("output", output))
    if verify and not skip_existing:
        raise UsageError(f"{Setting('verify')} goes with {Setting('skip_existing')}")
    suffixes = WRITERS[kind_of("OUT", to)].suffixes
    top = None if root is None else path_text("root", root)
    of_messages = next((n for n in ("topic", "rate_field", "time_field") if n in options), None)
    search = LogSearch(top, folder, None if options.get("kind") else of_messages, suffixes[0])
    names = paths_of("logs", logs)
    for name in names:
        search.add(name)
    if not search.logs:
        raise UsageError(f"there are no logs in {listed(names)}; name files, folders or patterns")
    found = part_of(search.logs, shard) if shard else list(search.logs)
    written = OutputSettings("OUT", to=to, layout=layout, extra_columns=extra_columns)
    wanted = propagation_settings(files_beside(options, Path.cwd()))
    if held := [name for name, value in wanted.given.items() if value == str(InMemory(None))]:
        raise UsageError(f"{Setting(held[0])} of batch() is a file, for all logs")
    job = Job("LOG", written, wanted)
    settings = BatchSettings.of(job, folder, retries=retries)._replace(is_library=True)
    manifest = Manifest(folder)
    run = Batch(search, found, settings, manifest, part=shard, skip=skip_existing, verify=verify)
    results = sorted(run.results(processes, dask, isolated=processes != 1))
    return [result.entry for _, result in results]
