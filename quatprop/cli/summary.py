"""The summary of a run, on stderr."""

from __future__ import annotations

import shlex
import sys
from typing import TYPE_CHECKING

import click

from quatprop.pipeline.summary import conventions, facts
from quatprop.rendering import lines_of, loss_lines
from quatprop.stores.objects import without_secret
from quatprop.text import spelled

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.pipeline.report import RunReport


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


def command_line() -> str:
    """Return the current command line, quoted for a shell."""
    return shlex.join(["quatprop", *map(without_secret, sys.argv[1:])])
