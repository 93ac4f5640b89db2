"""Compile a message type and the wanted fields into a decoding plan."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from quatprop.base.text import quoted
from quatprop.readers.messages.schema import (
    Array,
    Primitive,
    Sequence,
    String,
    Struct,
    Type,
    numeric_layout,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.readers.messages.schema import KeyPath


# Alignment and size of values in each encoding.
#
# ROS 1 is packed. XCDR1 aligns every number to its size, counted from the end of the 4-byte
# encapsulation header; XCDR2 to 4 bytes at most. A struct has no alignment of its own: its size
# depends on its offset.
#
# Reference: OMG DDS-XTypes 1.3, section 7.4.3 (XCDR1 and XCDR2).


class Placement(NamedTuple):
    """The alignment rules of an encoding.

    `header`: bytes before the origin of alignment
    `alignment`: largest alignment, bytes; 1 if packed
    `delimited`: whether the size in bytes precedes collections of strings or structs, in which
        writers differ
    """

    header: int
    alignment: int
    delimited: bool = False


ROS1 = Placement(0, 1)
XCDR1 = Placement(4, 8)
XCDR2 = Placement(4, 4, delimited=True)


class Extents:
    """Alignments and sizes of types, each computed once."""

    def __init__(self, placement: Placement) -> None:
        self.placement = placement
        self.alignment = cache(self._alignment)
        self.size = cache(self._size)

    def _alignment(self, kind: Type) -> int:
        """Return the largest alignment in a value of fixed size; 0 if its size varies."""
        match kind:
            case Primitive():
                return min(kind.size, self.placement.alignment)
            case Struct():
                parts = [self.alignment(part) for _, part in kind.fields]
                return max([1, *parts]) if all(parts) else 0
            case Array():
                delimited = self.placement.delimited and not isinstance(kind.element, Primitive)
                return 0 if delimited else self.alignment(kind.element)
        return 0

    def _size(self, kind: Type, begin: int) -> int:
        """Return the size of a value of fixed size with the padding before it, bytes.

        `begin`: offset behind the previous value, modulo 8, on which the padding depends
        """
        if isinstance(kind, Primitive):
            return -begin % self.alignment(kind) + kind.size
        end = begin
        if isinstance(kind, Struct):
            for _, part in kind.fields:
                end += self.size(part, end % 8)
        elif isinstance(kind, Array) and kind.length:
            # From the second element on all distances are equal: every element ends at the same
            # distance from its first number of the largest alignment.
            end += self.size(kind.element, end % 8)
            end += (kind.length - 1) * self.size(kind.element, end % 8)
        return end - begin


# Decoding plans: which bytes of a message to fetch and which to skip.
#
# A message consists of segments of fixed size, separated by strings and sequences whose length
# differs from message to message. A :class:`Segment` states what to fetch at fixed offsets from its
# beginning, and how to reach the next one. :mod:`quatprop.readers.messages.compiler` makes plans,
# :mod:`quatprop.readers.messages.columns` runs them.


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


MERGE_GAP = 64
"""Wanted bytes this close together are fetched in one call: copying the gap costs less."""

MAX_SEGMENTS = 10_000
"""Longer plans are refused: nested types can multiply segments without limit."""

MAX_SIZE = 1 << 30
"""Types with more fixed bytes are refused, so that offsets cannot overflow."""

_DELIMITED = (
    "a collection of strings or structs lies before or in the wanted field, which writers of XCDR2 "
    "encode in different ways"
)
_BYTE, _IDENTIFIER, _LENGTH = map(Primitive, ("u1", "u2", "u4"))


class NotPlannedError(Exception):
    """The definition does not determine the offset of a wanted field."""


@dataclass(slots=True)
class FieldTree:
    """The columns to be fetched from a field and from the fields below it."""

    columns: list[int] = field(default_factory=list)
    below: dict[str | int, FieldTree] = field(default_factory=dict)

    @classmethod
    def at(cls, key_paths: Iterable[KeyPath]) -> FieldTree:
        """Return the tree of the key paths of columns 0, 1, 2..."""
        root = cls()
        for column, key_path in enumerate(key_paths):
            here = root
            for key in key_path:
                here = here.below.setdefault(key, cls())
            here.columns.append(column)
        return root

    def under(self, key: str | int) -> FieldTree:
        """Return the tree of a field or element."""
        return self.below.get(key) or FieldTree()


@lru_cache(maxsize=256)
def compile_plan(root: Struct, key_paths: tuple[KeyPath, ...], placement: Placement) -> Plan:
    """Return the plan that fetches some fields of a message type."""
    compiler = _Compiler(Extents(placement), itertools.count(), len(key_paths))
    compiler.begin()
    compiler.walk(root, FieldTree.at(key_paths))
    compiler.close()
    return tuple(compiler.segments)


class _Compiler:
    """Walks a type and collects segments.

    The current position is `size` bytes behind the beginning of the open segment, whose offset from
    the origin of alignment is `phase` plus a multiple of `aligned_to`.
    """

    def __init__(self, extents: Extents, budget: Iterator[int], fields_left: int) -> None:
        self.extents = extents
        self.placement = extents.placement
        self.budget = budget
        self.fields_left = fields_left
        self.segments: list[Segment] = []
        self.pieces: list[Piece] = []
        self.phase = 0
        self.size = 0
        self.aligned_to = 1
        self.alignment = 1

    def begin(self) -> None:
        """Begin at the start of a message."""
        self.aligned_to = self.placement.alignment
        if self.placement.header:
            self.phase = -self.placement.header
            self.pieces.append(Piece(ENCAPSULATION, 0, _IDENTIFIER))
            self.size = self.placement.header

    def walk(self, kind: Type, wanted: FieldTree) -> None:
        """Fetch the wanted fields of a value; move behind it if more fields are wanted."""
        if wanted.columns:
            self._take(kind, wanted.columns)
        if not self.fields_left:
            return
        if not wanted.below and 0 < self.extents.alignment(kind) <= self.aligned_to:
            self._skip(kind, 1)
        elif isinstance(kind, Struct):
            for name, part in kind.fields:
                self.walk(part, wanted.under(name))
                if not self.fields_left:
                    return
        elif isinstance(kind, Array):
            self._array(kind, wanted)
        elif isinstance(kind, Sequence):
            self._refuse_delimited(kind.element)
            self._skip_sequence(kind.element)
        elif isinstance(kind, Primitive):
            self._align(kind.size)
            self.size += kind.size
        elif isinstance(kind, String) and not kind.wide:
            self._skip_sequence(_BYTE)
        else:
            name = "wstring" if isinstance(kind, String) else kind.name
            raise NotPlannedError(
                f"a field of type {quoted(name)} lies before the wanted one, and how many bytes "
                "it takes is not known"
            )

    def close(self, ending: Skip | Repeat | None = None) -> None:
        """End the open segment and begin another, of unknown alignment."""
        reach = max([self.size, *(piece.end for piece in self.pieces)])
        if reach > MAX_SIZE or next(self.budget) >= MAX_SEGMENTS:
            raise NotPlannedError("the definition is larger than any message")
        windows = _windows(self.pieces)
        self.segments.append(Segment(self.alignment, windows, reach, self.size, ending))
        self.pieces = []
        self.phase = self.size = 0
        self.aligned_to = self.alignment = 1

    def _take(self, kind: Type, columns: list[int]) -> None:
        shape = numeric_layout(kind)
        if shape is None or not self.extents.alignment(kind):
            raise NotPlannedError(_DELIMITED)
        number, count = shape
        self._align(number.size)
        length = None if isinstance(kind, Primitive) else count
        self.pieces += [Piece(column, self.size, number, length) for column in columns]
        self.fields_left -= len(columns)

    def _array(self, kind: Array, wanted: FieldTree) -> None:
        """Walk the elements that have wanted fields, and skip the others."""
        self._refuse_delimited(kind.element)
        stops = {key for key in wanted.below if isinstance(key, int)}
        if self.extents.alignment(kind) and kind.length:
            # Behind the first element the alignment is known: the others are equal distances apart.
            stops.add(0)
        passed = 0
        for stop in sorted(stops):
            self._skip(kind.element, stop - passed)
            self.walk(kind.element, wanted.under(stop))
            if not self.fields_left:
                return
            passed = stop + 1
        self._skip(kind.element, kind.length - passed)

    def _skip(self, element: Type, count: int) -> None:
        """Skip elements of fixed size that are aligned already, or elements of varying size."""
        if not count:
            return
        if self.extents.alignment(element):
            self.size += self.extents.size(Array(element, count), (self.phase + self.size) % 8)
        else:
            self.close(Repeat(self._element(element), count))

    def _skip_sequence(self, element: Type) -> None:
        """Skip a sequence, whose length each message states."""
        self._align(4)
        self.pieces.append(Piece(COUNT, self.size, _LENGTH))
        self.size += 4
        if not self.extents.alignment(element):
            self.close(Repeat(self._element(element), None))
            return
        first = tuple(self.extents.size(element, begin) for begin in range(8))
        further = self.extents.size(element, first[0] % 8)
        if max(*first, further) > MAX_SIZE:
            raise NotPlannedError("the definition is larger than any message")
        # The count ends at a multiple of 4, unless the encoding is packed.
        ends = (0, 4) if self.placement.alignment > 1 else range(8)
        padded = any(first[end] != further for end in ends)
        self.close(Skip(first if padded else None, further))
        # So the alignment behind the sequence is known, with or without elements.
        self.aligned_to = math.gcd(4, further, *(end + first[end] for end in ends))
        self.aligned_to = min(self.aligned_to, self.placement.alignment)

    def _element(self, element: Type) -> Plan:
        """Return the plan of one element at any offset."""
        inner = _Compiler(self.extents, self.budget, 1)
        inner.walk(element, FieldTree())
        inner.close()
        return tuple(inner.segments)

    def _refuse_delimited(self, element: Type) -> None:
        if self.placement.delimited and not isinstance(element, Primitive):
            raise NotPlannedError(_DELIMITED)

    def _align(self, to: int) -> None:
        to = min(to, self.placement.alignment)
        if to > self.aligned_to:
            if self.size or self.pieces:
                self.close()
            self.alignment = self.aligned_to = to
        self.size += -(self.phase + self.size) % to


def _windows(pieces: list[Piece]) -> tuple[Window, ...]:
    """Return few windows that contain all pieces and no large gaps."""
    windows: list[Window] = []
    for piece in sorted(pieces, key=lambda piece: piece.offset):
        if not windows or piece.offset > windows[-1].offset + windows[-1].size + MERGE_GAP:
            windows.append(Window(piece.offset, 0, ()))
        last = windows[-1]
        inside = Piece(piece.column, piece.offset - last.offset, piece.number, piece.length)
        size = max(last.size, inside.end)
        windows[-1] = Window(last.offset, size, (*last.pieces, inside))
    return tuple(windows)
