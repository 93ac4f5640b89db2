"""How the encodings place values: alignment, and the extent of values of fixed size.

ROS 1 is packed. XCDR1 aligns every number to its size, counted from the end of the four bytes of
encapsulation; XCDR2 does the same, but to 4 at most. A struct has no alignment of its own: its
extent depends on where it begins.

References
----------
OMG DDS-XTypes 1.3, section 7.4.3 (XCDR1 and XCDR2).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

from quatprop.messages.schema import Array, Primitive, Struct, Type


class Placement(NamedTuple):
    """How an encoding places its values.

    `header`: bytes before the origin of alignment
    `alignment`: largest alignment, bytes; 1 is packed
    `delimited`: whether collections of strings or structs are preceded by their size in bytes, in
        which writers differ
    """

    header: int
    alignment: int
    delimited: bool = False


ROS1 = Placement(0, 1)
XCDR1 = Placement(4, 8)
XCDR2 = Placement(4, 4, delimited=True)


class Extents:
    """Alignments and sizes of the parts of a definition, each computed once."""

    def __init__(self, placement: Placement) -> None:
        self.placement = placement
        self.alignment = cache(self._alignment)
        self.size = cache(self._size)

    def _alignment(self, kind: Type) -> int:
        """Return the largest alignment in a value of fixed size, or 0 where its size varies."""
        match kind:
            case Primitive():
                return min(kind.size, self.placement.alignment)
            case Struct():
                parts = [self.alignment(part) for _, part in kind.fields]
                return max([1, *parts]) if all(parts) else 0
            case Array(length=0):
                return 1
            case Array():
                delimited = self.placement.delimited and not isinstance(kind.element, Primitive)
                return 0 if delimited else self.alignment(kind.element)
        return 0

    def _size(self, kind: Type, begin: int) -> int:
        """Return the bytes of a value of fixed size, with the padding before it.

        `begin`: where it begins, modulo 8: of a type there are not more sizes than that
        """
        if isinstance(kind, Primitive):
            return -begin % self.alignment(kind) + kind.size
        end = begin
        if isinstance(kind, Struct):
            for _, part in kind.fields:
                end += self.size(part, end % 8)
        elif isinstance(kind, Array) and kind.length:
            # From the second element on they lie equal distances apart, because every element
            # ends equally far behind its first most aligned number.
            end += self.size(kind.element, end % 8)
            end += (kind.length - 1) * self.size(kind.element, end % 8)
        return end - begin
