"""Option values, read by the same parsers as the library's keywords and the keys of a suite."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.spelling import sentence

if TYPE_CHECKING:
    from quatprop.parsers import Parser

    ParamType = click.ParamType[Any]
else:
    # Older versions of click cannot be subscripted.
    ParamType = click.ParamType


class Parsed(ParamType):
    """An option whose value a parser reads.

    Parameters
    ----------
    parser
        Takes the text, or a value that it has returned before.
    name
        What help calls the value, such as ``"W,X,Y,Z"``.
    """

    def __init__(self, parser: Parser, name: str) -> None:
        self.parser = parser
        self.name = name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return what the parser makes of it, or fail with its sentence."""
        from quatprop.errors import UsageError

        try:
            return self.parser(value)
        except UsageError as error:
            self.fail(sentence(error), param, ctx)
