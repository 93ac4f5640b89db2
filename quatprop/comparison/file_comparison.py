"""Compare attitude series of files; long ones with equal timestamps while they are read.

A streamed comparison keeps only the error of each pair. A comparison that needs more, such as
interpolation, windows, a mounting or sorting, is done in memory.
"""

from __future__ import annotations

from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from quatprop.base.threads import in_background
from quatprop.comparison.alignment import MAX_SAMPLES, align
from quatprop.comparison.association import (
    Matching,
    OtherUnitError,
    equal_stamps,
    is_mostly_exact,
    require_enough,
)
from quatprop.comparison.comparison import build_comparison, compare, unit
from quatprop.comparison.result import AppliedOffset, Comparison, Coverage
from quatprop.comparison.statistics import CoveredTime, ErrorAccumulator
from quatprop.kinematics.quaternion import IDENTITY
from quatprop.kinematics.series import AttitudeSeries
from quatprop.propagation.attitude_input import open_attitudes, recorded_sensitivity

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Float64, Int64
    from quatprop.propagation.attitude_input import AttitudeInput, OpenAttitudes, ReadAttitudes
    from quatprop.settings.command_options import ComparisonSettings


SHORT = 1 << 17
"""Series of up to this many samples are compared in memory."""


def compare_files(
    a: AttitudeInput, b: AttitudeInput, settings: ComparisonSettings, *, keep: bool = True
) -> tuple[ReadAttitudes, ReadAttitudes, Comparison]:
    """Return two attitude series and their comparison; `keep`: with the pairs and errors."""
    with open_attitudes(a) as file_a, open_attitudes(b) as file_b, _units_of(file_a, file_b):
        files = file_a, file_b
        beginnings = [_beginning(file) for file in files]
        if not keep and _is_streamable(files, beginnings, settings):
            with suppress(_NotStreamableError):
                of_a, of_b = (chain(*part) for part in beginnings)
                comparison = _streamed(of_a, of_b, settings)
                return file_a.facts(), file_b.facts(), comparison
            beginnings = [_beginning(file) for file in files]
        first, second = (
            file.load(chain(*part)) for file, part in zip(files, beginnings, strict=True)
        )
        comparison = compare(first.series, second.series, settings)
        if any(one.signal.representation != "quaternion" for one in (first, second)):
            # Angles and matrices have no sign.
            kept = tuple(one for one in comparison.remarks if one.code != "opposite-signs")
            comparison = replace(comparison, remarks=kept)
        return first, second, comparison


@contextmanager
def _units_of(a: OpenAttitudes, b: OpenAttitudes) -> Iterator[None]:
    """Add the settings that repair times in a wrong unit to an error about them."""
    try:
        yield
    except OtherUnitError as error:
        units = {
            side: "".join(file.signal.match.stamp.units[:1]) for side, file in (("a", a), ("b", b))
        }
        raise error.for_files(units) from None


class _NotStreamableError(Exception):
    """The series must be compared in memory."""


def _beginning(file: OpenAttitudes) -> tuple[list[AttitudeSeries], Iterator[AttitudeSeries]]:
    """Return the first batches, just above :data:`SHORT` samples, and an iterator over the rest."""
    stated = recorded_sensitivity(file.signal.provenance)
    first, rest = [], (replace(batch, sensitivity=stated) for batch in file.batches())
    for batch in rest:
        first.append(batch)
        if sum(map(len, first)) > SHORT:
            break
    return first, rest


def _is_streamable(
    files: Iterable[OpenAttitudes],
    beginnings: Iterable[tuple[list[AttitudeSeries], object]],
    settings: ComparisonSettings,
) -> bool:
    firsts = [first for first, _ in beginnings]
    return (
        any(sum(map(len, first)) > SHORT for first in firsts)
        and not any(batch.covariance is not None for first in firsts for batch in first)
        and settings.match in {None, "exact"}
        and settings.align in {"none", "first"}
        and settings.time_offset != "auto"
        and settings.window is None
        and not (settings.judge or settings.start or settings.end or settings.rate)
        and not settings.in_parts
        and not any(file.recording.is_stream for file in files)
    )


