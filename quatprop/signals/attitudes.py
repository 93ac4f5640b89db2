"""From what a log holds to attitudes at stamps in ns.

The counterpart of :mod:`quatprop.signals.rates` for quaternions: a topic or a set of columns is
chosen, the clock read, and the numbers are brought into the terms that hold inside quatprop. The
layout is taken from names, definitions or metadata; where none of them says it, it is asked for.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, cast

from quatprop.errors import AmbiguousTopicError, UsageError
from quatprop.signals.attitude_messages import Candidate, of_messages
from quatprop.signals.attitude_source import AttitudeSource
from quatprop.signals.attitude_tables import of_table
from quatprop.tables.base import is_table
from quatprop.text import listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.base import MessageLog
    from quatprop.selection import AttitudeSelection
    from quatprop.tables.base import TableLog

__all__ = [
    "AttitudeSource",
    "attitude_candidates",
    "attitude_stamps",
    "choose_attitudes",
]


def choose_attitudes(log: MessageLog | TableLog, selection: AttitudeSelection) -> AttitudeSource:
    """Return the one source of attitudes that the options leave.

    Raises
    ------
    NoAttitudesError
        Nothing in the log carries attitudes.
    NoSuchTopicError
        The topic asked for is not there, or carries none.
    AmbiguousTopicError
        Several sources remain.
    UndeclaredError
        The layout, a column or the time is declared nowhere.
    UsageError
        Options contradict each other or the log.
    """
    found = attitude_candidates(log, selection)
    if len(found) == 1:
        return found[0].source()
    topics = [candidate.topic for candidate in found]
    if len(set(topics)) > 1:
        raise AmbiguousTopicError(log.path, topics, "attitudes")
    raise UsageError(
        f"{plain(log.path)}: messages of topic {quoted(topics[0])} carry several attitudes: "
        f"{listed(candidate.field for candidate in found)}; choose one with --quat-field"
    )


def attitude_candidates(
    log: MessageLog | TableLog, selection: AttitudeSelection
) -> list[Candidate]:
    """Return every attitude that the options leave, at least one, not yet looked at closely.

    Raises
    ------
    LogError
        As for :func:`choose_attitudes`, but for the ambiguity; what is said of a single source
        comes when it is asked for.
    """
    if is_table(log):
        return [Candidate("", "", partial(of_table, log, selection))]
    return of_messages(cast("MessageLog", log), selection)


def attitude_stamps(
    selection: AttitudeSelection, log: MessageLog | TableLog
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield the stamps of the messages that are chosen, and when they were logged.

    Yields
    ------
    tuple
        Shapes ``(N,)``, int64 ns, in order of log times; none for a table.
    """
    read = choose_attitudes(log, selection).stamps
    return iter(()) if read is None else read()
