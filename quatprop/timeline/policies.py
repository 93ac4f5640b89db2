"""Timestamp handling: irregularities in a stream of samples, and the policy for each.

In recordings timestamps repeat, step back and jump, and rates are missing. Every such event is
counted and located here; the user's policy decides whether it is an error. Nothing is repaired
silently: the counts include what a policy changed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import groupby, pairwise
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Protocol, TypeAlias, TypeVar

import numpy as np

from quatprop.base.errors import TimelineError
from quatprop.base.text import Setting
from quatprop.kinematics.series import GyroSeries
from quatprop.kinematics.time_series import IN_CACHE, blocks, reblock
from quatprop.timeline.counts import other_times
from quatprop.timeline.regular_time import RegularTime
from quatprop.timeline.stamps import LONGEST_NS, Rows, StampChecks, outliers_in_order

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.timeline.counts import Policy
    from quatprop.timeline.stamps import Examined

    Numbered: TypeAlias = tuple[GyroSeries, Int64]
    """A batch, and the indices of its samples among those that were read."""


_FEWEST_IN_TURN = 8
"""Samples of which none has rates about all three axes, that show that the axes alternate."""


class Timed(Rows, Protocol):
    """Rows with timestamps, ns."""

    @property
    def t_ns(self) -> Int64: ...  # noqa: D102


TimedT = TypeVar("TimedT", bound=Timed)


@dataclass(frozen=True, slots=True)
class TimedRows:
    """Rows of a signal that is not that of the rates.

    `t_ns`: timestamps, shape ``(N,)``
    `values`: shape ``(N, M)``
    """

    t_ns: Int64
    values: Float64

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, chosen: Bool) -> TimedRows:
        return TimedRows(self.t_ns[chosen], self.values[chosen])


def _at_times_of(
    rows: Iterable[TimedRows], times: Iterator[Int64]
) -> Iterator[tuple[Int64, Float64]]:
    """Yield rows with other times, one for each, in order."""
    known = np.empty(0, np.int64)
    for each in rows:
        parts = [known]
        while sum(map(len, parts)) < len(each) and (following := next(times, None)) is not None:
            parts.append(following)
        known = np.concatenate(parts)
        count = min(len(each), len(known))
        yield known[:count], each.values[:count]
        known = known[count:]


def _ignored(t_ns: Int64) -> None:
    """Take no notice of timestamps."""


class Timeline(StampChecks):
    """Applies a policy to a stream of samples and counts irregularities.

    `policy`: the handling of each kind of irregularity
    `chosen_by`: the setting that chooses timestamps: ``"clock"``, or of a table ``"time_col"``
    `method`, `rates`: those of the propagation, to estimate the attitude error by jitter
    `steadier`: see :class:`.StampChecks`
    """

    def __init__(  # noqa: PLR0913  # the policy, and the later propagation
        self,
        policy: Policy,
        path: Path | str,
        chosen_by: str = "clock",
        *,
        method: str = "start",
        rates: str = "body",
        steadier: Callable[[], str] = str,
    ) -> None:
        super().__init__(path, policy, chosen_by, steadier)
        self._new_regular_time = partial(RegularTime, path, method, rates)
        self._regular_time = self._new_regular_time()
        self._last_finite: Float64 | None = None
        self._last_magnitude = np.float64(0.0)

    @property
    def first_stamp_ns(self) -> int | None:
        """The log's timestamp of the first sample used, ns; None if it was not replaced."""
        return self._regular_time.first_ns

    def apply(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the samples that are used, in blocks."""
        return self.count_intervals(
            self.apply_nonfinite_policy(self.apply_backwards_policy(batches))
        )

    def apply_backwards_policy(self, batches: Iterable[GyroSeries]) -> Iterator[Numbered]:
        """Yield samples after applying the policy for backwards timestamps."""
        examined = self.examined(batches, attrgetter("t_ns"))
        if self.policy.on_backwards == "sort":
            yield from self._sorted(examined)
            return
        for each in examined:
            dropped = each.outliers | each.back
            if self.policy.on_backwards == "keep" or not dropped.any():
                yield each.batch, each.rows
            elif not dropped.all():
                yield each.batch[~dropped], each.rows[~dropped]

    def preview(
        self,
        batches: Iterable[TimedT],
        note: Callable[[Int64], object],
        policy: Policy | None = None,
    ) -> Iterator[TimedT]:
        """Yield the samples that the policy will keep, in a first pass over a log.

        Nothing is counted or sorted. `note` is called with the timestamps that are not outliers.
        """
        seen: list[tuple[Int64, Bool]] = []
        checks = StampChecks(self.path, policy or self.policy, self.chosen_by, self._steadier)
        for each in checks.examined(batches, attrgetter("t_ns")):
            batch, wrong = each.batch, each.outliers
            if self.policy.on_backwards == "sort":
                seen.append((batch.t_ns, wrong))
            else:
                note(batch.t_ns[~wrong])
            dropped = wrong | (each.back & (self.policy.on_backwards == "drop"))
            yield batch[~dropped]
        if seen:
            # After sorting, all timestamps are needed to find the outliers.
            t_ns, found = map(np.concatenate, zip(*seen, strict=True))
            note(t_ns[~outliers_in_order(t_ns, found)])

    def preview_at_times(
        self, batches: Iterable[GyroSeries], note: Callable[[Int64], object]
    ) -> Iterator[GyroSeries]:
        """Yield the samples of :meth:`preview` at the times that they will get."""
        kept = self.preview(batches, note)
        return self._new_regular_time().replaced(reblock(kept)) if self._changes_times else kept

    def preview_other_signal(
        self,
        rows: Iterable[tuple[Int64, Float64]],
        rates: Callable[[], Iterable[GyroSeries]] | None,
    ) -> Iterator[tuple[Int64, Float64]]:
        """Yield the rows of another signal as :meth:`preview_at_times` yields rates.

        `rates`: reads the rates in whose rows they stand; None: they stand in others
        """
        policy = self.policy
        if policy.on_backwards == "error":
            # It is about the rates.
            policy = policy._replace(on_backwards="keep")
        kept = self.preview((TimedRows(*row) for row in rows), _ignored, policy)
        if rates is None or not self._changes_times:
            yield from ((each.t_ns, each.values) for each in kept)
            return
        timed = self.preview_at_times(rates(), _ignored)
        yield from _at_times_of(kept, (each.t_ns for each in timed))

    @property
    def _changes_times(self) -> bool:
        """Whether timestamps will be replaced, before which a preview would have to sort them."""
        return self.policy.regular_time and self.policy.on_backwards != "sort"

    def apply_nonfinite_policy(self, numbered: Iterable[Numbered]) -> Iterator[GyroSeries]:
        """Yield samples with finite rates; others are dropped, replaced or refused."""
        for batch, rows in numbered:
            # If the sum is finite all are: one pass in the common case.
            with np.errstate(over="ignore", invalid="ignore"):
                total = batch.rate.sum()
            if np.isfinite(total):
                self._last_finite = batch.rate[-1]
                yield batch
            else:
                yield self._finite(batch, rows)

    def count_intervals(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield samples in blocks of fixed size, and count their intervals.

        Blocks begin at fixed sample indices, as the rounding of sums depends on the blocks.
        """
        regular = self._regular_time
        timed = regular.replaced if self.policy.regular_time else regular.observed
        for block in self.with_gap_limit(timed(reblock(batches)), attrgetter("t_ns")):
            self._measure(block, self.intervals(block.t_ns))
            yield block
        self.counts.steady_clock = regular.clock
        self.counts.packet_error_rad = regular.packet_error_rad

    def refuse_standing_clock(self) -> None:
        """Refuse samples that were used if no time passes between them.

        Increments do not depend on it.
        """
        counts = self.counts
        if counts.samples_used < 2 or counts.span_ns or counts.integrated_ns is not None:  # noqa: PLR2004
            return
        raise TimelineError(
            self.path,
            f"all {counts.samples_used} timestamps are {counts.first_ns} ns, so nothing turns; "
            f"{other_times(self.chosen_by)}",
        )

    def segments(self, blocks: Iterable[GyroSeries]) -> Iterator[Iterator[GyroSeries]]:
        """Split samples at gaps, if the policy does not propagate across them."""
        if not self.policy.cuts_at_gaps:
            yield iter(blocks)
            return
        for _, numbered in groupby(self._numbered(blocks), key=itemgetter(0)):
            yield (series for _, series in numbered)

    def _numbered(self, blocks: Iterable[GyroSeries]) -> Iterator[tuple[int, GyroSeries]]:
        """Split blocks at gaps and number the segments."""
        number, last_ns = 0, None
        for block in blocks:
            limit = LONGEST_NS if self.counts.gap_limit_ns is None else self.counts.gap_limit_ns
            before = block.t_ns[0] if last_ns is None else last_ns
            last_ns = block.t_ns[-1]
            starts = np.flatnonzero(np.diff(block.t_ns, prepend=before) > limit)
            for start, stop in pairwise([0, *starts.tolist(), len(block)]):
                # All edges but the beginning of the block are ends of gaps.
                number += start in starts
                if stop > start:
                    yield number, block[start:stop]

    def _finite(self, batch: GyroSeries, rows: Int64) -> GyroSeries:
        """Count rates that are not finite, and drop or replace them."""
        good: Bool = np.logical_and.reduce(np.isfinite(batch.rate), axis=1)
        event = self.counts.nonfinite
        event.add(np.flatnonzero(~good), batch.t_ns, rows)
        if self.policy.on_nonfinite == "error" and event.count:
            choose = f"choose {Setting('on_nonfinite', 'drop|hold')}"
            raise TimelineError(
                self.path,
                f"the rate of sample {event.first_index} (t = {event.first_ns} ns) is absent or "
                f"not finite; {_in_turn(batch, rows, good) or choose}",
            )
        if self.policy.on_nonfinite == "drop":
            return batch[good]
        return self._hold(batch, good, rows) if self.policy.on_nonfinite == "hold" else batch

    def _hold(self, batch: GyroSeries, good: Bool, rows: Int64) -> GyroSeries:
        """Replace each rate that is not finite by the last finite one."""
        latest_good = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
        rate = batch.rate[latest_good]
        if not good[0]:
            if self._last_finite is None:
                drop = Setting("on_nonfinite", "drop")
                choose = f"choose {drop}, or begin later with {Setting('start')}"
                raise TimelineError(
                    self.path,
                    f"the rate of sample {rows[0]} (t = {batch.t_ns[0]} ns) is not finite and "
                    f"there is none before it to hold; {_in_turn(batch, rows, good) or choose}",
                )
            rate[latest_good < 0] = self._last_finite
        self._last_finite = rate[-1]
        return batch.with_rate(rate)

    def _sorted(self, examined: Iterable[Examined[GyroSeries]]) -> Iterator[Numbered]:
        """Yield one batch of all samples but outliers, in order of time."""
        parts = list(examined)
        if not parts:
            return
        log = GyroSeries.joined([part.batch for part in parts])
        rows = np.concatenate([part.rows for part in parts])
        if self.counts.outliers.count:
            found = np.concatenate([part.outliers for part in parts])
            wrong = outliers_in_order(log.t_ns, found)
            if (wrong != found).any():
                self.count_again(log.t_ns, wrong)
            log, rows = log[~wrong], rows[~wrong]
        order = np.argsort(log.t_ns, kind="stable")
        yield log[order], rows[order]

    def _measure(self, batch: GyroSeries, intervals: Int64) -> None:
        """Add a batch to the statistics of rates; the intervals end at its last samples."""
        counts = self.counts
        every = np.empty(len(batch) + 1)
        every[0], magnitude = self._last_magnitude, every[1:]
        # Not einsum, whose rounding depends on whether the processor has fused multiply-add.
        with np.errstate(over="ignore", invalid="ignore"):  # rates of a damaged log
            for tile in blocks(len(batch), IN_CACHE):
                squares = batch.rate[tile] * batch.rate[tile]
                np.add(squares[:, 0], squares[:, 1], out=magnitude[tile])
                magnitude[tile] += squares[:, 2]
            np.sqrt(magnitude, out=magnitude)
        if not np.isfinite(magnitude.max()):
            magnitude[~np.isfinite(magnitude)] = 0.0
        counts.max_rate = max(counts.max_rate, float(magnitude.max()))
        first = len(batch) - len(intervals)
        if batch.integration_time_ns is not None:
            rate, duration = magnitude[first:], batch.integration_time_ns[first:]
            counts.integrated_ns = (counts.integrated_ns or 0) + int(duration.sum())
        else:
            rate, duration = every[first:-1], intervals
        if self.policy.cuts_at_gaps and counts.gap_limit_ns is not None:
            duration = np.where(intervals > counts.gap_limit_ns, 0, duration)
        # Not a dot product, whose rounding depends on the number of threads.
        with np.errstate(over="ignore", invalid="ignore"):
            counts.path_angle_rad += float((rate * duration).sum()) * 1e-9
        self._last_magnitude = magnitude[-1]


def _in_turn(batch: GyroSeries, rows: Int64, good: Bool) -> str:
    """Return what to do where each axis has rates, but no sample has all three; else nothing."""
    has_some = np.isfinite(batch.rate).any(axis=0).all()
    if good.any() or len(good) < _FEWEST_IN_TURN or not has_some:
        return ""
    return (
        f"none of the samples {rows[0]} to {rows[-1]} has rates about all three axes, as in a "
        "table with one axis in each row: fill each axis with its last rate, as with ffill() and "
        "dropna() of pandas"
    )
