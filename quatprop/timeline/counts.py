"""Policy for irregular timestamps and rates, and counts of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple

from quatprop.base.text import Remark, Setting
from quatprop.base.times import NS_PER_S, duration_text, utc_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Int64, Intp

LISTED_GAPS = 1000
"""Maximum number of listed gaps; all are counted."""

INTEGRATED_SHARE = 0.001
"""Increments that miss a larger share of the log's time cause a remark."""

FASTEST = 50_000
"""Hz: no gyroscope has a higher sample rate."""

EPOCH_US = (1_000_000_000_000_000, 2_000_000_000_000_000)
"""us since 1970 in 2001 and in 2033; as ns these are day 12 and day 23 of 1970 or of a clock."""

FASTEST_IN_US = 5_000
"""Hz: a rate above this with timestamps in that range indicates microseconds, at 5 Hz or more."""

LONGEST_S = 2
"""s: a longer median interval indicates another unit of time."""

COSTLY = math.radians(0.01)
"""rad: jitter that causes a smaller attitude error causes no remark."""

MANY_REPEATS = 1 / 8
"""Samples may share timestamps in packets if this share of intervals is 0."""

MIN_SAMPLES = 20
"""Minimum number of samples for remarks on the sample rate."""


class Policy(NamedTuple):
    """The handling of each kind of irregularity.

    `on_backwards`: timestamps earlier than a previous one, and outliers: ``"error"``; ``"drop"``
        the samples; ``"sort"`` all samples by time (keeps the whole log in memory) and drop
        outliers; ``"keep"`` them, for inspection only
    `on_nonfinite`: rates that are NaN or infinite: ``"error"``; ``"drop"`` the samples; ``"hold"``
        the last finite rate; ``"keep"`` them, for inspection only
    `on_gap`: intervals longer than `max_gap_ns`: ``"hold"`` propagates across them as across any
        other; ``"error"``; ``"zero"`` assumes no rotation; ``"split"`` restarts from q0
    `max_gap_ns`: intervals longer than this count as gaps, ns; None means
        :data:`quatprop.timeline.stamps.GAP_FACTOR` median intervals
    `regular_time`: whether to replace timestamps that jitter about a steady clock by its times
    """

    on_backwards: Literal["error", "drop", "sort", "keep"] = "error"
    on_nonfinite: Literal["error", "drop", "hold", "keep"] = "error"
    on_gap: Literal["hold", "zero", "split", "error"] = "hold"
    max_gap_ns: int | None = None
    regular_time: bool = False

    @property
    def cuts_at_gaps(self) -> bool:
        """Whether gaps are not propagated across."""
        return self.on_gap in {"zero", "split"}


OBSERVE = Policy(on_backwards="keep", on_nonfinite="keep")
"""Change nothing, count everything."""


@dataclass(slots=True)
class Event:
    """The number of occurrences of an irregularity, and the first of them.

    `count`: number of occurrences
    `first_index`: index of the first sample concerned, from 0: among the samples read for rates
        that are not finite, outliers and backwards timestamps; among those used for repeated
        timestamps and gaps
    `first_ns`: timestamp of that sample, ns
    `cause`: the likely cause, if the neighbouring timestamps show it; else ``""``
    """

    count: int = 0
    first_index: int | None = None
    first_ns: int | None = None
    cause: str = ""

    def add(self, where: Intp, t_ns: Int64, rows: Int64 | int) -> None:
        """Count the positions `where` in a batch of samples with the indices `rows`.

        `rows`: the indices, or only the first of consecutive indices
        """
        if len(where) and self.first_index is None:
            first = int(where[0])
            self.first_index = rows + first if isinstance(rows, int) else int(rows[first])
            self.first_ns = int(t_ns[first])
        self.count += len(where)


class SteadyClock(NamedTuple):
    """The steady clock about which timestamps jitter.

    `rate_hz`: its rate, Hz; the mean over a log
    `offset_ns`: its first time, ns
    `residual_rms_ns`: RMS difference between it and the timestamps, ns
    `residual_max_ns`: largest difference between it and the timestamps, ns
    `missing_ticks`: number of its times without a sample, not counting pauses
    `unchanged_samples`: samples whose timestamps do not jitter, or that are too few between pauses
        to decide
    `error_rad`: RMS over all samples of the angle between the attitudes propagated with the
        timestamps and with the clock, rad
    `packet`: largest number of samples under one timestamp, if they share timestamps; else 1
    """

    rate_hz: float
    offset_ns: int
    residual_rms_ns: float
    residual_max_ns: int
    missing_ticks: int
    unchanged_samples: int
    error_rad: float
    packet: int = 1


