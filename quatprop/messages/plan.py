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

    `offset`: where in the window, bytes
    `length`: how many, or None for a single number (which is not a row of one)
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

    `offset`: where it begins, bytes from the beginning of the segment
    `size`: bytes
    """

    offset: int
    size: int
    pieces: tuple[Piece, ...]


class Skip(NamedTuple):
    """Move over the counted elements, of fixed size.

    `first`: bytes of the first element, with the padding before it, by where the count ended modulo
        8; None where it takes as many as the others
    `further`: bytes of every other element
    """

    first: tuple[int, ...] | None
    further: int


class Repeat(NamedTuple):
    """Move over elements of varying size, one after another in all messages at once.

    `length`: how many there are; None where the message counts them
    """

    element: Plan
    length: int | None


class Segment(NamedTuple):
    """A run of fixed size, and how to reach the next segment.

    `alignment`: the segment begins at the next multiple of this
    `reach`: bytes that every message must have from the beginning of the segment on
    `size`: bytes to move on before `ending`
    `ending`: how to move on from there
    """

    alignment: int
    windows: tuple[Window, ...]
    reach: int
    size: int
    ending: Skip | Repeat | None = None


Plan: TypeAlias = tuple[Segment, ...]
