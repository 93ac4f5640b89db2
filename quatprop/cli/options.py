"""Options that several commands share, and the types of their values."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.selection import Selection

    ParamType = click.ParamType[Any]
else:
    # Older versions of click cannot be subscripted.
    ParamType = click.ParamType

Command = TypeVar("Command", bound="Callable[..., Any]")

KINDS = ("mcap", "bag", "db3", "rosbag2", "ulog", "parquet", "feather", "csv")
"""The keys of :data:`quatprop.readers.READERS`; spelled out so that help imports no reader."""


MAX_RATE = 1_000_000_000
"""Hz: stamps are whole nanoseconds."""

MAX_DENOMINATOR = 1001
"""Of a rate, so that times are exact in 64 bits; that of the television rates."""


class Numbers(ParamType):
    """A fixed count of numbers separated by commas.

    Parameters
    ----------
    names
        What each number is called in help and errors, such as ``"W,X,Y,Z"``.
    """

    def __init__(self, names: str) -> None:
        self.name = names
        self.count = names.count(",") + 1

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Return the numbers, or fail with the count that was expected."""
        if isinstance(value, tuple):
            return value
        try:
            numbers = tuple(float(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != self.count:
            self.fail(f"{value!r} is not {self.name}, {self.count} numbers", param, ctx)
        return numbers


class InitialAttitude(Numbers):
    """Four numbers, a word, or the path of an attitude series; words and paths arrive as text."""

    def __init__(self) -> None:
        super().__init__("W,X,Y,Z")
        self.name = "W,X,Y,Z|level|log|FILE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return four numbers, ``"level"``, ``"log"`` or the path of a file that is there."""
        from pathlib import Path

        if isinstance(value, str) and (value in {"level", "log"} or Path(value).exists()):
            return value
        if isinstance(value, str) and "," not in value:
            self.fail(f"{value!r} is not level or log, and no such file is there", param, ctx)
        return super().convert(value, param, ctx)


class Names(ParamType):
    """Three names or numbers of columns separated by commas."""

    name = "X,Y,Z"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str, str]:
        """Return the three names."""
        if isinstance(value, tuple):
            return value
        parts = [part.strip() for part in value.split(",")]
        if len(parts) != 3 or not all(parts):  # noqa: PLR2004  # three axes
            self.fail(f"{value!r} does not name three columns X,Y,Z", param, ctx)
        if len(set(parts)) != len(parts):
            self.fail(f"{value!r} names a column twice", param, ctx)
        return parts[0], parts[1], parts[2]


class Duration(ParamType):
    """A duration with units, in ns."""

    name = "DUR"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the duration in ns."""
        from quatprop.errors import UsageError
        from quatprop.times import duration_ns

        if isinstance(value, int):
            return value
        try:
            return duration_ns(value)
        except UsageError as error:
            self.fail(str(error), param, ctx)


class Frequency(ParamType):
    """How often a second, as the decimal or the fraction it is written as."""

    name = "HZ"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return a :class:`fractions.Fraction` above zero."""
        from fractions import Fraction

        try:
            rate = Fraction(value)
        except (ValueError, ZeroDivisionError):
            rate = Fraction(0)
        if not 0 < rate <= MAX_RATE or rate.denominator > MAX_DENOMINATOR:
            self.fail(f"{value!r} is no rate in Hz; write 100, 29.97 or 30000/1001", param, ctx)
        return rate


class Time(ParamType):
    """An instant, absolute or relative to an end of the log."""

    name = "TIME"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the :class:`quatprop.times.Instant`."""
        from quatprop.errors import UsageError
        from quatprop.times import instant

        try:
            return instant(value) if isinstance(value, str) else value
        except UsageError as error:
            self.fail(str(error), param, ctx)


class Bias(Numbers):
    """Three rates, or ``static`` with an optional duration: arrives as numbers or as ns."""

    def __init__(self) -> None:
        super().__init__("X,Y,Z")
        self.name = "X,Y,Z|static[:DUR]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return three numbers, or the length of the windows in which rest is looked for."""
        if not isinstance(value, str) or not value.startswith("static"):
            return super().convert(value, param, ctx)
        word, _, duration = value.partition(":")
        if word != "static":
            self.fail(f"{value!r} is neither X,Y,Z nor static[:DUR]", param, ctx)
        return Duration().convert(duration or "1s", param, ctx)


SELECTION_OPTIONS = (
    click.option(
        "--from",
        "kind",
        type=click.Choice(KINDS),
        help="Kind of the log.  [default: told by its content, then by its suffix]",
    ),
    click.option(
        "-t",
        "--topic",
        metavar="NAME",
        help="Topic to read.  [default: the only one that has rates]",
    ),
    click.option(
        "--rate-field",
        metavar="A.B.C",
        help="Field of the message that is the rate.  [default: known from its type]",
    ),
    click.option(
        "--time-field",
        metavar="A.B",
        help="Field of the message that is the time.  [default: the header stamp]",
    ),
    click.option(
        "--rate-cols",
        type=Names(),
        help="Rate columns of a table, by name or number from 0.  [default: by the header]",
    ),
    click.option(
        "--time-col",
        metavar="C",
        help="Time column of a table, by name or number from 0.  [default: by the header]",
    ),
    click.option(
        "--rate-unit",
        type=click.Choice(("rad/s", "deg/s")),
        help="Unit of the rates.  [default: as the log says]",
    ),
    click.option(
        "--time-unit",
        type=click.Choice(("s", "ms", "us", "ns")),
        help="Unit of the time.  [default: as the log says]",
    ),
    click.option(
        "--sample-rate",
        type=click.FloatRange(min=0, min_open=True),
        metavar="HZ",
        help="Samples a second of a table without a time.  [default: none]",
    ),
    click.option(
        "--clock",
        type=click.Choice(("header", "log", "publish")),
        help="Whose stamps.  [default: header where the message has one, else log]",
    ),
)


def selection_options(command: Command) -> Command:
    """Give a command the options that choose samples; they arrive as `chosen` keywords."""
    for option in reversed(SELECTION_OPTIONS):
        command = option(command)
    return command


def selection(chosen: dict[str, Any]) -> Selection:
    """Take the selection's keywords out of a command's options."""
    from dataclasses import fields

    from quatprop.selection import Selection

    return Selection(**{field.name: chosen.pop(field.name) for field in fields(Selection)})
