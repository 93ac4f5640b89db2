"""``quatprop batch``: many logs in, an attitude series of each out."""

from __future__ import annotations

import json
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli import propagate
from quatprop.cli.help import Command, GroupedOption
from quatprop.cli.options import QUIET, with_options
from quatprop.cli.types import PATH, content_of
from quatprop.concurrency.threads import available_cores
from quatprop.settings.keyword import Keyword
from quatprop.settings.parsers import Choice, flag
from quatprop.text import listed, plain
from quatprop.writers.formats import WRITERS

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Mapping

    from tqdm import tqdm

    from quatprop.batch.logs import LogSearch
    from quatprop.batch.manifest import Manifest
    from quatprop.batch.tasks import BatchResult, BatchSettings, BatchTask

ONE_LOG = {"log", "logs", "output", "to", "into", "plot", "report", "quiet", "verbose"}
"""Parameters of ``propagate`` that are about one log."""

OF_MESSAGES = ("topic", "rate_field", "time_field")
"""Options of ``propagate`` that no table can follow."""

SHARED = [option for option in propagate.command.params if option.name not in ONE_LOG]
"""The options of ``propagate`` that hold for every log."""


EXAMPLES = ("quatprop batch 'sample_logs/*.bag' -o attitudes --to csv -j 2",)


OPTIONS = {
    "--to": Keyword(
        Choice(*WRITERS), f"{', '.join(WRITERS)}.", "parquet", "FORMAT", group="Output",
        common=True, preset=True),
    "--list list_file": Keyword(
        PATH, "Also take names from FILE or stdin, one a line, relative to the current folder.",
        takes="FILE|-", group="Execution"),
    "--root": Keyword(
        PATH, "Outputs keep the path of their log below DIR.",
        "the folder that is searched, the fixed part of a GLOB, and for a LOG its own folder",
        "DIR", group="Execution"),
    "--shard": Keyword(
        click.STRING,
        "Only the I-th of N parts of the logs, I from 1, as for array jobs; every part "
        "must be given the same names.", "all", "I/N", group="Execution"),
    "-j processes": Keyword(
        click.IntRange(min=1), "Logs at a time: each in a process of its own.", "the cores", "N",
        group="Execution", common=True),
    "--dask": Keyword(
        click.STRING,
        "Use the workers of the Dask cluster whose scheduler has this address; they must "
        "see the same paths.", "this machine", "ADDRESS", group="Execution"),
    "--skip-existing": Keyword(
        flag, "Leave out logs whose output is up to date: made by the same version, with the "
        "same options, from the log as it is (size and time).", group="Execution", common=True),
    "--retries": Keyword(
        click.IntRange(min=0), "Try a log again, up to N times, whose process was killed.", "0",
        "N", group="Execution", preset=True),
    "--json as_json": Keyword(
        flag, "JSON on stdout: the report of each log.", group="Display", common=True),
    **QUIET,
}  # fmt: skip


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("names", type=PATH, metavar="LOG|DIR|GLOB...", nargs=-1)
@click.option(
    "-o",
    "--output",
    "folder",
    type=PATH,
    metavar="DIR",
    required=True,
    cls=GroupedOption,
    group="Output",
    common=True,
    help="Where the attitude series go: each under the name of its log, and the manifest; a "
    "folder, or a prefix such as s3://bucket/runs.",
)
@with_options(OPTIONS)
def command(
    names: tuple[str, ...], *, folder: str, as_json: bool, quiet: bool, **chosen: Any
) -> int:
    """Turn the body rates of each LOG into an attitude series in DIR.

    Folders, prefixes of object stores and quoted patterns (with **) are searched for logs, and
    DIR/manifest.jsonl lists them. A log that cannot be used does not stop the others (exit code
    2; 3: data was lost).
    """
    from quatprop.batch.execution import outdated, plan, with_data_lost
    from quatprop.batch.store_manifest import manifest_in, without_file_scheme
    from quatprop.batch.tasks import BatchSettings
    from quatprop.cli.progress import bar, on_terminal

    folder = without_file_scheme(folder)
    if chosen["dask"] and chosen["processes"]:
        raise click.UsageError("-j is for this machine; leave it out with --dask")
    if Path(folder).is_file():
        raise click.UsageError(f"-o {folder} is a file; name a folder for the outputs")
    search = _search(names, folder, chosen)
    manifest = manifest_in(folder)
    suffix = next((s for s in WRITERS[chosen["to"]].suffixes if s), "")
    paths = {"report": None, "into": None, "log": "LOG", "output": "OUT"}
    # Whoever propagates a log may do so in another folder.
    job = propagate.job_of({**chosen, **paths}, Path.cwd())
    planned = plan(search.logs, job, folder, suffix, manifest)
    _warn_of_unused(manifest)
    settings = BatchSettings.of(job, reports=as_json)
    tasks = outdated(planned, settings, manifest) if chosen["skip_existing"] else planned
    skipped = set(planned).difference(tasks)
    lost = with_data_lost(skipped, manifest) if skipped else 0
    if tasks:
        manifest.prepare()
    with closing(_results(tasks, settings, chosen, manifest)) as results:
        meter = bar(len(tasks), "log", disable=not on_terminal(quiet=quiet))
        shown = _Shown(tasks, meter, quiet=quiet, keeps=as_json)
        with meter:
            for index, result in results:
                shown.add(index, result)
    if tasks:
        manifest.write_table()
    if as_json:
        click.echo(json.dumps([report for _, report in sorted(shown.reports.items())], indent=2))
    if not quiet:
        shown.finish(skipped=len(skipped), lost=lost, other_files=search.other_files)
    if shown.states["failed"]:
        return 2
    return 3 if shown.states["data lost"] or lost else 0


