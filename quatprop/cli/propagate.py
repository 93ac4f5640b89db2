"""``quatprop propagate``: propagate a log."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quatprop.base.places import is_address
from quatprop.base.text import plain
from quatprop.cli.commands import Command
from quatprop.cli.options import (
    PATH,
    PLOT,
    QUIET,
    REPORT,
    TEXTS,
    config_option,
    options_of,
    with_options,
)
from quatprop.propagation.output_options import OUTPUT_OPTIONS, output_settings
from quatprop.settings import PROPAGATE
from quatprop.settings.parsers import Keyword, flag

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.propagation.attitude_stream import Observer
    from quatprop.propagation.job import Job

EXAMPLES = (
    "quatprop simulate demo.bag --motion tumbling",
    "quatprop propagate demo.bag -o attitude.csv --method coning",
    "quatprop propagate demo.bag -o attitude.mcap --start +1s",
    "quatprop propagate demo.bag -o - --rate 10",
)


OUT = {
    "-o --output": Keyword(
        PATH, "Where the attitudes go; - is stdout.", "none, required", "PATH|-",
        group="Output", common=True),
}  # fmt: skip
VERBOSE = {
    "-v --verbose": Keyword(
        flag, "A longer summary: conventions, policies, timings.", group="Display"),
}  # fmt: skip


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("logs", type=PATH, metavar="LOG...", nargs=-1, required=True)
@with_options(
    OUT,
    OUTPUT_OPTIONS,
    options_of(PROPAGATE),
    [config_option],
    {**REPORT, **PLOT, **QUIET, **VERBOSE},
)
def command(*, quiet: bool, verbose: bool, plot: str | None, **chosen: Any) -> int:
    """Turn the body rates of LOG into its attitude series.

    LOG is an MCAP file, a ROS 1 or ROS 2 bag, a ULog, a table (CSV, Parquet and others), or - for
    stdin; LOG:TOPIC names a topic of it. Several files of one recording are read as one log, in the
    order of their times. N samples give N attitudes, which go to a file of their own (-o).
    """
    from quatprop.cli.summary import INDENT, command_line, progress, show, summary
    from quatprop.propagation.job import run

    job = job_of(chosen)
    observer: Observer | None = None
    with progress(quiet=quiet), ExitStack() as stack:
        if plot is not None:
            from quatprop.tools.plot.contents import PropagationPicture

            drawing = PropagationPicture(plot, job, command=command_line())
            observer = stack.enter_context(drawing)
        report = run(job, observer, summary=not quiet)
    if not quiet:
        show(summary(report, verbose=verbose), INDENT)
    return 3 if report.data_lost else 0


def job_of(chosen: Mapping[str, Any], folder: Path | None = None) -> Job:
    """Return the job of the options; `folder`: to which paths are relative, if given."""
    from quatprop.propagation.job import Job

    if chosen["output"] is None:
        *logs, last = chosen["logs"]
        is_meant = bool(logs) and not is_address(last) and not Path(last).exists()
        raise click.UsageError(f"name the output: -o {plain(last) if is_meant else 'OUT'}")
    texts = click.get_current_context().meta.get(TEXTS, {})
    values = {name: texts.get(name, chosen.get(name)) for name in PROPAGATE}
    return Job.of(chosen["logs"], values, output_settings(chosen), folder)
