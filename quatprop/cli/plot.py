"""``quatprop plot``: pictures of rates, attitudes and errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from quatprop.base.text import plain
from quatprop.cli.commands import Command, GroupedOption
from quatprop.cli.compare import settings_of
from quatprop.cli.options import PATH, QUIET, input_of, options_of, refuse_stdin_twice, with_options
from quatprop.settings import PROPAGATE, option
from quatprop.settings.command_options import COMPARE
from quatprop.settings.parsers import Choice, Keyword, flag
from quatprop.settings.quantities import picture_size
from quatprop.settings.reading import ONE_SERIES, READ_RATES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.tools.plot.figure import Style

ATTITUDES = {name: parser for name, parser in ONE_SERIES.items() if name not in READ_RATES}
"""Settings for attitudes only."""

PART = ("start", "end")
NOT_OF_ERROR = {"--show", "--components", "--unwrap"}
OF_ERROR = {name: row for name, row in COMPARE.items() if name not in PART}


EXAMPLES = (
    "quatprop simulate demo.bag --motion tumbling",
    "quatprop plot demo.bag -o rates.png",
    "quatprop propagate demo.bag -o attitude.csv --method coning",
    "quatprop plot attitude.csv demo.truth.csv -o attitudes.svg",
    "quatprop plot attitude.csv --reference demo.truth.csv -o e.png",
)


OPTIONS = {
    "--show": Keyword(
        Choice("rates", "attitude"), "The quantity to draw.",
        "rates if there are any, unless an option selects attitudes", group="Options"),
    "--components": Keyword(
        flag, "Draw the four components of the quaternion.", "yaw, pitch and roll",
        group="Options"),
    "--unwrap": Keyword(
        flag, "Draw yaw and roll without jumps at half a turn.", "from -180 to 180 deg",
        group="Options"),
    "--size": Keyword(
        picture_size, "Size of the picture, such as 90mm, 16x9cm or 3.5in.", "7.5in wide",
        "W[xH]UNIT", group="Options"),
    "--dpi": Keyword(
        click.IntRange(min=10, max=2400), "Dots per inch of a PNG.", "200", "N", group="Output"),
    "--font-size": Keyword(
        click.FloatRange(min=2, max=72), "Size of the letters in points.", "8.5", "PT",
        group="Output"),
    "--style": Keyword(
        PATH, "Style sheet of matplotlib, for fonts, axes and grid of a picture.", takes="FILE",
        group="Output"),
    "--no-title": Keyword(flag, "Omit the lines above and below the panels.", group="Options"),
}  # fmt: skip
REFERENCE = {
    "--reference": Keyword(
        PATH,
        "Plot the geodesic error of each FILE relative to this attitude series; holds both in "
        "memory.", "what is in FILE", "REF", group="Options"),
}  # fmt: skip


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("files", type=PATH, metavar="FILE...", nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    type=PATH,
    metavar="PIC",
    required=True,
    cls=GroupedOption,
    group="Output",
    common=True,
    help="Where the picture goes: .png, .svg, .pdf, or .html for a report with the picture in it.",
)
@with_options(
    OPTIONS,
    options_of({name: PROPAGATE[name] for name in PART}, log="FILE"),
    REFERENCE,
    options_of(OF_ERROR, log="REF", prefix="(with --reference) "),
    QUIET,
    options_of(READ_RATES, log="FILE"),
    options_of(ATTITUDES, log="FILE", signal="attitudes"),
    options_of(ONE_SERIES, log="REF", signal="attitudes", side="ref"),
)
def command(files: tuple[str, ...], *, quiet: bool, **chosen: Any) -> int:
    """Draw rates or attitudes of each FILE, or its error against a reference, against time.

    A log shows its body rates, an attitude series its angles and its norm error. Gaps are shaded.
    Several files, or topics (FILE:TOPIC), are laid over one another.
    """
    from quatprop.cli.summary import command_line, progress
    from quatprop.tools.plot.plotting import View, plot

    reference = chosen["reference"]
    _refuse_idle(chosen)
    refuse_stdin_twice(*files, reference)
    against = None if reference is None else input_of(reference, chosen, side="ref", drop=True)
    with progress(quiet=quiet):
        lines, page, inputs_read = plot(
            files,
            View.from_settings(chosen),
            chosen["output"],
            against,
            settings_of(chosen),
            style=_style(chosen),
            command=command_line(),
        )
    if not quiet:
        shown = [*lines, *(f"warning: {warning}" for warning in page.warnings)]
        click.echo("\n".join(map(plain, shown)), err=True)
    return 3 if any(one.data_lost for one in inputs_read) else 0


def _style(chosen: Mapping[str, Any]) -> Style:
    """Return the size and style of the picture."""
    from quatprop.tools.plot.figure import STYLE, Style, style_sheet

    width, height = chosen["size"] or (STYLE.width, None)
    sheet = style_sheet(chosen["style"]) if chosen["style"] else {}
    dpi = chosen["dpi"] or STYLE.dpi
    font = chosen["font_size"] or sheet.get("font.size", STYLE.font)
    return Style(width, height, dpi, font, title=not chosen["no_title"], sheet=sheet)


def _refuse_idle(chosen: Mapping[str, Any]) -> None:
    """Refuse options without effect."""
    of_error = {option(name) for name in OF_ERROR}
    for parameter in click.get_current_context().command.params:
        name, value = parameter.opts[-1], chosen.get(str(parameter.name))
        if value is None or value is False:
            continue
        if chosen["reference"] is None and (name in of_error or name.endswith("-ref")):
            raise click.UsageError(f"{name} requires --reference")
        if chosen["reference"] is not None and name in NOT_OF_ERROR:
            raise click.UsageError(
                f"{name} cannot be combined with --reference, which draws an error"
            )
