"""Parsers of values from users: text, TOML values or Python values.

Each returns the value in the type that the program uses, accepts its own results, and
raises a :class:`quatprop.base.errors.UsageError` that does not name the setting.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from decimal import Decimal
from fractions import Fraction
from operator import index
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Protocol, SupportsFloat, TypeAlias, TypeGuard, get_args

from quatprop.base.errors import UsageError
from quatprop.base.text import did_you_mean, in_python, listed, shown
from quatprop.base.times import Instant, Nanoseconds, instant, length_ns
from quatprop.stores.objects import split_topic

Parser: TypeAlias = Callable[[object], Any]
"""Returns a value in the type that the program uses, or raises a UsageError about it."""

MAX_FREQUENCY = 1_000_000_000
"""Hz: stamps are whole nanoseconds."""

MIN_FREQUENCY = Decimal("1e-9")
"""Hz: an interval of 31 years."""


def text(value: object) -> str:
    """Return text that is not empty."""
    if not isinstance(value, str) or not value:
        raise UsageError(f"{shown(value)} is not a name")
    return value


def flag(value: object) -> bool:
    """Return True or False."""
    if not isinstance(value, bool):
        raise UsageError(f"{shown(value)} is not true or false")
    return value


def path(value: object) -> str:
    """Return a path as text."""
    if not isinstance(value, str | PathLike) or not str(value) or "\0" in str(value):
        raise UsageError(f"{shown(value)} is not a path")
    return str(fspath(value))


def choice_named(value: str, names: Iterable[str]) -> str:
    """Return the matching name, ignoring case; else the value itself."""
    name = value.lower()
    if name not in names:
        name = {"dps": "deg/s", "reference": "inertial"}.get(name, name)
    return name if name in names else value


class Choice:
    """A parser that accepts one of a few names."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def __call__(self, value: object) -> str:
        """Return the name."""
        hint = ""
        if isinstance(value, str):
            if (name := choice_named(value, self.names)) in self.names:
                return name
            hint = did_you_mean(value, self.names)
        raise UsageError(f"{shown(value)} is not one of {listed(self.names)}{hint}")


MATRIX_COLUMNS = (9, 12)
"""Numbers of columns of a rotation matrix row by row, and of the 3x4 matrix of a pose."""


def column_list(names: str, *others: int) -> Callable[[object], tuple[str, ...]]:
    """Return a parser of as many columns as `names` has, such as ``"X,Y,Z"``.

    Names in brackets are optional: ``"A,B,C[,D]"``.

    `others`: further numbers of columns, those of a matrix
    """
    counts = range(names.partition("[")[0].count(",") + 1, names.count(",") + 2)
    matrix = f", or {' or '.join(map(str, others))} of a matrix" if others else ""

    def parse_columns(value: object) -> tuple[str, ...]:
        parts = tuple(str(part).strip() for part in parts_of(value))
        if len(parts) not in {*counts, *others} or not all(parts):
            number = " or ".join(map(str, counts))
            raise UsageError(f"{shown(value)} does not name {number} columns {names}{matrix}")
        if len(set(parts)) != len(parts):
            again = next(part for part in parts if parts.count(part) > 1)
            ways = "; if several have that name, give their numbers, from 0"
            ways = "" if again.isdecimal() else ways
            raise UsageError(f"{shown(value)} names a column twice{ways}")
        return parts

    return parse_columns


def column_names(value: object) -> tuple[str, ...]:
    """Return the names of any number of columns."""
    parts = tuple(str(part).strip() for part in parts_of(value))
    if not parts or not all(parts):
        raise UsageError(f"{shown(value)} does not name columns A,B,...")
    if len(set(parts)) != len(parts):
        raise UsageError(f"{shown(value)} names a column twice")
    return parts


def number_list(names: str) -> Callable[[object], tuple[float, ...]]:
    """Return a parser of as many numbers as `names` has, such as ``"W,X,Y,Z"``."""
    count = names.count(",") + 1

    def parse_numbers(value: object) -> tuple[float, ...]:
        try:
            parts = tuple(float(str(part)) for part in parts_of(value))
        except ValueError:
            parts = ()
        if len(parts) != count or not all(map(math.isfinite, parts)):
            raise UsageError(f"{shown(value)} is not {names}, {count} finite numbers")
        return parts

    return parse_numbers


def number(value: object) -> float:
    """Return a finite number."""
    try:
        parsed = float(str(value))
    except ValueError:
        parsed = math.nan
    if not math.isfinite(parsed) or isinstance(value, bool):
        raise UsageError(f"{shown(value)} is not a finite number")
    return parsed


def count(value: object) -> int:
    """Return a whole number of at least one."""
    try:
        parsed = int(value) if isinstance(value, str) else _whole(value)
    except ValueError:
        parsed = None
    if parsed is None or parsed < 1:
        raise UsageError(f"{shown(value)} is not a whole number above 0")
    return parsed


