"""What was seen on a timeline: events counted and located, and the sentences about them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from quatprop.text import plain
from quatprop.times import duration_text

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from quatprop.timeline import Policy

LISTED_GAPS = 1000
"""So many gaps are listed one by one; the others are counted."""

INTEGRATED_SHARE = 0.001
"""Increments that miss more than this share of the log's time are remarked on."""


@dataclass(slots=True)
class Event:
    """How often something happened, and where first.

    Parameters
    ----------
    count
        Occurrences.
    first_index
        Sample index of the first, counted from 0 as read.
    first_ns
        Its stamp, ns.
    """

    count: int = 0
    first_index: int | None = None
    first_ns: int | None = None

    def add(self, where: NDArray[np.intp], start: int, t_ns: NDArray[np.int64]) -> None:
        """Count the sample positions `where` of a batch that starts at index `start`."""
        if len(where) and self.first_index is None:
            self.first_index = start + int(where[0])
            self.first_ns = int(t_ns[where[0]])
        self.count += len(where)


@dataclass(slots=True)
class Counts:
    """What was seen on the timeline; complete when the last batch has passed.

    Parameters
    ----------
    read, used
        Samples that came in and that went on.
    first_ns, last_ns
        Stamps of the first and last sample that went on.
    median_dt_ns
        Median of the first :data:`MEDIAN_WINDOW` positive intervals, ns.
    min_dt_ns, max_dt_ns
        Extreme intervals between samples that went on, ns.
    max_rate
        Largest finite magnitude of the angular rate, rad/s.
    turned
        Angle turned on the way, rad: the sum of abs(w) dt with the rate at each interval's start,
        or of the increments.
    integrated_ns
        For increments: the time over which the sensor integrated them, ns, in all intervals.
    gap_limit_ns
        Intervals longer than this were counted as gaps.
    duplicates, backwards, nonfinite, gaps
        Stamps equal to the one before; earlier than one before; rates not finite; long intervals.
        A gap is located by the sample after it.
    gap_list
        The first :data:`LISTED_GAPS` gaps: the stamps before and after each, ns.
    """

    read: int = 0
    used: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    median_dt_ns: int | None = None
    min_dt_ns: int | None = None
    max_dt_ns: int | None = None
    max_rate: float = 0.0
    turned: float = 0.0
    integrated_ns: int | None = None
    gap_limit_ns: int | None = None
    duplicates: Event = field(default_factory=Event)
    backwards: Event = field(default_factory=Event)
    nonfinite: Event = field(default_factory=Event)
    gaps: Event = field(default_factory=Event)
    gap_list: list[tuple[int, int]] = field(default_factory=list)

    @property
    def span_ns(self) -> int:
        """Time from the first sample to the last, ns."""
        return 0 if self.first_ns is None or self.last_ns is None else self.last_ns - self.first_ns

    @property
    def dropped(self) -> int:
        """Samples that were read but did not go on."""
        return self.read - self.used


def remarks(counts: Counts, policy: Policy) -> list[str]:
    """Return one sentence for every event that a reader of the result should know of.

    Parameters
    ----------
    counts
        What was seen.
    policy
        What was done about it.
    """
    done = {
        "duplicates": "kept: a step of zero time turns nothing",
        "backwards": {"drop": "dropped", "sort": "sorted"}.get(
            policy.on_backwards, "refused without --on-backwards drop|sort"
        ),
        "nonfinite": {"drop": "dropped", "hold": "replaced by the rate before"}.get(
            policy.on_nonfinite, "refused without --on-nonfinite drop|hold"
        ),
        "gaps": {"zero": "taken as no rotation", "split": "begun again at q0"}.get(
            policy.on_gap, "propagated across"
        ),
    }
    limit = duration_text(counts.gap_limit_ns or 0)
    what = {
        "duplicates": ("repeated stamp", "repeated stamps"),
        "backwards": ("stamp that steps back", "stamps that step back"),
        "nonfinite": ("rate that is not finite", "rates that are not finite"),
        "gaps": (f"interval longer than {limit}", f"intervals longer than {limit}"),
    }
    said = []
    for name, words in what.items():
        event: Event = getattr(counts, name)
        if event.count:
            said.append(
                f"{event.count} {words[event.count > 1]} ({done[name]}), "
                f"first at sample {event.first_index}, t = {event.first_ns} ns"
            )
    if counts.integrated_ns is not None:
        missed = counts.span_ns - counts.integrated_ns
        if abs(missed) > INTEGRATED_SHARE * counts.span_ns:
            said.append(
                f"the increments were integrated over {duration_text(counts.integrated_ns)} of the "
                f"{duration_text(counts.span_ns)} between the first stamp and the last"
                + (": the rest is taken as no rotation" if missed > 0 else "")
            )
    if counts.used > 1 and counts.span_ns == 0:
        said.append(
            f"all stamps are {plain(counts.first_ns)} ns: time does not pass; is there another "
            "--clock or time column?"
        )
    return said
