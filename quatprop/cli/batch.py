"""``quatprop batch``: many logs in, an attitude series of each out."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli import propagate
from quatprop.cli.options import quiet_option
from quatprop.provenance import as_json as to_json
from quatprop.writers import WRITERS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.batch.run import BatchManifest, Outcome
    from quatprop.pipeline.job import Job

ONE_LOG = {"log", "output", "to", "into", "plot", "report", "quiet", "verbose"}
"""Parameters of ``propagate`` that are about one log."""

SHARED = [option for option in propagate.command.params if option.name not in ONE_LOG]
"""The options of ``propagate`` that hold for every log."""


@click.command(no_args_is_help=True)
@click.argument("logs", metavar="LOG...", nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    "folder",
    metavar="DIR",
    required=True,
    help="Where the attitude series go, each under the name of its log.",
)
@click.option(
    "--to",
    type=click.Choice(tuple(WRITERS)),
    default="parquet",
    show_default=True,
    help="Format of the outputs.",
)
@click.option(
    "-j",
    "processes",
    type=click.IntRange(min=1),
    metavar="N",
    help="Logs at a time, each in a process of its own.  [default: the cores of this machine]",
)
@click.option(
    "--dask",
    metavar="ADDRESS",
    help="Let the workers of the Dask cluster with its scheduler there do it; they have to see the "
    "same paths.  [default: this machine]",
)
@click.option(
    "--skip-existing",
    is_flag=True,
    help="Leave out logs whose output is there, as after an interruption, if it was made by the "
    "same version from the log as it is (size and time), with the same options.",
)
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout: the report of each log.")
@quiet_option
def command(logs: tuple[str, ...], **chosen: Any) -> None:
    """Turn the body rates of each LOG into an attitude series in DIR.

    A log that cannot be used does not stop the others. All the options below that propagate has
    hold for every log. Where logs have the same name, the folders they are in are kept.

    \b
    quatprop batch logs/*.mcap -o attitudes --method coning
    quatprop batch runs/*/imu.bag -o attitudes --to csv -j 4

    Exit code 0: all done; 2: a log could not be used; 3: all done, but with data lost.
    """
    from pathlib import Path

    from quatprop.batch.run import BatchManifest

    own = {name: chosen.pop(name) for name in ("folder", "processes", "dask", "skip_existing")}
    as_json, quiet = chosen.pop("as_json"), chosen.pop("quiet")
    if own["dask"] and own["processes"]:
        raise click.UsageError("-j is for this machine; leave it out with --dask")
    folder = Path(own["folder"])
    if folder.exists() and not folder.is_dir():
        raise click.UsageError(f"-o {own['folder']} is a file; name a folder for the outputs")
    jobs = _jobs(logs, folder, chosen)
    made = BatchManifest(folder)
    wanted = [job for job in jobs if not (own["skip_existing"] and made.is_fresh(job))]
    try:
        found = _noted(_outcomes(wanted, own["processes"], own["dask"]), wanted, made)
        done = _said(found, wanted, quiet=quiet)
    finally:
        made.write()
    if as_json:
        click.echo(json.dumps(to_json([_report(outcome) for outcome in done]), indent=2))
    if not quiet:
        click.echo(_tally(done, len(jobs) - len(wanted)), err=True)
    if any(outcome.error for outcome in done):
        raise click.exceptions.Exit(2)
    if any(outcome.data_lost for outcome in done):
        raise click.exceptions.Exit(3)


command.params += SHARED


def _jobs(logs: Sequence[str], folder: Path, chosen: dict[str, Any]) -> list[Job]:
    """Return one job for each log, with outputs that replace nothing that is read."""
    from quatprop.batch.run import outputs
    from quatprop.writers.targets import refuse_overlap

    if "-" in logs:
        raise click.UsageError("stdin is one log; give it to quatprop propagate")
    suffix = next((s for s in WRITERS[chosen["to"]].suffixes if s), "")
    places = [str(place) for place in outputs(logs, folder, suffix)]
    refuse_overlap(logs, places)
    one_log = {"report": None, "into": None}
    return [
        propagate.job_of({**chosen, **one_log, "log": log, "output": place})
        for log, place in zip(logs, places, strict=True)
    ]


def _outcomes(jobs: list[Job], processes: int | None, dask: str | None) -> Iterator[Outcome]:
    from quatprop.batch.run import on_a_cluster, on_this_machine

    if dask is not None:
        return on_a_cluster(jobs, dask)
    return on_this_machine(jobs, processes or os.cpu_count() or 1)


def _noted(found: Iterator[Outcome], jobs: list[Job], made: BatchManifest) -> Iterator[Outcome]:
    """Pass outcomes on, and note which outputs were made, and from what."""
    from quatprop.batch.run import origin

    # Looked at before anything runs: a log that changes meanwhile is not the one that was read.
    before = [origin(job) for job in jobs]
    for job, came_from, outcome in zip(jobs, before, found, strict=True):
        if not outcome.error:
            made.note(job, came_from)
        yield outcome


def _said(found: Iterator[Outcome], jobs: list[Job], *, quiet: bool) -> list[Outcome]:
    """Say what comes of each log as soon as it is known; errors also when asked to be quiet."""
    from quatprop.cli.spelling import spelled
    from quatprop.text import plain

    width = max((len(plain(job.log)) for job in jobs), default=0)
    done = []
    for outcome in found:
        done.append(outcome)
        if outcome.error:
            click.echo(f"Error: {spelled(outcome.error)}", err=True)
        elif not quiet:
            click.echo(_line(outcome, width), err=True)
    return done


def _line(outcome: Outcome, width: int) -> str:
    """Return what came of one log in a line, and what is to be said of it beneath."""
    from quatprop.cli.spelling import spelled
    from quatprop.cli.summary import loss_lines
    from quatprop.text import plain
    from quatprop.times import duration_text

    if (report := outcome.report) is None:
        return plain(outcome.log)
    counts = report.counts
    figures = f"{counts.used:>12,} samples over {duration_text(counts.span_ns):<10}"
    lines = [f"{plain(outcome.log):<{width}}  {figures}  -> {plain(outcome.output)}"]
    lines += [f"  warning: {spelled(remark)}" for remark in report.remarks]
    return "\n".join(lines + [f"  {said}" for said in loss_lines(report.losses)])


def _tally(done: list[Outcome], skipped: int) -> str:
    if not done:
        return f"nothing to do: all {skipped} outputs are as they would be"
    failed = sum(bool(outcome.error) for outcome in done)
    said = f"{len(done) - failed} of {len(done)} logs done"
    samples = sum(outcome.report.counts.used for outcome in done if outcome.report)
    said += f", {samples:,} samples"
    return said + (f"; {skipped} skipped, as their outputs are as they would be" if skipped else "")


def _report(outcome: Outcome) -> dict[str, Any]:
    return {
        "log": outcome.log,
        "output": outcome.output,
        "error": str(outcome.error) or None,
        "seconds": outcome.seconds,
        "report": outcome.report and outcome.report.as_json(),
    }
