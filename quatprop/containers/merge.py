"""Merge batches of decoded rows by log time.

A log may be split into files, and its chunks may overlap in time. Rows are held back only while a
later batch may still precede them, so memory use is bounded by how far batches overlap.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.containers.base import NO_BOUND

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

_NEVER = int(np.iinfo(np.int64).max) + 1
"""The bound of a stream that has ended: later than any log time."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Rows decoded from one block of messages.

    Parameters
    ----------
    log_ns
        When each row was recorded, shape ``(N,)``, int64 ns.
    values
        Columns of N rows each, shapes ``(N, ...)``.
    not_before_ns
        No later batch of this stream holds a row with an earlier log time.
    """

    log_ns: NDArray[np.int64]
    values: tuple[NDArray[Any], ...]
    not_before_ns: int = NO_BOUND

    def __len__(self) -> int:
        return len(self.log_ns)

    def rows(self, selected: slice | NDArray[np.int64]) -> Columns:
        """Return selected rows: views for a slice, copies for positions."""
        return Columns(self.log_ns[selected], tuple(column[selected] for column in self.values))


def merge_by_time(
    streams: Sequence[Iterable[Columns]], not_before_ns: Sequence[int] | None = None
) -> Iterator[Columns]:
    """Merge streams of batches into one in order of log time.

    The result is that of a stable sort of all rows by log time, with equal times in order of
    streams and then of arrival, provided that no batch comes before its stream's bound.

    A batch without a bound (:data:`~quatprop.containers.base.NO_BOUND`) is taken to end before
    the next one of its stream begins; its stream need not be held in memory. Rows that come
    before their bound are not lost: they are yielded as soon as they are read, out of order.

    Parameters
    ----------
    streams
        Batches of rows, all with the same columns. A stream is asked for a batch only when all
        the others are beyond its bound.
    not_before_ns
        For each stream a log time that none of its rows precedes, where that is known without
        opening it; the stream is not opened until the others arrive there.

    Yields
    ------
    Columns
        Rows in order; `not_before_ns` is the last log time. A batch that is in order and does not
        overlap others is not copied.

    Examples
    --------
    >>> even = Columns(np.array([0, 2]), (np.array([10, 12]),), not_before_ns=4)
    >>> odd = Columns(np.array([1, 3]), (np.array([11, 13]),), not_before_ns=5)
    >>> [batch.values[0].tolist() for batch in merge_by_time([[even], [odd]])]
    [[10, 11, 12, 13]]
    """
    merge = _Merge(streams, not_before_ns or [NO_BOUND] * len(streams))
    while merge.advance():
        yield from merge.ready()


class _Merge:
    """The batches that are held back, and the bounds of the streams."""

    def __init__(self, streams: Sequence[Iterable[Columns]], bounds: Sequence[int]) -> None:
        self.streams = [iter(stream) for stream in streams]
        self.bounds = list(bounds)
        # First log time, stream and arrival: the place of a batch's first row in the output.
        self.waiting: list[tuple[int, int, int, Columns]] = []
        self.arrivals = 0

    def advance(self) -> bool:
        """Ask the stream with the lowest bound for a batch; False if all have ended."""
        bound = min(self.bounds, default=_NEVER)
        if bound == _NEVER:
            return False
        stream = self.bounds.index(bound)
        batch = next(self.streams[stream], None)
        if batch is None:
            self.bounds[stream] = _NEVER
        elif len(batch) == 0:
            self.bounds[stream] = max(bound, batch.not_before_ns)
        else:
            batch = _sorted(batch)
            not_before_ns = batch.not_before_ns
            if not_before_ns == NO_BOUND:
                not_before_ns = int(batch.log_ns[-1])
            self.bounds[stream] = max(bound, not_before_ns)
            self._wait(batch, stream, self.arrivals)
            self.arrivals += 1
        return True

    def _wait(self, batch: Columns, stream: int, arrival: int) -> None:
        heappush(self.waiting, (int(batch.log_ns[0]), stream, arrival, batch))

    def ready(self) -> Iterator[Columns]:
        """Yield the rows that nothing can precede any more."""
        bound = min(self.bounds)
        holding = self.bounds.index(bound)
        group: list[tuple[int, int, Columns]] = []
        ends: tuple[int, int, int] | None = None
        for stream, arrival, part in self._parts(bound, holding):
            first = (int(part.log_ns[0]), stream, arrival)
            last = (int(part.log_ns[-1]), stream, arrival)
            if ends is not None and ends < first:
                yield _merged(group)
                group, ends = [], None
            group.append((stream, arrival, part))
            ends = last if ends is None else max(ends, last)
        if group:
            yield _merged(group)

    def _parts(self, bound: int, holding: int) -> Iterator[tuple[int, int, Columns]]:
        """Take the ready rows out of the batches that are held back.

        Rows at the bound itself are ready unless the stream with the lowest bound comes before
        theirs: it may still have rows of that time.
        """
        while self.waiting and self.waiting[0][:2] <= (bound, holding):
            _, stream, arrival, batch = heappop(self.waiting)
            if (int(batch.log_ns[-1]), stream) <= (bound, holding):
                yield stream, arrival, batch
                continue
            count = int(batch.log_ns.searchsorted(bound, "right" if stream <= holding else "left"))
            self._wait(batch.rows(slice(count, None)), stream, arrival)
            yield stream, arrival, batch.rows(slice(count))


def _sorted(batch: Columns) -> Columns:
    """Return a batch in order of log time; it usually is."""
    if (batch.log_ns[1:] >= batch.log_ns[:-1]).all():
        return batch
    rows = batch.rows(np.argsort(batch.log_ns, kind="stable"))
    return Columns(rows.log_ns, rows.values, batch.not_before_ns)


def _merged(group: list[tuple[int, int, Columns]]) -> Columns:
    """Return parts that overlap in time as one batch, equal times in order of stream, arrival."""
    if len(group) == 1:
        part = group[0][2]
        log_ns, values = part.log_ns, part.values
    else:
        parts = [part for _, _, part in sorted(group, key=lambda entry: entry[:2])]
        log_ns = np.concatenate([part.log_ns for part in parts])
        order = np.argsort(log_ns, kind="stable")
        log_ns = log_ns[order]
        columns = zip(*(part.values for part in parts), strict=True)
        values = tuple(np.concatenate(column)[order] for column in columns)
    return Columns(log_ns, values, int(log_ns[-1]))
