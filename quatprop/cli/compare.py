"""``quatprop compare``: the error between two attitude series."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.commands import Command
from quatprop.cli.options import (
    JSON,
    PATH,
    PLOT,
    input_of,
    options_of,
    refuse_stdin_twice,
    with_options,
)
from quatprop.settings.command_options import COMPARE, ComparisonSettings
from quatprop.settings.parsers import Keyword, flag
from quatprop.settings.reading import CHECKS, ONE_SERIES

if TYPE_CHECKING:
    from collections.abc import Mapping


EXAMPLES = (
    "quatprop simulate demo.bag --motion tumbling",
    "quatprop propagate demo.bag -o attitude.csv --method coning",
    "quatprop compare attitude.csv demo.truth.csv --tol 0.05deg",
    "quatprop compare attitude.csv demo.truth.csv --json",
)


OPTIONS = {
    **PLOT,
    **JSON,
    "-q --quiet": Keyword(
        flag, "Print nothing; only set the exit code.", group="Display", common=True),
}  # fmt: skip


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("a", type=PATH, metavar="A")
@click.argument("b", type=PATH, metavar="B")
@with_options(
    options_of(COMPARE, log="B"),
    options_of(CHECKS),
    OPTIONS,
    options_of(ONE_SERIES, log="A", signal="attitudes", side="a"),
    options_of(ONE_SERIES, log="B", signal="attitudes", side="b"),
)
def command(a: str, b: str, *, as_json: bool, quiet: bool, plot: str | None, **chosen: Any) -> int:
    """Measure the geodesic error between two attitude series, A and B.

    Each is a table of attitudes, or a log with such a topic, LOG:TOPIC; both may be in one log.
    q and -q are the same attitude. B is the reference. Exit code 0: all criteria pass (--tol and
    others); 1: one fails; 2: A and B cannot be read or compared; 3: as 0, but some of A or B was
    left out.
    """
    from quatprop.cli.summary import command_line, progress, show
    from quatprop.tools.compared_files import compare_and_draw

    refuse_stdin_twice(a, b)
    side_a, side_b = input_of(a, chosen, side="a"), input_of(b, chosen, side="b")
    with progress(quiet=quiet):
        compared = compare_and_draw(side_a, side_b, settings_of(chosen), plot, command_line())
    if as_json:
        click.echo(json.dumps(compared.report(), indent=2))
    elif not quiet:
        show(compared.lines(), indent=10, err=False)
    if compared.comparison.passed is False:
        return 1
    return 3 if compared.data_lost else 0


def settings_of(chosen: Mapping[str, Any]) -> ComparisonSettings:
    """Return the settings of a comparison, from the options of a command."""
    from quatprop.settings.command_options import comparison_settings

    return comparison_settings(**{name: chosen[name] for name in COMPARE if name in chosen})
