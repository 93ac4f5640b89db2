"""Survey a log: every signal of body rates and of attitudes, with its counts and remarks.

A signal that cannot be read without more settings is listed with the settings that it needs.
"""

from __future__ import annotations

import math
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any, TypeVar

from quatprop.base.errors import (
    LogError,
    NoAttitudesError,
    NoRatesError,
    NoSamplesError,
    NoSignalsError,
    NoSuchTopicError,
    TimelineError,
    UndeclaredError,
    UsageError,
)
from quatprop.base.places import without_secret
from quatprop.base.provenance import JsonObject, entry_of
from quatprop.base.rendering import loss_lines, rows_html, table_html
from quatprop.base.text import Remark, in_python, listed, plain, spelled
from quatprop.base.threads import thread_count, use_threads
from quatprop.propagation.rate_stream import RateStream
from quatprop.propagation.recording import Recording, open_recording
from quatprop.readers.attitude_quality import QuaternionCheck
from quatprop.readers.attitude_signals import attitude_candidates, meaning_of, recorded_convention
from quatprop.readers.rate_signals import rate_candidates, unless_damaged
from quatprop.settings.reading import AttitudeSelection, RateSelection
from quatprop.timeline.counts import Counts
from quatprop.timeline.stamps import StampChecks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from quatprop.base.arrays import Int64
    from quatprop.base.errors import Loss
    from quatprop.kinematics.series import GyroSeries
    from quatprop.readers.signal import AttitudeSignal, Candidate, RateSignal, SelectionT, SignalT
    from quatprop.readers.tables.model import Log, Table

    Seen = dict[tuple[str, str], "_AttitudeReading"]


# The result of a survey: the signals of a log, with the facts about each.


COLUMNS = {
    "source": "source",
    "type": "type",
    "samples": "samples",
    "rate_hz": "Hz",
    "span_s": "span s",
    "gaps": "gaps",
    "duplicates": "dup",
    "backwards": "back",
}
"""Attribute of a signal -> heading of its column in a table."""

