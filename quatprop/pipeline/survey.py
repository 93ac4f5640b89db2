"""What a log holds: every source of body rates and of attitudes, measured on its timeline.

What cannot be measured because something about it is said nowhere is shown all the same, with
what is missing and the option that says it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

from quatprop.containers.remote import without_secret
from quatprop.errors import (
    LogError,
    NoAttitudesError,
    NoRatesError,
    NoSuchTopicError,
    TimelineError,
    UndeclaredError,
    UsageError,
)
from quatprop.formats import open_log
from quatprop.pipeline.plausibility import RateChecks, log_remarks
from quatprop.selection import AttitudeSelection
from quatprop.signals.attitudes import attitude_candidates
from quatprop.signals.quaternion_check import QuaternionCheck
from quatprop.signals.rates import rate_candidates
from quatprop.tables.base import is_table
from quatprop.text import Text, plain
from quatprop.timeline import OBSERVE, StampChecks, Timeline
from quatprop.timeline.counts import remarks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.base import MessageLog
    from quatprop.selection import RateSelection
    from quatprop.signals.signal import AttitudeSignal, Candidate, RateSignal, SelectionT, SignalT
    from quatprop.tables.base import TableLog
    from quatprop.timeline.counts import StampCounts

    Log = MessageLog | TableLog
    Facts = dict[str, Any]
    Int64 = NDArray[np.int64]

_OF_TIME = ("rate_hz", "span_s", "first_ns", "last_ns", "median_dt_ns", "min_dt_ns", "max_dt_ns",
            "gaps", "duplicates", "backwards")  # fmt: skip
_OF_RATES = ("rate_unit", "max_rate_rad_s", "max_rate_deg_s")

_ASSUMED: tuple[tuple[dict[str, Any], tuple[str, ...]], ...] = (
    ({"rate_unit": "rad/s"}, _OF_RATES),
    ({"time_unit": "ns"}, _OF_TIME),
    ({"rate_unit": "rad/s", "time_unit": "ns"}, (*_OF_RATES, *_OF_TIME)),
)
"""Units by which a table is read that says none, and the facts that are not known then."""


def survey(path: str, kind: str | None, selection: RateSelection) -> Facts:
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
        ``path``, ``kind``, ``sources`` of rates and ``attitudes`` (lists, each entry with type,
        counts, remarks, and in ``missing`` what is said nowhere) and ``losses``; JSON-ready.

    Raises
    ------
    LogError
        The log cannot be read, or holds neither body rates nor attitudes.
    """
    with open_log(path, kind) as log:
        # Who asks for certain rates is told when they are not there.
        named = selection.rate_field is not None or selection.rate_cols is not None
        none: LogError | None = None
        rates: list[Facts] = []
        try:
            rates = list(_rates(log, selection, path))
        except (NoRatesError, NoSuchTopicError) as error:
            none = error
        attitudes: list[Facts] = []
        if not (named or (path == "-" and rates)):
            attitudes = list(_attitudes(log, selection))
        if none is not None and not attitudes:
            raise none
        return {
            "path": without_secret(path),
            "kind": log.kind,
            "sources": rates,
            "attitudes": attitudes,
            "losses": [asdict(loss) for loss in log.losses],
        }


# Rates.


def _rates(log: Log, selection: RateSelection, path: str) -> Iterator[Facts]:
    for candidate in rate_candidates(log, selection):
        list_again = partial(rate_candidates, log)
        try:
            source, unknown, missing = _declared(candidate, list_again, selection, _ASSUMED)
        except (TimelineError, UndeclaredError) as error:
            yield _unread(error, candidate.topic or None)
            continue
        facts = _measured(source, path)
        if missing is not None:
            yield {**facts, **dict.fromkeys(unknown), "missing": missing, "remarks": []}
            continue
        if path != "-":
            facts["remarks"] += log_remarks(log, source)
        facts["remarks"] += log.remarks
        yield facts


def _declared(
    candidate: Candidate[SignalT],
    list_again: Callable[[SelectionT], list[Candidate[SignalT]]],
    selection: SelectionT,
    assumed: Iterable[tuple[dict[str, Any], tuple[str, ...]]],
) -> tuple[SignalT, tuple[str, ...], Text | None]:
    """Return a signal; where units are not declared, read by assumed ones.

    Returns
    -------
    signal : Signal
        The signal.
    unknown : tuple of str
        The facts that are not known where units were assumed.
    missing : Text or None
        What is not declared.
    """
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


