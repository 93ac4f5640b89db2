"""A setting in one row: how its value is parsed, and its text for help, options and documents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

from quatprop.settings.parsers import Choice
from quatprop.text import in_python

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

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

    `says`: one or more sentences; settings in them are marks (:class:`quatprop.text.Setting`),
        ``{log}`` is the name of the input in the interface, ``{signal}`` that of its data
    `takes`: the name of the value in help, which lists the names of a choice instead
    `common`: whether the short help shows it
    `preset`: whether the default is a value, which is parsed like a given one
    """

    parse: Callable[..., Any]
    says: str
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
        says = keyword.says
        if keyword.choices:
            says += f" One of {', '.join(map(repr, keyword.choices))}."
        if keyword.default != "none" or "none" in keyword.choices:
            says += f" By default: {keyword.default}."
        said = in_python(says.format(log=log, signal=signal))
        indent = " " * 4
        lines.append(f"{name} : {_type(hint.__origin__)}")
        lines.append(fill(said, 96, initial_indent=indent, subsequent_indent=indent))
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
