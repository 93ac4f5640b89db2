"""Rates of one recording in several files: merged by time, or set one after another.

A recording that was split overlaps by what its recorder held in memory when it began a new file.
Samples that are in several files are read once. Files that overlap by more, with other samples, are
of different times: their clocks begin anew in each.
"""

from __future__ import annotations

import re
from itertools import combinations, pairwise
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import TimelineError, UsageError
from quatprop.base.text import Remark, Setting, listed, plain
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.readers.tables.csv import CsvLog
from quatprop.readers.tables.model import RowBatch, joined_rows, merge_by_time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray, Int64
    from quatprop.readers.matching import Match
    from quatprop.readers.tables.model import Table


LONGEST_OVERLAP_NS = NS_PER_S
"""Longest overlap of the parts of a split recording, ns; of short ones, a share of the shorter."""

LARGEST_SHARE = 0.1

FEWEST_TURNS = 8
"""Samples of files that take fewer turns, as with a wrong timestamp, do not overlap."""


def merged(
    streams: Sequence[Iterable[RowBatch]], paths: Sequence[Path], note: Callable[[Remark], object]
) -> Iterator[RowBatch]:
    """Yield the rows of several files in order of time; refuse files that overlap.

    `paths`: the file of each stream
    `note`: gets a remark on samples that are in several files
    """
    files = [*dict.fromkeys(paths)]
    numbers = [files.index(path) for path in paths]
    ours = (map(_Numbering(number), one) for number, one in zip(numbers, streams, strict=True))
    overlap = _Overlap(files)
    for batch in merge_by_time([*ours]):
        yield from overlap.added(batch)
    yield from overlap.finished()
    if overlap.copies:
        copied = f"{overlap.copies} sample{'s' * (overlap.copies > 1)}"
        note(Remark("copies", f"the files overlap: {copied} in several of them are read once"))


