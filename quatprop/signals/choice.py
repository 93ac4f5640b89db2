"""The choice of a signal among those that a log seems to hold.

:mod:`quatprop.signals.rates` and :mod:`quatprop.signals.attitudes` list the signals of a log as
candidates; :func:`choose` takes the only one. Nothing is guessed silently: what was inferred is in
the remarks of the signal, what is ambiguous is refused with the setting that settles it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from quatprop.containers.merge import Columns, merge_by_time
from quatprop.errors import (
    AmbiguousTopicError,
    NoAttitudesError,
    NoRatesError,
    NoSuchTopicError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.messages.decoders import DECODERS
from quatprop.messages.definitions import message_type
from quatprop.messages.schema import at
from quatprop.signals.message_values import channels_of, series_of, stamps_of
from quatprop.signals.signal import RateSignal, Signal, no_parts
from quatprop.text import Setting, did_you_mean, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from quatprop.containers.base import Channel, MessageLog
    from quatprop.selection import SignalSelection
    from quatprop.tables.base import AnyLog

TABLE_SETTINGS = (
    "rate_cols",
    "quat_cols",
    "time_col",
    "sample_rate",
    "series",
    "from_angle_unit",
    "from_euler",
)
"""Settings that only tables have."""

SignalT = TypeVar("SignalT", bound=Signal)
SelectionT = TypeVar("SelectionT", bound="SignalSelection")


class Candidate(NamedTuple, Generic[SignalT]):
    """A signal that a log seems to hold.

    Parameters
    ----------
    topic, field
        Where it is in messages; ``""`` in a table.
    signal
        Returns it; raises a LogError or UsageError where something about it is not declared.
    preferred
        Whether it comes before others: rates that a sensor measured before estimated or commanded
        ones, the attitude of a vehicle before those of its several estimators.
    """

    topic: str
    field: str
    signal: Callable[[], SignalT]
    preferred: bool = True


class SignalKind(NamedTuple):
    """What error messages say about rates or about attitudes.

    Parameters
    ----------
    name
        Such as ``"body rates"``.
    secondary
        What candidates are that are not preferred.
    field
        The setting that names their message field.
    none
        The error for a log without any.
    """

    name: str
    secondary: str
    field: str
    none: type[NoRatesError | NoAttitudesError]


RATES = SignalKind("body rates", "estimated body rates", "rate_field", NoRatesError)
ATTITUDES = SignalKind("attitudes", "secondary attitudes", "quat_field", NoAttitudesError)


def choose(log: AnyLog, candidates: Sequence[Candidate[SignalT]], kind: SignalKind) -> SignalT:
    """Return the only signal among some candidates.

    Raises
    ------
    AmbiguousTopicError
        Several topics remain.
    UsageError
        Several fields of one topic remain.
    UnsupportedLogError
        One topic has several message definitions, and their samples or stamps are not alike.
    LogError
        Something about the signal is not declared.
    """
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
    remark = f"ignored {kind.secondary}: {listed(ignored)}"
    return replace(signal, remarks=(*signal.remarks, remark))


def _joined(log: AnyLog, signals: list[SignalT]) -> SignalT:
    """Return the rates of a topic that was recorded with several message definitions.

    Each is read by its own; samples come in the order of their log times.
    """
    first = signals[0]
    kinds = {(s.method, s.increments) if isinstance(s, RateSignal) else id(s) for s in signals}
    if not isinstance(first, RateSignal) or len(kinds) > 1:
        raise UnsupportedLogError(
            log.path,
            f"topic {quoted(first.name)} was recorded with {len(signals)} different message "
            "definitions, which are not read together; write the messages of each to a log of its "
            "own, by their times with `mcap filter`, or with `rosbag filter`",
        )
    if len({s.clock for s in signals}) > 1:
        raise UnsupportedLogError(
            log.path,
            f"topic {quoted(first.name)} was recorded with {len(signals)} different message "
            f"definitions, and some have no header stamp; choose {Setting('clock', 'log')}",
        )

    def merged() -> Iterator[Columns]:
        return merge_by_time([s.rows() for s in signals if isinstance(s, RateSignal)])

    remark = (
        f"topic {quoted(first.name)} was recorded with {len(signals)} different message "
        "definitions, each of which was read by its own"
    )
    return replace(
        first,
        stamps=lambda: stamps_of(merged()),
        batches=lambda: series_of(merged(), averages=first.method == "end"),
        rows=merged,
        part_reader=no_parts,
        remarks=(*first.remarks, remark),
    )


def _described(channel: Channel) -> str:
    """Return topic, type, and the encoding where it is not read."""
    encoding = ""
    if channel.encoding not in DECODERS:
        encoding = f", encoded as {channel.encoding or 'nothing known'}, which is not read"
    return f"{channel.topic} ({channel.type_name}{encoding})"


def message_candidates(
    log: MessageLog,
    selection: SelectionT,
    kind: SignalKind,
    find: Callable[[MessageLog, Channel, SelectionT], list[Candidate[SignalT]]],
) -> list[Candidate[SignalT]]:
    """Return the candidates in a log of messages, at least one.

    Parameters
    ----------
    log
        The log.
    selection
        What the user has chosen.
    kind
        What is wanted.
    find
        Returns the candidates of one channel.

    Raises
    ------
    NoSuchTopicError
        The topic is not there, or carries nothing of this kind.
    UsageError
        No message has the field, or a setting is for tables.
    SchemaError
        The only channel has no definition, or one that cannot be used.
    NoRatesError, NoAttitudesError
        The log holds nothing of this kind.
    """
    for name in TABLE_SETTINGS:
        if getattr(selection, name, None) is not None:
            raise UsageError(
                f"{Setting(name)} is for tables, and {quoted(log.path)} holds messages"
            )
    channels = channels_of(log, selection.topic)
    if found := [one for channel in channels for one in find(log, channel, selection)]:
        return found
    if channels and (name := getattr(selection, kind.field)) is not None:
        known = [
            f"{candidate.field} ({channel.topic})"
            for channel in channels
            for candidate in find(log, channel, replace(selection, **{kind.field: None}))
        ]
        there = f"the {kind.name} that are recognised are {listed(known)}"
        if not known:
            if len(channels) == 1:
                # Its definition says what is there, unless that is what is missing.
                root = message_type(channels[0], log.path)
                for part in name.split(","):
                    at(root, part.strip(), log.path)
            there = f"the topics are {listed(map(_described, channels))}"
        raise UsageError(f"{plain(log.path)}: no message has a field {quoted(name)}; {there}")
    anywhere = replace(selection, topic=None, **{kind.field: None})
    topics = [channel.topic for channel in channels_of(log) if find(log, channel, anywhere)]
    if selection.topic is None or not topics:
        raise kind.none(log.path, map(_described, channels_of(log)))
    choices = f"choose one of {listed(topics)}"
    choices += did_you_mean(selection.topic, topics) if len(topics) > 1 else ""
    raise NoSuchTopicError(
        log.path, f"no topic {quoted(selection.topic)} that carries {kind.name}; {choices}"
    )
