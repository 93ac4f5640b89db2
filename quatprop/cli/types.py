"""Option values, read by the same parsers as the library's keywords and the keys of a suite."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from quatprop import settings
from quatprop.cli.spelling import sentence
from quatprop.comparison.settings import COMPARE

if TYPE_CHECKING:
    from collections.abc import Callable

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

    def __init__(self, parser: Callable[[object], Any], name: str) -> None:
        self.parser = parser
        self.name = name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return what the parser makes of it, or fail with its sentence."""
        from quatprop.errors import UsageError

        try:
            return self.parser(value)
        except UsageError as error:
            self.fail(sentence(error), param, ctx)


def names(columns: str) -> Parsed:
    """Return the type of as many columns as are named, such as ``"X,Y,Z"``."""
    return Parsed(settings.columns(columns), columns)


def numbers(names: str) -> Parsed:
    """Return the type of as many numbers as are named, such as ``"X,Y,Z"``."""
    return Parsed(settings.numbers(names), names)


DURATION = Parsed(settings.duration, "DUR")
TIME = Parsed(settings.moment, "TIME")
TIME_OFFSET = Parsed(COMPARE["time_offset"], "DUR|auto")
ANGLE = Parsed(COMPARE["tol"], "ANGLE")
