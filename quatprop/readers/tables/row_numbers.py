"""Numbers of rows, watched from the first to the last: where they miss, rows are missing in time.

Rows that are counted at a sample rate take the same time each. A column of their numbers, such as
the index of pandas or the number of a packet, tells whether all are there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa

from quatprop.base.arrow_arrays import to_numpy
from quatprop.readers.tables.table_log import counted, counting, numbers_of
from quatprop.readers.tables.turns import ColumnWatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.base.arrays import Bool, Float64, Int64, Intp
    from quatprop.readers.tables.other_clocks import SampledTimes
    from quatprop.readers.tables.turns import RowWatch

_LEARNT = 1000
"""Rows that show how a column counts."""

_SHORT = 8
"""Rows of damaged or swapped numbers, after which they go on as before."""

_WRAPS = 0.9
"""Share of the steps back of one size, of numbers that begin anew after a certain one."""

_WHOLE = 0.9
"""Share of the packets that have the usual number of rows."""

_FEW = 20
"""Of numbers of rows, at most one in so many does not go on, or with times so many in all."""

_STRETCHES = 8
"""Fewest stretches between sampled times that show whether these go on evenly."""

_NEARBY = 2
"""Stretches on either side of numbers that are passed over, in which their time may be."""

_BEAT = 2
"""Rows by which the distances differ between numbers that are repeated at a beat."""

_RANGES = (1 << 8, 1 << 16, 1 << 32)
"""Numbers that there are in so many bits."""

_MOST = 10_000
"""Changes of the difference of number and row, from which on an irregular column is watched no
further."""

_LARGEST = 1e15
"""Larger numbers do not count rows."""


class Place(NamedTuple):
    """How often something is in a column, and the first row where it is, from 1; 0: nowhere."""

    numbers: int = 0
    times: int = 0
    row: int = 0


class Breaks(NamedTuple):
    """Where numbers of rows do not go on.

    `step`: the usual step
    `rows`: number of rows with the same number, as in packets; usually 1
    `interval_ns`: usual interval between rows, ns, if their times are used; else 0
    `share`: share of the numbers before which some are passed over
    `uneven`: where they do not, of too many places to tell why; `numbers`: of the rows looked at
    """

    step: int
    rows: int
    missed: Place
    repeated: Place
    stepped_back: Place
    interval_ns: float = 0
    share: float = 0
    uneven: Place = Place()

    def __str__(self) -> str:
        """Return what the numbers do, as the end of a sentence."""
        many, times, row = self.uneven
        if times:
            return f"steps unevenly in {times} of its first {many} rows, first in row {row}"
        many, times, row = self.missed
        said = []
        if times:
            where = f" before row {row}"
            where = f" in {times} places, first{where}" if times > 1 else where
            said.append(f"passes over {many} number{'s' * (many > 1)}{where}")
        if times := self.repeated.times:
            first = ", first" * (times > 1)
            what = f"repeats {times} number{'s' * (times > 1)}"
            said.append(f"{what}{first} in row {self.repeated.row}")
        if times := self.stepped_back.times:
            often = f"{times} times, first" if times > 1 else "once,"
            said.append(f"steps back {often} in row {self.stepped_back.row}")
        return ", and ".join(said)


class NumberedRows(NamedTuple):
    """A column of numbers to watch while a table is read.

    `found`: called once, at the end, if they do not all go on
    `times`: those of the rows, if these are used: only numbers are found that the times pass
        over, too; None: rows are counted
    """

    column: int
    found: Callable[[Breaks], None]
    times: SampledTimes | None = None

    def watch(self, rows: RowWatch) -> NumberWatch:
        """Return what watches it in one reading of the table."""
        return NumberWatch(self, rows)


class NumberWatch(ColumnWatch):
    """Watches the numbers of rows, and reports at the end where they do not go on.

    Number and row increase together: their difference changes where rows are missing, and stays
    where a row was lost to damage, or a number is wrong.
    """

    of_whole_rows = False

    def __init__(self, watched: NumberedRows, rows: RowWatch) -> None:
        self._found = watched.found
        self._times = watched.times.samples(rows) if watched.times else None
        self._numbers: list[Float64] = []
        self._places: list[Intp] = []
        self._waiting = 0
        self._step = self._rows = self._highest = 0
        self._before: tuple[int, int] | None = None
        # Where the difference changes, and what it is from there on.
        self._begins: list[Int64] = []
        self._differences: list[Int64] = []
        self._changes = self._end = 0
        self._most = _FEW if self._times else _MOST

    def see_values(self, values: pa.Array | pa.ChunkedArray, places: Intp) -> None:
        """Add cells of further rows."""
        self.add(_numbers(values), places)

    def add(self, numbers: Float64, places: Intp) -> None:
        """Add numbers of rows; NaN for cells without one."""
        self._numbers.append(numbers)
        self._places.append(places)
        self._waiting += len(numbers)
        if self._waiting >= _LEARNT:
            self._look()

    def finish(self) -> None:
        """Report where the numbers do not go on."""
        if self._waiting:
            self._look()
        if self._begins:
            begins, differences = np.concatenate(self._begins), np.concatenate(self._differences)
            count = np.arange(len(begins))
            if len(ends := np.flatnonzero((count >= self._most) & (begins < _FEW * count))):
                if self._times:
                    return  # it counts something else
                self._end = int(begins[ends[0]])
                begins, differences = begins[: ends[0]], differences[: ends[0]]
            breaks = self._breaks(begins, differences)
            share = breaks.missed.times / max(self._before[1] if self._before else 0, 1)
            breaks = breaks._replace(share=share)
            if any(each.times for each in breaks if isinstance(each, Place)):
                self._found(breaks)

    def _look(self) -> None:
        """Look at the rows that are waiting."""
        numbers, places = np.concatenate(self._numbers), np.concatenate(self._places)
        self._numbers, self._places, self._waiting = [], [], 0
        is_number = np.isfinite(numbers) & (np.abs(numbers) < _LARGEST)
        numbers, places = numbers[is_number], places[is_number]
        if self.is_over or not len(numbers):
            return
        if not self._step and not self._learn(numbers[:_LEARNT]):
            self.is_over = True
            return
        values, places = numbers.astype(np.int64), places.astype(np.int64)
        self._highest = max(self._highest, int(values.max()))
        last = None if self._before is None else self._before[1]
        counts = counted(values, self._before)
        self._before = int(values[-1]), int(counts[-1])
        if self._rows > 1:
            # The rows of a packet after its first say nothing.
            is_first = np.diff(counts, prepend=counts[0] - 1 if last is None else last) != 0
            counts, places = counts[is_first], places[is_first]
        differences = self._rows * counts - self._step * places
        known = self._differences[-1][-1:] if self._differences else differences[:1] - 1
        changes = np.diff(differences, prepend=known) != 0
        self._end = int(places[-1]) + 1
        if changes.any():
            self._begins.append(places[changes])
            self._differences.append(differences[changes])
            self._changes += int(np.count_nonzero(changes))
            self.is_over = self._changes > max(self._most, self._end // _FEW)

    def _learn(self, numbers: Float64) -> bool:
        """Learn from the first rows how the numbers count, and return whether they do."""
        how = counting(numbers)
        if how is not None:
            self._step, self._rows = 1 if how.is_by_one else how.step, 1
            return True
        # Neither the first nor the last packet may be whole.
        begins = np.flatnonzero(np.diff(numbers))[:-1] + 1
        sizes = np.diff(begins)
        how = counting(numbers[begins]) if len(begins) > 2 else None  # noqa: PLR2004
        usual = int(np.median(sizes)) if len(sizes) else 0
        self._step, self._rows = 1, usual
        if how is None or not how.is_by_one or not usual:
            return False
        if usual == 1:
            # Numbers of a slower sensor are repeated at a beat, rows that were written twice not.
            return bool(np.ptp(np.diff(np.flatnonzero(np.diff(numbers) == 0))) > _BEAT)
        return bool(np.mean(sizes == usual) >= _WHOLE)

    def _breaks(self, begins: Int64, differences: Int64) -> Breaks:
        """Return where numbers do not go on; what lasts for a few rows only is left out."""
        kept = [0]
        k, count = 1, len(begins)
        while k < count:
            near = int(np.searchsorted(begins, begins[k] + _SHORT, "right"))
            again = np.flatnonzero(differences[k + 1 : near] == differences[kept[-1]])
            if len(again):
                k += int(again[0]) + 2
                continue
            kept.append(k)
            k += 1
        rows = begins[kept[1:]] + 1
        changes = self._without_wraps(np.diff(differences[kept]))
        size = max(self._step, self._rows)
        if self._step == 1 and self._highest + 1 in _RANGES:
            # A number that fills its bits begins anew, and does not step back.
            changes += (self._highest + 1) * self._rows * (changes < -_SHORT * size)
        if self._times is not None:
            return self._unlike_times(rows, changes, size)
        missed = _place(rows, changes // size, changes >= size if self._rows > 1 else changes > 0)
        repeated = _place(rows, 0 * changes, (changes < 0) & (changes >= -size) & (self._rows == 1))
        back = _place(rows, 0 * changes, changes < -size)
        is_one_way = not back.times and not (missed.times and repeated.times)
        is_irregular = count > max(_FEW, self._end // _FEW)
        if is_irregular and (count >= _MOST or not is_one_way):
            uneven = Place(self._end, count - 1, int(begins[1]) + 1)
            return Breaks(self._step, self._rows, Place(), Place(), Place(), uneven=uneven)
        return Breaks(self._step, self._rows, missed, repeated, back)

    def _unlike_times(self, rows: Int64, changes: Int64, size: int) -> Breaks:
        """Return where numbers are passed over, though the times go on as if none were.

        `changes`: of the difference of number and row, in the rows `rows`, counted from 1
        """
        places, times = self._times() if self._times else (rows, None)
        none = Breaks(self._step, self._rows, Place(), Place(), Place())
        if times is None or not len(times):
            return none
        places, times = places[known := np.isfinite(times)], times[known]
        passed = np.concatenate([[0.0], np.cumsum(changes.clip(0)) / self._step])
        passed = np.diff(passed[np.searchsorted(rows, places + 1, "right")])
        if not (interval_ns := _even_interval(np.diff(places), np.diff(times), passed)):
            return none
        missed = _place(rows, changes // size, changes >= size)
        return Breaks(self._step, self._rows, missed, Place(), Place(), interval_ns)

    @staticmethod
    def _without_wraps(changes: Int64) -> Int64:
        """Return changes without the steps back of numbers that begin anew after a certain one."""
        sizes, times = np.unique(-changes[changes < 0], return_counts=True)
        if not len(times) or times.max() < 2 or times.max() < _WRAPS * times.sum():  # noqa: PLR2004
            return changes
        period = int(sizes[times.argmax()])
        return (changes + period // 2) % period - period // 2 if period > 2 * _SHORT else changes


def _even_interval(rows: Intp, times: Float64, passed: Float64) -> float:
    """Return the interval of rows whose times go on evenly where numbers are passed over; else 0.

    `rows`, `times`, `passed`: of stretches between sampled rows, how many rows they have, how long
        they take, and how many rows the numbers in them pass over, shape ``(N,)``
    """
    holes = passed > 0
    if len(rows) < _STRETCHES or not holes.any() or (times <= 0).any():
        return 0
    clean = ~holes
    if np.count_nonzero(clean) >= _STRETCHES // 2:
        interval = float(np.median(times[clean] / rows[clean]))
        scatter = np.median(np.abs(times / interval - rows)[clean])
    else:
        interval = float(np.median(times / rows))
        scatter = np.median(np.abs(times / interval - rows))
        whole = rows + passed
        if np.median(np.abs(times / float(np.median(times / whole)) - whole)) <= scatter:
            return 0  # the times contain what is missing, or as much is in all stretches
    more = times / interval - rows
    # The time of rows that come late is in a stretch nearby.
    near = np.convolve(holes, np.ones(2 * _NEARBY + 1), "same") > 0
    usual = float(np.median(passed[holes]))
    are_even = np.median(np.abs(more[holes])) < usual / 2 > 2 * scatter
    return interval if are_even and abs(more[near].sum()) < passed.sum() / 2 else 0


def _place(rows: Int64, numbers: Int64, where: Bool) -> Place:
    if not where.any():
        return Place()
    each = np.maximum(numbers[where], 1)
    return Place(int(each.sum()), int(np.count_nonzero(where)), int(rows[where][0]))


def _numbers(values: pa.Array | pa.ChunkedArray) -> Float64:
    """Return the numbers in cells of any type; NaN for others."""
    import pyarrow.compute as pc  # slow to import, and not needed without such a column

    try:
        if pa.types.is_binary(values.type):
            values = values.cast(pa.string())
        numbers: Float64 = to_numpy(pc.cast(values, pa.float64(), safe=False))
    except pa.ArrowException:
        cells = values.to_pylist()
        texts = (one.decode(errors="replace") if isinstance(one, bytes) else one for one in cells)
        return numbers_of([*texts])
    return numbers