def frequency(value: object) -> Fraction:
    """Return a frequency in Hz as an exact decimal or fraction."""
    # By its text: 29.97 means the decimal, not the nearest binary fraction.
    text = str(value).removesuffix("Hz").strip()
    numerator, _, denominator = text.partition("/")
    try:
        # The size first: the exact value of 1e-99999999 would fill the memory.
        if MIN_FREQUENCY <= Decimal(numerator) / Decimal(denominator or 1) <= MAX_FREQUENCY:
            return Fraction(text)
    except (ValueError, ArithmeticError):
        pass
    raise UsageError(
        f"{shown(value)} is not a rate from 1e-9 to 1e9 Hz; write 100, 29.97 or 30000/1001"
    )


def duration(value: object) -> Nanoseconds:
    """Return a duration in ns: text with units, a number of seconds, or a timedelta."""
    if isinstance(value, Nanoseconds):
        return value
    if isinstance(value, timedelta):
        # Those of pandas also have nanoseconds.
        whole = value // timedelta(microseconds=1) * 1000
        return Nanoseconds(whole + getattr(value, "nanoseconds", 0))
    if str(getattr(value, "dtype", "")).startswith("timedelta64[") and str(value) != "NaT":
        return Nanoseconds(value.astype("timedelta64[ns]").astype("int64"))  # type: ignore[attr-defined]
    if isinstance(value, str | SupportsFloat):
        return length_ns(str(value))
    raise UsageError(f"{shown(value)} is not a duration; write seconds, or text such as '20ms'")


def signed_duration(value: object) -> Nanoseconds:
    """Return a duration in ns that may be negative, such as ``"-12ms"``."""
    if isinstance(value, str) and value.startswith("-"):
        return Nanoseconds(-duration(value[1:]))
    return duration(value.removeprefix("+") if isinstance(value, str) else value)


def length(value: object) -> Nanoseconds:
    """Return a duration above zero, in ns."""
    parsed = duration(value)
    if parsed <= 0:
        raise UsageError(f"{shown(value)} is not a duration above 0")
    return parsed


def moment(value: object) -> Instant:
    """Return an instant: text, whole nanoseconds, or a datetime with its zone."""
    if isinstance(value, Instant):
        return value
    if isinstance(value, datetime):
        if value.tzinfo is None:
            raise UsageError(f"{shown(value)} needs a time zone, such as tzinfo=datetime.UTC")
        value = value.isoformat()
    ns = int(value) if isinstance(value, str) and value.isdecimal() else _whole(value)
    if ns is None and isinstance(value, str):
        return instant(value)
    if ns is None:
        raise UsageError(f"{shown(value)} is not a time; write text, whole ns, or a datetime")
    return Instant(ns, "clock")


def parts_of(value: object) -> list[object]:
    """Return the parts of text with commas, of a list, or of an array."""
    if isinstance(value, str):
        return list(value.split(","))
    convert = getattr(value, "tolist", None)
    value = value if convert is None else convert()
    try:
        return list(value) if isinstance(value, Iterable) else [value]
    except TypeError:
        return [value]


def _whole(value: object) -> int | None:
    """Return a whole number of any type, also of NumPy; None for other values and for booleans."""
    try:
        return None if str(value) in {"True", "False"} else index(value)  # type: ignore[arg-type]
    except TypeError:
        return None


# A setting in one row: how its value is parsed, and its text for help, options and documents.


PYTHON_TYPES = {
    "PathLike": "path",
    "Fraction": "float",
    "Collection": "sequence",
    "Literal": "str",
    "Sequence": "sequence",
    "Rotated": "Rotation",
    "Timed": "series",
}
"""Names of types in documents, if different from their own."""


@dataclass(frozen=True, slots=True)
class Keyword:
    """A keyword of the library, which is also an option and a key of a suite.

    `help`: one or more sentences; settings in them are marks (:class:`quatprop.base.text.Setting`),
        ``{log}`` is the name of the input in the interface, ``{signal}`` that of its data
    `takes`: the name of the value in help, which lists the names of a choice instead
    `common`: whether the short help shows it
    `preset`: whether the default is a value, which is parsed like a given one
    """

    parse: Callable[..., Any]
    help: str
    default: str = "none"
    takes: str = ""
    group: str = "Input"
    common: bool = False
    preset: bool = False

    def __call__(self, value: object) -> Any:
        """Return the value in the type that the program uses."""
        return self.parse(value)

    @property
    def choices(self) -> tuple[str, ...]:
        """The names that it accepts; empty for other parsers."""
        return self.parse.names if isinstance(self.parse, Choice) else ()


def keywords_of(options: type) -> Mapping[str, Keyword]:
    """Return the row of each keyword of a class, by name."""
    return {name: hint.__metadata__[0] for name, hint in options.__annotations__.items()}


def parameters(options: type, signal: str = "rates", log: str = "the log") -> str:
    """Return the paragraphs of numpydoc about the keywords of a class, for a function's help."""
    from textwrap import fill

    lines = []
    for name, hint in options.__annotations__.items():
        keyword: Keyword = hint.__metadata__[0]
        text = keyword.help
        if keyword.choices:
            text += f" One of {', '.join(map(repr, keyword.choices))}."
        if keyword.default != "none" or "none" in keyword.choices:
            text += f" By default: {keyword.default}."
        sentence = in_python(text.format(log=log, signal=signal))
        indent = " " * 4
        lines.append(f"{name} : {_type(hint.__origin__)}")
        lines.append(fill(sentence, 96, initial_indent=indent, subsequent_indent=indent))
    return "\n".join(lines)


