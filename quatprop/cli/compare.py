"""``quatprop compare``: the error between two attitude series."""

from __future__ import annotations

import json
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.attitude_options import UNSOUND_OPTIONS, attitude_options, attitude_selection
from quatprop.cli.options import plot_option, refuse_stdin_twice, with_options
from quatprop.cli.types import ANGLE, DURATION, TIME_OFFSET
from quatprop.comparison.settings import ALIGNMENTS, MATCHES

if TYPE_CHECKING:
    from collections.abc import Mapping
    from contextlib import AbstractContextManager

    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.plot.errors import ErrorPicture
    from quatprop.signals.attitude_input import AttitudeInput


@click.command(no_args_is_help=True)
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@click.option(
    "--tol",
    type=ANGLE,
    help="Largest error that passes, such as 1e-9rad or 0.1deg; above it the exit code is 1.  "
    "[default: none, all pass]",
)
@click.option(
    "--align",
    type=click.Choice(ALIGNMENTS),
    default="none",
    show_default=True,
    help="How B is rotated first: not at all; its reference frame, by the first pair or by the "
    "mean of all; or its reference and body frame (mount), from the motion.",
)
@click.option(
    "--time-offset",
    type=TIME_OFFSET,
    metavar="DUR|auto",
    default=0,
    help="Added to B's stamps, such as -12ms; auto estimates it from the angular speeds.  "
    "[default: none]",
)
@click.option(
    "--match",
    type=click.Choice(MATCHES),
    help="How attitudes are matched: equal stamps, the nearest, or interpolated ones (slerp), at "
    "the stamps of the series with the longer intervals.  [default: exact where "
    "at least half have equal stamps, else nearest if there is --max-dt, else interpolate]",
)
@click.option(
    "--max-dt",
    type=DURATION,
    help="Largest distance in time of samples that are matched or interpolated between.  "
    "[default: half the median interval to the nearest, 10 to interpolate]",
)
@click.option(
    "--min-matched",
    type=click.FloatRange(0, 100),
    metavar="PERCENT",
    default=50,
    show_default=True,
    help="Percentage of the shorter series that must be matched.",
)
@click.option(
    "--window",
    type=DURATION,
    help="Also compare the rotations over windows of this length.  [default: none]",
)
@with_options(UNSOUND_OPTIONS)
@plot_option
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout instead of text.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing; the exit code only.")
@with_options(attitude_options("A", "-a"))
@with_options(attitude_options("B", "-b"))
def command(a: str, b: str, *, as_json: bool, quiet: bool, plot: str | None, **chosen: Any) -> None:
    """Measure the geodesic error between two attitude series, A and B.

    Each is a table of attitudes, or a log with a topic of them: the same log twice, too. q and -q
    are the same attitude. Exit code 0: no error is above --tol; 1: one is; 2: A and B cannot be
    read or compared; 3: as 0, but some of A or B was left out.
    """
    from quatprop import __version__
    from quatprop.cli.spelling import spelled
    from quatprop.comparison.compare import compare
    from quatprop.comparison.summary import comparison_rows
    from quatprop.provenance import as_json as to_json
    from quatprop.rendering import lines_of
    from quatprop.signals.attitude_input import load_attitudes

    refuse_stdin_twice(a, b)
    sides = [input_of(a, "a", chosen), input_of(b, "b", chosen)]
    with _error_picture(plot, a, b) as picture:
        first, second = (load_attitudes(side) for side in sides)
        comparison = compare(first.series, second.series, settings_of(chosen))
        if picture is not None:
            picture.draw(first, second, comparison)
    if as_json:
        report = {
            "quatprop": __version__,
            "a": to_json(first.report()),
            "b": to_json(second.report()),
            **comparison.report(),
        }
        click.echo(json.dumps(report, indent=2))
    elif not quiet:
        rows = comparison_rows(first, second, comparison, spelled)
        click.echo("\n".join(lines_of(rows)))
    if not comparison.passed:
        raise click.exceptions.Exit(1)
    if first.data_lost or second.data_lost:
        raise click.exceptions.Exit(3)


def _error_picture(plot: str | None, a: str, b: str) -> AbstractContextManager[ErrorPicture | None]:
    """Return the picture of the error to be drawn; None in it where no picture is wanted."""
    if plot is None:
        return nullcontext()
    from quatprop.cli.spelling import spelled
    from quatprop.plot.errors import ErrorPicture

    return ErrorPicture(plot, [a, b], spell=spelled)


def settings_of(chosen: Mapping[str, Any]) -> ComparisonSettings:
    """Return how to compare, from the options of a command."""
    from quatprop.comparison.settings import comparison_settings

    return comparison_settings(
        tol=chosen["tol"],
        align=chosen["align"],
        time_offset=chosen["time_offset"],
        match=chosen.get("match"),
        max_dt=chosen["max_dt"],
        min_matched=chosen.get("min_matched"),
        window=chosen.get("window"),
    )


def input_of(path: str, side: str, chosen: Mapping[str, Any]) -> AttitudeInput:
    """Return what to read of one side, from the options of a command."""
    from quatprop.signals.attitude_input import AttitudeInput

    return AttitudeInput(
        path,
        chosen[f"kind_{side}"],
        attitude_selection(chosen, f"_{side}"),
        normalize=chosen["normalize"],
        drop=chosen["on_invalid"] == "drop",
        side=side,
    )
