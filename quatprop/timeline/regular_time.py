"""Detect jitter of timestamps about a steady clock, or replace them by its times.

The clock is fitted to each block of samples, so that memory use is constant and a clock that
drifts over hours is followed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from quatprop.base.errors import TimelineError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, geodesic_angle, multiply
from quatprop.kinematics.series import GyroSeries
from quatprop.timeline.counts import MANY_REPEATS, SteadyClock
from quatprop.timeline.packets import are_copies, begins_of, of_packets, packet_clock, spread_evenly
from quatprop.timeline.steady_clock import (
    SHORTEST,
    FittedClock,
    clock_of,
    follows,
    is_regular,
    share_of_repeats,
    stretches,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from quatprop.base.arrays import Float64, Int64

    Stretch: TypeAlias = tuple[GyroSeries, slice, FittedClock | None]

_FASTEST = 1e4
"""rad/s: larger rates are damaged, and are excluded."""

MOST_REPEATS = 1 / 2
"""If this share of timestamps repeats the one before, they are those of packets only."""


@dataclass(slots=True)
class _Sums:
    """Sums over the stretches of a log so far; stretches are the parts between pauses.

    `fitted`: samples that jitter; `kept`: samples that do not, or are too few to decide
    `judged`: whether there were enough samples to decide
    `carried`: square of the attitude error that earlier stretches leave, rad^2
    """

    fitted: int = 0
    kept: int = 0
    judged: bool = False
    missing: int = 0
    offset_ns: int | None = None
    intervals: float = 0.0
    span_ns: float = 0.0
    squares: float = 0.0
    largest_ns: int = 0
    error_squares: float = 0.0
    carried: float = 0.0
    packet: int = 1

    def keep(self, samples: int, *, judged: bool) -> None:
        """Add samples whose timestamps are not changed."""
        self.judged |= judged
        self.kept += samples
        self.error_squares += samples * self.carried

    def add(self, t_ns: Int64, clock: FittedClock, error: Float64) -> None:
        """Add timestamps that jitter about a clock, and the attitude errors by jitter, rad."""
        rest = t_ns - clock.t_ns
        self.offset_ns = int(clock.t_ns[0]) if self.offset_ns is None else self.offset_ns
        self.judged = True
        self.fitted += len(rest)
        self.missing += clock.missing
        span = int(clock.t_ns[-1] - clock.t_ns[0])
        self.span_ns += span
        self.intervals += span / clock.period_ns
        self.squares += float(np.var(rest)) * len(rest)
        self.largest_ns = max(self.largest_ns, int(np.abs(rest).max()))
        self.packet = max(self.packet, clock.packet)
        self._add_error(error)

    def note(self, error: Float64) -> None:
        """Add attitude errors, rad, of samples whose timestamps are not changed."""
        self.kept += len(error)
        self._add_error(error)

    @property
    def error_rad(self) -> float:
        """RMS over all samples of the attitude error, rad."""
        return float((self.error_squares / max(self.fitted + self.kept, 1)) ** 0.5)

    def _add_error(self, error: Float64) -> None:
        self.error_squares += len(error) * self.carried + float((error**2).sum())
        self.carried += float(error[-1]) ** 2

    def clock(self) -> SteadyClock | None:
        """Return the clock; None if nothing jitters."""
        if self.offset_ns is None:
            return None
        return SteadyClock(
            rate_hz=self.intervals * NS_PER_S / self.span_ns,
            offset_ns=self.offset_ns,
            residual_rms_ns=(self.squares / self.fitted) ** 0.5,
            residual_max_ns=self.largest_ns,
            missing_ticks=self.missing,
            unchanged_samples=self.kept,
            error_rad=self.error_rad,
            packet=self.packet,
        )


class RegularTime:
    """Compares timestamps with a steady clock, or replaces them by its times.

    `method`, `rates`: those of the propagation, to estimate the attitude error by jitter
    `first_ns`: the first timestamp before it was replaced, ns; None if it was not
    """

    def __init__(self, path: Path | str, method: str, rates: str) -> None:
        self._path, self._rates = path, rates
        self._propagated = partial(attitudes, method=method, rates=rates)
        self.first_ns: int | None = None
        self._sums: _Sums | None = _Sums()
        self._by_spread = _Sums()
        # Whether timestamps are those of the first samples of packets.
        self._at_first: bool | None = None

    @property
    def clock(self) -> SteadyClock | None:
        """The clock about which all timestamps jitter; None if there is none."""
        return self._sums.clock() if self._sums is not None else None

    @property
    def packet_error_rad(self) -> float:
        """RMS of the angle between attitudes by the timestamps and by samples spread evenly."""
        return self._by_spread.error_rad

    def observed(self, blocks: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield blocks unchanged, and fit the clock as long as there may be one."""
        for block in blocks:
            # Increments do not depend on their timestamps.
            if block.integration_time_ns is None:
                self._observe(block)
            yield block

    def replaced(self, blocks: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield blocks at the times of their clocks; refuse timestamps without a steady clock."""
        sums = self._sums = _Sums()
        for block in _with_long_end(blocks):
            self.first_ns = int(block.t_ns[0]) if self.first_ns is None else self.first_ns
            yield replace(block, t_ns=self._times(block, sums))
        if not sums.judged:
            raise self._refusal("of this log", f"no {SHORTEST} of them are without a pause")

    def _observe(self, block: GyroSeries) -> None:
        """Fit the clock of a block, and estimate what repeated timestamps cost."""
        if self._sums is not None:
            try:
                self._times(block, self._sums)
            except TimelineError:
                self._sums = None
        t_ns = block.t_ns
        is_packed = MANY_REPEATS <= share_of_repeats(t_ns) < 1
        if is_packed and (t_ns[1:] >= t_ns[:-1]).all() and not are_copies(t_ns, block.rate):
            self._by_spread.note(self._error_rad(block, spread_evenly(t_ns)))
        else:
            self._by_spread.keep(len(block), judged=False)

    def _times(self, block: GyroSeries, sums: _Sums) -> Int64:
        """Return the clock times of a block, and add it to the sums."""
        times = block.t_ns.copy()
        for samples, part, clock in self._clocks(block):
            if clock is None or not clock.jitters:
                sums.keep(len(samples), judged=clock is not None)
            elif clock.why_not:
                which = f"from {samples.t_ns[0]} to {samples.t_ns[-1]} ns"
                raise self._refusal(which, clock.why_not)
            else:
                sums.add(samples.t_ns, clock, self._error_rad(samples, clock.t_ns))
                times[part] = clock.t_ns
        return times

    def _clocks(self, block: GyroSeries) -> Iterator[Stretch]:
        """Yield the stretches of a block with their clocks; None for too few samples."""
        intervals = np.diff(block.t_ns)
        if (intervals < 0).any():
            yield block, slice(None), FittedClock(block.t_ns, why_not="they step back")
        elif is_regular(intervals):
            yield block, slice(None), FittedClock(block.t_ns, jitters=False)
        else:
            found = [*self._clocks_of(block)]
            if all(clock is None for *_, clock in found):
                found = [*self._clocks_of_bursts(block)] or found
            yield from found

    def _clocks_of(self, block: GyroSeries) -> Iterator[Stretch]:
        """Yield the stretches of irregular samples with their clocks."""
        for part in stretches(block.t_ns):
            yield block[part], part, self._clock_of(block[part])

    def _clocks_of_bursts(self, block: GyroSeries) -> Iterator[Stretch]:
        """Yield the same if samples come in bursts with long pauses, unless they were taken so."""
        together = of_packets(block.t_ns)
        if together is None:
            return
        for samples, part, clock in self._clocks_of(replace(block, t_ns=together)):
            if clock is None or clock.why_not:
                return
            if not follows(_without_damaged(samples.rate), clock.t_ns, block.t_ns[part]):
                return
            yield samples, part, clock

    def _clock_of(self, samples: GyroSeries) -> FittedClock | None:
        """Return the clock of a stretch, as of single samples or of packets."""
        t_ns, rate = samples.t_ns, _without_damaged(samples.rate)
        repeats = share_of_repeats(t_ns)
        enough = len(samples) >= SHORTEST
        if not MANY_REPEATS <= repeats < 1 or are_copies(t_ns, rate):
            return clock_of(t_ns, rate) if enough else None
        clock = clock_of(t_ns, rate) if enough and repeats < MOST_REPEATS else None
        is_found = clock is not None and not clock.why_not
        # Samples that are missing from one clock may be in packets of another.
        if clock is not None and is_found and not clock.missing:
            return clock
        together, at_first = packet_clock(t_ns, self._at_first)
        if clock is not None and (
            together.why_not or (is_found and together.missing >= clock.missing)
        ):
            return clock
        if together.why_not:
            return together if enough else None
        self._at_first = at_first
        return together

    def _error_rad(self, samples: GyroSeries, other_ns: Int64) -> Float64:
        """Return the angles between attitudes by the timestamps and by other times, rad.

        They are compared at each timestamp, at the sample of its packet that was taken then.
        """
        t_ns, rate = samples.t_ns, _without_damaged(samples.rate)
        by_stamps, by_clock = (self._propagated(times, rate) for times in (t_ns, other_ns))
        since = exp(rate * ((t_ns - other_ns) * 1e-9)[:, None])
        factors = (by_clock, since) if self._rates == "body" else (since, by_clock)
        error = geodesic_angle(by_stamps, multiply(*factors))
        if not share_of_repeats(t_ns):
            return error
        begins = begins_of(t_ns)
        sizes = np.diff(begins, append=len(t_ns))
        return np.repeat(error[begins if self._at_first else begins + sizes - 1], sizes)

    def _refusal(self, which: str, why: str) -> TimelineError:
        return TimelineError(
            self._path,
            f"the timestamps {which} do not jitter about a steady clock: {why}; omit "
            f"{Setting('regular_time')}",
        )


def _without_damaged(rate: Float64) -> Float64:
    """Return rates with zeros in place of damaged ones."""
    return np.where(np.abs(rate) < _FASTEST, rate, 0.0)


def _with_long_end(blocks: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
    """Yield blocks; a short last one is joined to the previous, as few samples show no clock."""
    held: GyroSeries | None = None
    for block in blocks:
        if held is not None and len(block) < len(held) // 2:
            block = GyroSeries.joined([held, block])  # noqa: PLW2901
        elif held is not None:
            yield held
        held = block
    if held is not None:
        yield held
