"""Compare attitude series of files: long ones with equal stamps while they are read.

Of each pair only the error is kept. What needs more than that (interpolation, windows, a mounting,
stamps out of order) is done in memory.
"""

from __future__ import annotations

from collections import deque
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from quatprop.comparison.alignment import align
from quatprop.comparison.association import Matching, associate, equal_stamps, require_enough
from quatprop.comparison.compare import compare, conclude, unit
from quatprop.comparison.criteria import Coverage
from quatprop.comparison.diagnosis import likely_cause
from quatprop.comparison.meter import CoveredTime, ErrorMeter
from quatprop.comparison.result import AppliedOffset
from quatprop.comparison.windows import MAX_SAMPLES
from quatprop.concurrency.threads import in_background
from quatprop.kinematics.quaternion import IDENTITY
from quatprop.series import AttitudeSeries
from quatprop.signals.attitude_input import open_attitudes

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.arrays import Float64, Int64
    from quatprop.comparison.result import Comparison
    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.signals.attitude_input import AttitudeFile, AttitudeInput, ReadAttitudes


SHORT = 1 << 17
"""Samples of a series that is compared in memory, where both are no longer."""


def compare_files(
    a: AttitudeInput, b: AttitudeInput, settings: ComparisonSettings, *, keep: bool = True
) -> tuple[ReadAttitudes, ReadAttitudes, Comparison]:
    """Compare two attitude series of files.

    Parameters
    ----------
    a, b
        The series.
    settings
        How to compare.
    keep
        Whether the result needs the time and the error of every pair.

    Returns
    -------
    a, b : ReadAttitudes
        What is known of the series.
    comparison : Comparison
        As of :func:`quatprop.comparison.compare.compare`.

    Raises
    ------
    LogError
        One of them cannot be read.
    ComparisonError, UsageError
        As for :func:`quatprop.comparison.compare.compare`.
    """
    with open_attitudes(a) as file_a, open_attitudes(b) as file_b:
        files = file_a, file_b
        beginnings = [_Beginning(file) for file in files]
        is_long = any(beginning.is_long for beginning in beginnings)
        has_sigmas = any(beginning.has_covariances for beginning in beginnings)
        if is_long and not keep and not has_sigmas and _is_streamable(files, settings):
            try:
                of_a, of_b = (beginning.batches() for beginning in beginnings)
                comparison = _streamed(of_a, of_b, settings)
            except _InMemoryError:
                beginnings = [_Beginning(file) for file in files]
            else:
                return file_a.facts(), file_b.facts(), comparison
        first, second = (
            file.load(beginning.batches())
            for file, beginning in zip(files, beginnings, strict=True)
        )
    return first, second, compare(first.series, second.series, settings)


class _InMemoryError(Exception):
    """The series have to be compared in memory."""


class _Beginning:
    """The first batches of a file, and whether there are more samples than are short."""

    def __init__(self, file: AttitudeFile) -> None:
        self._rest = file.batches()
        self._first: deque[AttitudeSeries] = deque()
        self.is_long = False
        for batch in self._rest:
            self._first.append(batch)
            if sum(map(len, self._first)) > SHORT:
                self.is_long = True
                break

    @property
    def has_covariances(self) -> bool:
        """Whether attitudes have covariances."""
        return any(batch.covariance is not None for batch in self._first)

    def batches(self) -> Iterator[AttitudeSeries]:
        """Yield all batches, once."""
        while self._first:
            yield self._first.popleft()
        yield from self._rest


def _is_streamable(files: Iterable[AttitudeFile], settings: ComparisonSettings) -> bool:
    return (
        settings.match in {None, "exact"}
        and settings.align in {"none", "first"}
        and settings.time_offset != "auto"
        and settings.window is None
        and not any(file.read_once for file in files)
    )


