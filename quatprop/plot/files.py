"""Files to what is drawn of them: read once from beginning to end, in flat memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from quatprop.conditioning import Conditioning, condition
from quatprop.containers.remote import without_secret
from quatprop.conventions import HAMILTON
from quatprop.errors import (
    LogError,
    NoAttitudesError,
    NoRatesError,
    NoSamplesError,
    NoSuchTopicError,
    UndeclaredError,
    UsageError,
)
from quatprop.formats import open_log
from quatprop.pipeline.plausibility import RateChecks, log_remarks
from quatprop.plot.accumulators import AttitudeSketch, RateSketch, Sketch
from quatprop.plot.facts import events_in, facts_of, named, samples_text, where_from
from quatprop.plot.names import names_of
from quatprop.plot.picture import Group, Part
from quatprop.selection import AttitudeSelection, RateSelection
from quatprop.signals.attitudes import choose_attitudes
from quatprop.signals.rates import UNITS, choose_rates
from quatprop.text import Setting, plain
from quatprop.timeline import OBSERVE, StampChecks, Timeline

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from quatprop.containers.base import Loss, MessageLog
    from quatprop.signals.signal import AttitudeSignal, RateSignal
    from quatprop.tables.base import TableLog
    from quatprop.text import Text
    from quatprop.timeline.counts import StampCounts
    from quatprop.times import Instant

    Tick = Callable[[int], None]
    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

DRAWN_AS = {
    False: "yaw, pitch and roll, q = q_z(yaw) q_y(pitch) q_x(roll), deg",
    True: "components, of q and -q those nearer to the row before",
}
"""Whether components are drawn -> what of an attitude is."""

SHOWS = ("rates", "attitude")
"""What can be drawn of a file."""


@dataclass(frozen=True, slots=True)
class View:
    """What to look at in files.

    Parameters
    ----------
    kind
        A key of :data:`quatprop.formats.READERS`; None: told by content and suffix.
    show
        One of :data:`SHOWS`; None: the rates of a file that has some, else its attitudes.
    rates, attitudes
        Which samples.
    components
        Draw quaternions as they are instead of as angles.
    start, end
        The part to draw, ends included.
    """

    kind: str | None = None
    show: str | None = None
    rates: RateSelection = field(default_factory=RateSelection)
    attitudes: AttitudeSelection = field(default_factory=AttitudeSelection)
    components: bool = False
    start: Instant | None = None
    end: Instant | None = None

    @property
    def looks_ahead(self) -> bool:
        """Whether a file has to be read once before it can be read for good."""
        return Conditioning(start=self.start, end=self.end).looks_ahead


@dataclass(frozen=True, slots=True)
class Seen:
    """One file, read.

    Parameters
    ----------
    path
        The file.
    part
        What is drawn of it.
    meaning
        What the numbers are: unit and clock, or convention and method.
    samples
        How many, over which time.
    facts
        Name and text of what is in its table.
    remarks
        What looks wrong.
    losses
        What could not be read.
    """

    path: str
    part: Part
    meaning: str
    samples: str
    facts: tuple[tuple[str, str], ...]
    remarks: tuple[str | Text, ...]
    losses: tuple[Loss, ...]

    @property
    def name(self) -> str:
        """What was read: file, topic and type."""
        return self.part.name


def see(path: str, view: View, tick: Tick = lambda _samples: None) -> Seen:
    """Read a file for a picture.

    Parameters
    ----------
    path
        A log or a table, or ``"-"`` for CSV on stdin.
    view
        What to look at.
    tick
        Called with the number of samples read so far.

    Raises
    ------
    LogError
        The file cannot be used as asked, or holds neither rates nor attitudes.
    UsageError
        It can be read only once, and would have to be twice.
    """
    if path == "-" and view.looks_ahead:
        raise UsageError("stdin can be read only once; relative --start and --end need a file")
    with open_log(path, view.kind) as log:
        name, source = without_secret(path), _chosen(log, view)
        if isinstance(source, tuple):
            return _see_attitudes(name, log, source[0], view, tick)
        return _see_rates(name, log, source, view, tick)


def _chosen(log: MessageLog | TableLog, view: View) -> RateSignal | tuple[AttitudeSignal]:
    """Return the rates, or in a tuple the attitudes, that are to be drawn."""
    if view.show == "attitude":
        return (choose_attitudes(log, view.attitudes),)
    try:
        return choose_rates(log, view.rates)
    except (NoRatesError, NoSuchTopicError, UndeclaredError) as error:
        if view.show == "rates":
            raise
        try:
            return (choose_attitudes(log, view.attitudes),)
        except (NoAttitudesError, NoSuchTopicError, UndeclaredError) as other:
            raise _neither(log, error, other) from error


_NEITHER = "neither body rates nor attitudes"

_COUNTERPARTS = {"rate_field": "quat_field", "rate_cols": "quat_cols"}
"""Settings about rates -> those about attitudes."""


def _neither(log: MessageLog | TableLog, rates: LogError, attitudes: LogError) -> LogError:
    """Return the error that says most of a file with neither rates nor attitudes."""
    if isinstance(rates, NoRatesError) and isinstance(attitudes, NoAttitudesError):
        held, *way_out = rates.reason.parts
        parts: list[str | Setting] = [str(held).replace("no body rates", _NEITHER, 1)]
        for part in way_out:
            parts.append(part)
            if isinstance(part, Setting) and part.name in _COUNTERPARTS:
                parts += [" or ", Setting(_COUNTERPARTS[part.name])]
        return LogError(log.path, *parts)
    return rates if isinstance(attitudes, NoAttitudesError | NoSuchTopicError) else attitudes


def _part(
    path: str, source: RateSignal | AttitudeSignal, sketch: Sketch, counts: StampCounts
) -> Part:
    """Return what is drawn of a file."""
    group = Group(sketch.rows, sketch.reduced(), counts.gap_limit_ns)
    return Part(names_of([path])[0], (group,), named(source))


def _see_rates(
    path: str, log: MessageLog | TableLog, source: RateSignal, view: View, tick: Tick
) -> Seen:
    part = Conditioning(start=view.start, end=view.end)
    batches, done = condition(source.batches, part, UNITS[source.unit])
    sketch, watch = RateSketch(source.unit, UNITS[source.unit]), RateChecks()
    timeline = Timeline(OBSERVE, path)
    counts = timeline.counts
    for _ in timeline.apply(sketch.passing(watch.observe(batches))):
        tick(counts.used)
    if not counts.used:
        raise NoSamplesError(path, source.name, done.outside)
    findings = watch.remarks(counts.median_dt_ns)
    if path != "-":
        findings += log_remarks(log, source)
    highest = f"{counts.max_rate / UNITS[source.unit]:.6g} {source.unit}"
    return Seen(
        path=path,
        part=_part(path, source, sketch, counts),
        meaning=f"body rates as recorded, {source.unit}, {source.clock} clock",
        samples=samples_text(counts),
        facts=(
            *where_from(path, log, source),
            ("convention", "rates as recorded, in the axes of the sensor; nothing subtracted"),
            ("rate", f"{source.field} in {source.unit}"),
            *facts_of(counts),
            ("largest rate", highest),
        ),
        remarks=(*map(str, source.remarks), *events_in(counts), *findings),
        losses=tuple(log.losses),
    )


def _see_attitudes(
    path: str, log: MessageLog | TableLog, source: AttitudeSignal, view: View, tick: Tick
) -> Seen:
    sketch = AttitudeSketch(components=view.components)
    outside = [0, 0]
    stamps = StampChecks(path)
    counts = stamps.counts
    for _ in stamps.observe(_sketched(_within(source, view, outside), sketch)):
        tick(counts.used)
    if not counts.used:
        raise NoSamplesError(path, source.name, outside)
    remarks = [*source.remarks, *events_in(counts)]
    if sketch.absent:
        remarks.append(
            f"{sketch.absent} rows are no attitude (zero, absent or not finite): not drawn"
        )
    made = source.provenance.get("convention")
    method = plain(made.get("method") or "") if isinstance(made, dict) else ""
    how = f", propagated with method {method}" if method else ""
    stored = f"{source.meaning.convention} {source.meaning.direction}"
    return Seen(
        path=path,
        part=_part(path, source, sketch, counts),
        meaning=f"{attitude_words(components=view.components)}{how}, {source.clock} clock",
        samples=samples_text(counts),
        facts=(
            *where_from(path, log, source),
            ("convention", HAMILTON.words),
            ("drawn as", DRAWN_AS[view.components]),
            ("attitude", f"{source.field}, stored {source.layout}, {stored}"),
            *((("method", method),) if method else ()),
            *facts_of(counts),
            ("off unit length", f"at most {sketch.worst:.3g}"),
        ),
        remarks=tuple(remarks),
        losses=tuple(log.losses),
    )


def attitude_words(*, components: bool) -> str:
    """Return the convention of what is drawn."""
    form = "components, sign continuous" if components else "zyx angles"
    return f"Hamilton q, body to reference, as {form}"


def _sketched(rows: Iterable[tuple[Int64, Float64]], sketch: AttitudeSketch) -> Iterator[Int64]:
    """Sketch attitudes, and yield their stamps."""
    for t_ns, wxyz in rows:
        sketch.add_rows(t_ns, wxyz)
        yield t_ns


def _within(
    source: AttitudeSignal, view: View, outside: list[int]
) -> Iterator[tuple[Int64, Float64]]:
    """Yield the rows of the part that is to be drawn; count those before and after it."""
    first_ns = last_ns = 0
    if view.looks_ahead:
        stamps = [(int(t_ns[0]), int(t_ns[-1])) for t_ns, _ in source.rows() if len(t_ns)]
        if stamps:
            first_ns, last_ns = stamps[0][0], stamps[-1][1]
    origin = {"clock": 0, "first": first_ns, "last": last_ns}
    bounds = np.iinfo(np.int64)
    low = bounds.min if view.start is None else view.start.ns + origin[view.start.origin]
    high = bounds.max if view.end is None else view.end.ns + origin[view.end.origin]
    for t_ns, wxyz in source.rows():
        before, after = t_ns < low, t_ns > high
        outside[0] += int(np.count_nonzero(before))
        outside[1] += int(np.count_nonzero(after))
        inside = ~(before | after)
        yield t_ns[inside], wxyz[inside]
