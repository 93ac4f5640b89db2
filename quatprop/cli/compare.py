"""``quatprop compare``: the error between two attitude series."""

from __future__ import annotations

import json
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import click

from quatprop.base.text import spelled
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
    from quatprop.base import __version__
    from quatprop.base.provenance import as_json as to_json
    from quatprop.base.rendering import lines_of
    from quatprop.cli.summary import command_line, progress, show
    from quatprop.comparison.file_comparison import compare_files
    from quatprop.comparison.result import comparison_rows

    refuse_stdin_twice(a, b)
    side_a, side_b = input_of(a, chosen, side="a"), input_of(b, chosen, side="b")
    picture = None
    with progress(quiet=quiet), ExitStack() as stack:
        if plot is not None:
            from quatprop.tools.plot.contents import pair_page
            from quatprop.tools.plot.page import PictureFile

            paths = side_a.path, side_b.path
            picture = stack.enter_context(PictureFile(plot, paths, command=command_line()))
        first, second, comparison = compare_files(
            side_a, side_b, settings_of(chosen), keep=plot is not None
        )
        if picture is not None:
            picture.commit(pair_page(first, second, comparison))
    if as_json:
        report = {
            "quatprop": __version__,
            "a": to_json(first.report(), spelled),
            "b": to_json(second.report(), spelled),
            **to_json(comparison, spelled),
        }
        click.echo(json.dumps(report, indent=2))
    elif not quiet:
        rows = comparison_rows(first, second, comparison)
        show(lines_of(rows), indent=10, err=False)
    if comparison.passed is False:
        return 1
    return 3 if first.data_lost or second.data_lost or comparison.left_out else 0


def settings_of(chosen: Mapping[str, Any]) -> ComparisonSettings:
    """Return the settings of a comparison, from the options of a command."""
    from quatprop.settings.command_options import comparison_settings

    return comparison_settings(**{name: chosen[name] for name in COMPARE if name in chosen})
