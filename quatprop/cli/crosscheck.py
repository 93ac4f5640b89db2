"""``quatprop crosscheck``: every source of rotation in logs against every other."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.commands import Command
from quatprop.cli.options import JSON, PATH, PLOT, QUIET, options_of, with_options
from quatprop.settings.crosscheck_options import CROSSCHECK, corrections
from quatprop.settings.parsers import Keyword

if TYPE_CHECKING:
    from quatprop.tools.crosscheck.result import CrossCheck

EXAMPLES = (
    "quatprop simulate demo.bag --motion tumbling",
    "quatprop crosscheck demo.bag demo.truth.csv",
    "quatprop crosscheck demo.bag demo.truth.csv --json",
)

REPEATED = {"--correct": Keyword(
    click.STRING, CROSSCHECK["correct"].help, CROSSCHECK["correct"].default,
    CROSSCHECK["correct"].takes, common=True)}  # fmt: skip
WRITTEN = {"--write-config": Keyword(
    PATH, "Write the configuration of propagate that the findings about the gyroscope imply.",
    takes="PATH|-", group="Output")}  # fmt: skip
ONCE = {name: row for name, row in CROSSCHECK.items() if name != "correct"}
ONCE["topic"] = replace(ONCE["topic"], default="all")


GIVEN = "quatprop.crosscheck.given"


class _Repeatable(Command):
    """Keeps what was given besides corrections, for the command line that has all of them."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        given = iter([*args])
        ctx.meta[GIVEN] = [
            word
            for word in given
            if not word.startswith("--correct=") and not (word == "--correct" and next(given, ""))
        ]
        return super().parse_args(ctx, args)


@click.command(cls=_Repeatable, examples=EXAMPLES, no_args_is_help=True)
@click.argument("logs", type=PATH, metavar="LOG...", nargs=-1, required=True)
@with_options(ONCE, options_of(REPEATED, multiple=True), {**PLOT, **WRITTEN, **JSON, **QUIET})
def command(  # noqa: PLR0913  # one keyword for each option
    logs: tuple[str, ...],
    *,
    correct: tuple[str, ...],
    plot: str | None,
    write_config: str | None,
    as_json: bool,
    quiet: bool,
    **chosen: Any,
) -> int:
    """Compare every source of rotation in LOG with every other.

    Every gyroscope and every orientation: topics, odometry, transforms, files. Dead, frozen and
    damaged sources are found, then units, layouts, directions, axes, mountings, clocks, scales and
    biases, each with the option that repairs it; --correct tries it. Findings are beyond 5
    standard deviations and the limits. Exit code 0: consistent; 1: not; 2: nothing is shown of
    some sources or of all, or LOG cannot be read; 3: as 0, but some of LOG was lost or left out.
    """
    from quatprop.base.provenance import as_json as to_json
    from quatprop.base.rendering import loss_lines
    from quatprop.base.text import plain, spelled
    from quatprop.cli.summary import command_line, progress, show
    from quatprop.tools.crosscheck.files import crosscheck_files

    values = {name: value for name, value in chosen.items() if value is not None}
    values["correct"] = corrections(correct)
    with progress(quiet=quiet):
        result = crosscheck_files(logs, values, plot, write_config, command_line())
    if as_json:
        click.echo(json.dumps(to_json(result.report(), spelled), indent=2))
    elif not quiet and write_config != "-":
        lines = [spelled(line) for line in result.lines()]
        show([*lines, *_corrected_command(result)], indent=9, err=False)
    if not quiet:
        remarks = (f"warning: {spelled(one)}" for one in result.remarks)
        for line in (*remarks, *loss_lines(result.losses)):
            click.echo(plain(line), err=True)
    return result.exit_code


def _corrected_command(result: CrossCheck) -> list[str]:
    """Return the command line with all corrections, if there are any."""
    from quatprop.tools.crosscheck.repairs import together

    if not (found := result.settings()):
        return []
    options = [
        part
        for source, settings in together(result.sources, found).items()
        for name, value in settings.items()
        for part in ("--correct", f"{source}:{name.replace('_', '-')}={value}")
    ]
    given: list[str] = click.get_current_context().meta[GIVEN]
    return [f"corrected: {shlex.join(['quatprop', 'crosscheck', *given, *options])}"]
