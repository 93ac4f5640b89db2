"""Search for the next record of a damaged log, for all record formats."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

WINDOW = 1 << 22
"""Bytes searched at a time."""


def first_accepted(
    read: Callable[[int, int], bytes],
    within: tuple[int, int, int],
    candidates: Callable[[bytes], Iterable[int]],
    accepted: Callable[[int], int | None],
    tries: int,
) -> int | None:
    """Return the offset of the first record that is accepted; None if there is none.

    `within`: the range of offsets to search, and the bytes that a candidate may extend behind it
    `candidates`: finds the offsets of candidates in some bytes
    `accepted`: returns the offset of the record at a candidate's offset; None if there is none
    `tries`: number of candidates after which the search ends
    """
    start, stop, behind = within
    for begin in range(start, stop, WINDOW):
        for place in candidates(read(begin, min(WINDOW, stop - begin) + behind)):
            record = accepted(begin + place)
            tries -= 1
            if record is not None or tries == 0:
                return record
    return None
