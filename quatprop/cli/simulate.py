"""``quatprop simulate``: a log with a known true attitude."""

from __future__ import annotations

from typing import Any

import click

from quatprop.cli.commands import Command
from quatprop.cli.options import PATH, options_of, with_options
from quatprop.settings.parsers import Keyword, flag
from quatprop.tools.simulation_options import LOG_FORMAT, SIMULATE

EXAMPLES = (
    "quatprop simulate spin.csv --frequency 0.25",
    "quatprop simulate coning.mcap --motion coning --rate 200 --duration 1m",
    "quatprop simulate rest.bag --motion rest --noise 1e-4 --bias 0.01,0,0",
)


LOG = {
    **LOG_FORMAT,
    "--truth": Keyword(
        PATH, "Where the true attitudes go, or 'none'.",
        "OUT's name with .truth.csv, or .truth.parquet for Parquet; none for -", "PATH"),
}  # fmt: skip
QUIET = {"-q --quiet": Keyword(flag, "Say nothing.", "a line on stderr")}


@click.command(
    cls=Command,
    examples=EXAMPLES,
    grouped=False,
    short_help="Write a log whose true attitude is known.",
    epilog="Rates are in rad/s, body frame.",
)
@click.argument("out", type=PATH)
@with_options(LOG, options_of(SIMULATE), QUIET)
def command(out: str, **options: Any) -> None:
    """Write a log of a known motion to OUT, and the true attitudes next to it.

    The same options give the same bytes.
    """
    from quatprop.base.rendering import count_text
    from quatprop.cli.summary import progress
    from quatprop.tools.simulation import simulate, truth_path
    from quatprop.tools.simulation_options import simulated

    motion, shape, gyroscope, q0 = simulated({name: options[name] for name in SIMULATE})
    truth = options["truth"] or truth_path(out, options["kind"])
    truth = None if truth == "none" else truth
    with progress(quiet=options["quiet"]):
        simulate(
            out,
            motion,
            shape,
            gyroscope,
            q0=q0,
            kind=options["kind"],
            compression=options["compression"],
            truth=truth,
        )
    if not options["quiet"]:
        truth_text = f"; the truth is in {truth}" if truth else ""
        click.echo(
            f"{out}: {count_text(gyroscope.samples, 'sample')} of {motion}{truth_text}", err=True
        )
