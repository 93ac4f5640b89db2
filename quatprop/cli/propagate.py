"""``quatprop propagate``: one log in, its attitude series out."""

from __future__ import annotations

from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.options import (
    SELECTION_OPTIONS,
    plot_option,
    quiet_option,
    report_option,
    with_options,
)
from quatprop.cli.output_options import OUTPUT_OPTIONS, into_option, output_settings
from quatprop.cli.types import Parsed
from quatprop.settings import FRAMES, LAYOUTS, METHODS, PROPAGATE

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from quatprop.pipeline.job import Job
    from quatprop.plot.propagation import PropagationPicture


PROPAGATION_OPTIONS = (
    click.option(
        "--method",
        type=click.Choice(METHODS),
        help="Integration rule: the rate over an interval is that of the sample at its start, of "
        "the one at its end, their mean, or linear between them (coning).  [default: start]",
    ),
    click.option(
        "--rates",
        type=click.Choice(FRAMES),
        help="Frame the rates are resolved in: body multiplies right, inertial left.  "
        "[default: body]",
    ),
    click.option(
        "--q0",
        type=Parsed(PROPAGATE["q0"], "W,X,Y,Z|level|log|FILE"),
        help="Attitude body to reference at the first sample: four numbers; level, roll and pitch "
        "from gravity at rest; log, the log's own orientation; or FILE, an attitude series, at "
        "that time.  [default: identity]",
    ),
    click.option(
        "--heading",
        type=Parsed(PROPAGATE["heading"], "DEG"),
        help="For --q0 level: rotation about the reference's z axis.  [default: 0]",
    ),
    click.option(
        "--reference-z",
        type=click.Choice(("up", "down")),
        help="For --q0 level: where the reference's z axis points (down for north-east-down).  "
        "[default: up]",
    ),
    click.option(
        "--q0-layout",
        type=click.Choice(LAYOUTS),
        help="Order of the four numbers of --q0.  [default: scalar-first]",
    ),
    click.option(
        "--bias",
        type=Parsed(PROPAGATE["bias"], "X,Y,Z|static[:DUR]"),
        help="Subtracted from the rates, in --rate-unit; static takes the mean rate at rest, found "
        "in windows of DUR (1s).  [default: none]",
    ),
    click.option(
        "--mount",
        metavar="W,X,Y,Z|x,-y,-z",
        help="Sensor axes to body axes: a quaternion, or the sensor axes that become x, y and z.  "
        "[default: they are the same]",
    ),
    click.option(
        "--start",
        type=Parsed(PROPAGATE["start"], "TIME"),
        help="Use the log from here: RFC 3339, ns, +10s from its first or -30s from its last "
        "sample.  [default: all]",
    ),
    click.option(
        "--end",
        type=Parsed(PROPAGATE["end"], "TIME"),
        help="Use the log up to here; as --start.  [default: all]",
    ),
    click.option(
        "--on-backwards",
        type=click.Choice(("error", "drop", "sort")),
        help="Timestamps that go backwards: refuse, drop until the clock has caught up, or sort "
        "(holds the log in memory).  [default: error]",
    ),
    click.option(
        "--on-nonfinite",
        type=click.Choice(("error", "drop", "hold")),
        help="Rates that are NaN or infinite: refuse, drop, or hold the previous rate.  "
        "[default: error]",
    ),
    click.option(
        "--max-gap",
        type=Parsed(PROPAGATE["max_gap"], "DUR"),
        help="Intervals longer than this count as gaps.  [default: 10 median intervals]",
    ),
    click.option(
        "--on-gap",
        type=click.Choice(("hold", "zero", "split", "error")),
        help="Gaps: propagate across and warn, take the rate across as zero, begin again at --q0, "
        "or refuse.  [default: hold]",
    ),
    click.option(
        "--every",
        type=Parsed(PROPAGATE["every"], "N"),
        help="Write every N-th attitude only.  [default: all]",
    ),
    click.option(
        "--rate",
        type=Parsed(PROPAGATE["rate"], "HZ"),
        help="Write attitudes at this rate, exact at those times under the method.  "
        "[default: at the samples]",
    ),
    click.option(
        "--at",
        type=click.Path(exists=True),
        metavar="FILE",
        help="Write attitudes at the stamps of this series of attitudes or rates, exact under the "
        "method; times outside the log are left out.  [default: at the samples]",
    ),
)
"""Settings of a propagation: each is a key of :data:`quatprop.settings.PROPAGATE`."""


@click.command(no_args_is_help=True)
@click.argument("log")
@click.option(
    "-o",
    "--output",
    metavar="PATH|-",
    help="Where the attitudes go; - is CSV on stdout.  [default: none, so --into is needed]",
)
@into_option
@with_options(OUTPUT_OPTIONS)
@with_options(PROPAGATION_OPTIONS)
@report_option
@plot_option
@quiet_option
@click.option(
    "-v", "--verbose", is_flag=True, help="A longer summary: conventions, policies, timings."
)
@with_options(SELECTION_OPTIONS)
def command(**chosen: Any) -> None:
    """Turn the body rates of LOG into its attitude series.

    LOG is an MCAP file, a ROS 1 bag, a ROS 2 bag (folder or .db3), a CSV, Parquet or Feather
    table, or - for CSV on stdin. N samples give N attitudes; the first is --q0. Say where they go:
    to a file of their own with -o, or into a copy of LOG with --into.
    """
    from quatprop.cli import summary as words
    from quatprop.pipeline.job import run

    quiet, verbose, plot = (chosen.pop(name) for name in ("quiet", "verbose", "plot"))
    job = job_of(chosen)
    with words.progress(quiet=quiet) as tick, _drawing(job, plot) as picture:
        report = run(job, tick, picture, summary=not quiet)
        if picture is not None:
            picture.commit(report)
    if not quiet:
        click.echo(words.summary(report, verbose=verbose), err=True)
    if report.data_lost:
        raise click.exceptions.Exit(3)


def _drawing(job: Job, plot: str | None) -> AbstractContextManager[PropagationPicture | None]:
    """Return the picture of a job in the making; None in it where no picture is wanted."""
    if plot is None:
        return nullcontext()
    from quatprop.cli.spelling import spelled
    from quatprop.plot.propagation import PropagationPicture

    settings, output = job.settings, job.output
    resampled = settings.rate is not None or settings.at is not None
    inputs = [job.log, *settings.inputs]
    outputs = [output.path, output.report]
    return PropagationPicture(plot, inputs, outputs, resampled=resampled, spell=spelled)


def job_of(chosen: dict[str, Any]) -> Job:
    """Return what the options ask for, with typed values."""
    from quatprop.pipeline.job import Job
    from quatprop.pipeline.settings import propagation_settings

    return Job(
        log=chosen["log"],
        output=output_settings(chosen),
        settings=propagation_settings({name: chosen[name] for name in PROPAGATE}),
    )
