"""Sentences for users: settings that each interface spells in its own way, and safe quoting.

A choice of the user's is a :class:`Setting` in a :class:`Text`: ``clock='log'`` in Python,
``--clock log`` on the command line, ``clock = "log"`` in a suite.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

MAX_LISTED = 12
"""Names listed one by one before "and N more"."""

MAX_SHOWN = 60
"""Characters of a value that are shown as they are."""


_MARK = re.compile("\ue000(.*?)\ue001")
"""A setting in an f-string: :func:`quoted` and :func:`plain` let no such characters pass."""


class Setting(NamedTuple):
    """A choice of the user's, to be mentioned in a sentence.

    In an f-string it is a mark, which :class:`Text` reads; ``str()`` spells it as Python does.

    `name`: the parameter of the library, such as ``"on_backwards"``
    `value`: what it could be set to, such as ``"log"``; alternatives with ``|`` between them. Empty
        where only the choice is mentioned
    `side`: of which input, where a command has two: ``"a"`` or ``"b"``

    Examples
    --------
    >>> str(Setting("on_backwards", "drop|sort"))
    "on_backwards='drop' or 'sort'"
    """

    name: str
    value: str = ""
    side: str = ""

    def __str__(self) -> str:
        if not self.value:
            return self.name
        return f"{self.name}=" + " or ".join(repr(value) for value in self.value.split("|"))

    def __format__(self, _spec: str) -> str:
        return f"\ue000{self.name}\ue002{self.value}\ue002{self.side}\ue001"


class Text(str):
    """A sentence that may mention settings: text as the library spells it, and its parts.

    `parts`: Text, in which f-strings may have settings; settings, and sentences to be joined as
        they are

    Examples
    --------
    >>> text = Text(f"several topics carry body rates; choose one with {Setting('topic')}")
    >>> text
    'several topics carry body rates; choose one with topic'
    >>> text.spelled(lambda setting: f"--{setting.name}")
    'several topics carry body rates; choose one with --topic'
    """

    __slots__ = ("parts",)

    parts: tuple[str | Setting, ...]

    def __new__(cls, *parts: str | Setting) -> Self:
        """Join the parts."""
        flat: list[str | Setting] = []
        for part in parts:
            if isinstance(part, Text):
                flat += part.parts
                continue
            for number, piece in enumerate(_MARK.split(f"{part}")):
                # Every second piece is what stood in a mark.
                flat.append(Setting(*piece.split("\ue002")) if number % 2 else piece)
        text = super().__new__(cls, "".join(map(str, flat)))
        text.parts = tuple(filter(None, flat))
        return text

    def __reduce__(self) -> tuple[type[Text], tuple[str | Setting, ...]]:
        return Text, self.parts

    def spelled(self, spell: Callable[[Setting], str]) -> str:
        """Return the sentence, its settings spelled by a function."""
        return "".join(part if isinstance(part, str) else spell(part) for part in self.parts)


def quoted(text: object) -> str:
    """Return `text` in quotes, with everything unprintable escaped.

    Examples
    --------
    >>> quoted("/imu")
    "'/imu'"
    """
    return "'" + plain(text) + "'"


def plain(text: object) -> str:
    """Return `text` on one line with everything unprintable escaped, without quotes."""
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode()
        for character in str(text)
    )


def shown(value: object) -> str:
    """Return a value that was given, quoted; of what is large or unusual, its type alone.

    Examples
    --------
    >>> shown("fast"), shown((1, 0)), shown((0,) * 5000)
    ("'fast'", "'1,0'", 'a value of type tuple')
    """
    if isinstance(value, list | tuple) and len(value) <= MAX_LISTED:
        return quoted(",".join(map(str, value)))
    if value is None or isinstance(value, str | bytes | int | float):
        return quoted(value)
    text = str(value)
    simple = "\n" not in text and len(text) < MAX_SHOWN and not text.startswith("<")
    return quoted(text) if simple else f"a value of type {type(value).__name__}"


def nearest(name: str, names: Iterable[str]) -> str | None:
    """Return the name that was probably meant, whatever its case; None where none is like it.

    Examples
    --------
    >>> nearest("imu", ["/gps", "/imu/data"]), nearest("--metod", ["--mode", "--method"])
    ('/imu/data', '--method')
    """
    from difflib import get_close_matches

    lower = {other.lower().strip("-"): other for other in names}
    name = name.lower().strip("-")
    longer = [other for other in lower if len(name) > 1 and name in other]
    beginning = [other for other in longer if other.startswith(name)]
    near = beginning or get_close_matches(name, lower, 1, 0.7) or sorted(longer, key=len)
    return lower[near[0]] if near else None


def did_you_mean(name: str, names: Iterable[str], otherwise: str = "") -> str:
    """Return the end of a sentence: which name was probably meant, or `otherwise`.

    Examples
    --------
    >>> "no method 'conning'" + did_you_mean("conning", ["start", "coning"])
    "no method 'conning'; did you mean 'coning'?"
    """
    near = nearest(name, names)
    way_out = otherwise if near is None else f"did you mean {quoted(near)}?"
    return f"; {way_out}" if way_out else ""


def listed(names: Iterable[object]) -> str:
    """Return names quoted and separated by commas, cut after :data:`MAX_LISTED`."""
    every = [quoted(name) for name in names]
    if len(every) <= MAX_LISTED:
        return ", ".join(every)
    return ", ".join(every[:MAX_LISTED]) + f" and {len(every) - MAX_LISTED} more"