@dataclass(slots=True)
class Counts:
    """Counts and statistics of timestamps and rates; complete after the last batch.

    Parameters
    ----------
    samples_read
        Samples read in the requested range.
    samples_used
        Samples used.
    first_ns
        Timestamp of the first sample used, ns.
    last_ns
        Timestamp of the last sample used, ns.
    median_dt_ns
        Median of the first :data:`quatprop.timeline.stamps.MEDIAN_WINDOW` positive intervals, ns.
    min_dt_ns
        Shortest interval between samples used, ns.
    max_dt_ns
        Longest interval between samples used, ns.
    gap_limit_ns
        Intervals longer than this count as gaps, ns.
    duplicates
        Timestamps equal to the previous one.
    backwards
        Timestamps earlier than a previous one.
    outliers
        Timestamps ahead of those that follow.
    gaps
        Intervals above the limit, located by the sample after each.
    longest_gap
        The timestamps before and after the longest gap, ns.
    gap_list
        The timestamps before and after each of the first :data:`LISTED_GAPS` gaps, ns.
    max_rate
        Largest finite magnitude of the angular rate, rad/s.
    path_angle_rad
        Total angle traversed, rad: the sum of abs(w) dt with the rate at the start of each
        interval, or of the increments.
    integrated_ns
        For increments, their total integration time, ns.
    nonfinite
        Rates that are NaN or infinite.
    steady_clock
        The clock about which the timestamps jitter; None if they do not.
    packet_error_rad
        If samples share timestamps, RMS over all samples of the angle between the attitudes
        propagated with the timestamps and with samples spread evenly between them, rad; else 0.
    """

    samples_read: int = 0
    samples_used: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    median_dt_ns: int | None = None
    min_dt_ns: int | None = None
    max_dt_ns: int | None = None
    gap_limit_ns: int | None = None
    duplicates: Event = field(default_factory=Event)
    backwards: Event = field(default_factory=Event)
    outliers: Event = field(default_factory=Event)
    gaps: Event = field(default_factory=Event)
    longest_gap: tuple[int, int] | None = None
    gap_list: list[tuple[int, int]] = field(default_factory=list)
    max_rate: float = 0.0
    path_angle_rad: float = 0.0
    integrated_ns: int | None = None
    nonfinite: Event = field(default_factory=Event)
    steady_clock: SteadyClock | None = None
    packet_error_rad: float = 0.0

    @property
    def span_ns(self) -> int:
        """Time from the first sample to the last, ns."""
        return 0 if self.first_ns is None or self.last_ns is None else self.last_ns - self.first_ns

    @property
    def dropped(self) -> int:
        """Samples that were read but not used."""
        return self.samples_read - self.samples_used


HANDLED = {
    ("", ""): "kept: a zero-length step leaves the attitude unchanged",
    ("on_backwards", "drop"): "dropped",
    ("on_backwards", "sort"): "sorted",
    ("on_backwards", "keep"): f"refused without {Setting('on_backwards', 'drop|sort')}",
    ("on_nonfinite", "drop"): "dropped",
    ("on_nonfinite", "hold"): "replaced by the last finite rate",
    ("on_nonfinite", "keep"): f"refused without {Setting('on_nonfinite', 'drop|hold')}",
    ("outliers", "drop"): "dropped",
    ("outliers", "sort"): "dropped",
    ("outliers", "keep"): f"refused without {Setting('on_backwards', 'drop|sort')}",
    ("on_gap", "hold"): "propagated across",
    ("on_gap", "zero"): "no rotation assumed",
    ("on_gap", "split"): "restarted from q0",
}
"""Setting and its value -> the handling of an event, for sentences."""


_LONGEST_PAUSE_NS = 365 * 86_400 * NS_PER_S
"""After a longer interval, a clock was set, as from 1970 to today, ns."""


def remarks(counts: Counts, policy: Policy, chosen_by: str = "clock") -> Iterator[Remark]:
    """Yield a remark on every kind of event that occurred.

    `chosen_by`: the setting that chooses timestamps
    """
    limit = duration_text(counts.gap_limit_ns or 0)
    events = {
        "": ("repeated-stamps", counts.duplicates, "repeated timestamp{s}"),
        "outliers": ("stamp-outliers", counts.outliers, "timestamp outlier{s}"),
        "on_backwards": ("stamps-back", counts.backwards, "non-monotonic timestamp{s}"),
        "on_nonfinite": ("nonfinite-rates", counts.nonfinite, "non-finite rate{s}"),
        "on_gap": ("gaps", counts.gaps, f"interval{{s}} longer than {limit}"),
    }
    for setting, (code, event, noun) in events.items():
        if event.count:
            chosen = policy.on_backwards if setting == "outliers" else getattr(policy, setting, "")
            handled = HANDLED[setting, chosen]
            if event is counts.backwards and event.cause and chosen == "keep":
                handled = "refused"  # neither drop nor sort corrects the clock
            longest = ""
            # A wrong timestamp at an end may be the cause of the longest gap.
            if event is counts.gaps and counts.longest_gap is not None:
                before, after = counts.longest_gap
                which = "; the longest, of " if event.count > 1 else ", "
                longest = f"{which}{duration_text(after - before)} after {before} ns"
                if after - before > _LONGEST_PAUSE_NS and chosen == "hold":
                    starts, ends = Setting("start", f"{after}"), Setting("end", f"{before}")
                    longest += f": if the clock was set there, use one part, by {starts} or {ends}"
            cost = _cost_of_packets(counts, chosen_by) if event is counts.duplicates else ""
            if event is counts.gaps and counts.steady_clock is None and _come_in_bursts(counts):
                cost = (
                    "; the samples come in bursts: if they were taken one after another, these are "
                    "times of arrival, and the rates are propagated wrongly; "
                    f"{other_times(chosen_by)}"
                )
            yield Remark(
                code,
                f"{event.count} {noun.format(s='s' if event.count > 1 else '')} ({handled}), first "
                f"at sample {event.first_index}, t = {event.first_ns} ns{event.cause}{longest}"
                f"{cost}",
            )
    yield from _time_remarks(counts, chosen_by)
    clock = counts.steady_clock
    if clock is None or clock.error_rad < COSTLY or policy.regular_time:
        return
    if clock.packet > 1:
        are_shared = counts.duplicates.count >= MANY_REPEATS * counts.samples_used
        have = "share a timestamp" if are_shared else "are stamped at about one time"
        yield Remark(
            "packets",
            f"up to {clock.packet} samples {have}, of a steady clock of "
            f"{clock.rate_hz:.6g} Hz: the attitude error is {math.degrees(clock.error_rad):.2g} "
            f"deg RMS; {Setting('regular_time')} gives each sample its time by that clock",
        )
    else:
        yield Remark(
            "jitter",
            f"the timestamps jitter about a steady clock of {clock.rate_hz:.6g} Hz, by "
            f"{duration_text(round(clock.residual_rms_ns))} RMS and at most "
            f"{duration_text(clock.residual_max_ns)}: if they are arrival times or rounded, the "
            f"attitude error is {math.degrees(clock.error_rad):.2g} deg RMS; "
            f"{Setting('regular_time')} uses the times of that clock, but if the samples were "
            "taken at the times stated, it is what makes this error",
        )


