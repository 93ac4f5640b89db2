"""``quatprop info``: the contents of logs."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from quatprop.base.provenance import as_json as to_json
from quatprop.base.rendering import aligned, loss_lines
from quatprop.base.text import plain, spelled
from quatprop.cli.commands import Command
from quatprop.cli.options import PATH, options_of, with_options
from quatprop.settings.parsers import Keyword, flag
from quatprop.settings.reading import READ_RATES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from quatprop.propagation.survey import AttitudeSurvey, LogSurvey, SignalSurvey

NUMBERS_FROM = 2
"""Columns from this index on are numbers, and right-aligned."""


EXAMPLES = (
    "quatprop simulate demo.bag --motion tumbling",
    "quatprop info demo.bag",
    "quatprop info --json demo.bag demo.truth.csv",
    "quatprop propagate demo.bag -o attitude.parquet --method mean",
    "quatprop info attitude.parquet --as-config",
)


OPTIONS = {
    "--json as_json": Keyword(
        flag, "JSON on stdout instead of a table.", group="Display", common=True),
    "--as-config": Keyword(
        flag, "Print the options that LOG, an output of propagate, was made with, as a file "
        "for propagate --config, which makes it again.", group="Display", common=True),
}  # fmt: skip


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("logs", type=PATH, metavar="LOG...", nargs=-1, required=True)
@with_options(
    OPTIONS,
    options_of({**READ_RATES, "topic": replace(READ_RATES["topic"], default="all")}),
)
def command(logs: tuple[str, ...], as_json: bool, as_config: bool, **chosen: Any) -> int:
    """Show every source of body rates and of attitudes in each LOG.

    For every topic or set of columns: its type, samples, sample rate, span, gaps (longer than 10
    median intervals), repeated and non-monotonic timestamps; of rates the largest, of attitudes
    how many rows are invalid, and the layout. Where a source cannot be read without an option, that
    option is named. LOG:TOPIC shows one topic.
    """
    from quatprop.base.errors import QuatpropError
    from quatprop.cli.summary import progress
    from quatprop.propagation.configuration import config_of
    from quatprop.propagation.survey import provenance_of, survey
    from quatprop.settings.reading import RateSelection

    kind = chosen.pop("kind")
    wanted = RateSelection(**chosen)
    if as_config:
        if len(logs) > 1 or as_json:
            raise click.UsageError("--as-config prints one file for one LOG")
        made = config_of(logs[0], provenance_of(logs[0], kind, wanted))
        for sentence in made.changed:
            click.echo(f"Warning: {sentence}", err=True)
        click.echo(made.text)
        return 0
    surveys: list[LogSurvey] = []
    for name in logs:
        try:
            with progress():
                surveys.append(survey(name, kind, wanted))
        except QuatpropError as error:
            click.echo(f"Error: {error}", err=True)
    if as_json:
        click.echo(json.dumps(to_json(surveys), indent=2))
    else:
        click.echo("\n\n".join("\n".join(_lines(log)) for log in surveys), nl=bool(surveys))
    if len(surveys) < len(logs):
        return 2
    return 3 if any(log.losses for log in surveys) else 0


def _lines(log: LogSurvey) -> Iterator[str]:
    """Yield the tables of a log, and the remarks on it."""
    from quatprop.propagation.survey import ATTITUDE_COLUMNS, RATE_COLUMNS, cell_text

    yield f"{plain(log.path)} ({log.kind})"
    if log.sources:
        yield from _table(log.sources, RATE_COLUMNS)
    if log.attitudes:
        yield from _table(log.attitudes, ATTITUDE_COLUMNS)
    own = (one for one in log.attitudes if one.invalid != one.samples)
    names = [one.source for one in (*log.sources, *own) if one.samples]
    if len(set(names)) > 1:
        yield f"  {len(names)} sources of rotation: crosscheck compares each with every other"
    yield from (
        f"  {cell_text(one.source)}: {made}" for one in log.attitudes if (made := _making(one))
    )
    for signal in (*log.sources, *log.attitudes):
        side = "info" if signal in log.attitudes else ""
        yield from (f"  {cell_text(signal.source)}: {spelled(note, side)}" for note in signal.notes)
    yield from (f"  {line}" for line in loss_lines(log.losses))


def _table(signals: Sequence[SignalSurvey], columns: Mapping[str, str]) -> Iterator[str]:
    rows = [list(columns.values())]
    rows += [signal.cells(columns) for signal in signals]
    yield from (f"  {line}" for line in aligned(rows, NUMBERS_FROM))


def _making(attitudes: AttitudeSurvey) -> str:
    """Return a text on the provenance of attitudes; ``""``: unknown."""
    facts = []
    if attitudes.made_from is not None:
        facts.append(f"from {plain(attitudes.made_from)}")
    if attitudes.method is not None:
        facts.append(f"method {plain(attitudes.method)}")
    if attitudes.q0_wxyz is not None:
        facts.append(f"q0 {','.join(f'{x:.9g}' for x in attitudes.q0_wxyz)} (wxyz)")
    if facts:
        facts.append(f"stored as {attitudes.convention} {attitudes.direction}")
    return ", ".join(facts)
