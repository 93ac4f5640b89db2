"""The summary of a run, on stderr."""

from __future__ import annotations

import json
import shlex
import sys
from typing import TYPE_CHECKING

import click

from quatprop.pipeline.summary import conventions, facts
from quatprop.provenance import as_json as to_json
from quatprop.rendering import lines_of, loss_lines
from quatprop.stores.objects import without_secret
from quatprop.text import plain, spelled
from quatprop.writers.targets import is_stdout

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from quatprop.pipeline.report import RunReport
    from quatprop.rendering import Row
    from quatprop.tables.log import Loss
    from quatprop.text import Remark


INDENT = 12
"""Width of the labels in a summary."""


def show(lines: Iterable[str], indent: int = 2, *, err: bool = True) -> None:
    """Print lines; on a terminal, long lines are wrapped and indented."""
    stream = sys.stderr if err else sys.stdout
    if stream is not None and stream.isatty():
        from shutil import get_terminal_size
        from textwrap import TextWrapper

        wrapper = TextWrapper(
            width=get_terminal_size().columns,
            subsequent_indent=" " * indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
        lines = [wrapper.fill(line) for line in lines]
    click.echo("\n".join(lines), err=err)


def summary(report: RunReport, *, verbose: bool) -> list[str]:
    """Return the lines of the summary of a run."""
    rows = [*facts(report), *(conventions(report) if verbose else ())]
    if verbose and report.seconds is not None:
        rows.append(("seconds", f"{report.seconds:.3f}"))
    lines = lines_of(rows, width=INDENT - 1)
    lines += [f"warning: {spelled(remark)}" for remark in report.remarks]
    return lines + loss_lines(report.losses)


def show_result(  # noqa: PLR0913  # a result, how to show it, and what was lost
    result: object,
    rows: Iterable[Row],
    width: int,
    remarks: Iterable[Remark],
    losses: Sequence[Loss],
    *,
    as_json: bool,
    quiet: bool,
    output: str | None,
) -> None:
    """Print a result on stdout, unless a file goes there, and warnings on stderr."""
    if as_json:
        click.echo(json.dumps(to_json(result, spelled), indent=2))
    elif not (quiet or (output is not None and is_stdout(output))):
        show(lines_of(rows, width), width + 1, err=False)
    if not quiet:
        for line in (*(f"warning: {spelled(one)}" for one in remarks), *loss_lines(losses)):
            click.echo(plain(line), err=True)


def command_line() -> str:
    """Return the current command line, quoted for a shell."""
    return shlex.join(["quatprop", *map(without_secret, sys.argv[1:])])
