"""Types of option values, with the parsers of the library's keywords and the keys of a suite."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from quatprop.errors import UsageError, os_reason
from quatprop.settings.guarded_text import MAX_BYTES, ContentError, read_bytes
from quatprop.settings.parsers import Parser, choice_named
from quatprop.text import did_you_mean

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

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
