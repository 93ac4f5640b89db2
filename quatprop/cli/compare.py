"""``quatprop compare``: the error between two attitude series."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, TypeVar

import click

from quatprop.cli.options import KINDS, Duration, ParamType

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.signals.operands import Reading

Command = TypeVar("Command", bound="Callable[..., Any]")

ALIGNMENTS = ("none", "first", "mean", "mount")
"""Those of :mod:`quatprop.compare.alignment`; spelled out to keep help quick."""

MATCHES = ("exact", "nearest", "interpolate")
"""Those of :mod:`quatprop.compare.association`."""


class Angle(ParamType):
    """An angle with its unit, in rad."""

    name = "ANGLE"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the angle in rad."""
        from quatprop.compare import angle_rad
        from quatprop.errors import UsageError

        if isinstance(value, float):
            return value
        try:
            return angle_rad(value)
        except UsageError as error:
            self.fail(str(error), param, ctx)


class TimeOffset(Duration):
    """A signed duration in ns, or ``auto``."""

    name = "DUR|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return ns, or ``"auto"``."""
        if value == "auto" or isinstance(value, int):
            return value
        sign = -1 if value.startswith("-") else 1
        return sign * super().convert(value.lstrip("+-"), param, ctx)


def _four_columns(
    _context: click.Context, option: click.Parameter, text: str | None
) -> tuple[str, ...] | None:
    if text is None:
        return None
    parts = tuple(part.strip() for part in text.split(","))
    if len(parts) != len("wxyz") or not all(parts):
        raise click.BadParameter(f"{text!r} does not name four columns A,B,C,D", param=option)
    return parts


SIDE_OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "kind": ("from", {"type": click.Choice(KINDS), "help": "Kind of {side}.  [default: told]"}),
    "topic": (
        "topic",
        {"metavar": "NAME", "help": "Topic of {side}.  [default: the only one with attitudes]"},
    ),
    "quat_field": (
        "quat-field",
        {"metavar": "A.B.C", "help": "Message field of {side}.  [default: known from its type]"},
    ),
    "quat_cols": (
        "quat-cols",
        {
            "metavar": "A,B,C,D",
            "callback": _four_columns,
            "help": "Columns of {side} as stored, by name or number.  [default: by the header]",
        },
    ),
    "frame": (
        "frame",
        {
            "metavar": "[PARENT:]CHILD",
            "help": "Transform of {side}, of a list of them.  [default: the only one]",
        },
    ),
    "layout": (
        "from-layout",
        {
            "type": click.Choice(("scalar-first", "scalar-last", "wxyz", "xyzw")),
            "help": "Order of the numbers of {side}.  [default: as names or metadata say]",
        },
    ),
    "convention": (
        "from-convention",
        {
            "type": click.Choice(("hamilton", "jpl")),
            "help": "Convention of {side}.  [default: as metadata say, or hamilton]",
        },
    ),
    "direction": (
        "from-direction",
        {
            "type": click.Choice(("body-to-ref", "ref-to-body")),
            "help": "Direction of {side}.  [default: as metadata say, or body-to-ref]",
        },
    ),
    "clock": (
        "clock",
        {
            "type": click.Choice(("header", "log", "publish")),
            "help": "Whose stamps of {side}.  [default: header where there is one, else log]",
        },
    ),
    "time_field": (
        "time-field",
        {"metavar": "A.B", "help": "Message field of the time of {side}.  [default: the header]"},
    ),
    "time_col": (
        "time-col",
        {"metavar": "C", "help": "Time column of {side}.  [default: by the header]"},
    ),
    "time_unit": (
        "time-unit",
        {
            "type": click.Choice(("s", "ms", "us", "ns")),
            "help": "Unit of the time of {side}.  [default: as the log says]",
        },
    ),
    "sample_rate": (
        "sample-rate",
        {
            "type": click.FloatRange(min=0, min_open=True),
            "metavar": "HZ",
            "help": "Rows a second of {side}, a table without a time.  [default: none]",
        },
    ),
}
"""What to read of each side: keyword -> name of the option, to which -a or -b is added."""


def _side_options(command: Command) -> Command:
    for side in ("b", "a"):
        for key, (name, facts) in reversed(SIDE_OPTIONS.items()):
            said = {**facts, "help": facts["help"].format(side=side.upper())}
            command = click.option(f"--{name}-{side}", f"{key}_{side}", **said)(command)
    return command


@click.command(no_args_is_help=True)
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@click.option(
    "--tol",
    "tolerance",
    type=Angle(),
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
    type=TimeOffset(),
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
    type=Duration(),
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
    type=Duration(),
    help="Compare also the rotations over windows of this length.  [default: none]",
)
@click.option(
    "--on-invalid",
    type=click.Choice(("error", "drop")),
    default="error",
    show_default=True,
    help="Rows that are no rotation (zero, NaN, not of unit length): refuse, or leave out.",
)
@click.option("--normalize", is_flag=True, help="Scale quaternions of any length to unit length.")
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout instead of text.")
@click.option("-q", "--quiet", is_flag=True, help="No figures; the exit code only.")
@_side_options
def command(a: str, b: str, as_json: bool, quiet: bool, **chosen: Any) -> None:
    """Measure the geodesic error between two attitude series, A and B.

    Each is a table of attitudes, or a log with a topic of them: the same log twice, too. q and -q
    are the same attitude. Exit code 0: no error is above --tol; 1: one is; 2: A and B cannot be
    read or compared; 3: as 0, but some of A or B was left out.
    """
    from quatprop import __version__
    from quatprop.cli.comparison_words import comparison
    from quatprop.compare import Settings, compare
    from quatprop.signals.operands import read_operand

    unsound = {"drop": chosen.pop("on_invalid") == "drop", "normalize": chosen.pop("normalize")}
    first, second = (
        read_operand(_reading(path, side, chosen, unsound)) for path, side in ((a, "a"), (b, "b"))
    )
    chosen["min_matched"] /= 100
    found = compare(first.series, second.series, Settings(**chosen))
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


def _reading(path: str, side: str, chosen: dict[str, Any], unsound: dict[str, bool]) -> Reading:
    """Take the options of one side out of a command's."""
    from quatprop.selection import Selection
    from quatprop.signals.attitudes import AttitudeSelection
    from quatprop.signals.operands import Reading

    said = {key: chosen.pop(f"{key}_{side}") for key in SIDE_OPTIONS}
    kind = said.pop("kind")
    samples = ("topic", "clock", "time_field", "time_col", "time_unit", "sample_rate")
    selection = AttitudeSelection(Selection(**{key: said.pop(key) for key in samples}), **said)
    return Reading(path, kind, selection, **unsound)
