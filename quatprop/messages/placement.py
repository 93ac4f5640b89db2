"""Alignment and size of values in each encoding.

ROS 1 is packed. XCDR1 aligns every number to its size, counted from the end of the 4-byte
encapsulation header; XCDR2 to 4 bytes at most. A struct has no alignment of its own: its size
depends on its offset.

References
----------
OMG DDS-XTypes 1.3, section 7.4.3 (XCDR1 and XCDR2).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

from quatprop.messages.schema import Array, Primitive, Struct, Type


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
