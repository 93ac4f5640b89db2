"""``quatprop plot``: pictures of rates, attitudes and errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import click

from quatprop.cli.compare import settings_of
from quatprop.cli.help import Command
from quatprop.cli.options import (
    QUIET,
    input_of,
    own_options,
    refuse_stdin_twice,
    setting_options,
    with_options,
)
from quatprop.cli.types import PATH, OneOf, Parsed
from quatprop.comparison.settings import COMPARE
from quatprop.settings import ONE_SERIES, PROPAGATE, READ_RATES
from quatprop.settings.quantities import picture_size
from quatprop.settings.spelling import option
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.plot.figure import Style

ATTITUDES = {name: parser for name, parser in ONE_SERIES.items() if name not in READ_RATES}
"""Settings about attitudes alone."""

PART = ("start", "end")
NOT_OF_ERROR = {"--show", "--components", "--unwrap", "--start", "--end"}
ERROR = {name: COMPARE[name] for name in ("tol", "align", "time_offset", "max_dt", "window")}


EXAMPLES = (
    "quatprop plot sample_logs/tumbling.bag -o rates.png",
    "quatprop plot attitude.csv sample_logs/tumbling.truth.csv -o attitudes.svg",
    "quatprop plot attitude.csv --reference sample_logs/tumbling.truth.csv -o e.png",
)


OPTIONS = own_options(
    {
        "--show": "What to draw.  [default: attitudes where an option says which, else the rates "
        "of a file that has some, else its attitudes]",
        "--components": "Draw the four components of the quaternion.  [default: yaw, pitch and "
        "roll]",
        "--unwrap": "Draw yaw and roll beyond half a turn.  [default: from -180 to 180 deg]",
        "--size": "W[xH]UNIT  Size of the picture, such as 90mm, 16x9cm or 3.5in.  [default: "
        "7.5in wide]",
        "--dpi": "N  Dots an inch of a PNG.  [default: 200]",
        "--font-size": "PT  Size of the letters in points.  [default: 8.5]",
        "--no-title": "Leave out the lines above and below the panels.",
    },
    {
        "--show": OneOf(("rates", "attitude")),
        "--size": Parsed(picture_size, "SIZE"),
        "--dpi": click.IntRange(min=10, max=2400),
        "--font-size": click.FloatRange(min=2, max=72),
    },
)
REFERENCE = {
    "--reference": "REF  Draw the geodesic error of each FILE against this attitude series; holds "
    "both in memory.  [default: what is in FILE]",
}


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("files", type=PATH, metavar="FILE...", nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    type=PATH,
    metavar="PIC",
    required=True,
    help="Where the picture goes: .png, .svg, .pdf, or .html for a report with the picture in it.",
)
@with_options(
    OPTIONS,
    setting_options({name: PROPAGATE[name] for name in PART}, log="FILE"),
    REFERENCE,
    setting_options(ERROR, log="REF", prefix="(with --reference) "),
    QUIET,
    setting_options(READ_RATES, log="FILE"),
    setting_options(ATTITUDES, log="FILE", signal="attitudes"),
    setting_options(ONE_SERIES, log="REF", signal="attitudes", side="ref"),
)
def command(files: tuple[str, ...], *, quiet: bool, **chosen: Any) -> int:
    """Draw rates or attitudes of each FILE, or its error against a reference, against time.

    A log shows its body rates, an attitude series its angles and its norm error. Gaps are shaded.
    Several files are laid over one another.
    """
    from quatprop.cli.progress import progress
    from quatprop.cli.summary import command_line
    from quatprop.conditioning import Conditioning
    from quatprop.plot.files import View
    from quatprop.plot.run import plot
    from quatprop.settings.selection import RateSelection

    reference = chosen["reference"]
    _refuse_idle(chosen)
    if chosen["components"] and chosen["unwrap"]:
        raise click.UsageError("--unwrap does not go with --components, which have no turns")
    refuse_stdin_twice(*files, reference)
    against = None if reference is None else input_of(reference, chosen, side="ref", drop=True)
    view = View(
        kind=chosen["kind"],
        show=_show(chosen),
        rates=RateSelection.of(chosen),
        attitudes=input_of("", chosen).selection,
        components=chosen["components"],
        unwrap=chosen["unwrap"],
        part=Conditioning(start=chosen["start"], end=chosen["end"]),
    )
    with progress(quiet=quiet):
        lines, warnings, data_lost = plot(
            files,
            chosen["output"],
            view,
            against,
            settings_of(chosen),
            style=_style(chosen),
            command=command_line(),
        )
    if not quiet:
        said = [*lines, *(f"warning: {warning}" for warning in warnings)]
        click.echo("\n".join(map(plain, said)), err=True)
    return 3 if data_lost else 0


def _style(chosen: Mapping[str, Any]) -> Style:
    """Return how large the picture is to be."""
    from quatprop.plot.figure import STYLE, Style

    width, height = chosen["size"] or (STYLE.width, None)
    dpi, font = chosen["dpi"] or STYLE.dpi, chosen["font_size"] or STYLE.font
    return Style(width, height, dpi, font, title=not chosen["no_title"])


def _show(chosen: Mapping[str, Any]) -> Literal["rates", "attitude"] | None:
    """Return what to draw: an option about attitudes asks for attitudes."""
    show: Literal["rates", "attitude"] | None = chosen["show"]
    for name in ("components", "unwrap", *ATTITUDES):
        if chosen[name]:
            if show == "rates":
                raise click.UsageError(f"{option(name)} goes with --show attitude")
            return "attitude"
    return show


def _refuse_idle(chosen: Mapping[str, Any]) -> None:
    """Refuse options that go with others than those that are given."""
    of_error = {option(name) for name in ERROR}
    for parameter in click.get_current_context().command.params:
        name, value = parameter.opts[-1], chosen.get(str(parameter.name))
        if value is None or value is False:
            continue
        if chosen["reference"] is None and (name in of_error or name.endswith("-ref")):
            raise click.UsageError(f"{name} goes with --reference")
        if chosen["reference"] is not None and name in NOT_OF_ERROR:
            raise click.UsageError(f"{name} does not go with --reference, which draws an error")
