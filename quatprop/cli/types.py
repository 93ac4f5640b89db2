"""The types of what options take: numbers, columns, durations, instants, angles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.spelling import sentence

if TYPE_CHECKING:
    ParamType = click.ParamType[Any]
else:
    # Older versions of click cannot be subscripted.
    ParamType = click.ParamType

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
    """A fixed count of names or numbers of columns separated by commas.

    Parameters
    ----------
    names
        What each stands for, such as ``"X,Y,Z"``.
    """

    def __init__(self, names: str) -> None:
        self.name = names
        self.count = names.count(",") + 1

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Return the names, or fail with the count that was expected."""
        if isinstance(value, tuple):
            return value
        parts = tuple(part.strip() for part in value.split(","))
        if len(parts) != self.count or not all(parts):
            self.fail(f"{value!r} does not name {self.count} columns {self.name}", param, ctx)
        if len(set(parts)) != len(parts):
            self.fail(f"{value!r} names a column twice", param, ctx)
        return parts


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
            self.fail(sentence(error), param, ctx)


class TimeOffset(Duration):
    """A signed duration in ns, or ``auto``."""

    name = "DUR|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return ns, or ``"auto"``."""
        if value == "auto" or isinstance(value, int):
            return value
        sign = -1 if value.startswith("-") else 1
        return sign * super().convert(value.lstrip("+-"), param, ctx)


class Angle(ParamType):
    """An angle with its unit, in rad."""

    name = "ANGLE"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the angle in rad."""
        from quatprop.comparison import angle_rad
        from quatprop.errors import UsageError

        if isinstance(value, float):
            return value
        try:
            return angle_rad(value)
        except UsageError as error:
            self.fail(sentence(error), param, ctx)


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
            self.fail(sentence(error), param, ctx)


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
