"""What the time stamps are allowed to do, and what is done about it.

A recorder promises nothing: stamps repeat, step back and leap, rates are missing. Every such
event is counted and located here; whether it is an error is the user's policy. Nothing is
repaired silently: what a policy changed stands in the counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby, pairwise
from operator import itemgetter
from typing import TYPE_CHECKING, Literal

import numpy as np

from quatprop.errors import TimelineError
from quatprop.series import GyroSeries, reblock
from quatprop.timeline.counts import LISTED_GAPS, Counts
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

GAP_FACTOR = 10
"""A gap is an interval longer than this many median intervals, unless told otherwise."""

LONGEST_NS = int(np.iinfo(np.int64).max)
"""The longest interval that fits 64 bits."""

MEDIAN_WINDOW = 65_536
"""The median interval is that of the first so many intervals: exact, and flat in memory."""


@dataclass(frozen=True, slots=True)
class Policy:
    """What to do about each kind of event.

    Parameters
    ----------
    on_backwards
        Stamps earlier than one before: ``"error"``; ``"drop"`` the samples; ``"sort"`` all samples
        by stamp (holds the log in memory); ``"keep"`` them, for looking only.
    on_nonfinite
        Rates that are NaN or infinite: ``"error"``; ``"drop"`` the samples; ``"hold"`` the last
        finite rate; ``"keep"`` them, for looking only.
    on_gap
        Intervals longer than `max_gap_ns`: ``"hold"`` propagates across them like any other;
        ``"error"``; ``"zero"`` takes the rate across as zero; ``"split"`` begins again at q0.
    max_gap_ns
        The longest interval that is no gap, ns; None means :data:`GAP_FACTOR` median intervals.
    """

    on_backwards: Literal["error", "drop", "sort", "keep"] = "error"
    on_nonfinite: Literal["error", "drop", "hold", "keep"] = "error"
    on_gap: Literal["hold", "zero", "split", "error"] = "hold"
    max_gap_ns: int | None = None


OBSERVE = Policy(on_backwards="keep", on_nonfinite="keep")
"""Change nothing, count everything."""


class Timeline:
    """Applies a policy to a stream of samples and counts what it sees.

    Parameters
    ----------
    policy
        What to do about each kind of event.
    path
        The log, for errors.
    """

    def __init__(self, policy: Policy, path: Path | str) -> None:
        self.policy = policy
        self.path = path
        self.counts = Counts(gap_limit_ns=policy.max_gap_ns)
        self._latest: int | None = None
        self._held: NDArray[np.float64] | None = None
        self._last_magnitude = np.float64(0.0)

    def apply(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the samples that go on, in batches.

        Parameters
        ----------
        batches
            Samples in the order of the log.

        Yields
        ------
        GyroSeries
            Samples that keep the policy; stamps never decrease unless the policy keeps that.

        Raises
        ------
        TimelineError
            An event that the policy calls an error.
        """
        finite = (self._finite(batch) for batch in self._located(batches))
        if self.policy.on_backwards == "sort":
            ordered: Iterable[GyroSeries] = self._sorted(finite)
        else:
            ordered = (self._forward(batch) for batch in finite)
        # Sums of floats depend on where they are cut: so they are cut at fixed sample indices.
        for batch in reblock(self._with_gap_limit(ordered)):
            self._measure(batch)
            yield batch

    def stretches(self, batches: Iterable[GyroSeries]) -> Iterator[Iterator[GyroSeries]]:
        """Yield what :meth:`apply` does, cut where a gap is not to be propagated across.

        Parameters
        ----------
        batches
            Samples in the order of the log.

        Yields
        ------
        iterator of GyroSeries
            The samples of one stretch; take them all before the next stretch.
        """
        applied = self.apply(batches)
        if self.policy.on_gap not in {"zero", "split"}:
            yield applied
            return
        for _, numbered in groupby(self._numbered(applied), key=itemgetter(0)):
            yield (series for _, series in numbered)

    def _numbered(self, blocks: Iterable[GyroSeries]) -> Iterator[tuple[int, GyroSeries]]:
        """Cut blocks at gaps and number the stretches."""
        number, last_ns = 0, None
        for block in blocks:
            limit = self.counts.gap_limit_ns
            before = block.t_ns[0] if last_ns is None else last_ns
            last_ns = block.t_ns[-1]
            if limit is None:
                yield number, block
                continue
            starts = np.flatnonzero(np.diff(block.t_ns, prepend=before) > limit)
            edges = [0, *starts.tolist(), len(block)]
            for start, stop in pairwise(edges):
                # Every edge but the block's own beginning is the end of a gap.
                number += start in starts
                if stop > start:
                    yield number, block[start:stop]

    def _located(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        for batch in batches:
            if len(batch):
                yield batch
                self.counts.read += len(batch)

    def _finite(self, batch: GyroSeries) -> GyroSeries:
        """Find rates that are not finite, and drop or fill them."""
        # Where the sum is finite all are: one pass for the common case.
        with np.errstate(over="ignore", invalid="ignore"):
            total = batch.rate.sum()
        if np.isfinite(total):
            self._held = batch.rate[-1]
            return batch
        good: NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(batch.rate), axis=1)
        event = self.counts.nonfinite
        event.add(np.flatnonzero(~good), self.counts.read, batch.t_ns)
        if self.policy.on_nonfinite == "error" and event.count:
            raise TimelineError(
                self.path,
                f"the rate of sample {event.first_index} (t = {event.first_ns} ns) is not finite; "
                "choose --on-nonfinite drop|hold",
            )
        if self.policy.on_nonfinite == "drop":
            return batch[good]
        if self.policy.on_nonfinite == "hold":
            return self._hold(batch, good)
        return batch

    def _hold(self, batch: GyroSeries, good: NDArray[np.bool_]) -> GyroSeries:
        if self._held is None and not good[0]:
            raise TimelineError(
                self.path,
                f"the rate of sample {self.counts.read} (t = {batch.t_ns[0]} ns) is not finite and "
                "there is none before it to hold; choose --on-nonfinite drop, or begin later with "
                "--start",
            )
        before = batch.rate[0] if self._held is None else self._held
        rows = np.concatenate([before[None], batch.rate])
        latest_good = np.maximum.accumulate(np.where(good, np.arange(1, len(rows)), 0))
        rate = rows[latest_good]
        self._held = rate[-1]
        return batch.with_rate(rate)

    def _forward(self, batch: GyroSeries) -> GyroSeries:
        """Find stamps that are earlier than one before, and drop them."""
        t_ns = batch.t_ns
        if not len(t_ns):
            return batch
        latest = int(t_ns[0]) if self._latest is None else self._latest
        if t_ns[0] >= latest and (t_ns[1:] >= t_ns[:-1]).all():
            self._latest = int(t_ns[-1])
            return batch
        reached = np.maximum.accumulate(np.maximum(t_ns, latest))
        # While looking, a backward step is one that goes back from its neighbour; a policy that
        # drops must drop everything up to the point where the clock has caught up again.
        if self.policy.on_backwards == "keep":
            back = np.diff(t_ns, prepend=latest) < 0
            self._latest = int(t_ns[-1])
        else:
            back = t_ns < reached
            self._latest = int(reached[-1])
        event = self.counts.backwards
        event.add(np.flatnonzero(back), self.counts.read, t_ns)
        if self.policy.on_backwards == "error":
            first = int(np.flatnonzero(back)[0])
            earlier = int(reached[first])
            raise TimelineError(
                self.path,
                f"time steps back by {duration_text(earlier - int(t_ns[first]))} at sample "
                f"{event.first_index} (t = {event.first_ns} ns); "
                "choose --on-backwards drop|sort, or another --clock",
            )
        if self.policy.on_backwards == "keep":
            return batch
        return batch[~back]

    def _sorted(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        whole = list(batches)
        if not whole:
            return
        log = GyroSeries.joined(whole)
        back = np.flatnonzero(log.t_ns < np.maximum.accumulate(log.t_ns))
        self.counts.backwards.add(back, 0, log.t_ns)
        yield log[np.argsort(log.t_ns, kind="stable")]

    def _with_gap_limit(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Hold the first samples back until the median interval is known."""
        window: list[GyroSeries] = []
        held = 0
        stream = iter(batches)
        for batch in stream:
            window.append(batch)
            held += len(batch)
            if held > MEDIAN_WINDOW:
                break
        if not held:
            return
        intervals = np.diff(np.concatenate([batch.t_ns for batch in window])[: MEDIAN_WINDOW + 1])
        positive = intervals[intervals > 0]
        if len(positive):
            self.counts.median_dt_ns = int(np.median(positive))
            if self.counts.gap_limit_ns is None:
                self.counts.gap_limit_ns = GAP_FACTOR * self.counts.median_dt_ns
        yield from window
        yield from stream

    def _measure(self, batch: GyroSeries) -> None:
        counts, t_ns = self.counts, batch.t_ns
        magnitude = np.sqrt(np.einsum("ij,ij->i", batch.rate, batch.rate))
        if not np.isfinite(magnitude.sum()):
            magnitude = np.where(np.isfinite(magnitude), magnitude, 0.0)
        first_ns = int(t_ns[0]) if counts.first_ns is None else counts.first_ns
        if int(t_ns[-1]) - first_ns > LONGEST_NS:
            raise TimelineError(
                self.path,
                f"its stamps span more than 292 years, up to {t_ns[-1]} ns; check --time-unit, the "
                "time column or --clock",
            )
        if counts.last_ns is None:
            counts.first_ns = int(t_ns[0])
            intervals, ruling, ends = np.diff(t_ns), magnitude[:-1], t_ns[1:]
        else:
            intervals = np.diff(t_ns, prepend=np.int64(counts.last_ns))
            ruling, ends = np.append(self._last_magnitude, magnitude[:-1]), t_ns
        counts.max_rate = max(counts.max_rate, float(magnitude.max()))
        lasting = intervals
        if batch.span_ns is not None:
            first = len(t_ns) - len(ends)
            ruling, lasting = magnitude[first:], batch.span_ns[first:]
            counts.integrated_ns = (counts.integrated_ns or 0) + int(lasting.sum())
        if self.policy.on_gap in {"zero", "split"} and counts.gap_limit_ns is not None:
            # Nothing is known to turn across a gap that is not propagated across.
            lasting = np.where(intervals > counts.gap_limit_ns, 0, lasting)
        # Not by a dot product: how that adds up depends on the number of threads.
        with np.errstate(over="ignore", invalid="ignore"):
            counts.turned += float((ruling * lasting).sum()) * 1e-9
        if len(intervals):
            self._measure_intervals(intervals, ends)
        self._last_magnitude = magnitude[-1]
        counts.last_ns = int(t_ns[-1])
        counts.used += len(batch)

    def _measure_intervals(self, intervals: NDArray[np.int64], ends: NDArray[np.int64]) -> None:
        """Count duplicates and gaps among intervals that end at the stamps `ends`."""
        counts = self.counts
        shortest, longest = int(intervals.min()), int(intervals.max())
        counts.min_dt_ns = min(shortest, shortest if counts.min_dt_ns is None else counts.min_dt_ns)
        counts.max_dt_ns = max(longest, longest if counts.max_dt_ns is None else counts.max_dt_ns)
        start = max(counts.used, 1)
        if shortest <= 0:
            counts.duplicates.add(np.flatnonzero(intervals == 0), start, ends)
        limit = counts.gap_limit_ns
        if limit is None or longest <= limit:
            return
        where = np.flatnonzero(intervals > limit)
        counts.gaps.add(where, start, ends)
        after = ends[where[: LISTED_GAPS - len(counts.gap_list)]]
        before = after - intervals[where[: len(after)]]
        counts.gap_list += zip(before.tolist(), after.tolist(), strict=True)
        if self.policy.on_gap == "error":
            raise TimelineError(
                self.path,
                f"a gap ends at sample {counts.gaps.first_index} (t = {counts.gaps.first_ns} ns), "
                f"longer than {duration_text(limit)}; choose --on-gap hold|zero|split or a "
                "longer --max-gap",
            )
