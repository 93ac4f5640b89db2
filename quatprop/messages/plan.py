"""What a message type is to the machine: which bytes to fetch, how far to move.

A message is a row of runs at distances known beforehand, parted by strings and sequences whose
length each message says for itself. A :class:`Segment` is one such run: what to fetch at fixed
distances from where it begins, and how to get from there to the next one.
:mod:`quatprop.messages.compiler` makes plans, :mod:`quatprop.messages.columns` follows them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from quatprop.messages.schema import Primitive

COUNT = -1
"""The column of a :class:`Piece` that is the length of what follows."""

ENCAPSULATION = -2
"""The column of a :class:`Piece` that says how the message is encoded."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Numbers within a window.

    Parameters
    ----------
    column
        Which column they are.
    offset
        Where in the window, bytes.
    number
        Their type.
    count
        How many, or None for one that is not a row of one.
    """

    column: int
    offset: int
    number: Primitive
    count: int | None = None

    @property
    def end(self) -> int:
        """Where the piece ends, bytes."""
        return self.offset + self.number.size * (1 if self.count is None else self.count)


@dataclass(frozen=True, slots=True)
class Window:
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


@dataclass(frozen=True, slots=True)
class Skip:
    """Move over as many elements of fixed size as were counted.

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


@dataclass(frozen=True, slots=True)
class Repeat:
    """Walk elements of varying size, one after another in all messages at once.

    Parameters
    ----------
    element
        The way over one element.
    count
        How many there are; None where they were counted.
    """

    element: Plan
    count: int | None


@dataclass(frozen=True, slots=True)
class Segment:
    """Fixed distances, and the way to the next segment.

    Parameters
    ----------
    alignment
        The segment begins at the next multiple of this.
    windows
        What to fetch.
    reach
        Bytes that every message must still have from the beginning of the segment.
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
