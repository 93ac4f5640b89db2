"""``quatprop batch``: propagate many logs."""

from __future__ import annotations

import json
from collections import Counter
from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quatprop.base.text import plain
from quatprop.cli import propagate
from quatprop.cli.commands import Command, GroupedOption
from quatprop.cli.options import PATH, QUIET, content_of, with_options
from quatprop.propagation.output_options import OUTPUT_OPTIONS
from quatprop.settings.parsers import Keyword, flag

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tqdm import tqdm

    from quatprop.tools.batch.execution import Batch
    from quatprop.tools.batch.log_search import LogSearch
    from quatprop.tools.batch.planning import BatchResult, BatchSettings, Plan
    from quatprop.tools.batch.tasks import BatchTask


ONE_LOG = {
    *("log", "logs", "output", "to", "plot", "report", "quiet", "verbose", "in_sequence"),
}
"""Parameters of ``propagate`` for a single log, or for several files as one."""

SHARED = [option for option in propagate.command.params if option.name not in ONE_LOG]
"""The options of ``propagate`` that apply to every log."""


EXAMPLES = (
    "quatprop simulate demo.bag --motion tumbling",
    "quatprop batch '*.bag' -o attitudes --to csv -j 2",
)


OPTIONS = {
    "--to": replace(OUTPUT_OPTIONS["--to"], default="parquet", preset=True),
    "--list list_file": Keyword(
        PATH, "Also read names from FILE or stdin, one per line, relative to the current folder.",
        takes="FILE|-", group="Execution"),
    "--root": Keyword(
        PATH, "Outputs keep the path of their log below DIR.",
        "the folder that is searched, the fixed part of a GLOB, and for a LOG its own folder",
        "DIR", group="Execution"),
    "--shard": Keyword(
        click.STRING,
        "Only the I-th of N parts of the logs, I from 1, as for array jobs; a log's part "
        "depends only on its name.", "all", "I/N", group="Execution"),
    "-j processes": Keyword(
        click.IntRange(min=1), "Logs at a time: each in its own process.",
        "the cores", "N",
        group="Execution", common=True),
    "--dask": Keyword(
        click.STRING,
        "Run on the workers of the Dask cluster whose scheduler has this address; they must "
        "see the same paths.", "this machine", "ADDRESS", group="Execution"),
    "--expect": Keyword(
        PATH, "Expectations on each log: a TOML file with the keys of [case.NAME.expect] of check; "
        "the manifest lists those that are not met.", takes="FILE", group="Execution"),
    "--skip-existing": Keyword(
        flag, "Skip logs whose output is up to date: same version, options, log (size and time) "
        "and output size.",
        group="Execution", common=True),
    "--verify": Keyword(
        flag, "With --skip-existing, also compare the SHA-256 of each output.",
        group="Execution"),
    "--retries": Keyword(
        click.IntRange(min=0),
        "Retry a log up to N times if its process was killed or its store did not answer.",
        "0", "N", group="Execution", preset=True),
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
    help="Where the attitude series go: each under the name of its log, with the suffix "
    "added, and the manifest; a folder, or a prefix such as s3://bucket/runs.",
)
@with_options(OPTIONS)
def command(
    names: tuple[str, ...], *, folder: str, as_json: bool, quiet: bool, **chosen: Any
) -> int:
    """Turn the body rates of each LOG into an attitude series in DIR.

    Folders, prefixes of object stores and quoted patterns are searched for logs; a log that
    fails does not stop the others. -t '*' is every topic with rates.
    """
    from quatprop.base.places import without_file_scheme
    from quatprop.cli.summary import bar, on_terminal
    from quatprop.tools.batch.execution import dask_executor

    folder = without_file_scheme(folder)
    _refuse_contradictions(folder, chosen)
    search, settings, batch = _planned(names, folder, chosen, reports=as_json)
    count = len(batch.plan.tasks)
    shown = ShownResults(batch.plan, settings, quiet=quiet, keeps=as_json)
    cluster = dask_executor(chosen["dask"]) if chosen["dask"] and count else nullcontext()
    with (
        bar(count, "log", disable=not on_terminal(quiet=quiet)) as meter,
        cluster as executor,
        closing(batch.results(executor, chosen["processes"])) as results,
    ):
        for index, result in results:
            shown.add(index, result, meter)
    if as_json:
        click.echo(json.dumps([report for _, report in sorted(shown.reports.items())], indent=2))
    counts = {
        "table|without body rates": shown.states["no rates"],
        "other file": search.other_files,
        "link|to folders": search.links,
    }
    if not quiet:
        shown.finish(batch.plan, counts, len(batch.gone))
    only_tables = count and count == shown.states["no rates"] and not batch.plan.skipped
    if only_tables and not chosen["shard"]:
        raise click.UsageError(
            f"there are no logs: {ignored_text(counts)}; name the logs themselves"
        )
    return shown.exit_code(batch.plan)


