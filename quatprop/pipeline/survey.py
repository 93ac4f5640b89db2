"""What a log holds: every source of body rates and of attitudes, measured on its timeline.

What cannot be measured because something about it is said nowhere is shown all the same, with
what is missing and the option that says it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any, cast

from quatprop.containers.remote import without_secret
from quatprop.errors import (
    LogError,
    NoAttitudesError,
    NoRatesError,
    NoSuchTopicError,
    UndeclaredError,
    UsageError,
)
from quatprop.formats import open_log
from quatprop.pipeline.plausibility import RateChecks, log_remarks
from quatprop.selection import AttitudeSelection
from quatprop.signals.attitudes import attitude_candidates
from quatprop.signals.channel_values import channels_of
from quatprop.signals.rates import sources
from quatprop.signals.rotation_check import RotationCheck
from quatprop.tables.base import is_table
from quatprop.text import plain
from quatprop.timeline import OBSERVE, StampChecks, Timeline
from quatprop.timeline.counts import remarks

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.base import MessageLog
    from quatprop.selection import RateSelection
    from quatprop.signals.attitude_messages import Candidate
    from quatprop.signals.attitudes import AttitudeSource
    from quatprop.signals.rates import Source
    from quatprop.tables.base import TableLog
    from quatprop.text import Text
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
    try:
        found = sources(log, selection)
    except UndeclaredError as error:
        yield from _undeclared(log, selection, path, error)
        return
    for source in found:
        facts = _measured(source, path)
        if path != "-":
            facts["remarks"] += log_remarks(log, source)
        facts["remarks"] += log.remarks
        yield facts


def _undeclared(
    log: Log, selection: RateSelection, path: str, error: UndeclaredError
) -> Iterator[Facts]:
    """Yield what can be known of sources one of which is not told in full."""
    if not is_table(log):
        topics = dict.fromkeys(one.topic for one in channels_of(cast("MessageLog", log)))
        if selection.topic is None and len(topics) > 1:
            for topic in topics:
                try:
                    yield from _rates(log, replace(selection, topic=topic), path)
                except (NoRatesError, NoSuchTopicError):
                    continue
            return
    for said, unknown in _ASSUMED:
        try:
            found = sources(log, replace(selection, **said))
        except (UndeclaredError, UsageError):
            continue
        for source in found:
            facts = _measured(source, path)
            yield {**facts, **dict.fromkeys(unknown), "missing": error.reason, "remarks": []}
        return
    yield _unread(error)


def _unread(error: LogError, name: str | None = None, type_name: str = "") -> Facts:
    """Return what is said of a source that cannot even be counted."""
    facts = dict.fromkeys((*_OF_RATES, *_OF_TIME, "rate", "clock", "samples", "nonfinite"))
    return {**facts, "source": name, "type": type_name, "missing": error.reason, "remarks": []}


def _measured(source: Source, path: str) -> Facts:
    timeline = Timeline(OBSERVE, path)
    watch = RateChecks()
    deque(timeline.apply(watch.passing(source.batches())), maxlen=0)
    counts = timeline.counts
    return {
        "source": source.name,
        "type": source.type_name,
        "rate": source.rate,
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
    for candidate in found:
        try:
            source, unknown, missing = _declared(log, candidate, wanted)
            facts = _observed(source, log)
        except NoAttitudesError:
            continue
        except LogError as error:
            name = candidate.topic or ",".join(cast("TableLog", log).columns())
            yield _unread_attitude(candidate.field, name, error.reason)
        except UsageError as error:
            reason = str(error).removeprefix(f"{plain(log.path)}: ")
            yield _unread_attitude(candidate.field, candidate.topic, reason)
        else:
            yield {**facts, **dict.fromkeys(unknown), "missing": missing}


def _declared(
    log: Log, candidate: Candidate, wanted: AttitudeSelection
) -> tuple[AttitudeSource, tuple[str, ...], Text | None]:
    """Return a source; where the unit of its time is not declared, read as ns, and what is said."""
    try:
        return candidate.source(), (), None
    except UndeclaredError as error:
        if not is_table(log) or wanted.time_unit is not None:
            raise
        try:
            (again,) = attitude_candidates(log, replace(wanted, time_unit="ns"))
            return again.source(), _OF_TIME, error.reason
        except (UndeclaredError, UsageError):
            raise error from None


def _unread_attitude(field: str, name: str, reason: str | Text) -> Facts:
    known = dict.fromkeys((*_OF_TIME, "clock", "samples", "no_rotation", "layout",
                           "convention", "direction"))  # fmt: skip
    told = {"source": name, "type": "", "attitude": field}
    return {**known, **told, "missing": reason, "remarks": []}


def _observed(source: AttitudeSource, log: Log) -> Facts:
    """Return what stamps and rows of a source are like.

    Raises
    ------
    NoAttitudesError
        Every row is marked as absent, as gyroscopes without an estimate do.
    """
    check = RotationCheck(log.path, drop=True)
    stamps = StampChecks(log.path)

    def checked() -> Iterator[Int64]:
        # Invalid quaternions have stamps too.
        for t_ns, wxyz in source.rows():
            deque(check.apply([(t_ns, wxyz)]), maxlen=0)
            yield t_ns

    deque(stamps.observe(checked()), maxlen=0)
    if check.counts.not_finite == check.counts.read > 0:
        raise NoAttitudesError(log.path, [source.name])
    said = [check.counts.words] if check.counts.bad else []
    return {
        "source": source.name,
        "type": source.type_name,
        "attitude": source.quaternion,
        "layout": source.layout or source.representation,
        "convention": source.meaning.convention,
        "direction": source.meaning.direction,
        "clock": source.clock,
        "samples": stamps.counts.used,
        **_timed(stamps.counts),
        "no_rotation": check.counts.bad,
        "remarks": [*source.remarks, *said],
    }
