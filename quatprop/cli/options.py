"""Options that several commands share: each is defined once and means the same everywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import click

from quatprop.cli.types import Parsed
from quatprop.settings import CLOCKS, KINDS, RATE_UNITS, SELECT_RATES, TIME_UNITS

Command = TypeVar("Command", bound="Callable[..., Any]")

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from quatprop.selection import RateSelection

    class Option(Protocol):
        """Gives a command an option."""

        def __call__(self, command: Command, /) -> Command:
            """Return the command with the option."""


kind_option = click.option(
    "--from",
    "kind",
    type=click.Choice(KINDS),
    help="Kind of the log.  [default: told by its content, then by its suffix]",
)

SELECTION_OPTIONS = (
    kind_option,
    click.option(
        "-t",
        "--topic",
        metavar="NAME",
        help="Topic to read.  [default: the only one that has rates]",
    ),
    click.option(
        "--rate-field",
        metavar="A.B.C",
        help="Field of the message that is the rate.  [default: known from its type]",
    ),
    click.option(
        "--time-field",
        metavar="A.B",
        help="Field of the message that is the time.  [default: the header stamp]",
    ),
    click.option(
        "--rate-cols",
        type=Parsed(SELECT_RATES["rate_cols"], "X,Y,Z"),
        help="Rate columns of a table, by name or number from 0.  [default: by the header]",
    ),
    click.option(
        "--time-col",
        metavar="C",
        help="Time column of a table, by name or number from 0.  [default: by the header]",
    ),
    click.option(
        "--rate-unit",
        type=click.Choice(RATE_UNITS),
        help="Unit of the rates.  [default: as the log says]",
    ),
    click.option(
        "--time-unit",
        type=click.Choice(TIME_UNITS),
        help="Unit of the time.  [default: as the log says]",
    ),
    click.option(
        "--sample-rate",
        type=Parsed(SELECT_RATES["sample_rate"], "HZ"),
        help="Samples a second of a table without a time.  [default: none]",
    ),
    click.option(
        "--clock",
        type=click.Choice(CLOCKS),
        help="Timestamp source.  [default: header where the message has one, else log]",
    ),
)

report_option = click.option(
    "--report",
    metavar="PATH|-",
    help="Write a JSON report: source, conventions, counts, policies, version.  [default: none]",
)
plot_option = click.option(
    "--plot",
    metavar="PIC",
    help="Draw a picture: .png, .svg, .pdf, or .html for a report with the picture in it.  "
    "[default: none]",
)
quiet_option = click.option("-q", "--quiet", is_flag=True, help="No summary; errors only.")


def with_options(options: Iterable[Option]) -> Callable[[Command], Command]:
    """Return a decorator that gives a command these options, in this order."""

    def decorated(command: Command) -> Command:
        for option in reversed(tuple(options)):
            command = option(command)
        return command

    return decorated


def refuse_stdin_twice(*paths: str | None) -> None:
    """Refuse to read several series from stdin: what is read first leaves nothing."""
    if paths.count("-") > 1:
        raise click.UsageError("stdin can be read only once; name files for the others")


def selection(chosen: dict[str, Any]) -> RateSelection:
    """Take the selection's keywords out of a command's options."""
    from dataclasses import fields

    from quatprop.selection import RateSelection

    return RateSelection(**{field.name: chosen.pop(field.name) for field in fields(RateSelection)})
