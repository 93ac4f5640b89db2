"""``quatprop plot``: pictures of rates, attitudes and errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import click

from quatprop.cli.attitude_options import ATTITUDE_OPTIONS, attitude_options, attitude_selection
from quatprop.cli.compare import settings_of
from quatprop.cli.options import (
    SELECTION_OPTIONS,
    quiet_option,
    refuse_stdin_twice,
    selection,
    with_options,
)
from quatprop.cli.spelling import spelled
from quatprop.cli.types import ANGLE, DURATION, TIME, TIME_OFFSET
from quatprop.comparison.settings import ALIGNMENTS
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Mapping

OF_SAMPLES = ("kind", "topic", "clock", "time_field", "time_col", "time_unit", "sample_rate")
"""Options that rates and attitudes share."""

OWN_OPTIONS = [
    option
    for key, option in zip(ATTITUDE_OPTIONS, attitude_options("FILE"), strict=True)
    if key not in OF_SAMPLES
]


@click.command(no_args_is_help=True)
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    metavar="PIC",
    required=True,
    help="Where the picture goes: .png, .svg, .pdf, or .html for a report with the picture in it.",
)
@click.option(
    "--show",
    type=click.Choice(("rates", "attitude")),
    help="What to draw.  [default: attitudes where an option says which, else the rates of a file "
    "that has some, else its attitudes]",
)
@click.option(
    "--components",
    is_flag=True,
    help="Draw the four components of the quaternion.  [default: yaw, pitch and roll]",
)
@click.option(
    "--start",
    type=TIME,
    help="Draw from here: RFC 3339, ns, +10s from the first or -30s from the last sample.  "
    "[default: all]",
)
@click.option("--end", type=TIME, help="Draw up to here; as --start.  [default: all]")
@click.option(
    "--reference",
    metavar="REF",
    help="Draw the geodesic error of each FILE against this attitude series; holds both in "
    "memory.  [default: what is in FILE]",
)
@click.option(
    "--tol",
    type=ANGLE,
    help="With --reference: draw this tolerance, such as 0.1deg, and mark the first sample above "
    "it; the exit code stays 0.  [default: none]",
)
@click.option(
    "--align",
    type=click.Choice(ALIGNMENTS),
    default="none",
    show_default=True,
    help="With --reference: how it is rotated first; as for compare.",
)
@click.option(
    "--time-offset",
    type=TIME_OFFSET,
    metavar="DUR|auto",
    default=0,
    help="With --reference: added to its stamps; as for compare.  [default: none]",
)
@click.option(
    "--max-dt",
    type=DURATION,
    help="With --reference: largest distance in time of matched samples; as for compare.  "
    "[default: half the median interval to the nearest, 10 to interpolate]",
)
@quiet_option
@with_options(SELECTION_OPTIONS)
@with_options(OWN_OPTIONS)
@with_options(attitude_options("REF", "-ref"))
def command(files: tuple[str, ...], *, quiet: bool, **chosen: Any) -> None:
    """Draw rates or attitudes of each FILE, or its error against a reference, against time.

    A log shows its body rates, an attitude series its angles and its norm error. Gaps are shaded.
    Several files are laid over one another.

    \b
    quatprop plot flight.bag -o rates.png
    quatprop plot old.parquet new.parquet -o attitude.svg
    quatprop plot attitude.csv -o report.html --reference truth.csv --tol 0.1deg
    """
    from quatprop.cli import summary
    from quatprop.plot.files import View
    from quatprop.plot.run import Plot, plot
    from quatprop.signals.attitude_input import AttitudeInput

    reference = chosen["reference"]
    _refuse_idle(reference)
    refuse_stdin_twice(*files, reference)
    against = None
    if reference is not None:
        selected = attitude_selection(chosen, "_ref")
        against = AttitudeInput(reference, chosen["kind_ref"], selected, drop=True, side="ref")
    job = Plot(
        files=files,
        output=chosen["output"],
        view=View(
            kind=chosen["kind"],
            show=_show(chosen),
            rates=selection(dict(chosen)),
            attitudes=attitude_selection(chosen),
            components=chosen["components"],
            start=chosen["start"],
            end=chosen["end"],
        ),
        reference=against,
        settings=settings_of(chosen),
    )
    with summary.progress(quiet=quiet) as tick:
        drawn = plot(job, tick, spelled)
    if not quiet:
        lines = [*drawn.lines, *(f"warning: {warning}" for warning in drawn.warnings)]
        click.echo("\n".join(map(plain, lines)), err=True)
    if drawn.data_lost:
        raise click.exceptions.Exit(3)


def _show(chosen: Mapping[str, Any]) -> Literal["rates", "attitude"] | None:
    """Return what to draw: an option about attitudes asks for attitudes."""
    show: Literal["rates", "attitude"] | None = chosen["show"]
    for key, (name, _) in {"components": ("--components", {}), **ATTITUDE_OPTIONS}.items():
        if key not in OF_SAMPLES and chosen[key]:
            if show == "rates":
                raise click.UsageError(f"{name} goes with --show attitude")
            return "attitude"
    return show


def _refuse_idle(reference: str | None) -> None:
    """Refuse options that go with others than those that are given."""
    context = click.get_current_context()
    given = [
        option.opts[-1]
        for option in context.command.params
        if context.get_parameter_source(str(option.name)) is click.core.ParameterSource.COMMANDLINE
    ]
    for option in given:
        of_reference = option in {"--tol", "--align", "--time-offset", "--max-dt"}
        if reference is None and (of_reference or option.endswith("-ref")):
            raise click.UsageError(f"{option} goes with --reference")
        if reference is not None and option in {"--show", "--components", "--start", "--end"}:
            raise click.UsageError(f"{option} does not go with --reference, which draws an error")
