"""What a log holds: every source of body rates, measured on its timeline."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from quatprop.readers import open_log
from quatprop.sanity import Watch, orientation_remarks
from quatprop.signals.rates import sources
from quatprop.timeline import OBSERVE, Timeline
from quatprop.timeline.counts import remarks

if TYPE_CHECKING:
    from quatprop.selection import Selection
    from quatprop.signals.rates import Source


def survey(path: str, kind: str | None, selection: Selection) -> dict[str, Any]:
    """Read a log once per source and return what it holds.

    Parameters
    ----------
    path
        The log.
    kind
        Its kind, or None: told by its content.
    selection
        Restricts the sources; None for all.

    Returns
    -------
    dict
        ``path``, ``kind``, ``sources`` (a list, each with type, counts and remarks) and
        ``losses``; JSON-ready.

    Raises
    ------
    LogError
        The log cannot be read, or holds no body rates.
    """
    with open_log(path, kind) as log:
        found = []
        for source in sources(log, selection):
            facts = _measured(source, path)
            if path != "-":
                facts["remarks"] += orientation_remarks(log, source)
            found.append(facts)
        return {
            "path": path,
            "kind": log.kind,
            "sources": found,
            "losses": [asdict(loss) for loss in log.losses],
        }


def _measured(source: Source, path: str) -> dict[str, Any]:
    timeline = Timeline(OBSERVE, path)
    watch = Watch()
    deque(timeline.apply(watch.passing(source.batches())), maxlen=0)
    counts = timeline.counts
    span_s = counts.span_ns * 1e-9
    return {
        "source": source.name,
        "type": source.type_name,
        "rate": source.rate,
        "rate_unit": source.unit,
        "clock": source.clock,
        "samples": counts.used,
        "rate_hz": (counts.used - 1) / span_s if span_s > 0 else None,
        "span_s": span_s,
        "first_ns": counts.first_ns,
        "last_ns": counts.last_ns,
        "median_dt_ns": counts.median_dt_ns,
        "min_dt_ns": counts.min_dt_ns,
        "max_dt_ns": counts.max_dt_ns,
        "gaps": counts.gaps.count,
        "duplicates": counts.duplicates.count,
        "backwards": counts.backwards.count,
        "nonfinite": counts.nonfinite.count,
        "max_rate_rad_s": counts.max_rate,
        "max_rate_deg_s": math.degrees(counts.max_rate),
        "remarks": [
            *source.remarks,
            *remarks(counts, OBSERVE),
            *watch.remarks(counts.median_dt_ns),
        ],
    }