def _cost_of_packets(counts: Counts, chosen_by: str) -> str:
    """Return what timestamps that samples share may cost, if no steady clock says it."""
    is_said = counts.steady_clock is not None or counts.samples_used < MIN_SAMPLES
    if is_said or counts.packet_error_rad < COSTLY:
        return ""
    return (
        "; if these samples were taken one after another, the attitude error is about "
        f"{math.degrees(counts.packet_error_rad):.2g} deg RMS: {other_times(chosen_by)}"
    )


def _come_in_bursts(counts: Counts) -> bool:
    """Return whether most of the time is in gaps between a few samples each."""
    mean_ns = counts.span_ns / max(counts.samples_used - 1, 1)
    is_often = counts.gaps.count > MANY_REPEATS * counts.samples_used
    return is_often and mean_ns > 2 * (counts.median_dt_ns or 0)


def other_times(chosen_by: str) -> str:
    """Return the ways to other times."""
    remedy = f"choose other timestamps with {Setting(chosen_by)}"
    if chosen_by == "time_col":
        remedy += f", or count rows at a steady rate with {Setting('sample_rate', 'HZ')}"
    return remedy


def _time_remarks(counts: Counts, chosen_by: str) -> Iterator[Remark]:
    """Yield remarks on the time span and rate of the samples."""
    if (
        counts.duplicates.count > counts.samples_used / 2
        and (counts.first_ns or 0) % NS_PER_S == 0
        and counts.median_dt_ns is not None
        and counts.median_dt_ns % NS_PER_S == 0
    ):
        yield Remark(
            "whole-seconds",
            "the timestamps are whole seconds, each of several samples: they do not show when a "
            f"sample was taken; choose other timestamps with {Setting(chosen_by)}",
        )
    if counts.integrated_ns is not None:
        missed = counts.span_ns - counts.integrated_ns
        if abs(missed) > INTEGRATED_SHARE * counts.span_ns:
            yield Remark(
                "increments-span",
                f"the increments cover {duration_text(counts.integrated_ns)} of the "
                f"{duration_text(counts.span_ns)} between the first timestamp and the last"
                + (": no rotation is assumed for the rest" if missed > 0 else ""),
            )
    if counts.samples_used > 1 and counts.span_ns == 0:
        yield Remark(
            "equal-stamps",
            f"all timestamps are {counts.first_ns} ns, so the rates cannot be propagated; choose "
            f"other timestamps with {Setting(chosen_by)}",
        )
    elif counts.samples_used >= MIN_SAMPLES and counts.span_ns > 0:
        first_ns, rate = counts.first_ns or 0, (counts.samples_used - 1) * NS_PER_S / counts.span_ns
        oddity = ""
        if (counts.median_dt_ns or 0) > LONGEST_S * NS_PER_S:
            oddity = f"{rate:.3g} samples per second are few for a gyroscope"
        elif rate > FASTEST:
            oddity = f"{rate:,.0f} samples per second are beyond any gyroscope"
        elif EPOCH_US[0] <= first_ns < EPOCH_US[1] and rate > FASTEST_IN_US:
            oddity = (
                f"{rate:,.0f} samples per second that begin on {utc_text(first_ns)[:10]} are odd"
            )
        if oddity:
            yield Remark(
                "sample-rate",
                f"{oddity}; if the timestamps are in another unit, use "
                f"{Setting('time_unit', 's|ms|us|ns')}",
            )