class _Passing:
    """A series that passes in rising order of its stamps.

    Attributes
    ----------
    held
        Samples that were read and not yet taken; empty at the end.
    samples
        How many were read.
    covered
        Their stamps.
    start_ns
        Where the time begins that both series cover.
    """

    def __init__(self, batches: Iterator[AttitudeSeries], offset_ns: int) -> None:
        self._batches = batches
        self._offset_ns = offset_ns
        self._head: list[AttitudeSeries] = []
        self.held = AttitudeSeries(np.empty(0, np.int64), np.empty((0, 4)))
        self.samples = self.start_ns = 0
        self.covered = CoveredTime()
        self.refill()

    def refill(self) -> None:
        """Hold the next batch.

        Raises
        ------
        _InMemoryError
            Stamps are not in order.
        """
        batch = next(self._batches, None)
        if batch is None:
            self.held = self.held[:0]
            return
        t_ns = batch.t_ns + self._offset_ns
        if (t_ns[1:] <= t_ns[:-1]).any() or (self.samples and t_ns[0] <= self.covered.last_ns):
            raise _InMemoryError
        self.held = AttitudeSeries(t_ns, unit(batch.wxyz))
        self.samples += len(t_ns)
        self.covered.add(t_ns)
        if t_ns[0] < self.start_ns:
            self._head.clear()
        if sum(map(len, self._head[1:])) < MAX_SAMPLES:
            self._head.append(self.held)

    def take(self, until_ns: int) -> AttitudeSeries:
        """Return the samples that are held, up to a time."""
        count = int(np.searchsorted(self.held.t_ns, until_ns, side="right"))
        taken, self.held = self.held[:count], self.held[count:]
        if not len(self.held):
            self.refill()
        return taken

    def head(self) -> AttitudeSeries:
        """Return the samples in which causes are looked for, and some more on either side."""
        return AttitudeSeries.joined(self._head)


class _EqualStamps:
    """The samples of two series that have equal stamps.

    Attributes
    ----------
    matched, candidates
        How many there are, and could be at best.
    """

    def __init__(self, a: _Passing, b: _Passing) -> None:
        self._sides = a, b
        self.matched = 0
        self._common = [0, 0]
        for side in self._sides:
            side.start_ns = max(a.covered.first_ns, b.covered.first_ns)

    @property
    def candidates(self) -> int:
        """As for :class:`quatprop.comparison.association.Pairs`."""
        return min(self._common)

    def __iter__(self) -> Iterator[tuple[Int64, Int64, Float64, Float64]]:
        a, b = self._sides
        first = 0
        while len(a.held) and len(b.held):
            until_ns = min(int(a.held.t_ns[-1]), int(b.held.t_ns[-1]))
            of_a, of_b = a.take(until_ns), b.take(until_ns)
            for place, part in enumerate((of_a, of_b)):
                self._common[place] += int(np.count_nonzero(part.t_ns >= a.start_ns))
            if np.array_equal(of_a.t_ns, of_b.t_ns):
                index = np.arange(first, first + len(of_a))
                yield of_a.t_ns, index, of_a.wxyz, of_b.wxyz
                self.matched += len(of_a)
            elif len(of_a) and len(of_b):
                in_a, in_b = equal_stamps(of_a.t_ns, of_b.t_ns)
                yield of_a.t_ns[in_a], first + in_a, of_a.wxyz[in_a], of_b.wxyz[in_b]
                self.matched += len(in_a)
            first += len(of_a)
        for side in self._sides:
            # All is read, to count what is there and what was lost.
            while len(side.held):
                side.take(int(side.held.t_ns[-1]))


def _streamed(
    a: Iterable[AttitudeSeries], b: Iterable[AttitudeSeries], settings: ComparisonSettings
) -> Comparison:
    """Compare series while they are read.

    Raises
    ------
    _InMemoryError
        Stamps are not in order, or too few are equal.
    """
    offset_ns = int(settings.time_offset)
    with closing(in_background(a, 1)) as batches_a, closing(in_background(b, 1)) as batches_b:
        sides = _Passing(batches_a, 0), _Passing(batches_b, offset_ns)
        pairs = _EqualStamps(*sides)
        meter = ErrorMeter("A", align("none", IDENTITY, IDENTITY), settings.limit_rad)
        for t_ns, index, of_a, of_b in pairs:
            if not len(meter) and len(t_ns):
                meter.alignment = align(settings.align, of_a, of_b)
            meter.add(t_ns, index, of_a, of_b)
    # Arrow keeps what it read with; the errors are sorted and explained in its place.
    pa.default_memory_pool().release_unused()
    min_matched = settings.min_matched / 100
    if settings.match is None and 2 * pairs.matched < max(pairs.candidates, 1):
        raise _InMemoryError
    covered = meter.covered
    ends = covered.first_ns, covered.last_ns
    matching = Matching("exact", "A", 0, pairs.matched, pairs.candidates, *ends)
    spans_ns = [(side.covered.first_ns, side.covered.last_ns) for side in sides]
    require_enough(matching, spans_ns, min_matched)
    match = partial(
        associate, match=settings.match, max_dt_ns=settings.max_dt, min_matched=min_matched
    )
    return conclude(
        settings,
        meter,
        matching,
        AppliedOffset(offset_ns, None),
        Coverage.of(covered, sides[1].covered, 100 * pairs.matched / sides[1].samples),
        lambda rising: likely_cause(
            sides[0].head(), sides[1].head(), match, settings.align, rising
        ),
    )
