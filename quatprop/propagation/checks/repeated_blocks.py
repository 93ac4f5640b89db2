"""Blocks of rows that are exact copies of rows before, with new times.

A buffer that is sent again and files that overlap repeat even the noise, which a sensor does not.
No sample is changed here; the finding is one sentence with its place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.text import Remark
from quatprop.propagation.checks.samples import NEIGHBOURS, Samples, Stretch, has_noise

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from quatprop.base.arrays import Bool, Float64, Intp


FEWEST = 10
"""Fewest rows of a copy: noise of a step repeats so many on two axes by chance of 1e-11."""

CHANGING = 0.8
"""Smallest share of them that differ from the row before; others are held."""

NOISY_AXES = 2
"""Fewest axes with noise next to them, so that no motion returns to the same rates."""

MOST_LAGS = 128
"""Distances from rows to their copies that are looked at; more are of a coarse sensor at rest."""

HALF = 0.5
"""Share of rows that are the same once more, of a motion that returns."""

ENOUGH = 1000
"""So many copies are enough to know."""

_ODD = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
_PICKED = np.uint64(1 << 58)
"""Products below it are those of one row in 64, the same ones wherever they stand: of a copy of 50
rows, half are found, of 200 rows nearly all."""


class RepeatedBlocks:
    """Finds blocks that repeat rows of the same block of samples or the one before."""

    def __init__(self) -> None:
        self._before = Samples()
        self._keys, self._places = np.empty(0, np.uint64), np.empty(0, np.intp)
        self._found: Stretch | None = None

    def add(self, samples: Samples) -> None:
        """Add new samples; they are kept, not copied."""
        if self._found is not None and self._found.times >= ENOUGH:
            return
        bits = samples.columns.view(np.uint64)
        places = np.flatnonzero((bits[0] + bits[1]) * _ODD[0] < _PICKED)
        keys = (bits[:, places] * _ODD[:, None]).sum(axis=0)
        every_keys = np.concatenate([self._keys, keys])
        ordered = np.sort(every_keys)
        if (ordered[1:] == ordered[:-1]).any():
            self._look(samples, every_keys, places)
        self._keys, self._places = keys, places
        self._before = samples

    def _look(self, samples: Samples, every_keys: NDArray[np.uint64], places: Intp) -> None:
        """Note the copies to which rows with the same key belong.

        `every_keys`: of the picked rows before, then of those in `samples`, which are at `places`
        """
        seen = self._before.size
        order = np.argsort(every_keys, kind="stable")
        same = np.flatnonzero(every_keys[order[1:]] == every_keys[order[:-1]])
        every_places = np.concatenate([self._places, places + seen])
        firsts, seconds = every_places[order[same]], every_places[order[same + 1]]
        is_new = seconds >= seen
        firsts, seconds = firsts[is_new], seconds[is_new]
        if not 0 < len(np.unique(seconds - firsts)) <= MOST_LAGS:
            return
        every, every_ns = samples.after(self._before)
        ends: dict[int, int] = {}
        for first, second in sorted(zip(firsts.tolist(), seconds.tolist(), strict=True)):
            lag = second - first
            if ends.get(lag, -1) > second:
                continue
            back = _equal_rows(every[:, : first + 1][:, ::-1], every[:, : second + 1][:, ::-1])
            begin = second - back + 1
            end = second + _equal_rows(every[:, first:], every[:, second:])
            ends[lag] = end
            if back and _is_copy(every, begin, end, lag):
                first_ns, last_ns, origin_ns = every_ns[[begin, end - 1, begin - lag]].tolist()
                found = Stretch(first_ns, last_ns, end - begin, origin_ns=origin_ns)
                self._found = found.after(self._found)

    def remarks(self) -> Iterator[Remark]:
        """Yield a sentence if rows are copies of others."""
        if (found := self._found) is None:
            return
        yield Remark(
            "repeated-rows",
            f"{found.samples} rows from t = {found.begin_ns} ns on are those from t = "
            f"{found.origin_ns} ns on, with their noise{found.often}: were they recorded twice, or "
            "joined from files that overlap? leave one copy out, and keep the times of the other",
        )


def _equal_rows(one: Float64, other: Float64) -> int:
    """Return how many rows from the first on are equal."""
    count = min(int(one.shape[1]), int(other.shape[1]))
    for size in (NEIGHBOURS, count):
        part = min(size, count)
        differs: Bool = (one[:, :part] != other[:, :part]).any(axis=0)
        if differs.any():
            return int(differs.argmax())
    return count


def _is_copy(every: Float64, begin: int, end: int, lag: int) -> bool:
    """Return whether rows ``[begin, end)`` repeat those `lag` before, and the noise of these."""
    rows = every[:, begin:end]
    count = rows.shape[1]
    if count < FEWEST or (rows[:, 1:] != rows[:, :-1]).any(axis=0).mean() < CHANGING:
        return False
    # A vibration without noise returns again and again.
    further = every[:, max(begin - 2 * lag, 0) : begin - 2 * lag + count]
    beyond = every[:, begin + lag : end + lag]
    pairs = [(further, rows), (beyond, rows), (rows[:, lag:], rows[:, :-lag])]
    for one, other in pairs:
        if 0 < one.shape[1] == other.shape[1] and (one == other).all(axis=0).mean() > HALF:
            return False
    middle = begin - lag + count // 2
    near = every[:, max(middle - NEIGHBOURS // 2, 0) : middle + NEIGHBOURS // 2]
    return bool(np.count_nonzero(has_noise(near)) >= NOISY_AXES)