def _unread(error: LogError, name: str | None = None) -> Facts:
    """Return the facts of a source that cannot even be counted."""
    facts = dict.fromkeys((*_OF_RATES, *_OF_TIME, "rate", "clock", "samples", "nonfinite"))
    return {**facts, "source": name, "type": "", "missing": error.reason, "remarks": []}


def _measured(source: RateSignal, path: str) -> Facts:
    timeline = Timeline(OBSERVE, path)
    watch = RateChecks()
    deque(timeline.apply(watch.observe(source.batches())), maxlen=0)
    counts = timeline.counts
    return {
        "source": source.name,
        "type": source.type_name,
        "rate": source.field,
        "rate_unit": source.unit,
        "clock": source.clock,
        "samples": counts.used,
        **_timed(counts),
        "nonfinite": counts.nonfinite.count,
        "max_rate_rad_s": counts.max_rate,
        "max_rate_deg_s": math.degrees(counts.max_rate),
        "missing": None,
        "remarks": [
            *source.remarks,
            *remarks(counts, OBSERVE),
            *watch.remarks(counts.median_dt_ns),
        ],
    }


def _timed(counts: StampCounts) -> Facts:
    span_s = counts.span_ns * 1e-9
    return {
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
    }


# Attitudes.


def _attitudes(log: Log, selection: RateSelection) -> Iterator[Facts]:
    wanted = AttitudeSelection.like(selection)
    try:
        found = attitude_candidates(log, wanted)
    except (NoAttitudesError, NoSuchTopicError):
        return
    except LogError as error:
        # One topic that needs more than there is here does not hide the others.
        topics = dict.fromkeys(one.topic for one in cast("MessageLog", log).channels())
        if is_table(log) or selection.topic is not None or len(topics) == 1:
            yield _unread_attitude("", selection.topic or "", error.reason)
            return
        for topic in topics:
            yield from _attitudes(log, replace(selection, topic=topic))
        return
    assumed, list_again = _ASSUMED[1:2], partial(attitude_candidates, log)
    for candidate in found:
        try:
            source, unknown, missing = _declared(candidate, list_again, wanted, assumed)
            facts = _observed(source, log)
        except NoAttitudesError:
            continue
        except LogError as error:
            name = candidate.topic or ",".join(cast("TableLog", log).columns())
            yield _unread_attitude(candidate.field, name, error.reason)
        except UsageError as error:
            sentence, *rest = error.text.parts
            if isinstance(sentence, str):
                sentence = sentence.removeprefix(f"{plain(log.path)}: ")
            yield _unread_attitude(candidate.field, candidate.topic, Text(sentence, *rest))
        else:
            yield {**facts, **dict.fromkeys(unknown), "missing": missing}


def _unread_attitude(field: str, name: str, reason: Text) -> Facts:
    known = dict.fromkeys((*_OF_TIME, "clock", "samples", "no_rotation", "layout",
                           "convention", "direction"))  # fmt: skip
    told = {"source": name, "type": "", "attitude": field}
    return {**known, **told, "missing": reason, "remarks": []}


def _observed(source: AttitudeSignal, log: Log) -> Facts:
    """Return what stamps and rows of a source are like.

    Raises
    ------
    NoAttitudesError
        Every row is marked as absent, as gyroscopes without an estimate do.
    """
    check = QuaternionCheck(log.path, drop=True)
    stamps = StampChecks(log.path)

    def checked() -> Iterator[Int64]:
        # Invalid quaternions have stamps too.
        for t_ns, wxyz in source.rows():
            deque(check.apply([(t_ns, wxyz)]), maxlen=0)
            yield t_ns

    deque(stamps.observe(checked()), maxlen=0)
    if check.counts.not_finite == check.counts.read > 0:
        raise NoAttitudesError(log.path, [source.name])
    said = [check.counts.summary] if check.counts.invalid else []
    return {
        "source": source.name,
        "type": source.type_name,
        "attitude": source.field,
        "layout": source.layout or source.representation,
        "convention": source.meaning.convention,
        "direction": source.meaning.direction,
        "clock": source.clock,
        "samples": stamps.counts.used,
        **_timed(stamps.counts),
        "no_rotation": check.counts.invalid,
        "remarks": [*source.remarks, *said],
    }
