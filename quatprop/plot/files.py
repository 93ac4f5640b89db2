"""Read files for a picture: once from beginning to end, in constant memory."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from quatprop.conditioning import condition
from quatprop.conditioning.time_range import absolute_range
from quatprop.containers.stores import without_secret
from quatprop.conventions import HAMILTON
from quatprop.errors import (
    LogError,
    NoAttitudesError,
    NoRatesError,
    NoSamplesError,
    NoSuchTopicError,
    UndeclaredError,
)
from quatprop.formats import open_log
from quatprop.pipeline.plausibility import log_remarks
from quatprop.pipeline.rate_checks import RateChecks
from quatprop.plot.accumulators import SIGMA_BAND, AttitudeAccumulator, RateAccumulator
from quatprop.plot.picture import PlottedFile
from quatprop.plot.view import FileView
from quatprop.rendering import count_text, instant_text, samples_text, source_text
from quatprop.signals.attitudes import choose_attitudes
from quatprop.signals.rates import UNITS, choose_rates
from quatprop.signals.signal import RateSignal
from quatprop.text import Setting, plain
from quatprop.timeline import Timeline
from quatprop.timeline.counts import Counts
from quatprop.timeline.stamps import OBSERVE, StampChecks
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from quatprop.plot.accumulators import Accumulator
    from quatprop.plot.view import View
    from quatprop.rendering import Row
    from quatprop.signals.signal import AttitudeSignal
    from quatprop.tables.base import AnyLog
    from quatprop.timeline.counts import StampCounts

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

DRAWN_AS = {
    False: "yaw, pitch and roll, q = q_z(yaw) q_y(pitch) q_x(roll), deg",
    True: "components, of q and -q those nearer to the row before",
}
"""Whether components are drawn -> what is drawn of an attitude."""


def view_file(path: str, view: View) -> FileView:
    """Read a file for a picture.

    Parameters
    ----------
    path
        A log or a table, or ``"-"`` for CSV on stdin.
    view
        What to draw.

    Raises
    ------
    LogError
        The file cannot be used with this selection, or holds neither rates nor attitudes.
    UsageError
        It can be read only once, and would have to be read twice.
    """
    with open_log(path, view.kind, msg_path=view.rates.msg_path) as log:
        name, signal = without_secret(path), _choose(log, view)
        if isinstance(signal, RateSignal):
            return _view_rates(name, log, signal, view)
        return _view_attitudes(name, log, signal, view)


def _choose(log: AnyLog, view: View) -> RateSignal | AttitudeSignal:
    """Return the rates to draw, or else the attitudes."""
    if view.show == "attitude":
        return choose_attitudes(log, view.attitudes)
    try:
        return choose_rates(log, view.rates)
    except (NoRatesError, NoSuchTopicError, UndeclaredError) as error:
        if view.show == "rates":
            raise
        try:
            return choose_attitudes(log, view.attitudes)
        except (NoAttitudesError, NoSuchTopicError, UndeclaredError) as other:
            raise _neither(log, error, other) from error


_COUNTERPARTS = {"rate_field": "quat_field", "rate_cols": "quat_cols"}
"""Settings about rates -> those about attitudes."""


def _neither(log: AnyLog, rates: LogError, attitudes: LogError) -> LogError:
    """Return the most useful error for a file with neither rates nor attitudes."""
    if isinstance(rates, NoRatesError) and isinstance(attitudes, NoAttitudesError):
        content, *way_out = rates.reason.parts
        neither = str(content).replace("no body rates", "neither body rates nor attitudes", 1)
        parts: list[str | Setting] = [neither]
        for part in way_out:
            parts.append(part)
            if isinstance(part, Setting) and part.name in _COUNTERPARTS:
                parts += [" or ", Setting(_COUNTERPARTS[part.name])]
        return LogError(log.path, *parts)
    return rates if isinstance(attitudes, NoAttitudesError | NoSuchTopicError) else attitudes


def _view_rates(path: str, log: AnyLog, source: RateSignal, view: View) -> FileView:
    batches, done = condition(source.batches, view.part, UNITS[source.unit])
    drawn, checks = RateAccumulator(source.unit, UNITS[source.unit]), RateChecks()
    timeline = Timeline(OBSERVE, path)
    counts = timeline.counts
    deque(timeline.apply(drawn.passing(checks.observe(batches))), maxlen=0)
    if not counts.used:
        raise NoSamplesError(path, source.name, done.outside)
    remarks = [*source.remarks, *_irregularities(counts), *checks.remarks(counts)]
    remarks += log.remarks
    if path != "-":
        remarks += log_remarks(log, source)
    return FileView(
        plotted=_plotted(path, source, drawn, counts),
        meaning=f"body rates as recorded, {source.unit}, {source.clock} clock",
        samples=samples_text(counts.used, counts.span_ns),
        facts=(
            *_source_facts(path, log, source),
            ("convention", "rates as recorded, in the axes of the sensor; nothing subtracted"),
            ("rate", f"{source.field} in {source.unit}"),
            *_time_facts(counts),
            ("largest rate", f"{counts.max_rate / UNITS[source.unit]:.6g} {source.unit}"),
        ),
        remarks=tuple(remarks),
        losses=tuple(log.losses),
    )


def _view_attitudes(path: str, log: AnyLog, source: AttitudeSignal, view: View) -> FileView:
    drawn = AttitudeAccumulator(
        components=view.components, unwrap=view.unwrap, has_sigmas=source.may_have_covariances
    )
    outside, stamps = [0, 0], StampChecks(path)
    counts = stamps.counts
    deque(stamps.observe(_drawn(source, view, drawn, outside)), maxlen=0)
    if not counts.used:
        raise NoSamplesError(path, source.name, outside)
    remarks = [*source.remarks, *_irregularities(counts), *log.remarks]
    if drawn.invalid:
        invalid = count_text(drawn.invalid, "invalid quaternion")
        remarks.append(f"{invalid} (zero, absent or not finite): not drawn")
    convention = source.provenance.get("convention")
    method = plain(convention.get("method") or "") if isinstance(convention, dict) else ""
    form = "components, sign continuous" if view.components else "zyx angles"
    form += f" ({SIGMA_BAND})" if drawn.knows_sigmas else ""
    propagated = f", propagated with method {method}" if method else ""
    stored = f"{source.meaning.convention} {source.meaning.direction}"
    return FileView(
        plotted=_plotted(path, source, drawn, counts),
        meaning=f"Hamilton q, body to reference, as {form}{propagated}, {source.clock} clock",
        samples=samples_text(counts.used, counts.span_ns),
        facts=(
            *_source_facts(path, log, source),
            ("convention", HAMILTON.description),
            ("drawn as", DRAWN_AS[view.components]),
            ("attitude", f"{source.field}, stored {source.layout}, {stored}"),
            *((("method", method),) if method else ()),
            *_time_facts(counts),
            ("norm error", f"at most {drawn.norm_error:.3g}"),
        ),
        remarks=tuple(remarks),
        losses=tuple(log.losses),
    )


def _plotted(
    path: str, source: RateSignal | AttitudeSignal, drawn: Accumulator, counts: StampCounts
) -> PlottedFile:
    shown = source_text(source.name, source.type_name)
    return PlottedFile(path, (drawn.group(counts.gap_limit_ns),), shown)


def _source_facts(path: str, log: AnyLog, source: RateSignal | AttitudeSignal) -> Iterator[Row]:
    yield "file", f"{path} ({log.kind})"
    yield "source", source_text(source.name, source.type_name)
    yield "clock", source.clock


def _time_facts(counts: StampCounts) -> Iterator[Row]:
    yield "samples", samples_text(counts.used, counts.span_ns)
    for label, t_ns in (("first", counts.first_ns), ("last", counts.last_ns)):
        yield label, f"{instant_text(t_ns or 0)} ({t_ns} ns)"
    if counts.median_dt_ns is not None and counts.max_dt_ns is not None:
        median, longest = duration_text(counts.median_dt_ns), duration_text(counts.max_dt_ns)
        yield "interval", f"median {median}, longest {longest}"


def _irregularities(counts: StampCounts) -> Iterator[str]:
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
    for event, noun, details in events:
        if event.count:
            yield f"{count_text(event.count, noun)}{details}, first at {event.first_ns} ns"


def _drawn(
    source: AttitudeSignal, view: View, drawn: AttitudeAccumulator, outside: list[int]
) -> Iterator[Int64]:
    """Accumulate the part to draw and yield its stamps; count the samples before and after it."""
    ends = (0, 0)
    if view.part.looks_ahead:
        stamps = [(int(t_ns[0]), int(t_ns[-1])) for t_ns, _ in source.rows() if len(t_ns)]
        if stamps:
            ends = stamps[0][0], stamps[-1][1]
    start_ns, end_ns = absolute_range(view.part, *ends)
    for t_ns, wxyz, _, covariance in source.read(covariances=source.may_have_covariances):
        before = np.zeros(len(t_ns), np.bool_) if start_ns is None else t_ns < start_ns
        after = np.zeros(len(t_ns), np.bool_) if end_ns is None else t_ns > end_ns
        outside[0] += int(np.count_nonzero(before))
        outside[1] += int(np.count_nonzero(after))
        inside = ~(before | after)
        known = None if covariance is None else covariance[inside]
        drawn.add_rows(t_ns[inside], wxyz[inside], known)
        yield t_ns[inside]
