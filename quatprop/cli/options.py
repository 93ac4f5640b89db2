"""Create options from their keywords: help text, default, and parser.

Options that are settings of the library are defined in :mod:`quatprop.settings`, and mean the same
everywhere. Further options of a command have keywords of the same type.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import click

from quatprop.cli.help import GroupedOption
from quatprop.cli.types import PATH, OneOf, ParamType, Parsed
from quatprop.errors import UsageError
from quatprop.settings.keyword import Keyword
from quatprop.settings.parsers import Choice, flag, path
from quatprop.settings.spelling import in_options, option
from quatprop.text import plain, shown
from quatprop.writers.targets import is_stdout, is_stream

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from quatprop.logs.attitude_input import AttitudeInput

    Command = TypeVar("Command", bound=Callable[..., Any])
    Option = Callable[[Any], Any]
    """Adds an option to a command."""


def options_of(
    rows: Mapping[str, Keyword],
    *,
    log: str = "LOG",
    signal: str = "rates",
    side: str = "",
    prefix: str = "",
) -> list[Option]:
    """Return the options for keywords, by the name of a setting, or by names for click.

    `log`, `signal`: names of the input and of its signal in help
    `side`: suffix of the options and parameters, such as ``"a"`` for ``--topic-a``
    `prefix`: prefix of the help of each option
    """
    options = []
    for name, row in rows.items():
        ending = side and f"-{side}"
        short = "-t " if name == "topic" and not side else ""
        names = f"{short}{option(name)}{ending} {name}{ending.replace('-', '_')}"
        says = row.says
        if name == "kind":
            says = f"{says[:-1]}: {', '.join(row.choices)}."
        if not row.preset and (row.parse is not flag or row.default != "none"):
            says = f"{says}  [default: {row.default}]"
        value: dict[str, Any] = {"is_flag": True} if row.parse is flag else {"type": _type(row)}
        if row.preset:
            value |= {"default": row.default, "show_default": True}
        options.append(
            click.option(
                *(name if name.startswith("-") else names).split(),
                cls=GroupedOption,
                group=f"Input {side.upper()}" if side else row.group,
                common=row.common and not side,
                metavar=row.takes or None,
                help=plain(in_options(prefix + says.format(log=log, signal=signal), side)),
                **value,
            )
        )
    return options


def _type(row: Keyword) -> ParamType:
    """Return the click type of a value."""
    if isinstance(row.parse, click.ParamType):
        return row.parse
    return OneOf(row.choices) if row.choices else Parsed(row.parse, row.takes)


REPORT = {
    "--report": Keyword(
        PATH,
        "Write a JSON report: source, conventions, counts, policies, version.",
        takes="PATH|-",
        group="Output",
    ),
}
PLOT = {
    "--plot": Keyword(
        PATH,
        "Draw a picture: .png, .svg, .pdf, or .html for a report with the picture in it.",
        takes="PIC",
        group="Output",
        common=True,
    ),
}
VIEW = {
    "--view": Keyword(
        Choice("rerun", "foxglove"),
        "Open the result in Rerun (extra: rerun) or Foxglove's desktop app: attitudes as axes, "
        "rates or errors as plots, at the times of the log.",
        group="Output",
    ),
}
QUIET = {"-q --quiet": Keyword(flag, "No summary; errors only.", group="Display", common=True)}


def yaml_path(value: object) -> str:
    """Return the path of a YAML file to write, or of stdout."""
    parsed = path(value)
    if not (is_stdout(parsed) or is_stream(parsed) or parsed.lower().endswith((".yaml", ".yml"))):
        raise UsageError(
            f"{shown(value)} ends in neither .yaml nor .yml; rename it, or choose - for stdout"
        )
    return parsed


JSON = {
    "--json as_json": Keyword(
        flag, "JSON on stdout instead of text.", group="Display", common=True
    ),
}


def with_options(
    *options: Sequence[Option] | Mapping[str, Keyword],
) -> Callable[[Command], Command]:
    """Return a decorator that adds options, or those of keywords, to a command, in this order."""
    every: list[Option] = []
    for some in options:
        every += options_of(some) if isinstance(some, Mapping) else some

    def decorated(command: Command) -> Command:
        for give in reversed(every):
            command = give(command)
        return command

    return decorated


def refuse_stdin_twice(*paths: str | None) -> None:
    """Refuse to read several series from stdin."""
    if paths.count("-") > 1:
        raise click.UsageError("stdin can be read only once; name files for the others")


def input_of(
    path: str, chosen: Mapping[str, Any], *, side: str = "", drop: bool = False
) -> AttitudeInput:
    """Return the attitudes to read, from the options of a command."""
    from quatprop.logs.attitude_input import attitude_input
    from quatprop.settings.reading import READ_ATTITUDES
    from quatprop.stores.log_names import split_topic

    keys = {name: f"{name}_{side}" if f"{name}_{side}" in chosen else name
            for name in READ_ATTITUDES}  # fmt: skip
    # The time range of the command applies to an input without a side.
    without = ("start", "end") if side else ()
    options = {
        name: chosen[key] for name, key in keys.items() if key in chosen and name not in without
    }
    path, options["topic"] = split_topic(path, options.get("topic"))
    return attitude_input(path, {"on_invalid": "drop" if drop else None, **options}, side)