command.params += SHARED


def _search(names: Iterable[str], folder: str, chosen: Mapping[str, Any]) -> LogSearch:
    """Return the logs of all names, or of one part of them."""
    from quatprop.batch.execution import shard
    from quatprop.batch.logs import LogSearch
    from quatprop.stores.objects import without_secret

    given = list(names)
    if chosen["list_file"] is not None:
        text = content_of(chosen["list_file"]).decode("utf-8-sig", "surrogateescape")
        given += [name for line in text.split("\n") if (name := line.rstrip("\r"))]
    of_messages = next(filter(chosen.get, OF_MESSAGES), None) if chosen["kind"] is None else None
    search = LogSearch(chosen["root"], folder, of_messages)
    for name in given:
        search.add(name)
    if not search.logs:
        where = f" in {listed(map(without_secret, given))}" if given else ""
        raise click.UsageError(
            f"there are no logs{where}; name files, folders or patterns, or use --list"
        )
    if chosen["shard"]:
        search.logs = shard(search.logs, chosen["shard"])
    return search


def _warn_of_unused(manifest: Manifest) -> None:
    """Say that lines of the manifest cannot be used."""
    if lines := manifest.unused:
        where = f"line {lines[0]}" + f" and {len(lines) - 1} more" * (len(lines) > 1)
        click.echo(
            f"Warning: {plain(manifest.place)}: {where}: not what a batch writes; ignored, so that "
            "a log may be propagated again",
            err=True,
        )


def _results(
    tasks: list[BatchTask], settings: BatchSettings, chosen: Mapping[str, Any], manifest: Manifest
) -> Generator[tuple[int, BatchResult]]:
    from quatprop.batch.cluster import on_a_cluster
    from quatprop.batch.execution import on_this_machine

    if chosen["dask"] is not None:
        return on_a_cluster(tasks, settings, chosen["dask"], manifest, chosen["retries"])
    processes = chosen["processes"] or available_cores()
    return on_this_machine(tasks, settings, processes, manifest, chosen["retries"])


class _Shown:
    """Shows results as they come; what is kept of them does not grow with their number."""

    def __init__(
        self, tasks: list[BatchTask], meter: tqdm[Any], *, quiet: bool, keeps: bool
    ) -> None:
        self.states: Counter[str] = Counter()
        self.reports: dict[int, Any] = {}
        self._errors: list[str] = []
        self._samples = 0
        self._tasks, self._quiet, self._keeps = tasks, quiet, keeps
        self._width = max((len(plain(task.log)) for task in tasks), default=0)
        self._meter = meter

    def add(self, index: int, result: BatchResult) -> None:
        """Show the result of a log; errors also when asked to be quiet."""
        self.states[result.entry.state] += 1
        self._samples += result.entry.samples or 0
        task = self._tasks[index]
        if self._keeps:
            self.reports[index] = _report(task, result)
        if result.entry.state == "failed":
            self._errors.append(result.entry.error or "")
            self._say(f"Error: {self._errors[-1]}")
        elif not self._quiet and result.entry.span_s is not None:
            self._say(_line(task, result, result.entry.span_s, self._width))
        self._meter.update()

    def _say(self, text: str) -> None:
        """Print lines above the progress."""
        self._meter.clear()
        click.echo(text, err=True)

    def finish(self, skipped: int, lost: int, other_files: int) -> None:
        """Show the errors again, which may have scrolled away, and the totals."""
        if self._errors and len(self._tasks) > 1:
            click.echo(f"{len(self._errors)} failed:", err=True)
            for error in self._errors:
                click.echo(f"  {error}", err=True)
        before = f"; data was lost in {lost} of them" * bool(lost)
        if not self._tasks:
            what = "its output is" if skipped == 1 else f"all {skipped} outputs are"
            click.echo(f"nothing to do: {what} up to date{before}", err=True)
            return
        tables = self.states["no rates"]
        logs = len(self._tasks) - tables
        text = f"{logs - self.states['failed']} of {logs} logs done, {self._samples:,} samples"
        if skipped:
            text += f"; {skipped} skipped, as their outputs are up to date{before}"
        counts = ((tables, "table", " without body rates"), (other_files, "other file", ""))
        ignored = [f"{n} {what}{'s' * (n > 1)}{which}" for n, what, which in counts if n]
        click.echo(text + "; ignored " * bool(ignored) + " and ".join(ignored), err=True)


def _line(task: BatchTask, result: BatchResult, span_s: float, width: int) -> str:
    """Return the result of one log in a line, and its warnings and losses below."""
    from quatprop.rendering import loss_lines
    from quatprop.stores.objects import without_secret
    from quatprop.times import duration_text

    span = duration_text(round(span_s * 1e9))
    samples = f"{result.entry.samples:>12,} samples over {span:<10}"
    lines = [f"{plain(task.log):<{width}}  {samples}  -> {plain(without_secret(task.output))}"]
    lines += [f"  warning: {remark}" for remark in result.entry.remarks]
    return "\n".join(lines + [f"  {line}" for line in loss_lines(result.losses)])


def _report(task: BatchTask, result: BatchResult) -> dict[str, object]:
    from quatprop.stores.objects import without_secret

    return {
        "log": task.log,
        "output": without_secret(task.output),
        "error": result.entry.error,
        "seconds": result.entry.seconds,
        "report": result.report,
    }
