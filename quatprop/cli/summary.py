"""The summary of a run, on stderr."""

from __future__ import annotations

import json
import shlex
import sys
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from quatprop.base.places import is_stdout, without_secret
from quatprop.base.progress import SHOW
from quatprop.base.provenance import as_json as to_json
from quatprop.base.rendering import lines_of, loss_lines
from quatprop.base.text import plain, spelled
from quatprop.propagation.report import conventions, facts

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from tqdm import tqdm

    from quatprop.base.errors import Loss
    from quatprop.base.rendering import Row
    from quatprop.base.text import Remark
    from quatprop.propagation.report import RunReport


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


# Progress bars on a terminal.


DELAY_S = 0.5
"""Minimum duration for which a bar is shown, s."""


@contextmanager
def progress(*, quiet: bool = False) -> Iterator[None]:
    """Show progress in this block, if stderr is a terminal."""
    token = SHOW.set(_shown if on_terminal(quiet=quiet) else None)
    try:
        yield
    finally:
        SHOW.reset(token)


def on_terminal(*, quiet: bool = False) -> bool:
    """Return whether stderr is a terminal, and progress is not turned off."""
    # A process may have no stderr.
    return sys.stderr is not None and sys.stderr.isatty() and not quiet


def bar(total: int | None, unit: str, **options: Any) -> tqdm[Any]:
    """Return a progress bar on stderr, which disappears when closed."""
    from tqdm import tqdm

    # Its monitor thread would exist when processes are forked.
    tqdm.monitor_interval = 0
    # Its own lock is one of processes, which one that is killed leaves behind.
    tqdm.set_lock(threading.RLock())
    return tqdm(total=total, unit=unit, leave=False, dynamic_ncols=True, **options)


def _shown(batches: Iterator[Any], total: int | None) -> Iterator[Any]:
    began, done, shown = time.time(), 0, None
    try:
        for batch in batches:
            yield batch
            done += len(batch)
            if shown is None and time.time() - began > DELAY_S:
                shown = bar(total, " samples", unit_scale=True)
            if shown is not None:
                shown.update(done - shown.n)
    finally:
        if shown is not None:
            shown.close()
