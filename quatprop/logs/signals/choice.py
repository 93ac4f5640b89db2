"""Choose a signal among the candidates in a log.

Nothing is guessed silently: inferences are in the remarks of the signal, and ambiguities are
refused, with the setting that resolves them.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from quatprop.errors import (
    AmbiguousTopicError,
    NoAttitudesError,
    NoRatesError,
    NoSuchTopicError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.logs.matching.find import Found, find
from quatprop.logs.signals.signal import RateSignal, Signal
from quatprop.text import Remark, Setting, did_you_mean, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from quatprop.settings.selection import SignalSelection
    from quatprop.tables.log import Log

TABLE_SETTINGS = (
    "rate_cols",
    "quat_cols",
    "time_col",
    "sample_rate",
    "from_angle_unit",
    "from_euler",
)
"""Settings that apply only to files of rows."""

MESSAGE_SETTINGS = ("topic", "rate_field", "time_field", "quat_field", "frame")
"""Settings that apply only to logs of messages."""

SignalT = TypeVar("SignalT", bound=Signal)
SelectionT = TypeVar("SelectionT", bound="SignalSelection")


class Candidate(NamedTuple, Generic[SignalT]):
    """A possible signal in a log.

    `signal`: returns it, or raises a LogError or UsageError if something is not declared
    `preferred`: whether it takes precedence: measured over estimated and commanded rates, the
        attitude of a vehicle over those of its estimators
    """

    found: Found
    signal: Callable[[], SignalT]
    preferred: bool = True

    @property
    def topic(self) -> str:
        """The topic; ``""`` in a file."""
        return self.found.table.name

    @property
    def field(self) -> str:
        """The field; ``""`` in a file."""
        return self.found.field


class SignalKind(NamedTuple):
    """A kind of signal, rates or attitudes, for error messages.

    `name`: such as ``"body rates"``
    `secondary`: name of candidates that are not preferred
    `field`: the setting for the message field
    `none`: the error for a log without this kind
    """

    quantity: str
    name: str
    secondary: str
    field: str
    none: type[NoRatesError | NoAttitudesError]


RATES = SignalKind("rate", "body rates", "estimated body rates", "rate_field", NoRatesError)
ATTITUDES = SignalKind("quat", "attitudes", "secondary attitudes", "quat_field", NoAttitudesError)


def choose(log: Log, candidates: Sequence[Candidate[SignalT]], kind: SignalKind) -> SignalT:
    """Return the only signal among candidates."""
    preferred = [candidate for candidate in candidates if candidate.preferred] or candidates
    topics = [candidate.topic for candidate in preferred]
    if len(set(topics)) > 1:
        raise AmbiguousTopicError(
            log.path,
            f"several topics carry {kind.name}: {listed(topics)}; choose one with "
            f"{Setting('topic')}",
        )
    fields = list(dict.fromkeys(candidate.field for candidate in preferred))
    if len(fields) > 1:
        raise UsageError(
            f"{plain(log.path)}: messages of topic {quoted(topics[0])} carry several {kind.name}: "
            f"{listed(fields)}; choose one with {Setting(kind.field)}"
        )
    signal = preferred[0].signal()
    if len(preferred) > 1:
        signal = _joined(log, [signal, *(candidate.signal() for candidate in preferred[1:])])
    ignored = [candidate.topic for candidate in candidates if candidate not in preferred]
    if not ignored:
        return signal
    remark = Remark("ignored-signals", f"ignored {kind.secondary}: {listed(ignored)}")
    return replace(signal, remarks=(*signal.remarks, remark))


def _joined(log: Log, signals: list[SignalT]) -> SignalT:
    """Return the rates of a topic recorded with several message definitions, or in several files.

    Samples are merged by log time.
    """
    first = signals[0]
    files = {s.matches[0].table.path for s in signals if isinstance(s, RateSignal)}
    if len(files) == len(signals):
        several = f"{len(files)} files"
        text = f"{several} are read as one log, in the order of their times"
        remark = Remark("several-files", text)
    else:
        several = f"{len(signals)} different message definitions"
        remark = Remark(
            "several-definitions",
            f"topic {quoted(first.name)} was recorded with {several}, each of which was read by "
            "its own",
        )
    kinds = {(s.method, s.increments) if isinstance(s, RateSignal) else id(s) for s in signals}
    what = f"topic {quoted(first.name)} was recorded with {several}"
    if not isinstance(first, RateSignal) or len(kinds) > 1:
        raise UnsupportedLogError(
            log.path,
            f"{what}, which are not read together; write the messages of each to a log of its "
            "own, by their times with `mcap filter`, or with `rosbag filter`",
        )
    if len({s.clock for s in signals}) > 1:
        raise UnsupportedLogError(
            log.path,
            f"{what}, and some have no header timestamp; choose {Setting('clock', 'log')}",
        )
    return replace(
        first,
        matches=tuple(m for s in signals if isinstance(s, RateSignal) for m in s.matches),
        remarks=(*first.remarks, remark),
    )


def candidates(log: Log, selection: SignalSelection, kind: SignalKind) -> list[Found]:
    """Return where a log has signals of a kind that match a selection, at least one.

    The columns of a file are matched later, by :attr:`Candidate.signal`.
    """
    tables = log.tables(selection.topic)
    field = getattr(selection, kind.field)
    is_file = any(not table.is_typed for table in tables or log.tables())
    why = "is for tables, and this log holds messages"
    if is_file:
        columns = Setting(f"{kind.quantity}_cols")
        why = "is for logs of messages and this is a table; choose columns with "
        why += f"{columns} and {Setting('time_col')}"
    for name in MESSAGE_SETTINGS if is_file else TABLE_SETTINGS:
        if getattr(selection, name, None) is not None:
            raise UsageError(f"{plain(log.path)}: {Setting(name)} {why}")
    for by_key in (False, True):
        found = (find(table, kind.quantity, field, by_key=by_key) for table in tables)
        if every := [*chain.from_iterable(found)]:
            return every
    if tables and field is not None:
        known = [
            f"{one.field} ({table.name})" for table in tables for one in find(table, kind.quantity)
        ]
        there = f"the {kind.name} that are recognised are {listed(known)}"
        if not known:
            if len(tables) == 1:
                # The error lists the fields of the message definition, if there is one.
                for part in field.split(","):
                    tables[0].refuse_unknown(part.strip())
                raise kind.none(log.path, map(str, tables))
            there = f"the topics are {listed(map(str, tables))}"
        raise UsageError(f"{plain(log.path)}: no message has a field {quoted(field)}; {there}")
    every_table = log.tables()
    carrying = [table.name for table in every_table if find(table, kind.quantity)]
    if selection.topic is None or not carrying:
        raise kind.none(log.path, map(str, every_table))
    choices = f"choose one of {listed(carrying)}"
    choices += did_you_mean(selection.topic, carrying) if len(carrying) > 1 else ""
    raise NoSuchTopicError(
        log.path, f"no topic {quoted(selection.topic)} that carries {kind.name}; {choices}"
    )
