"""Merge batches of decoded rows by log time.

A log may be split into files, and its chunks may overlap in time. Rows are held back only while a
later batch may still precede them, so memory use is bounded by how far batches overlap.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from quatprop.errors import MessageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    _Waiting = tuple[int, int, int, "RowBatch"]
    """First log time, stream and arrival of a held-back batch, its sort key; and the batch."""

Source = TypeVar("Source")
Result = TypeVar("Result")

NO_BOUND = int(np.iinfo(np.int64).min)
"""`watermark_ns` of a batch without a bound on later ones."""

_NEVER = int(np.iinfo(np.int64).max) + 1
"""Bound of a stream that has ended: after any log time."""


@dataclass(frozen=True, slots=True, eq=False)
class RowBatch:
    """Rows decoded from one block of messages.

    `log_ns`: log times, shape ``(N,)``, int64 ns
    `values`: columns of N rows each, shapes ``(N, ...)``
    `watermark_ns`: no later batch of this stream holds a row with an earlier log time
    """

    log_ns: NDArray[np.int64]
    values: tuple[NDArray[Any], ...]
    watermark_ns: int = NO_BOUND

    def __len__(self) -> int:
        return len(self.log_ns)

    def without(self, positions: Sequence[int]) -> RowBatch:
        """Return the rows except those at some positions."""
        return self.rows(np.delete(np.arange(len(self)), positions))

    def rows(self, selected: slice | NDArray[np.int64]) -> RowBatch:
        """Return selected rows: views for a slice, copies for indices."""
        return RowBatch(self.log_ns[selected], tuple(column[selected] for column in self.values))


def without_misfits(
    convert: Callable[[Source], Result],
    source: Source,
    leave_out: Callable[[Source, MessageError], Source],
) -> Result:
    """Convert rows or blocks of messages, leaving out those that `convert` refuses."""
    try:
        return convert(source)
    except MessageError as error:
        return without_misfits(convert, leave_out(source, error), leave_out)


def joined_rows(batches: Sequence[RowBatch]) -> RowBatch:
    """Return batches of one stream, at least one, as one batch."""
    if len(batches) == 1:
        return batches[0]
    columns = zip(*(batch.values for batch in batches), strict=True)
    values = tuple(np.concatenate(column) for column in columns)
    log_ns = np.concatenate([batch.log_ns for batch in batches])
    return RowBatch(log_ns, values, batches[-1].watermark_ns)


def merge_by_time(streams: Sequence[Iterable[RowBatch]]) -> Iterator[RowBatch]:
    """Merge streams of batches into one in order of log time.

    The result is a stable sort of all rows by log time, with equal times in order of stream and
    then of arrival, provided that no batch precedes the bound of its stream.

    A batch without a bound (:data:`~quatprop.tables.batches.NO_BOUND`) is assumed to end before the
    next one of its stream begins, so its stream is not held in memory. Rows that precede the bound
    are yielded as soon as they are read, out of order.
    """
    iterators = [iter(stream) for stream in streams]
    bounds = [NO_BOUND] * len(iterators)
    waiting: list[_Waiting] = []
    for arrival in count():
        bound = min(bounds, default=_NEVER)
        if bound == _NEVER:
            return
        stream = bounds.index(bound)
        batch = next(iterators[stream], None)
        if batch is None:
            bounds[stream] = _NEVER
        elif len(batch) == 0:
            bounds[stream] = max(bound, batch.watermark_ns)
        else:
            batch = _sorted(batch)
            is_bounded = batch.watermark_ns != NO_BOUND
            later_ns = batch.watermark_ns if is_bounded else int(batch.log_ns[-1])
            bounds[stream] = max(bound, later_ns)
            heappush(waiting, (int(batch.log_ns[0]), stream, arrival, batch))
        if ready := _ready(waiting, bounds):
            yield _merged(ready)


def _ready(waiting: list[_Waiting], bounds: list[int]) -> list[_Waiting]:
    """Remove and return the held-back rows that no later row can precede.

    Rows at the lowest bound are ready unless its stream precedes theirs, and may still have rows of
    this time.
    """
    bound = min(bounds)
    holding = bounds.index(bound)
    ready = []
    while waiting and waiting[0][:2] <= (bound, holding):
        first_ns, stream, arrival, batch = heappop(waiting)
        if (int(batch.log_ns[-1]), stream) > (bound, holding):
            size = int(batch.log_ns.searchsorted(bound, "right" if stream <= holding else "left"))
            rest = batch.rows(slice(size, None))
            heappush(waiting, (int(rest.log_ns[0]), stream, arrival, rest))
            batch = batch.rows(slice(size))
        ready.append((first_ns, stream, arrival, batch))
    return ready


def _sorted(batch: RowBatch) -> RowBatch:
    """Return a batch sorted by log time; it usually is already."""
    if (batch.log_ns[1:] >= batch.log_ns[:-1]).all():
        return batch
    rows = batch.rows(np.argsort(batch.log_ns, kind="stable"))
    return RowBatch(rows.log_ns, rows.values, batch.watermark_ns)


def _merged(waiting: list[_Waiting]) -> RowBatch:
    """Return batches as one, with equal times in order of stream, then of arrival."""
    if len(waiting) == 1:
        part = waiting[0][3]
        log_ns, values = part.log_ns, part.values
    else:
        parts = [part for *_, part in sorted(waiting, key=lambda entry: entry[1:3])]
        log_ns = np.concatenate([part.log_ns for part in parts])
        order = np.argsort(log_ns, kind="stable")
        log_ns = log_ns[order]
        columns = zip(*(part.values for part in parts), strict=True)
        values = tuple(np.concatenate(column)[order] for column in columns)
    return RowBatch(log_ns, values, int(log_ns[-1]))
