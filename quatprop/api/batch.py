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
    from quatprop.batching.logs import LogSearch
    from quatprop.pipeline.job import Job
    from quatprop.pipeline.settings import OutputSettings
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
    dataset: bool = False,
    buckets: int | None = None,
    **options: Unpack[PropagateOptions],
) -> list[ManifestEntry]:
    """Turn the body rates of many logs into attitude series in a folder.

    Logs are propagated in child processes, which import the calling script: call this below
    ``if __name__ == "__main__":``, or with ``processes=1``, which uses this process.

    Parameters
    ----------
    logs
        Logs; folders and store prefixes to search for logs; and patterns (with ``**``).
    output
        The folder, or a prefix such as ``s3://bucket/runs``.
    to, layout, extra_columns
        As for :func:`write`.
    root, shard
        Outputs keep the path of their log below the folder `root`; one of N parts of the logs, as
        ``"1/8"``.
    processes, dask
        Number of processes, by default that of the cores; address of a Dask scheduler to use
        instead.
    skip_existing, verify
        Skip logs whose output is up to date; also compare the digests of outputs.
    retries
        Number of retries of a log if its process was killed or its store did not answer.
    dataset, buckets
        Write one Parquet dataset instead of one file per log; its number of files, by default 256.
    **options
        Selection of samples and settings of the propagation; only files, no objects in memory.

    Returns
    -------
    list of ManifestEntry
        The entry in the manifest of each log that was propagated now, as named tuples
        (``pandas.DataFrame(entries)`` is a table). A log that cannot be used has the state
        ``"failed"`` and an `error`, and does not stop the others.

    Raises
    ------
    QuatpropError
        There are no logs, or the settings cannot be used.
    """
    from quatprop.batching.manifest import Manifest
    from quatprop.batching.planning import dataset_files
    from quatprop.batching.planning import shard as part_of
    from quatprop.batching.run import Batch
    from quatprop.batching.tasks import BatchSettings
    from quatprop.pipeline.settings import OutputSettings
    from quatprop.stores.objects import without_file_scheme

    _refuse_here(verify=verify, skip_existing=skip_existing)
    folder = without_file_scheme(path_text("output", output))
    written = OutputSettings("OUT", to=to, layout=layout, extra_columns=extra_columns)
    search = _search(paths_of("logs", logs), folder, written, root, options)
    files = dataset_files(written.kind, dataset=dataset, buckets=buckets)
    settings = BatchSettings.of(
        _job(written, options), folder, retries=retries, files=files, is_library=True
    )
    part = part_of(shard, files)
    run = Batch(search, settings, Manifest(folder), part, skip=skip_existing, verify=verify)
    results = sorted(run.results(processes, dask, isolated=processes != 1))
    return [result.entry for _, result in results]


def _refuse_here(*, verify: bool, skip_existing: bool) -> None:
    """Refuse a batch within its own child processes, and contradictory settings."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise UsageError(
            "the processes of batch() import this script; call it below "
            "if __name__ == '__main__':, or with processes=1"
        )
    if verify and not skip_existing:
        raise UsageError(f"{Setting('verify')} requires {Setting('skip_existing')}")


def _search(
    names: Sequence[str],
    folder: str,
    written: OutputSettings,
    root: StrPath | None,
    options: PropagateOptions,
) -> LogSearch:
    """Return the search with the logs found."""
    from quatprop.batching.logs import LogSearch
    from quatprop.writers.formats import WRITERS

    top = None if root is None else path_text("root", root)
    of_messages = next((n for n in ("topic", "rate_field", "time_field") if n in options), None)
    of_messages = None if options.get("kind") else of_messages
    search = LogSearch(top, folder, of_messages, WRITERS[written.kind].suffixes[0])
    for name in names:
        search.add(name)
    if not search.logs:
        raise UsageError(f"there are no logs in {listed(names)}; name files, folders or patterns")
    return search


def _job(written: OutputSettings, options: PropagateOptions) -> Job:
    """Return the job for each log; files are relative to the current folder."""
    from quatprop.pipeline.job import Job
    from quatprop.pipeline.settings import propagation_settings

    wanted = propagation_settings(files_beside(options, Path.cwd()))
    if held := [name for name, value in wanted.given.items() if value == str(InMemory(None))]:
        raise UsageError(f"{Setting(held[0])} of batch() is a file, for all logs")
    return Job("LOG", written, wanted)
