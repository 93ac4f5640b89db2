"""What is said of a file beside its picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.plot.picture import instant_text
from quatprop.text import plain
from quatprop.timeline.counts import Counts
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.containers.base import MessageLog
    from quatprop.signals.signal import AttitudeSignal, RateSignal
    from quatprop.tables.base import TableLog
    from quatprop.timeline.counts import StampCounts


def named(source: RateSignal | AttitudeSignal) -> str:
    """Return the topic and its type, or the columns and their dialect."""
    return " ".join(plain(text) for text in (source.name, source.type_name) if text)


def where_from(
    path: str, log: MessageLog | TableLog, source: RateSignal | AttitudeSignal
) -> Iterator[tuple[str, str]]:
    """Yield where samples come from."""
    yield "file", f"{path} ({log.kind})"
    yield "source", named(source)
    yield "clock", source.clock


def facts_of(counts: StampCounts) -> Iterator[tuple[str, str]]:
    """Yield how many samples there were, and when."""
    yield "samples", samples_text(counts)
    for word, t_ns in (("first", counts.first_ns), ("last", counts.last_ns)):
        yield word, f"{instant_text(t_ns or 0)} ({t_ns} ns)"
    if counts.median_dt_ns is not None and counts.max_dt_ns is not None:
        said = f"median {duration_text(counts.median_dt_ns)}"
        yield "interval", f"{said}, longest {duration_text(counts.max_dt_ns)}"


def samples_text(counts: StampCounts) -> str:
    """Return how many samples there were, over which time and how often."""
    said = f"{counts.used:,} sample{'s' if counts.used > 1 else ''}"
    if counts.span_ns <= 0:
        return said
    often = (counts.used - 1) / (counts.span_ns * 1e-9)
    return f"{said} over {duration_text(counts.span_ns)}, {often:.6g} Hz"


def events_in(counts: StampCounts) -> Iterator[str]:
    """Yield a sentence for each kind of irregularity."""
    limit = duration_text(counts.gap_limit_ns or 0)
    longest = duration_text(counts.max_dt_ns or 0)
    events = [
        (counts.gaps, "gap", f" longer than {limit}, the longest {longest}: shaded"),
        (counts.duplicates, "repeated timestamp", ""),
        (counts.backwards, "non-monotonic timestamp", ""),
    ]
    if isinstance(counts, Counts):
        events.append((counts.nonfinite, "non-finite rate", " (not drawn)"))
    for event, noun, which in events:
        if event.count:
            plural = "s" if event.count > 1 else ""
            yield f"{event.count:,} {noun}{plural}{which}, first at {event.first_ns} ns"
