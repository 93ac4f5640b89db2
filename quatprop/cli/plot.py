"""``quatprop plot``: pictures of rates, attitudes and errors."""

from __future__ import annotations

from typing import Any

import click

from quatprop.cli.attitude_options import ATTITUDE_OPTIONS, attitude_options, attitude_selection
from quatprop.cli.compare import ALIGNMENTS
from quatprop.cli.options import (
    SELECTION_OPTIONS,
    quiet_option,
    refuse_stdin_twice,
    selection,
    with_options,
)
from quatprop.cli.spelling import spelled
from quatprop.cli.types import ANGLE, DURATION, TIME, TIME_OFFSET

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
    "tolerance",
    type=ANGLE,
    help="With --reference: draw this tolerance, such as 0.1deg, and mark the first sample above "
    "it; the exit code stays 0.  [default: none]",
)
@click.option(
    "--align",
    type=click.Choice(ALIGNMENTS),
    default="none",
    show_default=True,
    help="With --reference: what it is turned by first; as for compare.",
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
    "max_dt_ns",
    type=DURATION,
    help="With --reference: how far apart samples that belong together may be; as for compare.  "
    "[default: half the median interval to the nearest, 10 to interpolate]",
)
@quiet_option
@with_options(SELECTION_OPTIONS)
@with_options(OWN_OPTIONS)
@with_options(attitude_options("REF", "-ref"))
def command(files: tuple[str, ...], quiet: bool, **chosen: Any) -> None:
    """Draw rates or attitudes of each FILE, or its error against a reference, against time.

    A log shows its body rates, an attitude series its angles and its norm error. Gaps are shaded.
    Several files are laid over one another.

    \b
    quatprop plot flight.bag -o rates.png
    quatprop plot old.parquet new.parquet -o attitude.svg
    quatprop plot attitude.csv -o report.html --reference truth.csv --tol 0.1deg
    """
    from quatprop.cli import summary as words
    from quatprop.comparison import Settings
    from quatprop.plot.files import View
    from quatprop.plot.run import Plot, plot
    from quatprop.signals.attitude_input import AttitudeInput
    from quatprop.text import plain

    reference, kind_ref = chosen.pop("reference"), chosen.pop("kind_ref")
    _refuse_idle(reference)
    refuse_stdin_twice(*files, reference)
    show = _shown(chosen)
    of_reference = attitude_selection(chosen, "_ref")
    keys = ("tolerance", "align", "time_offset", "max_dt_ns")
    settings = Settings(**{key: chosen.pop(key) for key in keys})
    attitudes = attitude_selection(
        {**{key: chosen[key] for key in OF_SAMPLES if key != "kind"}, **_own(chosen)}
    )
    job = Plot(
        files,
        chosen.pop("output"),
        View(
            kind=chosen.pop("kind"),
            show=show,
            rates=selection(chosen),
            attitudes=attitudes,
            **chosen,
        ),
        reference and AttitudeInput(reference, kind_ref, of_reference, drop=True, side="ref"),
        settings,
    )
    with words.progress(quiet=quiet) as tick:
        report = plot(job, tick)
    if not quiet:
        lines = [plain(line) for line in report["lines"]]
        lines += [f"warning: {spelled(warning)}" for warning in report["warnings"]]
        click.echo("\n".join(lines), err=True)
    if report["data_lost"]:
        raise click.exceptions.Exit(3)


def _shown(chosen: dict[str, Any]) -> str | None:
    """Take out what is to be shown: whoever says which attitudes wants attitudes."""
    show: str | None = chosen.pop("show")
    for key, (name, _) in {"components": ("--components", {}), **ATTITUDE_OPTIONS}.items():
        if key not in OF_SAMPLES and chosen[key]:
            if show == "rates":
                raise click.UsageError(f"{name} goes with --show attitude")
            return "attitude"
    return show


def _own(chosen: dict[str, Any]) -> dict[str, Any]:
    """Take the options that only attitudes have out of a command's."""
    return {key: chosen.pop(key) for key in ATTITUDE_OPTIONS if key not in OF_SAMPLES}


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
