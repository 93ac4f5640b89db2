"""Timestamp handling: the choices for each kind of irregularity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Policy:
    """How each kind of irregularity is handled.

    Parameters
    ----------
    on_backwards
        Time stamps earlier than one before: ``"error"``; ``"drop"`` the samples; ``"sort"`` all
        samples by stamp (keeps the whole log in memory); ``"keep"`` them, for inspection only.
    on_nonfinite
        Rates that are NaN or infinite: ``"error"``; ``"drop"`` the samples; ``"hold"`` the last
        finite rate; ``"keep"`` them, for inspection only.
    on_gap
        Intervals longer than `max_gap_ns`: ``"hold"`` propagates across them like any other;
        ``"error"``; ``"zero"`` assumes no rotation; ``"split"`` restarts from q0.
    max_gap_ns
        Intervals longer than this count as gaps, ns; None means
        :data:`quatprop.timeline.stamps.GAP_FACTOR` median intervals.
    """

    on_backwards: Literal["error", "drop", "sort", "keep"] = "error"
    on_nonfinite: Literal["error", "drop", "hold", "keep"] = "error"
    on_gap: Literal["hold", "zero", "split", "error"] = "hold"
    max_gap_ns: int | None = None

    @property
    def cuts_at_gaps(self) -> bool:
        """Whether a gap is not propagated across."""
        return self.on_gap in {"zero", "split"}


OBSERVE = Policy(on_backwards="keep", on_nonfinite="keep")
"""Change nothing, count everything."""
