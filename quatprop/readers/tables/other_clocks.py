"""A second clock, or a counter, that departs from the used one somewhere in a table.

The first rows are compared when the clock is chosen. Whether two clocks still agree in the last
row, a few of the rows between tell: a jump stays, while a delay passes and drift is slow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.readers.tables.turns import EVERY, ColumnWatch

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import pyarrow as pa

    from quatprop.base.arrays import Bool, Float64, Intp
    from quatprop.readers.tables.model import Group
    from quatprop.readers.tables.turns import RowWatch

    Times = Callable[[Sequence[Sequence[object]]], Float64 | None]

_FEWEST = 16
_END, _LEAST_END, _LONGEST_END = 0.1, 3, 50
"""Share of the compared rows at either end whose median difference is its first or its last."""

_ROWS = 3
"""Intervals between rows by which two clocks may come apart."""

_SCATTER = 3
_MOST = 0.9
"""A jump is so many times as large as this quantile of the changes of the difference."""

_UNEVEN = 0.25
"""Quantile of these changes, as a share of the intervals, from which on a column is no clock."""

_BY_JUMPS = 0.7
"""Smallest share of the whole change that is made in jumps."""


class Divergence(NamedTuple):
    """How far another clock goes beyond the used one, and where.

    `by`: in the unit of the other clock; negative if it falls behind
    `speed`: units of the other clock for one of the used one
    `jumps`: stretches between compared rows in which it jumps, shape ``(N - 1,)``
    `largest`: the stretch with the largest jump
    """

    by: float
    speed: float
    jumps: Bool
    largest: int


def divergence(used: Float64, other: Float64) -> Divergence | None:
    """Return how two clocks come apart for good by jumps; None: they do not, or one is no clock.

    `used`, `other`: their times in every :data:`EVERY`-th row, finite, shape ``(N,)``
    """
    if len(used) < _FEWEST:
        return None
    ours, theirs = np.diff(used), np.diff(other)
    if (theirs < 0).any() or (ours <= 0).any():
        return None
    speed = float(np.median(theirs / ours))
    apart = other - other[0] - speed * (used - used[0])
    changes = np.diff(apart)
    usual = float(np.median(theirs))
    scatter = float(np.quantile(np.abs(changes), _MOST, method="nearest"))
    limit = max(_SCATTER * scatter, _ROWS * usual / EVERY)
    if not theirs.all():
        # It repeats its times, as one of whole seconds.
        limit = max(limit, 2 * float(theirs[theirs > 0].min(initial=np.inf)))
    if not speed or scatter > _UNEVEN * usual:
        return None
    end = min(max(int(_END * len(apart)), _LEAST_END), _LONGEST_END)
    by = float(np.median(apart[-end:]) - np.median(apart[:end]))
    jumps = np.abs(changes) > limit
    by_jumps = float(changes[jumps].sum())
    # A clock that is set, as by the first fix of a GPS, moves by more than the whole log.
    if (
        not limit < abs(by) < other[-1] - other[0] - abs(by)
        or not _BY_JUMPS < by_jumps / by < 1 / _BY_JUMPS
    ):
        return None
    return Divergence(by_jumps, speed, jumps, int(np.argmax(changes * np.sign(by))))


class SampledTimes(NamedTuple):
    """Columns of a clock to sample while a table is read.

    `times`: returns the times of their cells, ns; None if they have none
    """

    columns: Group
    times: Times

    def samples(self, rows: RowWatch) -> Callable[[], tuple[Intp, Float64 | None]]:
        """Return what returns the sampled rows and their times, once the table is read."""
        columns = [rows.sampled(k) for k in self.columns]

        def timed() -> tuple[Intp, Float64 | None]:
            places = np.array(columns[0].places, np.intp)
            are_same = all(each.places == columns[0].places for each in columns)
            return places, self.times([each.cells for each in columns]) if are_same else None

        return timed


class OtherClock(NamedTuple):
    """A clock to compare with the used one.

    `compare`: called once, at the end, with the times of both in the sampled rows, and these rows,
        where both have one
    """

    used: SampledTimes
    other: SampledTimes
    compare: Callable[[tuple[Float64, Float64], Intp], None]

    @property
    def column(self) -> int:
        """The first of its columns."""
        return self.other.columns[0]

    def watch(self, rows: RowWatch) -> OtherClockWatch:
        """Return what watches it in one reading of the table."""
        return OtherClockWatch(self, rows)


class OtherClockWatch(ColumnWatch):
    """Compares two clocks when all rows are read; their cells are sampled for both."""

    is_over = True

    def __init__(self, clock: OtherClock, rows: RowWatch) -> None:
        self._compare = clock.compare
        self._used, self._other = clock.used.samples(rows), clock.other.samples(rows)

    def see_values(self, values: pa.Array | pa.ChunkedArray, places: Intp) -> None:
        """Add nothing: the cells are sampled."""

    def finish(self) -> None:
        """Compare the clocks."""
        (places, used), (others, other) = self._used(), self._other()
        if used is None or other is None or not np.array_equal(places, others):
            return
        known = np.isfinite(used) & np.isfinite(other)
        self._compare((used[known], other[known]), places[known])
