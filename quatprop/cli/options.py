"""Create options from their keywords: help text, default, and parser.

Options that are settings of the library are defined in :mod:`quatprop.settings`, and mean the same
everywhere. Further options of a command have keywords of the same type.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from quatprop.base.errors import UsageError, os_reason
from quatprop.base.guarded_text import MAX_BYTES, ContentError, read_bytes, read_toml
from quatprop.base.places import is_stdout, is_stream
from quatprop.base.text import did_you_mean, plain, quoted, shown
from quatprop.cli.commands import GroupedOption
from quatprop.settings import in_options, option
from quatprop.settings.parsers import Keyword, Parser, choice_named, flag, path, resolve_path

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from click.shell_completion import CompletionItem

    from quatprop.propagation.attitude_input import AttitudeInput

    Command = TypeVar("Command", bound=Callable[..., Any])
    Option = Callable[[Any], Any]
    """Adds an option to a command."""


# Types of option values, with the parsers of the library's keywords and the keys of a suite.


if TYPE_CHECKING:
    ParamType = click.ParamType[Any]
else:
    # That of older versions of click cannot be subscripted.
    ParamType = click.ParamType


class _Path(click.Path):
    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Refuse an empty name, which would be the current folder."""
        if not value:
            self.fail("the name is empty; is a variable of the shell not set?", param, ctx)
        return super().convert(value, param, ctx)


PATH = _Path(readable=False)
"""A file, a folder, or an address; errors are found when it is opened."""


def content_of(name: str) -> bytes:
    """Return the content of a file named by an option, or of stdin for ``-``."""
    try:
        with click.open_file(name, "rb") as file:
            return read_bytes(file, MAX_BYTES * 4)
    except ContentError as error:
        raise click.UsageError(f"{name}: {error}") from error
    except OSError as error:
        raise click.UsageError(f"{name}: {os_reason(error)}") from error


TEXTS = "quatprop.texts"
"""Key in ``Context.meta``: the text of option values, by parameter."""


class Parsed(ParamType):
    """An option type with a parser.

    `parser`: accepts text, or a value that it has returned before
    `name`: the value in help, such as ``"W,X,Y,Z"``
    """

    can_be_none = True

    def __init__(self, parser: Parser, name: str) -> None:
        self.parser = parser
        self.name = name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the parsed value, or fail with the error of the parser."""
        if ctx is not None and param is not None and isinstance(value, str):
            ctx.meta.setdefault(TEXTS, {})[param.name] = value
        try:
            return self.parser(value)
        except UsageError as error:
            self.fail(str(error), param, ctx)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem[str]]:
        """Return possible values, such as the topics of the log on the line."""
        from quatprop.cli.completion import values

        return values(str(param.name), self.name, ctx, incomplete)


class OneOf(click.Choice[str]):
    """An option type for one of a few names, which suggests similar ones."""

    can_be_none = True

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the name in its usual spelling."""
        return super().convert(choice_named(str(value), self.choices), param, ctx)

    def get_invalid_choice_message(self, value: Any, ctx: click.Context | None) -> str:
        """Return the error for an invalid value."""
        message = super().get_invalid_choice_message(value, ctx)
        if {part.strip() for part in str(value).split(",")} <= {*self.choices}:
            return f"{value!r} names several, and only one is possible."
        return message.rstrip(".") + did_you_mean(str(value), self.choices)


def options_of(  # noqa: PLR0913  # how one row becomes an option
    rows: Mapping[str, Keyword],
    *,
    log: str = "LOG",
    signal: str = "rates",
    side: str = "",
    prefix: str = "",
    multiple: bool = False,
) -> list[Option]:
    """Return the options for keywords, by the name of a setting, or by names for click.

    `log`, `signal`: names of the input and of its signal in help
    `side`: suffix of the options and parameters, such as ``"a"`` for ``--topic-a``
    `prefix`: prefix of the help of each option
    `multiple`: whether they may be given more than once
    """
    options = []
    for name, row in rows.items():
        ending = side and f"-{side}"
        short = "-t " if name == "topic" and not side else ""
        names = f"{short}{option(name)}{ending} {name}{ending.replace('-', '_')}"
        text = prefix + _help_of(name, row).format(log=log, signal=signal)
        value: dict[str, Any] = {"is_flag": True} if row.parse is flag else {"type": _type(row)}
        if multiple:
            value["multiple"] = True
        if row.preset:
            value |= {"default": row.default, "show_default": True}
        options.append(
            click.option(
                *(name if name.startswith("-") else names).split(),
                cls=GroupedOption,
                group=f"Input {side.upper()}" if side else row.group,
                common=row.common and not side,
                metavar=row.takes or None,
                help=plain(in_options(text, side)),
                **value,
            )
        )
    return options


def _help_of(name: str, row: Keyword) -> str:
    """Return the sentences of a row with its default, unless click shows that."""
    kinds = f": {', '.join(row.choices)}." if name == "kind" else ""
    text = row.help[:-1] + kinds if kinds else row.help
    if not row.preset and (row.parse is not flag or row.default != "none"):
        text = f"{text}  [default: {row.default}]"
    return text


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
    from quatprop.propagation.attitude_input import attitude_input
    from quatprop.settings.reading import READ_ATTITUDES

    keys = {name: f"{name}_{side}" if f"{name}_{side}" in chosen else name
            for name in READ_ATTITUDES}  # fmt: skip
    # The time range of the command applies to an input without a side.
    without = ("start", "end") if side else ()
    options = {
        name: chosen[key] for name, key in keys.items() if key in chosen and name not in without
    }
    return attitude_input(path, {"on_invalid": "drop" if drop else None, **options}, side)


# Options in a file: ``--config FILE.toml``, with the keys of a suite.


ONE_RUN = {"config", "output", "folder", "report", "plot", "help", "help_all"}
"""Parameters for a single run, which are not allowed in a file."""


def _read(ctx: click.Context, _parameter: click.Parameter, name: str | None) -> None:
    if name is None or ctx.resilient_parsing:
        return
    try:
        table = read_toml(content_of(name))
    except ContentError as error:
        raise click.UsageError(f"{plain(name)}: {error}") from error
    ctx.default_map = {**(ctx.default_map or {}), **_defaults(ctx, name, table)}


def _defaults(ctx: click.Context, name: str, table: Mapping[str, object]) -> dict[str, object]:
    """Return the defaults in a file, by parameter."""
    parameters = {
        option[2:]: parameter
        for parameter in ctx.command.params
        if isinstance(parameter, click.Option) and parameter.name not in ONE_RUN
        for option in parameter.opts
        if option.startswith("--")
    }
    defaults: dict[str, object] = {}
    for key, value in table.items():
        if key not in parameters:
            hint = did_you_mean(key, parameters, "the keys are options without their dashes")
            raise click.UsageError(f"{name}: no such key {quoted(key)}{hint}")
        parameter = str(parameters[key].name)
        if parameters[key].is_flag and not isinstance(value, bool):
            raise click.UsageError(f"{name}: {quoted(key)} is true or false, not {value!r}")
        text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
        text = str(resolve_path(parameter, text, Path(name).parent) or text)
        defaults[parameter] = value if isinstance(value, bool) else text
    return defaults


config_option = click.option(
    "--config",
    cls=GroupedOption,
    group="Execution",
    common=False,
    type=PATH,
    metavar="FILE",
    is_eager=True,
    expose_value=False,
    callback=_read,
    help="Read options from a TOML file, with the same keys as a suite; paths are relative to it. "
    "The command line takes precedence; none unsets an option.  "
    "[default: none]",
)