command.params += SHARED


def _planned(
    names: tuple[str, ...], folder: str, chosen: Mapping[str, Any], *, reports: bool
) -> tuple[LogSearch, BatchSettings, Batch]:
    """Return the search, the settings and the batch; warn of unusable lines in its manifest."""
    from quatprop.tools.batch.execution import Batch
    from quatprop.tools.batch.log_search import search_logs
    from quatprop.tools.batch.manifest import Manifest
    from quatprop.tools.batch.planning import BatchSettings, shard
    from quatprop.tools.check.expect import read_expectations

    part = shard(chosen["shard"])
    given = [*names, *_listed_in(chosen["list_file"])]
    search = search_logs(
        given, chosen["root"], folder, chosen["to"], chosen, otherwise=", or use --list"
    )
    manifest = Manifest(folder)
    # Workers may run in another folder.
    paths = {"report": None, "logs": ["LOG"], "output": "OUT"}
    job = propagate.job_of({**chosen, **paths}, Path.cwd())
    expect = None if chosen["expect"] is None else read_expectations(chosen["expect"])
    others = {"reports": reports, "retries": chosen["retries"]}
    settings = BatchSettings.for_job(job, folder, expect, **others)
    skip, verify = chosen["skip_existing"], chosen["verify"]
    batch = Batch(search, settings, manifest, part, skip=skip, verify=verify)
    if count := manifest.unused:
        click.echo(
            f"Warning: {plain(manifest.place)}: {count} line{'s' * (count > 1)} that no batch "
            "writes; ignored, so that a log may be propagated again",
            err=True,
        )
    return search, settings, batch


def _refuse_contradictions(folder: str, chosen: Mapping[str, Any]) -> None:
    """Refuse contradictory options, and a file in place of a folder."""
    if chosen["dask"] and chosen["processes"]:
        raise click.UsageError("-j is for this machine; omit it with --dask")
    if Path(folder).is_file():
        raise click.UsageError(f"-o {folder} is a file; name a folder for the outputs")


def _listed_in(file: str | None) -> list[str]:
    """Return the names in a file or on stdin, one per line."""
    if file is None:
        return []
    text = content_of(file).decode("utf-8-sig", "surrogateescape")
    return [name for line in text.split("\n") if (name := line.rstrip("\r"))]


# The results of a batch, as they come, and its totals.


