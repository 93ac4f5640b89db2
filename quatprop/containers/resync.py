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
    """Return where the first record begins that is accepted as one; None where there is none.

    Parameters
    ----------
    read
        Reads so many bytes from a place.
    within
        Where a candidate may begin, where it may not any more, and the bytes that it needs behind.
    candidates
        Where in some bytes a record may be.
    accepted
        Where the record begins that is at a candidate; None where there is none.
    tries
        After so many candidates the search is given up, so that it ends on hostile files.
    """
    start, stop, behind = within
    for begin in range(start, stop, WINDOW):
        for place in candidates(read(begin, min(WINDOW, stop - begin) + behind)):
            record = accepted(begin + place)
            tries -= 1
            if record is not None or tries == 0:
                return record
    return None
