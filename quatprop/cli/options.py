"""Options from tables: what help says of each, and the parser of its value.

An option that is a setting of the library follows from its row in :mod:`quatprop.settings`, and
means the same everywhere. What a command has beside them is in a table of its own, for
:func:`own_options`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import click

from quatprop.cli.help import SettingOption
from quatprop.cli.spelling import option as option_name
from quatprop.cli.spelling import spelled
from quatprop.cli.types import PATH, OneOf, ParamType, Parsed
from quatprop.settings.parsers import Choice, Parser, flag
from quatprop.text import Setting, Text

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from quatprop.logs.attitude_input import AttitudeInput
    from quatprop.settings.keyword import Keyword

    Command = TypeVar("Command", bound=Callable[..., Any])
    Option = Callable[[Any], Any]
    """Gives a command an option."""


def setting_options(
    keywords: Mapping[str, Keyword],
    *,
    log: str = "LOG",
    signal: str = "rates",
    side: str = "",
    prefix: str = "",
) -> list[Option]:
    """Return the options for settings.

    `log`, `signal`: what help calls the input, and what is read of it
    `side`: ends the names of the options, such as ``"a"`` for ``--topic-a``, and after an
        underscore the keywords
    `prefix`: begins the help of each
    """
    options = []
    for name, keyword in keywords.items():
        short = "-t " if name == "topic" and not side else ""
        names = f"{short}{option_name(Setting(name), side)} {name}_{side}".rstrip("_")
        says = keyword.says
        if name == "kind":
            says = f"{says[:-1]}: {', '.join(keyword.choices)}."
        if keyword.parse is not flag or keyword.default != "none":
            says = f"{says}  [default: {keyword.default}]"
        text = spelled(Text(prefix + says.format(log=log, signal=signal)), side)
        group = f"Input {side.upper()}" if side else keyword.group
        common = keyword.common and not side
        options.append(
            _option(
                names,
                keyword.parse,
                keyword.takes,
                text,
                cls=SettingOption,
                group=group,
                common=common,
            )
        )
    return options


def own_options(
    texts: Mapping[str, str],
    kinds: Mapping[str, Parser | ParamType] | None = None,
    defaults: Mapping[str, object] | None = None,
) -> list[Option]:
    """Return the options of one command.

    `defaults`: names -> the default, which help shows; without one it is None, or said in the text
    """
    kinds, defaults = kinds or {}, defaults or {}
    options = []
    for names, text in texts.items():
        takes, _, says = text.partition("  ")
        if " " in takes:
            takes, says = "", text
        shown = {"default": defaults[names], "show_default": True} if names in defaults else {}
        options.append(_option(names, kinds.get(names), takes, says, **shown))
    return options


def _option(
    names: str, kind: Parser | ParamType | None, takes: str, says: str, **attributes: Any
) -> Option:
    """Return an option; `takes` is what help calls its value, unless that is a choice or a flag."""
    if kind is flag or not (kind or takes):
        return click.option(*names.split(), is_flag=True, help=says, **attributes)
    if isinstance(kind, Choice):
        kind = OneOf(kind.names)
    elif kind is not None and not isinstance(kind, click.ParamType):
        kind = Parsed(kind, takes)
    metavar = takes or None
    return click.option(*names.split(), type=kind or PATH, metavar=metavar, help=says, **attributes)


REPORT = {
    "--report": "PATH|-  Write a JSON report: source, conventions, counts, policies, version.  "
    "[default: none]",
}
PLOT = {
    "--plot": "PIC  Draw a picture: .png, .svg, .pdf, or .html for a report with the picture in "
    "it.  [default: none]",
}
QUIET = {"-q --quiet": "No summary; errors only."}
JSON = {"--json as_json": "JSON on stdout instead of text."}


def with_options(
    *options: Sequence[Option] | dict[str, str],
) -> Callable[[Command], Command]:
    """Return a decorator that gives a command these options, or those of texts, in this order."""
    every: list[Option] = []
    for some in options:
        every += own_options(some) if isinstance(some, dict) else some

    def decorated(command: Command) -> Command:
        for option in reversed(every):
            command = option(command)
        return command

    return decorated


def refuse_stdin_twice(*paths: str | None) -> None:
    """Refuse to read several series from stdin: what is read first leaves nothing."""
    if paths.count("-") > 1:
        raise click.UsageError("stdin can be read only once; name files for the others")


def input_of(
    path: str, chosen: Mapping[str, Any], *, side: str = "", drop: bool = False
) -> AttitudeInput:
    """Return which attitudes to read, from the options of a command."""
    from quatprop.logs.attitude_input import attitude_input
    from quatprop.settings import READ_ATTITUDES

    keys = {name: f"{name}_{side}" if f"{name}_{side}" in chosen else name
            for name in READ_ATTITUDES}  # fmt: skip
    options = {name: chosen[key] for name, key in keys.items() if key in chosen}
    return attitude_input(path, {"on_invalid": "drop" if drop else None, **options}, side)
