"""Sentences for users: settings that each interface spells in its own way, and safe quoting.

A sentence is plain text. A setting in it is a mark, which is spelled where the text leaves the
program: ``clock='log'`` in Python, ``--clock log`` on the command line, ``clock = "log"`` in a
suite.
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    Spelling = Callable[[str, str], str]
    """Returns a sentence as an interface spells it, and what the second argument says: of which of
    several inputs its settings are."""

MAX_LISTED = 12
"""Names listed one by one before "and N more"."""

MAX_SHOWN = 60
"""Characters of a value that are shown as they are."""

MARK = "\ue000"
"""How the mark of a setting begins."""

_MARK = re.compile("\ue000([^\ue000-\ue002]*)\ue002([^\ue000-\ue002]*)\ue002(\\w*)\ue001")
"""A setting in a sentence: :func:`quoted` and :func:`plain` let no such characters pass."""


def Setting(name: str, value: str = "", side: str = "") -> str:  # noqa: N802  # the mark's name
    """Return the mark of a setting, to be mentioned in a sentence.

    `name`: the parameter of the library, such as ``"on_backwards"``
    `value`: what it could be set to, such as ``"log"``; alternatives with ``|`` between them. Empty
        where only the choice is mentioned
    `side`: of which input, where a command has two: ``"a"`` or ``"b"``
    """
    return f"\ue000{name}\ue002{value}\ue002{side}\ue001"


def with_settings(text: str, spell: Callable[[str, str, str], str]) -> str:
    """Return a sentence whose marks a function has replaced by name, value and side."""
    return _MARK.sub(lambda mark: spell(*mark.groups()), text)


class Remark(str):
    """A sentence about a log or a result that a reader should know.

    `code`: names what it says; it stays when the sentence changes
    """

    __slots__ = ("code",)

    code: str

    def __new__(cls, code: str, text: str) -> Self:
        """Return a sentence with its code."""
        remark = super().__new__(cls, text)
        remark.code = code
        return remark

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        """Return what a copy in another process is made of."""
        return self.code, str(self)

    def spelled(self, spell: Callable[[str], str]) -> Remark:
        """Return the remark as an interface spells it."""
        return Remark(self.code, spell(self))


_ELSEWHERE = {"a": " of read_attitudes", "b": " of read_attitudes"} | dict.fromkeys(
    ("at", "q0"), " of convert"
)
"""Functions with the settings of inputs that a function of the library only names."""


def in_python(text: str, side: str = "") -> str:
    """Return a sentence as the library spells settings; whose they are is said after the last."""
    elsewhere = _ELSEWHERE.get(side, "")

    def spell(name: str, value: str, _own: str) -> str:
        values = " or ".join(map(repr, filter(None, value.split("|"))))
        return name + "=" * bool(value) + values + elsewhere * (name != "start")

    return said_once(with_settings(text, spell), elsewhere)


def said_once(text: str, phrase: str) -> str:
    """Return a sentence that has a phrase only where it had it last."""
    if not phrase:
        return text
    before, last, after = text.rpartition(phrase)
    return before.replace(phrase, "") + last + after


_SPELLING: ContextVar[Spelling] = ContextVar("SPELLING", default=in_python)


@contextmanager
def spelling(interface: Spelling) -> Iterator[None]:
    """Spell sentences as an interface does in this block, or in a function that this decorates."""
    token = _SPELLING.set(interface)
    try:
        yield
    finally:
        _SPELLING.reset(token)


def spelled(text: str, side: str = "") -> str:
    """Return a sentence on one line, as the interface spells it that runs."""
    return plain(_SPELLING.get()(text, side))


def quoted(text: object) -> str:
    """Return `text` in quotes, with everything unprintable escaped."""
    return "'" + plain(text) + "'"


def plain(text: object) -> str:
    """Return `text` on one line with everything unprintable escaped, without quotes."""
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode()
        for character in str(text)
    )


def shown(value: object) -> str:
    """Return a value that was given, quoted; of what is large or unusual, its type alone."""
    if isinstance(value, list | tuple) and len(value) <= MAX_LISTED:
        return quoted(",".join(map(str, value)))
    if value is None or isinstance(value, str | bytes | int | float):
        return quoted(value)
    text = str(value)
    simple = "\n" not in text and len(text) < MAX_SHOWN and not text.startswith("<")
    return quoted(text) if simple else f"a value of type {type(value).__name__}"


def nearest(name: str, names: Iterable[str]) -> str | None:
    """Return the name that was probably meant, whatever its case; None if none is like it."""
    from difflib import get_close_matches

    lower = {other.lower().strip("-"): other for other in names}
    name = name.lower().strip("-")
    longer = [other for other in lower if len(name) > 1 and name in other]
    beginning = [other for other in longer if other.startswith(name)]
    near = beginning or get_close_matches(name, lower, 1, 0.7) or sorted(longer, key=len)
    return lower[near[0]] if near else None


def did_you_mean(name: str, names: Iterable[str], otherwise: str = "") -> str:
    """Return the end of a sentence: which name was probably meant, or `otherwise`."""
    near = nearest(name, names)
    way_out = otherwise if near is None else f"did you mean {quoted(near)}?"
    return f"; {way_out}" if way_out else ""


def listed(names: Iterable[object]) -> str:
    """Return names quoted and separated by commas, cut after :data:`MAX_LISTED`."""
    every = [quoted(name) for name in names]
    if len(every) <= MAX_LISTED:
        return ", ".join(every)
    return ", ".join(every[:MAX_LISTED]) + f" and {len(every) - MAX_LISTED} more"
