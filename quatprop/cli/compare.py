"""``quatprop compare``: the error between two attitude series."""

from __future__ import annotations

import json
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.attitude_options import UNSOUND_OPTIONS, attitude_options, attitude_selection
from quatprop.cli.options import plot_option, refuse_stdin_twice, with_options
from quatprop.cli.types import ANGLE, DURATION, TIME_OFFSET

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from quatprop.comparison import Settings
    from quatprop.plot.errors import ErrorPicture
    from quatprop.signals.attitude_input import AttitudeInput


ALIGNMENTS = ("none", "first", "mean", "mount")
"""Those of :mod:`quatprop.comparison.alignment`; spelled out to keep help quick."""

MATCHES = ("exact", "nearest", "interpolate")
"""Those of :mod:`quatprop.comparison.association`."""


@click.command(no_args_is_help=True)
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@click.option(
    "--tol",
    "tolerance",
    type=ANGLE,
    help="Largest error that passes, such as 1e-9rad or 0.1deg; above it the exit code is 1.  "
    "[default: none, all pass]",
)
@click.option(
    "--align",
    type=click.Choice(ALIGNMENTS),
    default="none",
    show_default=True,
    help="What B is turned by first: nothing; the reference frame, by the first pair or by the "
    "mean of all; or reference and body frame (mount), from the motion.",
)
@click.option(
    "--time-offset",
    type=TIME_OFFSET,
    metavar="DUR|auto",
    default=0,
    help="Added to B's stamps, such as -12ms; auto finds it from the angular speeds.  "
    "[default: none]",
)
@click.option(
    "--match",
    type=click.Choice(MATCHES),
    help="Which attitudes belong together: those of equal stamps, the nearest, or interpolated "
    "ones (slerp), at the stamps of the series with the longer intervals.  [default: exact where "
    "at least half have equal stamps, else nearest if there is --max-dt, else interpolate]",
)
@click.option(
    "--max-dt",
    "max_dt_ns",
    type=DURATION,
    help="How far apart samples that belong together, or are interpolated between, may be.  "
    "[default: half the median interval to the nearest, 10 to interpolate]",
)
@click.option(
    "--min-matched",
    type=click.FloatRange(0, 100),
    metavar="PERCENT",
    default=50,
    show_default=True,
    help="Share of the shorter series that must find a partner.",
)
@click.option(
    "--window",
    "window_ns",
    type=DURATION,
    help="Compare also the rotations over windows of this length.  [default: none]",
)
@with_options(UNSOUND_OPTIONS)
@plot_option
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout instead of text.")
@click.option("-q", "--quiet", is_flag=True, help="No figures; the exit code only.")
@with_options(attitude_options("A", "-a"))
@with_options(attitude_options("B", "-b"))
def command(a: str, b: str, as_json: bool, quiet: bool, plot: str | None, **chosen: Any) -> None:
    """Measure the geodesic error between two attitude series, A and B.

    Each is a table of attitudes, or a log with a topic of them: the same log twice, too. q and -q
    are the same attitude. Exit code 0: no error is above --tol; 1: one is; 2: A and B cannot be
    read or compared; 3: as 0, but some of A or B was left out.
    """
    from quatprop import __version__
    from quatprop.cli.comparison_summary import comparison
    from quatprop.comparison import compare
    from quatprop.signals.attitude_input import load_attitudes

    refuse_stdin_twice(a, b)
    unsound = {"drop": chosen.pop("on_invalid") == "drop", "normalize": chosen.pop("normalize")}
    sides = [reading_of(path, side, chosen, unsound) for path, side in ((a, "a"), (b, "b"))]
    with _drawing(plot, a, b) as picture:
        first, second = (load_attitudes(side) for side in sides)
        found = compare(first.series, second.series, settings_of(chosen))
        if picture is not None:
            picture.draw(first, second, found)
    report = {
        "quatprop": __version__,
        "a": first.report(),
        "b": second.report(),
        **found.report(),
    }
    if not quiet:
        click.echo(json.dumps(report, indent=2) if as_json else comparison(report))
    if not found.passed:
        raise click.exceptions.Exit(1)
    if first.data_lost or second.data_lost:
        raise click.exceptions.Exit(3)


def _drawing(plot: str | None, a: str, b: str) -> AbstractContextManager[ErrorPicture | None]:
    """Return the picture of the error in the making; None in it where no picture is wanted."""
    if plot is None:
        return nullcontext()
    from quatprop.plot.errors import ErrorPicture

    return ErrorPicture(plot, [a, b])


def settings_of(chosen: dict[str, Any]) -> Settings:
    """Return how to compare, from the options that are left when both sides have theirs."""
    from quatprop.comparison import Settings

    chosen["min_matched"] /= 100
    return Settings(**chosen)


def reading_of(
    path: str, side: str, chosen: dict[str, Any], unsound: dict[str, bool]
) -> AttitudeInput:
    """Take the options of one side out of a command's."""
    from quatprop.signals.attitude_input import AttitudeInput

    kind = chosen.pop(f"kind_{side}")
    selected = attitude_selection(chosen, f"_{side}")
    return AttitudeInput(path, kind, selected, **unsound, side=side)
