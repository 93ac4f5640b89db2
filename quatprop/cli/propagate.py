"""``quatprop propagate``: one log in, its attitude series out."""

from __future__ import annotations

import math
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.options import (
    LAYOUTS,
    SELECTION_OPTIONS,
    plot_option,
    quiet_option,
    report_option,
    selection,
    with_options,
)
from quatprop.cli.output_options import OUTPUT_OPTIONS, destination, into_option, message
from quatprop.cli.types import Bias, Duration, Frequency, InitialAttitude, Time

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from quatprop.pipeline.job import Job
    from quatprop.plot.propagation import PropagationPicture


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
@click.option(
    "--method",
    type=click.Choice(("start", "end", "mean", "coning")),
    default="start",
    show_default=True,
    help="Which samples rule an interval: the one at its start, at its end, their mean, or a rate "
    "linear between them.",
)
@click.option(
    "--rates",
    type=click.Choice(("body", "inertial")),
    default="body",
    show_default=True,
    help="Frame the rates are resolved in: body multiplies right, inertial left.",
)
@click.option(
    "--q0",
    type=InitialAttitude(),
    help="Attitude body to reference at the first sample: four numbers; level, roll and pitch from "
    "gravity at rest; log, the log's own orientation; or FILE, an attitude series, at that time.  "
    "[default: identity]",
)
@click.option(
    "--heading",
    type=float,
    default=0.0,
    show_default=True,
    metavar="DEG",
    help="For --q0 level: rotation about the reference's z axis.",
)
@click.option(
    "--reference-z",
    type=click.Choice(("up", "down")),
    default="up",
    show_default=True,
    help="For --q0 level: where the reference's z axis points (down for north-east-down).",
)
@click.option(
    "--q0-layout",
    type=click.Choice(LAYOUTS),
    default="scalar-first",
    show_default=True,
    help="Order of the four numbers of --q0.",
)
@click.option(
    "--bias",
    type=Bias(),
    help="Subtracted from the rates, in --rate-unit; static takes the mean over the log's rest, "
    "looked for in windows of DUR (1s).  [default: none]",
)
@click.option(
    "--mount",
    metavar="W,X,Y,Z|x,-y,-z",
    help="Sensor axes to body axes: a quaternion, or the sensor axes that become x, y and z.  "
    "[default: they are the same]",
)
@click.option(
    "--start",
    type=Time(),
    help="Use the log from here: RFC 3339, ns, +10s from its first or -30s from its last sample.  "
    "[default: all]",
)
@click.option("--end", type=Time(), help="Use the log up to here; as --start.  [default: all]")
@click.option(
    "--on-backwards",
    type=click.Choice(("error", "drop", "sort")),
    default="error",
    show_default=True,
    help="Stamps that step back: refuse, drop until the clock has caught up, or sort (holds the "
    "log in memory).",
)
@click.option(
    "--on-nonfinite",
    type=click.Choice(("error", "drop", "hold")),
    default="error",
    show_default=True,
    help="Rates that are NaN or infinite: refuse, drop, or hold the rate before.",
)
@click.option(
    "--max-gap",
    type=Duration(),
    help="Longest interval that is no gap.  [default: 10 median intervals]",
)
@click.option(
    "--on-gap",
    type=click.Choice(("hold", "zero", "split", "error")),
    default="hold",
    show_default=True,
    help="Gaps: propagate across and warn, take the rate across as zero, begin again at --q0, or "
    "refuse.",
)
@click.option(
    "--every",
    type=click.IntRange(min=1),
    metavar="N",
    help="Write every N-th attitude only.  [default: all]",
)
@click.option(
    "--rate",
    type=Frequency(),
    help="Write attitudes so often a second, exact at those times under the method.  "
    "[default: at the samples]",
)
@click.option(
    "--at",
    type=click.Path(exists=True),
    metavar="FILE",
    help="Write attitudes at the stamps of this series of attitudes or rates, exact under the "
    "method; times outside the log are left out.  [default: at the samples]",
)
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
        report = run(job, tick, picture)
        if picture is not None:
            picture.commit(report)
    if not quiet:
        click.echo(words.summary(report, verbose=verbose), err=True)
    if report["data_lost"]:
        raise click.exceptions.Exit(3)


def _drawing(job: Job, plot: str | None) -> AbstractContextManager[PropagationPicture | None]:
    """Return the picture of a job in the making; None in it where no picture is wanted."""
    if plot is None:
        return nullcontext()
    from quatprop.plot.propagation import PropagationPicture

    resampled = job.rate is not None or job.at is not None
    inputs = [job.log, job.q0.words, job.at]
    return PropagationPicture(plot, inputs, [job.output, job.report], resampled=resampled)


def job_of(chosen: dict[str, Any]) -> Job:
    """Return what the options ask for; in the context of the command, whose options they are."""
    from quatprop.conditioning import Conditioning
    from quatprop.conventions.layout import layout_named
    from quatprop.pipeline.initial_attitude import Start
    from quatprop.pipeline.job import Job
    from quatprop.timeline import Policy

    # What is drawn of a job is no part of it.
    chosen.pop("plot", None)
    _refuse_idle(chosen["q0"])
    start = {
        "heading": math.radians(chosen.pop("heading")),
        "down": chosen.pop("reference_z") == "down",
    }
    q0, q0_order = chosen.pop("q0"), layout_named(chosen.pop("q0_layout")).order
    if isinstance(q0, str):
        start["words"] = q0
    elif q0 is not None:
        start["wxyz"] = tuple(q0[q0_order.index(part)] for part in range(4))
    bias = chosen.pop("bias")
    layout = chosen.pop("layout")
    return Job(
        log=chosen.pop("log"),
        selection=selection(chosen),
        policy=Policy(
            on_backwards=chosen.pop("on_backwards"),
            on_nonfinite=chosen.pop("on_nonfinite"),
            on_gap=chosen.pop("on_gap"),
            max_gap_ns=chosen.pop("max_gap"),
        ),
        q0=Start(**start),
        layout=layout and layout_named(layout).name,
        message=message(chosen),
        **destination(chosen),
        conditioning=Conditioning(
            bias=bias if isinstance(bias, tuple) else None,
            static_ns=bias if isinstance(bias, int) else None,
            mount=chosen.pop("mount"),
            start=chosen.pop("start"),
            end=chosen.pop("end"),
        ),
        **chosen,
    )


def _refuse_idle(q0: tuple[float, ...] | str | None) -> None:
    """Refuse options that belong to another kind of --q0 than the one that is given."""
    source = click.get_current_context().get_parameter_source
    for option, goes_with, fits in (
        ("heading", "level", q0 == "level"),
        ("reference_z", "level", q0 == "level"),
        ("q0_layout", "W,X,Y,Z", isinstance(q0, tuple)),
    ):
        if not fits and source(option) is not click.core.ParameterSource.DEFAULT:
            raise click.UsageError(f"--{option.replace('_', '-')} goes with --q0 {goes_with}")