RATE_COLUMNS = {**COLUMNS, "max_rate_rad_s": "max rad/s"}
ATTITUDE_COLUMNS = {**COLUMNS, "source": "attitudes", "invalid": "invalid", "layout": "layout"}


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSurvey:
    """One signal of a log; None where something is unknown.

    `source`, `type`: topic and message type, or columns and dialect
    `rate_hz`, `span_s`: mean sample rate, Hz, and time from the first sample to the last, s
    `first_ns`, `last_ns`: first and last stamp, ns
    `median_dt_ns`, `min_dt_ns`, `max_dt_ns`: intervals, ns
    `gaps`, `duplicates`, `backwards`: intervals longer than 10 median ones, repeated timestamps,
        and those that go backwards or are outliers
    `missing`: what is not declared, and the settings that declare it; None if nothing is missing
    `remarks`: remarks on the series
    """

    source: str | None
    type: str = ""
    clock: str | None = None
    samples: int | None = None
    rate_hz: float | None = None
    span_s: float | None = None
    first_ns: int | None = None
    last_ns: int | None = None
    median_dt_ns: int | None = None
    min_dt_ns: int | None = None
    max_dt_ns: int | None = None
    gaps: int | None = None
    duplicates: int | None = None
    backwards: int | None = None
    missing: str | None = None
    remarks: tuple[Remark, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Missing settings, and remarks."""
        return (*((self.missing,) if self.missing else ()), *self.remarks)

    def cells(self, columns: Iterable[str]) -> list[str]:
        """Return the values of attributes as texts in a table."""
        return [cell_text(getattr(self, name)) for name in columns]


def cell_text(value: object) -> str:
    """Return a value as text in a table."""
    if value is None:
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else plain(value)


@dataclass(frozen=True, slots=True, kw_only=True)
class RateSurvey(SignalSurvey):
    """One signal of body rates; takes the parameters of :class:`SignalSurvey` too.

    `rate`, `rate_unit`: the field or the columns, and their unit
    `nonfinite`: samples that are NaN or infinite
    `max_rate_rad_s`, `max_rate_deg_s`: largest magnitude of the angular rate
    """

    rate: str | None = None
    rate_unit: str | None = None
    nonfinite: int | None = None
    max_rate_rad_s: float | None = None
    max_rate_deg_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeSurvey(SignalSurvey):
    """One signal of attitudes; takes the parameters of :class:`SignalSurvey` too.

    `attitude`: the field or the columns
    `invalid`: rows that are no unit quaternions
    `method`, `made_from`, `q0_wxyz`: how they were made, as the metadata of their file say: the
        integration rule, the log of the rates, and the first attitude (Hamilton, body -> reference,
        scalar first)
    """

    attitude: str = ""
    layout: str | None = None
    convention: str | None = None
    direction: str | None = None
    invalid: int | None = None
    method: str | None = None
    made_from: str | None = None
    q0_wxyz: tuple[float, ...] | None = None


SurveyT = TypeVar("SurveyT", bound=SignalSurvey)


@dataclass(frozen=True, slots=True)
class LogSurvey:
    """The content of a log.

    Parameters
    ----------
    path
        The log.
    kind
        Its format.
    sources, attitudes
        Its signals of body rates and of attitudes. Each has a `source` (topic or columns), `type`,
        `clock`, `samples`, `rate_hz`, `span_s`, `first_ns`, `last_ns`, `gaps`, `duplicates`,
        `backwards`, `remarks`, and `missing`: the settings that it needs to be read.
    losses
        Parts of the log that could not be read.
    """

    path: str
    kind: str
    sources: tuple[RateSurvey, ...]
    attitudes: tuple[AttitudeSurvey, ...]
    losses: tuple[Loss, ...]

    def __repr__(self) -> str:
        sources = [f"{one.source} ({one.samples})" for one in (*self.sources, *self.attitudes)]
        return f"<LogSurvey: {self.path} ({self.kind}): {listed(sources) or 'nothing'}>"

    def _repr_html_(self) -> str:
        """Return a table of the signals, and what is to be known of them, for notebooks."""
        title = f"{self.path} ({self.kind})"
        parts = [
            table_html(title, columns.values(), [signal.cells(columns) for signal in signals])
            for signals, columns in (
                (self.sources, RATE_COLUMNS),
                (self.attitudes, ATTITUDE_COLUMNS),
            )
            if signals
        ]
        signals = (*self.sources, *self.attitudes)
        notes = [(cell_text(one.source), spelled(text)) for one in signals for text in one.notes]
        notes += [("lost", line) for line in loss_lines(self.losses)]
        return "".join(parts or [f"<p>{escape(title)}</p>"]) + rows_html("", notes) * bool(notes)

    def in_python(self) -> LogSurvey:
        """Return it with settings spelled as keywords."""

        def spelled(one: SurveyT) -> SurveyT:
            missing = one.missing and in_python(one.missing)
            return replace(
                one,
                missing=missing,
                remarks=tuple(remark.spelled(in_python) for remark in one.remarks),
            )

        sources, attitudes = tuple(map(spelled, self.sources)), tuple(map(spelled, self.attitudes))
        return replace(self, sources=sources, attitudes=attitudes)


def timing(counts: Counts) -> dict[str, Any]:
    """Return what a survey says of stamps, by name."""
    span_s = counts.span_ns * 1e-9
    return {
        "rate_hz": (counts.samples_used - 1) / span_s if span_s > 0 else None,
        "span_s": span_s,
        "first_ns": counts.first_ns,
        "last_ns": counts.last_ns,
        "median_dt_ns": counts.median_dt_ns,
        "min_dt_ns": counts.min_dt_ns,
        "max_dt_ns": counts.max_dt_ns,
        "gaps": counts.gaps.count,
        "duplicates": counts.duplicates.count,
        "backwards": counts.backwards.count + counts.outliers.count,
    }


def making(provenance: JsonObject) -> dict[str, Any]:
    """Return how attitudes were made; what is not as this package writes it is left out."""
    convention = entry_of(provenance, "convention", dict)
    q0 = entry_of(convention, "q0_wxyz", list)
    return {
        "method": entry_of(convention, "method", str) or None,
        "made_from": entry_of(entry_of(provenance, "source", dict), "path", str) or None,
        "q0_wxyz": tuple(q0) if [type(x) for x in q0] == [float] * 4 else None,
    }


READ_ONCE = Remark("read-once", "text on stdin is read only once: attitudes were not looked for")

_TIMING = tuple(timing(Counts()))
_RATES = ("rate_unit", "max_rate_rad_s", "max_rate_deg_s")

_ASSUMED: tuple[tuple[dict[str, Any], tuple[str, ...]], ...] = (
    ({"rate_unit": "rad/s"}, _RATES),
    ({"time_unit": "ns"}, _TIMING),
    ({"rate_unit": "rad/s", "time_unit": "ns"}, (*_RATES, *_TIMING)),
)
"""Units assumed for a table that declares none, and the facts that are then unknown."""


def survey(name: str, kind: str | None, selection: RateSelection) -> LogSurvey:
    """Read every signal of a log once.

    `name`: the log, possibly ``LOG:TOPIC``
    `kind`: its kind; None to detect it from the content
    """
    # Nothing is propagated or written, so all cores but one decompress data in advance.
    threads = thread_count()
    with (
        use_threads(threads + 1 if threads > 1 else 1),
        open_recording([name], selection, kind) as recording,
    ):
        return _survey(recording)


def _survey(recording: Recording) -> LogSurvey:
    log, selection = recording.tables, recording.selection
    read_once = recording.is_stream
    only_rates = selection.rate_field is not None or selection.rate_cols is not None
    no_rates: LogError | None = None
    seen: Seen | None = None if only_rates else {}
    rates: tuple[RateSurvey, ...] = ()
    try:
        rates = tuple(_rates(recording, seen, read_once=read_once))
    except (NoRatesError, NoSuchTopicError) as error:
        no_rates = error
    attitudes: tuple[AttitudeSurvey, ...] = ()
    if not (only_rates or (read_once and rates)):
        attitudes = tuple(_attitudes(log, selection, seen or {}))
    if no_rates is not None and not attitudes:
        if isinstance(no_rates, NoRatesError) and not only_rates:
            no_rates = NoSignalsError(log.path, no_rates.seen, no_rates.what, no_rates.packed)
        raise unless_damaged(log, no_rates)
    name = without_secret(recording.name)
    return LogSurvey(name, log.kind, rates, attitudes, recording.losses)


class _AttitudeReading:
    """Attitudes of a log, and the findings while they are read."""

    def __init__(self, log: Log, signal: AttitudeSignal) -> None:
        self.signal = signal
        self.check = QuaternionCheck(log.path, drop=True)
        self.stamps = StampChecks(log.path)

    def __iter__(self) -> Iterator[Int64]:
        """Read the attitudes, and yield their stamps; invalid quaternions have stamps too."""
        for t_ns, wxyz in self.signal.rows():
            deque(self.check.apply([(t_ns, wxyz)]), maxlen=0)
            yield t_ns


def _attitude_reading(
    log: Log, selection: RateSelection, rates: RateSignal, seen: Seen
) -> _AttitudeReading | None:
    """Return and note the only attitudes in the messages of rates, if no settings are missing."""
    try:
        wanted = replace(AttitudeSelection.like(selection), topic=rates.name)
        (candidate,) = attitude_candidates(log, wanted)
        reading = _AttitudeReading(log, candidate.signal())
    except (LogError, UsageError, ValueError):
        return None
    name = reading.signal.name, reading.signal.field
    return None if name in seen else seen.setdefault(name, reading)


def _rates(recording: Recording, seen: Seen | None, *, read_once: bool) -> Iterator[RateSurvey]:
    """Yield the rates of a log; attitudes in the same messages are read with them, and noted."""
    log, selection = recording.tables, recording.selection
    list_again = partial(rate_candidates, log)
    for candidate in rate_candidates(log, selection):
        try:
            signal, unknown, missing = _declared(candidate, list_again, selection, _ASSUMED)
        except (TimelineError, UndeclaredError) as error:
            yield RateSurvey(source=candidate.topic or None, missing=error.reason)
            continue
        attitudes = None
        if seen is not None and candidate.found.table.is_typed:
            attitudes = _attitude_reading(log, selection, signal, seen)
        try:
            surveyed = _survey_rates(recording, signal, attitudes)
        except UndeclaredError as error:  # of series that begin late
            yield RateSurvey(source=candidate.topic or None, missing=error.reason)
            continue
        remarks = (*surveyed.remarks, *([READ_ONCE] if read_once else []))
        facts = {
            **dict.fromkeys(unknown),
            "missing": missing,
            "remarks": remarks if missing is None else (),
        }
        yield replace(surveyed, **facts)  # type: ignore[arg-type]  # unknown ones are optional


def _declared(
    candidate: Candidate[SignalT],
    list_again: Callable[[SelectionT], list[Candidate[SignalT]]],
    selection: SelectionT,
    assumed: Iterable[tuple[dict[str, Any], tuple[str, ...]]],
) -> tuple[SignalT, tuple[str, ...], str | None]:
    """Return a signal, in assumed units if they are not declared."""
    try:
        return candidate.signal(), (), None
    except UndeclaredError as error:
        for units, unknown in assumed:
            try:
                signal = next(
                    again.signal()
                    for again in list_again(replace(selection, **units))
                    if (again.topic, again.field) == (candidate.topic, candidate.field)
                )
            except (UndeclaredError, UsageError):
                continue
            return signal, unknown, error.reason
        raise


def _in_step(batches: Iterable[GyroSeries], attitudes: _AttitudeReading) -> Iterator[GyroSeries]:
    """Yield batches, and read attitudes in the same messages in parallel."""
    other = attitudes.stamps.observe(attitudes)
    for batch in batches:
        next(other, None)
        yield batch
    deque(other, maxlen=0)


def _survey_rates(
    recording: Recording, signal: RateSignal, attitudes: _AttitudeReading | None
) -> RateSurvey:
    stream = RateStream(recording, source=signal)
    with suppress(NoSamplesError):
        raw = iter if attitudes is None else partial(_in_step, attitudes=attitudes)
        deque(stream.read(raw=raw), maxlen=0)
    counts = stream.counts
    return RateSurvey(
        source=signal.name,
        type=signal.type_name,
        rate=signal.field,
        rate_unit=signal.unit,
        clock=signal.clock,
        samples=counts.samples_used,
        **timing(counts),
        nonfinite=counts.nonfinite.count,
        max_rate_rad_s=counts.max_rate,
        max_rate_deg_s=math.degrees(counts.max_rate),
        remarks=tuple(stream.remarks()),
    )


def _attitudes(log: Log, selection: RateSelection, seen: Seen) -> Iterator[AttitudeSurvey]:
    wanted = AttitudeSelection.like(selection)
    try:
        candidates = attitude_candidates(log, wanted)
    except (NoAttitudesError, NoSuchTopicError):
        return
    except LogError as error:
        # A topic that cannot be read must not hide the others.
        topics = {table.name: table for table in log.tables(selection.topic)}
        if selection.topic is not None or len(topics) <= 1:
            made = [_made(table, wanted) for table in topics.values()]
            made = made or [AttitudeSurvey(source=selection.topic or "")]
            yield replace(made[0], missing=error.reason)
            return
        for topic in topics:
            yield from _attitudes(log, replace(selection, topic=topic), seen)
        return
    assumed, list_again = _ASSUMED[1:2], partial(attitude_candidates, log)
    for candidate in candidates:
        try:
            signal, unknown, missing = _declared(candidate, list_again, wanted, assumed)
            surveyed = _survey_attitudes(signal, log, seen)
        except NoAttitudesError:
            continue
        except LogError as error:
            columns = candidate.found.table.columns
            name = candidate.topic or ",".join(column.text for column in columns)
            yield AttitudeSurvey(source=name, attitude=candidate.field, missing=error.reason)
        except UsageError as error:
            reason = error.text.removeprefix(f"{plain(log.path)}: ")
            yield AttitudeSurvey(source=candidate.topic, attitude=candidate.field, missing=reason)
        else:
            facts = {**dict.fromkeys(unknown), "missing": missing}
            yield replace(surveyed, **facts)  # type: ignore[arg-type]  # all optional


def _made(table: Table, wanted: AttitudeSelection) -> AttitudeSurvey:
    """Return the facts about attitudes in the metadata of a table, if there are any."""
    with suppress(LogError, UsageError):
        made = table.provenance()
        meaning = meaning_of(table.path, wanted, recorded_convention(made))
        meant: dict[str, Any] = {"convention": meaning.convention, "direction": meaning.direction}
        return AttitudeSurvey(source=table.name, **meant, **making(made))
    return AttitudeSurvey(source=table.name)


def _survey_attitudes(signal: AttitudeSignal, log: Log, seen: Seen) -> AttitudeSurvey:
    """Return the survey of a signal of attitudes."""
    reading = seen.get((signal.name, signal.field))
    if reading is None:
        reading = _AttitudeReading(log, signal)
        deque(reading.stamps.observe(reading), maxlen=0)
    counts, stamps = reading.check.counts, reading.stamps.counts
    if counts.not_finite == counts.samples_read > 0:
        raise NoAttitudesError(log.path, [signal.name])
    return AttitudeSurvey(
        source=signal.name,
        type=signal.type_name,
        attitude=signal.field,
        layout=signal.layout or signal.representation,
        convention=signal.meaning.convention,
        direction=signal.meaning.direction,
        clock=signal.clock,
        samples=stamps.samples_used,
        **timing(stamps),
        invalid=counts.invalid,
        **making(signal.provenance),
        remarks=(
            *signal.remarks,
            *((Remark("invalid-quaternions", counts.summary),) if counts.invalid else ()),
            *log.remarks,
        ),
    )


# Facts about a log that need no reading of its samples.


def provenance_of(name: str, kind: str | None, selection: RateSelection) -> JsonObject:
    """Return the provenance in the metadata of a file of attitudes, possibly ``LOG:TOPIC``."""
    with open_recording([name], selection, kind) as recording:
        return recording.attitude_signal(AttitudeSelection.like(selection)).provenance


def columns_in(name: str, kind: str | None) -> list[str]:
    """Return the names of the columns of a log without messages."""
    with open_recording([name], kind=kind) as recording:
        files = (table for table in recording.tables.tables() if not table.is_typed)
        return [column.text for table in files for column in table.columns]


def signals_in(
    name: str, kind: str | None, topic: str | None, *, rates: bool, attitudes: bool
) -> list[tuple[str, str]]:
    """Return topic and field of each signal of rates and of attitudes in a log of messages."""
    found: list[tuple[str, str]] = []
    with open_recording([name], RateSelection(topic=topic), kind) as recording:
        log, selection = recording.tables, recording.selection
        with suppress(LogError):
            if rates:
                every = rate_candidates(log, selection)
                found += [(one.topic, one.field) for one in every]
        with suppress(LogError):
            if attitudes:
                others = attitude_candidates(log, AttitudeSelection.like(selection))
                found += [(one.topic, one.field) for one in others]
    return found
