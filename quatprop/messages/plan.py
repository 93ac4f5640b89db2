"""Decoding plans: which bytes of a message to fetch, and how far to move.

A message consists of runs of fixed size, separated by strings and sequences whose length differs
from message to message. A :class:`Segment` is one such run: what to fetch at fixed offsets from its
beginning, and how to move from there to the next. :mod:`quatprop.messages.compiler` makes plans,
:mod:`quatprop.messages.columns` follows them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from quatprop.messages.schema import Primitive

COUNT = -1
"""Column number of a :class:`Piece` that is the number of elements that follow."""

ENCAPSULATION = -2
"""Column number of a :class:`Piece` that is the encapsulation identifier."""


class Piece(NamedTuple):
    """Numbers within a window.

    Parameters
    ----------
    column
        Number of the column.
    offset
        Where in the window, bytes.
    number
        Their type.
    length
        How many, or None for a single number (which is not a row of one).
    """

    column: int
    offset: int
    number: Primitive
    length: int | None = None

    @property
    def end(self) -> int:
        """Where the piece ends, bytes."""
        return self.offset + self.number.size * (1 if self.length is None else self.length)


class Window(NamedTuple):
    """Bytes fetched at once.

    Parameters
    ----------
    offset
        Where it begins, bytes from the beginning of the segment.
    size
        Bytes.
    pieces
        What is in it.
    """

    offset: int
    size: int
    pieces: tuple[Piece, ...]


class Skip(NamedTuple):
    """Move over the counted elements, of fixed size.

    Parameters
    ----------
    first
        Bytes of the first element, with the padding before it, by where the count ended modulo 8;
        None where it takes as many as the others.
    further
        Bytes of every other element.
    """

    first: tuple[int, ...] | None
    further: int


class Repeat(NamedTuple):
    """Move over elements of varying size, one after another in all messages at once.

    Parameters
    ----------
    element
        The plan of one element.
    length
        How many there are; None where the message counts them.
    """

    element: Plan
    length: int | None


class Segment(NamedTuple):
    """A run of fixed size, and how to reach the next segment.

    Parameters
    ----------
    alignment
        The segment begins at the next multiple of this.
    windows
        What to fetch.
    reach
        Bytes that every message must have from the beginning of the segment on.
    size
        Bytes to move on before `ending`.
    ending
        How to move on from there.
    """

    alignment: int
    windows: tuple[Window, ...]
    reach: int
    size: int
    ending: Skip | Repeat | None = None


Plan: TypeAlias = tuple[Segment, ...]
