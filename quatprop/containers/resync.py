"""The search for the next record of a damaged log, whichever grammar its records have."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

WINDOW = 1 << 22
"""Bytes that are searched at a time."""


def first_accepted(
    read: Callable[[int, int], bytes],
    within: tuple[int, int, int],
    candidates: Callable[[bytes], Iterable[int]],
    accepted: Callable[[int], int | None],
    tries: int,
) -> int | None:
    """Return where the first record begins that is accepted as one; None if there is none.

    `accepted`: where the record begins that is at a candidate; None if there is none
    """
    start, stop, behind = within
    for begin in range(start, stop, WINDOW):
        for place in candidates(read(begin, min(WINDOW, stop - begin) + behind)):
            record = accepted(begin + place)
            tries -= 1
            if record is not None or tries == 0:
                return record
    return None
