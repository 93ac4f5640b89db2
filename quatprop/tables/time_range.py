"""Ranges of time, and when the parts of a log were recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Sequence


class TimeRange(NamedTuple):
    """A range of time, ends included.

    `first_ns`, `last_ns`: its ends, ns
    """

    first_ns: int
    last_ns: int

    @property
    def length_ns(self) -> int:
        """Its length, ns."""
        return self.last_ns - self.first_ns

    def overlaps(self, first_ns: int, last_ns: int) -> bool:
        """Return whether it has a moment in common with another range, given by its ends."""
        return first_ns <= self.last_ns and self.first_ns <= last_ns


class TimedPart(Protocol):
    """A part of a log, such as a chunk.

    `first_ns`, `last_ns`: Log times of its earliest and latest message, ns; the latest is None
        where it is unknown
    """

    first_ns: int
    last_ns: int | None


Part = TypeVar("Part", bound=TimedPart)


def span_of(parts: Sequence[TimedPart]) -> TimeRange | None:
    """Return when parts in order of time were recorded; None where that is not known of each."""
    last = [part.last_ns for part in parts if part.last_ns is not None]
    if not parts or len(last) < len(parts):
        return None
    return TimeRange(parts[0].first_ns, max(last))


def parts_within(parts: Sequence[Part], within: TimeRange) -> list[Part]:
    """Return the parts that overlap a range, or may."""
    return [p for p in parts if p.last_ns is None or within.overlaps(p.first_ns, p.last_ns)]
