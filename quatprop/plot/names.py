"""What files are called, and what is said below a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.containers.base import Loss
    from quatprop.text import Text

NOTES = 3
"""Warnings that stand below a picture; a report has all of them."""


def names_of(paths: Iterable[str]) -> list[str]:
    """Return what files are called: their own names, or their paths where those are the same.

    Examples
    --------
    >>> names_of(["runs/a.csv", "b.csv"]), names_of(["1/a.csv", "2/a.csv"])
    (['a.csv', 'b.csv'], ['1/a.csv', '2/a.csv'])
    """
    paths = list(paths)
    own = ["stdin" if path == "-" else Path(path).name for path in paths]
    return [
        plain(path if own.count(name) > 1 else name) for path, name in zip(paths, own, strict=True)
    ]


def lost_text(losses: Iterable[Loss]) -> Iterator[str]:
    """Yield what could not be read of a damaged file."""
    yield from (f"lost: {loss.place}: {loss.reason}" for loss in losses)


def noted(warnings: tuple[str | Text, ...]) -> tuple[str, ...]:
    """Return what stands below a picture.

    Examples
    --------
    >>> noted(("one", "two", "three", "four"))
    ('one', 'two', 'and 2 more warnings')
    """
    if len(warnings) <= NOTES:
        return tuple(map(str, warnings))
    kept = tuple(map(str, warnings[: NOTES - 1]))
    return (*kept, f"and {len(warnings) - len(kept)} more warnings")
