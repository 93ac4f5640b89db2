"""``quatprop info``: what logs hold."""

from __future__ import annotations

import json
from typing import Any

import click

from quatprop.cli.options import SELECTION_OPTIONS, selection, with_options
from quatprop.cli.spelling import sentence, spelled
from quatprop.containers.base import Loss
from quatprop.provenance import as_json as to_json
from quatprop.rendering import loss_lines
from quatprop.text import plain

TIMED = {
    "source": "source",
    "type": "type",
    "samples": "samples",
    "rate_hz": "Hz",
    "span_s": "span s",
    "gaps": "gaps",
    "duplicates": "dup",
    "backwards": "back",
}
"""Key of a source's facts -> heading in a table."""

COLUMNS = {
    "sources": {**TIMED, "max_rate_rad_s": "max rad/s"},
    "attitudes": {**TIMED, "source": "attitudes", "no_rotation": "bad", "layout": "layout"},
}
"""What is shown of rates and of attitudes."""

NUMBERS_FROM = 2
"""Columns from here on are numbers and aligned to the right."""


@click.command(no_args_is_help=True)
@click.argument("logs", metavar="LOG...", nargs=-1, required=True)
@click.option("--json", "as_json", is_flag=True, help="JSON on stdout instead of a table.")
@with_options(SELECTION_OPTIONS)
def command(logs: tuple[str, ...], as_json: bool, **chosen: Any) -> None:
    """Show every source of body rates and of attitudes in each LOG.

    For every topic or set of columns: its type, samples, sample rate, span, gaps (longer than 10
    median intervals), repeated and non-monotonic timestamps; of rates the largest, of attitudes
    how many rows are no rotation, and the layout. What is missing to read a source is said with
    the option that says it.
    """
    from quatprop.errors import QuatpropError
    from quatprop.pipeline.survey import survey

    kind = chosen.pop("kind")
    wanted = selection(chosen)
    surveys: list[dict[str, Any]] = []
    unusable = 0
    for path in logs:
        try:
            surveys.append(survey(path, kind, wanted))
        except QuatpropError as error:
            unusable += 1
            click.echo(f"Error: {sentence(error)}", err=True)
    if as_json:
        click.echo(json.dumps(to_json(surveys), indent=2))
    else:
        click.echo("\n\n".join(_described(facts) for facts in surveys), nl=bool(surveys))
    if unusable:
        raise click.exceptions.Exit(2)
    if any(facts["losses"] for facts in surveys):
        raise click.exceptions.Exit(3)


def _described(facts: dict[str, Any]) -> str:
    """Return the tables of one log, and what is to be remarked on."""
    lines = [f"{plain(facts['path'])} ({facts['kind']})"]
    for kind, columns in COLUMNS.items():
        if facts[kind]:
            lines += _table(facts[kind], columns)
    for source in (*facts["sources"], *facts["attitudes"]):
        name = _cell(source["source"])
        if source["missing"]:
            lines.append(f"  {name}: {spelled(source['missing'])}")
        lines += [f"  {name}: {spelled(text)}" for text in source["remarks"]]
    lines += [f"  {line}" for line in loss_lines([Loss(**loss) for loss in facts["losses"]])]
    return "\n".join(lines)


def _table(sources: list[dict[str, Any]], columns: dict[str, str]) -> list[str]:
    rows = [list(columns.values())]
    rows += [[_cell(source[key]) for key in columns] for source in sources]
    widths = [max(len(row[column]) for row in rows) for column in range(len(columns))]
    return [
        "  "
        + "  ".join(
            cell.rjust(width) if column >= NUMBERS_FROM else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else plain(value)
