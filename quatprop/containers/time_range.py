"""A range of time."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TimeRange:
    """A range of time, ends included.

    Parameters
    ----------
    first_ns, last_ns
        Its ends, ns.
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