class ShownResults:
    """Shows results as they arrive; keeps only totals, errors and requested reports."""

    def __init__(
        self,
        plan: Plan,
        settings: BatchSettings,
        *,
        quiet: bool,
        keeps: bool,
    ) -> None:
        from quatprop.base.rendering import count_text

        self.states: Counter[str] = Counter()
        self.unexpected = 0
        self.reports: dict[int, Any] = {}
        self._errors: list[str] = []
        self._samples = 0
        tasks = plan.tasks
        self._tasks, self._settings, self._quiet, self._keeps = tasks, settings, quiet, keeps
        self._count, self._unit, self._what = len(tasks), "log|s", "logs"
        if plan.of_topics:
            logs = count_text(len({task.path for task in tasks}), "log")
            self._unit, self._what = "series|", f"series of {logs}"
        self._width = max((len(plain(task.label)) for task in tasks), default=0)

    def add(self, index: int, result: BatchResult, meter: tqdm[Any]) -> None:
        """Show the result of a log above the progress bar; errors even if quiet."""
        self.states[result.entry.state] += 1
        self._samples += result.entry.samples or 0
        self.unexpected += bool(result.entry.unmet)
        task = self._tasks[index]
        output, text = self._settings.output_of(task), ""
        if self._keeps:
            self.reports[index] = _report(task, output, result)
        if result.entry.state == "failed":
            self._errors.append(result.entry.error or "")
            text = f"Error: {self._errors[-1]}"
        elif not self._quiet and result.entry.span_s is not None:
            text = _line(task, output, result, self._width)
        if text:
            meter.clear()
            click.echo(text, err=True)
        meter.update()

    def exit_code(self, planned: Plan) -> int:
        """Return 2 if a log failed, 1 if one is not as expected, 3 if data was lost, else 0."""
        if self.states["failed"]:
            return 2
        if self.unexpected or planned.unexpected:
            return 1
        return 3 if self.states["data lost"] or planned.lost else 0

    def finish(self, planned: Plan, ignored: Mapping[str, int], gone: int) -> None:
        """Show the errors again, and the totals."""
        if self._errors and self._count > 1:
            click.echo(f"{len(self._errors)} failed:", err=True)
            for error in self._errors:
                click.echo(f"  {error}", err=True)
        if unexpected := self.unexpected + planned.unexpected:
            unit, _, plural = self._unit.partition("|")
            click.echo(f"{unexpected} {unit}{plural * (unexpected > 1)} not as expected", err=True)
        skipped, lost = planned.skipped, planned.lost
        before = f"; data was lost in {lost} of them" * bool(lost)
        what = f"{gone} log{'s are' if gone > 1 else ' is'} no longer there"
        before += f"; {what}, and noted as deleted" * bool(gone)
        if not self._count and skipped:
            what = "its output is" if skipped == 1 else f"all {skipped} outputs are"
            click.echo(f"nothing to do: {what} up to date{before}", err=True)
            return
        logs = self._count - self.states["no rates"]
        text = f"{logs - self.states['failed']} of {logs} {self._what} done, "
        text += f"{self._samples:,} samples"
        text += f"; {skipped} skipped, as their outputs are up to date" * bool(skipped) + before
        click.echo(f"{text}; {ignored_text(ignored)}".removesuffix("; "), err=True)


def _line(task: BatchTask, output: str, result: BatchResult, width: int) -> str:
    """Return a line for a result, followed by its warnings and losses."""
    from quatprop.base.places import without_secret
    from quatprop.base.rendering import loss_lines
    from quatprop.base.times import duration_text

    span = duration_text(round((result.entry.span_s or 0) * 1e9))
    samples = f"{result.entry.samples:>12,} samples over {span:<10}"
    lines = [f"{plain(task.label):<{width}}  {samples}  -> {plain(without_secret(output))}"]
    lines += [f"  not as expected: {reason}" for reason in result.entry.unmet or ()]
    lines += [f"  warning: {remark}" for remark in result.entry.remarks]
    return "\n".join(lines + [f"  {line}" for line in loss_lines(result.losses)])


def _report(task: BatchTask, output: str, result: BatchResult) -> dict[str, object]:
    from quatprop.base.places import without_secret

    return {
        "log": task.shown,
        "output": without_secret(output),
        "error": result.entry.error,
        "unmet": result.entry.unmet,
        "seconds": result.entry.seconds,
        "report": result.report,
    }


def ignored_text(counts: Mapping[str, int]) -> str:
    """Return a text with the numbers of ignored items."""
    words = []
    for name, count in counts.items():
        what, _, which = name.partition("|")
        words += [f"{count} {what}{'s' * (count > 1)}{' ' * bool(which)}{which}"] * bool(count)
    *others, last = words or [""]
    return f"ignored {', '.join(others)}{' and ' * bool(others)}{last}" if last else ""