class _Ordered:
    """A series that is read batch by batch, in order of time.

    `held`: samples read but not yet taken; empty at the end
    `head`: the batches in which causes are searched for
    `start_ns`: start of the common time of both series, ns
    `common`: number of samples taken in the common time
    """

    def __init__(self, batches: Iterator[AttitudeSeries], offset_ns: int) -> None:
        self._batches = batches
        self._offset_ns = offset_ns
        self.head: list[AttitudeSeries] = []
        self.held = AttitudeSeries(np.empty(0, np.int64), np.empty((0, 4)))
        self.samples = self.start_ns = self.common = 0
        self.covered = CoveredTime()
        self.refill()

    def refill(self) -> None:
        """Read the next batch."""
        batch = next(self._batches, None)
        if batch is None:
            self.held = self.held[:0]
            return
        t_ns = batch.t_ns + self._offset_ns
        if (t_ns[1:] <= t_ns[:-1]).any() or (self.samples and t_ns[0] <= self.covered.last_ns):
            raise _NotStreamableError
        self.held = replace(batch, t_ns=t_ns, wxyz=unit(batch.wxyz))
        self.samples += len(t_ns)
        self.covered.add(t_ns)
        if t_ns[0] < self.start_ns:
            self.head.clear()
        if sum(map(len, self.head[1:])) < MAX_SAMPLES:
            self.head.append(self.held)

    def take(self, until_ns: int) -> AttitudeSeries:
        """Remove and return the held samples up to a time."""
        count = int(np.searchsorted(self.held.t_ns, until_ns, side="right"))
        taken, self.held = self.held[:count], self.held[count:]
        self.common += int(np.count_nonzero(taken.t_ns >= self.start_ns))
        if not len(self.held):
            self.refill()
        return taken


def _equal_stamps(a: _Ordered, b: _Ordered) -> Iterator[tuple[Int64, Int64, Float64, Float64]]:
    """Yield pairs with equal timestamps: times, ns, indices in A, and attitudes of A and B."""
    a.start_ns = b.start_ns = max(a.covered.first_ns, b.covered.first_ns)
    first = 0
    while len(a.held) and len(b.held):
        until_ns = min(int(a.held.t_ns[-1]), int(b.held.t_ns[-1]))
        of_a, of_b = a.take(until_ns), b.take(until_ns)
        if len(of_a) and len(of_b):
            in_a, in_b = equal_stamps(of_a.t_ns, of_b.t_ns)
            index = first + np.arange(len(of_a))[in_a]
            yield of_a.t_ns[in_a], index, of_a.wxyz[in_a], of_b.wxyz[in_b]
        first += len(of_a)
    for side in (a, b):
        # The rest is read to count samples and losses.
        while len(side.held):
            side.refill()


def _streamed(
    a: Iterable[AttitudeSeries], b: Iterable[AttitudeSeries], settings: ComparisonSettings
) -> Comparison:
    """Compare series while they are read."""
    offset_ns = int(settings.time_offset)
    with closing(in_background(a, 1)) as batches_a, closing(in_background(b, 1)) as batches_b:
        sides = _Ordered(batches_a, 0), _Ordered(batches_b, offset_ns)
        measured = ErrorAccumulator("A", align("none", IDENTITY, IDENTITY), settings.limit_rad)
        for t_ns, index, of_a, of_b in _equal_stamps(*sides):
            if not len(measured) and len(t_ns):
                measured.alignment = align(settings.align, of_a, of_b)
            measured.add(t_ns, index, of_a, of_b)
    # Arrow's buffers are returned before the errors are sorted and explained.
    pa.default_memory_pool().release_unused()
    candidates = min(side.common for side in sides)
    if settings.match is None and not is_mostly_exact(len(measured), candidates):
        raise _NotStreamableError
    covered = measured.covered
    ends = covered.first_ns, covered.last_ns
    matching = Matching("exact", "A", 0, len(measured), candidates, *ends)
    spans_ns = [(side.covered.first_ns, side.covered.last_ns) for side in sides]
    require_enough(matching, spans_ns, settings)
    time_of_a, time_of_b = (covered.share_of(side.covered) for side in sides)
    coverage = Coverage(time_of_b, 100 * len(measured) / sides[1].samples, time_of_a)
    first, second = (AttitudeSeries.joined(side.head) for side in sides)
    offset = AppliedOffset(offset_ns, None)
    return build_comparison(first, second, settings, measured, matching, offset, coverage)
