"""Sentences for users: settings spelled for each interface, and safe quoting.

A sentence is plain text with marks for settings, which are replaced on output: ``clock='log'`` in
Python, ``--clock log`` on the command line, ``clock = "log"`` in a suite.
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    Spelling = Callable[[str, str], str]
    """Returns a sentence with settings spelled for an interface; the second argument is the input
    to which they apply, if there are several."""

MAX_LISTED = 12
"""Maximum number of names that are listed before "and N more"."""

MAX_SHOWN = 60
"""Maximum length of a value that is shown."""

MARK = "\ue000"
"""First character of the mark of a setting."""

_MARK = re.compile("\ue000([^\ue000-\ue002]*)\ue002([^\ue000-\ue002]*)\ue002(\\w*)\ue001")
"""A setting in a sentence; :func:`quoted` and :func:`plain` escape its marks in other text."""


def Setting(name: str, value: str = "", side: str = "") -> str:  # noqa: N802  # the mark's name
    """Return the mark of a setting for a sentence.

    `name`: parameter of the library, such as ``"on_backwards"``
    `value`: suggested value, such as ``"log"``, or alternatives separated by ``|``; may be empty
    `side`: input to which it applies, if a command has two: ``"a"`` or ``"b"``
    """
    return f"\ue000{name}\ue002{value}\ue002{side}\ue001"


def with_settings(text: str, spell: Callable[[str, str, str], str]) -> str:
    """Return a sentence with marks replaced by a function of name, value and side."""
    return _MARK.sub(lambda mark: spell(*mark.groups()), text)


class Remark(str):
    """A remark on a log or a result.

    `code`: identifies the kind of remark, stable when the sentence changes
    """

    __slots__ = ("code",)

    code: str

    def __new__(cls, code: str, text: str) -> Self:
        """Return a remark."""
        remark = super().__new__(cls, text)
        remark.code = code
        return remark

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        """Return the arguments for unpickling."""
        return self.code, str(self)

    def spelled(self, spell: Callable[[str], str]) -> Remark:
        """Return the remark with settings spelled for an interface."""
        return Remark(self.code, spell(self))


_ELSEWHERE = dict.fromkeys(("a", "b", "ref"), " of read_attitudes") | dict.fromkeys(
    ("at", "q0", "relative_to"), " of convert"
)
"""Input -> the function with its settings, if the called function only takes its name."""

_HERE = {"relative_to": {"normalize", "on_invalid"}}
"""Input -> settings of it that the called function has too; of others ``start`` and its name."""


def in_python(text: str, side: str = "") -> str:
    """Return a sentence with settings spelled as in Python; their function is named once, last."""
    elsewhere, here = _ELSEWHERE.get(side, ""), _HERE.get(side, {"start"}) | {side}

    def spell(name: str, value: str, _own: str) -> str:
        values = " or ".join(map(repr, filter(None, value.split("|"))))
        return name + "=" * bool(value) + values + elsewhere * (name not in here)

    return only_last(with_settings(text, spell), elsewhere)


def only_last(text: str, phrase: str) -> str:
    """Return a sentence with all but the last occurrence of a phrase removed."""
    if not phrase:
        return text
    before, last, after = text.rpartition(phrase)
    return before.replace(phrase, "") + last + after


_SPELLING: ContextVar[Spelling] = ContextVar("SPELLING", default=in_python)


@contextmanager
def spelling(interface: Spelling) -> Iterator[None]:
    """Spell settings for an interface in this block, or as a decorator in a function."""
    token = _SPELLING.set(interface)
    try:
        yield
    finally:
        _SPELLING.reset(token)


def spelled(text: str, side: str = "") -> str:
    """Return a sentence on one line, with settings spelled for the current interface."""
    return plain(_SPELLING.get()(text, side))


def quoted(text: object) -> str:
    """Return text in quotes, with unprintable characters escaped."""
    return "'" + plain(text) + "'"


def plain(text: object) -> str:
    """Return text on one line, with unprintable characters escaped."""
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode()
        for character in str(text)
    )


def shown(value: object) -> str:
    """Return an argument as quoted text; for large or unusual values, only the type."""
    if isinstance(value, list | tuple) and len(value) <= MAX_LISTED:
        return quoted(",".join(map(str, value)))
    if isinstance(value, str | bytes | int):
        return quoted(value)
    text = str(value)
    simple = "\n" not in text and len(text) < MAX_SHOWN and not text.startswith("<")
    return quoted(text) if simple else f"a value of type {type(value).__name__}"


def nearest(name: str, names: Iterable[str]) -> str | None:
    """Return the most similar name, ignoring case; None if none is similar."""
    from difflib import get_close_matches

    lower = {other.lower().strip("-"): other for other in names}
    name = name.lower().strip("-")
    longer = [other for other in lower if len(name) > 1 and name in other]
    beginning = [other for other in longer if other.startswith(name)]
    near = beginning or get_close_matches(name, lower, 1, 0.7) or sorted(longer, key=len)
    return lower[near[0]] if near else None


def did_you_mean(name: str, names: Iterable[str], otherwise: str = "") -> str:
    """Return the end of a sentence that suggests a similar name, or `otherwise`."""
    near = nearest(name, names)
    remedy = otherwise if near is None else f"did you mean {quoted(near)}?"
    return f"; {remedy}" if remedy else ""


def listed(names: Iterable[object]) -> str:
    """Return names, quoted and separated by commas, at most :data:`MAX_LISTED`."""
    every = [quoted(name) for name in names]
    if len(every) <= MAX_LISTED:
        return ", ".join(every)
    return ", ".join(every[:MAX_LISTED]) + f" and {len(every) - MAX_LISTED} more"