def _type(hint: Any) -> str:
    """Return the name of a type in numpydoc: ``"str or float"``."""
    names = [
        getattr(one, "__name__", str(one))
        for one in get_args(hint) or [hint]
        if one is not type(None)
    ]
    *first, last = dict.fromkeys(PYTHON_TYPES.get(name, name) for name in names)
    return f"{', '.join(first)} or {last}" if first else last


# Parsers of settings about attitudes and rates: numbers, a file, a topic, or a value in memory.


FROM_THE_LOG = ("level", "log")
"""Initial attitudes from the log itself."""

FILE_SETTINGS = frozenset({"at", "bias", "calibration", "imu", "msg_path", "q0"})
"""Settings whose value is, or may be, the name of a file."""

STATIC = "static"
"""Value for a bias that is the mean rate at rest."""


class Rotated(Protocol):
    """A rotation, such as that of scipy."""

    def as_matrix(self) -> Any:
        """Return the rotation matrix, shape ``(3, 3)``."""


class Timed(Protocol):
    """A series of rates or of attitudes."""

    @property
    def t_ns(self) -> Any:
        """The timestamps, shape ``(N,)``, ns."""


class InMemory:
    """A value without text: times or a series in a program that uses the library."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __str__(self) -> str:
        """Return the text for reports."""
        return "in memory"


def place(value: object) -> tuple[float, ...]:
    """Return a latitude, and the azimuth of the reference's x axis if given, deg."""
    names = "LAT,AZIMUTH" if len(parts_of(value)) > 1 else "LAT"
    numbers = number_list(names)(value)
    if abs(numbers[0]) > 90:  # noqa: PLR2004  # the poles
        raise UsageError(f"{shown(value)} is not a latitude: give -90 to 90 deg, north positive")
    return numbers


def resolve_path(name: str, text: str, folder: Path) -> Path | None:
    """Return the file that a setting names, relative to a folder; None if it names none."""
    path = folder / text
    words = {"bias": (STATIC,), "q0": FROM_THE_LOG}.get(name, ())
    if name not in FILE_SETTINGS or "://" in text or re.split("[:@]", text)[0].strip() in words:
        return None
    # It may also be a topic or numbers.
    is_there = Path(split_topic(str(path))[0]).exists()
    return path if is_there or not (words or name == "at" or "," in text) else None


def resolve_paths(values: Mapping[str, object], folder: Path) -> dict[str, object]:
    """Return settings with the paths of their files relative to a folder."""
    texts = {name: str(one) for name, one in values.items() if isinstance(one, str | PathLike)}
    files = {name: resolve_path(name, text, folder) for name, text in texts.items()}
    return {**values, **{name: str(file) for name, file in files.items() if file is not None}}


def times(value: object) -> str | InMemory:
    """Return the path of a series, or times in memory."""
    is_times = isinstance(value, Iterable) and not isinstance(value, str)
    return InMemory(value) if is_times else path(value)


def initial_attitude(value: object) -> tuple[float, ...] | str | InMemory:
    """Return four numbers, ``"level"``, ``"log"``, or an attitude series: a path or a topic.

    `value`: text, four numbers, a series in memory, or a rotation of scipy
    """
    if hasattr(value, "t_ns"):
        return InMemory(value)
    if (as_quat := getattr(value, "as_quat", None)) is not None:
        x, y, z, w = parts_of(as_quat())
        value = (w, x, y, z)
    if isinstance(value, str) and value in FROM_THE_LOG:
        return value
    if not is_name(value):
        return number_list("W,X,Y,Z")(value)
    may_be_a_topic = isinstance(value, str) and "." not in Path(value).name
    if not may_be_a_topic and not Path(split_topic(str(value))[0]).exists():
        raise UsageError(
            f"{shown(value)} is not four numbers W,X,Y,Z, level, log or an existing file"
        )
    return path(value)


def mounting(value: object) -> str:
    """Return axes, a name or a quaternion as text, which the conditioning parses.

    `value`: text, four numbers, a matrix of shape ``(3, 3)``, or a rotation of scipy
    """
    if isinstance(value, str):
        return value
    as_matrix = getattr(value, "as_matrix", None)
    parts = parts_of(value if as_matrix is None else as_matrix())
    # The rows of a matrix in sequence.
    rows = [parts_of(part) if not isinstance(part, str) else [part] for part in parts]
    return ",".join(str(part) for row in rows for part in row)


def is_name(value: object) -> TypeGuard[str | PathLike[str]]:
    """Return whether a value may be a file or a topic: text that is not numbers."""
    if not isinstance(value, str) or not value:
        return isinstance(value, PathLike)
    try:
        list(map(float, value.split(",")))
    except ValueError:
        return True
    return False
