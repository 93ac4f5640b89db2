"""Decoding plans: which bytes of a message to fetch and which to skip.

A message consists of segments of fixed size, separated by strings and sequences whose length
differs from message to message. A :class:`Segment` states what to fetch at fixed offsets from its
beginning, and how to reach the next one. :mod:`quatprop.messages.compiler` makes plans,
:mod:`quatprop.messages.columns` runs them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from quatprop.messages.schema import Primitive

COUNT = -1
"""Column number of a :class:`Piece` that holds the number of elements that follow."""

ENCAPSULATION = -2
"""Column number of a :class:`Piece` that holds the encapsulation identifier."""


class Piece(NamedTuple):
    """One or several adjacent numbers in a window.

    `offset`: from the beginning of the window, bytes
    `length`: number of numbers; None for a single number (rather than a row of one)
    """

    column: int
    offset: int
    number: Primitive
    length: int | None = None

    @property
    def end(self) -> int:
        """Offset behind the piece, bytes."""
        return self.offset + self.number.size * (1 if self.length is None else self.length)


class Window(NamedTuple):
    """Bytes that are fetched in one call.

    `offset`: from the beginning of the segment, bytes
    `size`: bytes
    """

    offset: int
    size: int
    pieces: tuple[Piece, ...]


class Skip(NamedTuple):
    """Skip a counted number of elements of fixed size.

    `first`: bytes of the first element with the padding before it, by the offset behind the count
        modulo 8; None if always as many as `further`
    `further`: bytes of every other element
    """

    first: tuple[int, ...] | None
    further: int


class Repeat(NamedTuple):
    """Skip elements of varying size, one after another, in all messages at once.

    `length`: number of elements; None if the message states it
    """

    element: Plan
    length: int | None


class Segment(NamedTuple):
    """A part of a message of fixed size, and how to reach the next segment.

    `alignment`: the segment begins at the next multiple of this, bytes
    `reach`: bytes that every message must have from the beginning of the segment on
    `size`: bytes before `ending`
    `ending`: the elements to skip before the next segment, if any
    """

    alignment: int
    windows: tuple[Window, ...]
    reach: int
    size: int
    ending: Skip | Repeat | None = None


Plan: TypeAlias = tuple[Segment, ...]