class _Numbering:
    """Appends a column with the number of their file to rows."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __call__(self, batch: RowBatch) -> RowBatch:
        numbers = np.full(len(batch), self._number, np.int16)
        return RowBatch(batch.log_ns, (*batch.values, numbers), batch.watermark_ns)


class _Overlap:
    """Finds out by how much the samples of several files overlap, and leaves out copies.

    `copies`: number of samples that are left out so far
    """

    def __init__(self, files: Sequence[Path]) -> None:
        self._files = files
        self._first: dict[int, int] = {}
        self._last: dict[int, int] = {}
        self._turns = 0
        self._latest = -1
        self._held: RowBatch | None = None
        self.copies = 0

    def added(self, batch: RowBatch) -> Iterator[RowBatch]:
        """Add merged rows, and yield those that no copy can follow."""
        kinds = np.full(len(batch), _ALONE, np.int8)
        batch = RowBatch(batch.log_ns, (*batch.values, kinds))
        rows = joined_rows([self._held, batch]) if self._held else batch
        _mark_copies(rows)
        end = int(np.searchsorted(rows.log_ns, rows.log_ns[-1] - LONGEST_OVERLAP_NS))
        self._held = rows.rows(slice(end, None))
        yield from self._once(rows.rows(slice(end)))

    def finished(self) -> Iterator[RowBatch]:
        """Yield the last rows, and refuse files that overlap."""
        if self._held:
            yield from self._once(self._held)
        lengths = {number: last - self._first[number] for number, last in self._last.items()}
        for one, other in combinations(lengths, 2):
            self._refuse(one, other, LARGEST_SHARE * min(lengths[one], lengths[other]))

    def _once(self, rows: RowBatch) -> Iterator[RowBatch]:
        """Yield rows, of those that are in several files the first."""
        *values, numbers, kinds = rows.values
        kept = np.flatnonzero(kinds != _COPY)
        self.copies += len(rows) - len(kept)
        is_alone = kinds == _ALONE
        self._note(numbers[is_alone], rows.log_ns[is_alone])
        if len(kept):
            yield RowBatch(rows.log_ns, tuple(values)).rows(kept)

    def _note(self, numbers: AnyArray, log_ns: Int64) -> None:
        """Note the rows that are in one file only."""
        turns = np.flatnonzero(np.diff(numbers, prepend=np.int16(self._latest)))
        if not len(numbers):
            return
        self._turns += len(turns)
        self._latest = int(numbers[-1])
        found = {self._latest, *numbers[turns].tolist()}
        for number in found:
            times = log_ns if len(found) == 1 else log_ns[numbers == number]
            self._first.setdefault(number, int(times[0]))
            self._last[number] = int(times[-1])
        for one in self._first:
            for other in found - {one}:
                self._refuse(one, other, LONGEST_OVERLAP_NS)

    def _refuse(self, one: int, other: int, limit_ns: float) -> None:
        """Refuse two files that overlap by more than a limit, ns."""
        first_ns = max(self._first[one], self._first[other])
        overlap_ns = min(self._last[one], self._last[other]) - first_ns
        if overlap_ns <= limit_ns or self._turns < FEWEST_TURNS:
            return
        names = " and ".join(plain(self._files[number]) for number in sorted((one, other)))
        if self.copies > self._turns:
            raise TimelineError(
                names,
                f"most samples between {first_ns} ns and {first_ns + overlap_ns} ns are in both, "
                "as if two recorders had written them; name one, or cut one where the other begins",
            )
        raise TimelineError(
            names,
            f"both have samples between {first_ns} ns and {first_ns + overlap_ns} ns, a span of "
            f"{duration_text(overlap_ns)}, so they are no parts of one recording; if they are of "
            "two sensors, name one; if they follow each other, and the clock of each begins anew, "
            f"name them in order, with {Setting('in_sequence')}",
        )


_ALONE, _COPIED, _COPY = range(3)
"""Kinds of rows: in one file only; the first of those that are in several; the others."""


def _mark_copies(rows: RowBatch) -> None:
    """Mark the rows that are in several files, by their file and kind in the last two columns.

    Copies have the same timestamps and values; two recorders note them at different times.
    """
    *values, numbers, kinds = rows.values
    if (numbers == numbers[0]).all():
        return
    columns = [part for each in values for part in each.reshape(len(rows), -1).T]
    # Samples of a packet have one time: only in this order are copies next to each other.
    order = np.lexsort(columns[::-1])
    is_other = np.zeros(len(rows) - 1, np.bool_)
    for column in columns:
        after, before = column[order[1:]], column[order[:-1]]
        is_other |= (after != before) & ((after == after) | (before == before))  # noqa: PLR0124
    begins = np.flatnonzero(np.concatenate([[True], is_other]))
    group = np.cumsum(np.concatenate([[0], is_other]))
    is_copy = numbers[order] != numbers[order[begins]][group]
    is_copied = np.logical_or.reduceat(is_copy, begins)[group]
    kinds[order] = np.maximum(kinds[order], is_copied * _COPIED + is_copy)


def in_sequence(streams: Sequence[Iterable[RowBatch]], paths: Sequence[Path]) -> Iterator[RowBatch]:
    """Yield the rows of several files one after another, whatever their clocks.

    Each begins one usual interval after the end of the one before.
    """
    end_ns: int | None = None
    between_ns = 0
    for path in dict.fromkeys(paths):
        own = [one for one, of in zip(streams, paths, strict=True) if of == path]
        shift_ns, last_ns, step_ns = None, 0, 0
        for batch in merge_by_time(own) if own[1:] else own[0]:
            t_ns = batch.values[0]
            step_ns = _usual_step(t_ns) or step_ns
            if shift_ns is None:
                first_ns = int(t_ns.min())
                shift_ns = 0 if end_ns is None else end_ns + (between_ns or step_ns) - first_ns
                last_ns = first_ns + shift_ns
            moved = t_ns + shift_ns
            last_ns = max(last_ns, int(moved.max()))
            yield RowBatch(batch.log_ns, (moved, *batch.values[1:]), batch.watermark_ns)
        if shift_ns is not None:
            end_ns, between_ns = last_ns, step_ns


def _usual_step(t_ns: Int64) -> int:
    """Return the median interval between timestamps, ns; 0 if there is none."""
    steps = np.diff(t_ns)
    steps = steps[steps > 0]
    return int(np.median(steps)) if len(steps) else 0


# Which files are no parts of one recording, or not in order.


def refuse_parts_without_header(tables: Sequence[Table]) -> None:
    """Refuse text without a header next to text with one, as the parts that split(1) writes."""
    texts = [table for table in tables if isinstance(table, CsvLog)]
    bare = [one for one in texts if all(name == str(k) for k, name in enumerate(one.names))]
    if not bare or len(bare) == len(texts):
        return
    first = next(one for one in texts if one not in bare)
    are_parts = len(bare) == len(texts) - 1 and texts[0] is first
    way = f"write that above the rows of {plain(bare[0].path)}, too"
    if are_parts:
        way = f"join the parts first, as with cat {' '.join(plain(one.path) for one in texts)}"
    raise UsageError(
        f"{plain(bare[0].path)}: it has no header, but {plain(first.path)} has one; {way}"
    )


def refuse_other_columns(matches: Sequence[Match]) -> None:
    """Refuse columns that were chosen by number in files that have them in another order."""
    first, *others = (
        [one.table.columns[k].key for group in one.sets for k in group] for one in matches
    )
    for match, keys in zip(matches[1:], others, strict=True):
        if match.is_named and not match.table.is_typed and keys != first:
            raise UsageError(
                f"{plain(match.table.path)}: {Setting('rate_cols')} chooses {listed(keys)} in it, "
                f"but {listed(first)} in {plain(matches[0].table.path)}; name the columns, or "
                "write them in the same order"
            )


def unlike_their_numbers(matches: Sequence[Match]) -> str:
    """Return the end of a sentence on files that the numbers in their names order otherwise."""
    paths = [*map(plain, dict.fromkeys(match.table.path for match in matches))]
    numbers = [[int(number) for number in re.findall(r"\d+", path)] for path in paths]
    if len({re.sub(r"\d+", "#", path) for path in paths}) > 1:
        return ""
    # Of several numbers, such as those of a date, it is not known which comes first.
    if sum(len({*each}) > 1 for each in zip(*numbers, strict=True)) != 1:
        return ""
    for (one, other), (before, after) in zip(pairwise(paths), pairwise(numbers), strict=True):
        if before > after:
            return f"; by the numbers in their names, {other} comes before {one}"
    return ""
