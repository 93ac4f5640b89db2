"""A signal of a log: body rates or attitudes, their time base, and how to read them.

:mod:`quatprop.signals.rates` and :mod:`quatprop.signals.attitudes` list the signals of a log as
candidates; :func:`choose` takes the only one. Nothing is guessed silently: what was inferred is in
:attr:`Signal.remarks`, what is ambiguous is refused with the setting that settles it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar

from quatprop.errors import (
    AmbiguousTopicError,
    NoAttitudesError,
    NoRatesError,
    NoSuchTopicError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.messages.definitions import message_type
from quatprop.signals.message_values import channels_of
from quatprop.text import Setting, Text, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.conditioning.time_range import PartReader
    from quatprop.containers.base import Channel, MessageLog
    from quatprop.conventions import Meaning
    from quatprop.provenance import JsonObject
    from quatprop.selection import SignalSelection
    from quatprop.series import GyroSeries
    from quatprop.tables.base import TableLog

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]
    Rows: TypeAlias = Iterator[tuple[Int64, Float64]]
    Poses: TypeAlias = Iterator[tuple[Int64, Float64, Float64]]

TABLE_SETTINGS = ("rate_cols", "quat_cols", "time_col", "sample_rate")


def no_parts() -> None:
    """Return nothing: only the whole log can be read."""


def _no_stamps() -> Iterator[tuple[Int64, Int64]]:
    return iter(())


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """One series of samples in a log.

    Parameters
    ----------
    name
        The topic, or the names of the columns.
    type_name
        The message type, or the dialect of a table; ``""`` where there is none.
    field
        The message field, the columns, or the frames.
    clock
        Time base: ``"header"``, ``"log"``, ``"publish"``, or the name of a column.
    remarks
        What was inferred.
    stamps
        Reads the stamps of messages and their log times, shape ``(N,)`` each, int64 ns, in the
        order of the samples; nothing for a table.
    """

    name: str
    type_name: str
    field: str
    clock: str
    remarks: tuple[str | Text, ...] = ()
    stamps: Callable[[], Iterator[tuple[Int64, Int64]]] = _no_stamps


@dataclass(frozen=True, slots=True, kw_only=True)
class RateSignal(Signal):
    """Body rates of a log; takes the parameters of :class:`Signal` too.

    Parameters
    ----------
    batches
        Reads the samples, rad/s and ns, in batches in the order of the log.
    unit
        Unit in which they are stored, ``"rad/s"`` or ``"deg/s"``.
    method
        The integration rule that fits the sensor, where the definition of its messages says it.
    increments
        Whether samples are increments, which the sensor has integrated.
    """

    batches: Callable[[], Iterator[GyroSeries]]
    unit: str
    method: str | None = None
    increments: bool = False
    part_reader: Callable[[], PartReader | None] = no_parts

    @property
    def samples(self) -> str:
        """What the samples are: ``"rates"``, ``"averages"`` or ``"increments"``."""
        if self.increments:
            return "increments"
        return "averages" if self.method == "end" else "rates"

    def method_used(self, wanted: str | None) -> tuple[str, str]:
        """Return the integration rule, and where it comes from.

        Parameters
        ----------
        wanted
            The method that the user has chosen; None: what the log says, or else ``"start"``.

        Returns
        -------
        method : str
            A key of :data:`quatprop.kinematics.increments.METHODS`.
        method_from : str
            ``"given"``, ``"log"`` where it follows from what the samples are, or ``"default"``.
        """
        if self.increments and wanted in {None, "start", "mean"}:
            # Where the rate was known in between is lost: all three are the increment itself.
            return "end", "log"
        if wanted is not None:
            return wanted, "given"
        return (self.method, "log") if self.method else ("start", "default")

    def method_remarks(self, wanted: str | None) -> list[str]:
        """Return the remarks on a method that the user has chosen for this signal."""
        samples = self.samples
        if samples == "rates" or wanted in {None, "end"}:
            return []
        if wanted in {"coning", "cubic"}:
            remark = (
                f"method {wanted} adds to {samples} the coning that a sensor leaves out; method "
                "end fits sensors that correct for it themselves, such as those of PX4"
            )
            return [remark]
        if self.increments:
            return [f"samples are increments, to which method {wanted} does not apply; end is used"]
        remark = (
            "each rate is the average over the interval before its stamp, which is what method "
            f"{self.method} assumes; method {wanted} was used"
        )
        return [remark]


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeSignal(Signal):
    """Attitudes of a log; takes the parameters of :class:`Signal` too.

    Parameters
    ----------
    rows
        Reads stamps in ns and quaternions ``(N, 4)``, scalar first, Hamilton, body -> reference,
        batch after batch in the order of the log. They are not checked: see
        :class:`quatprop.signals.quaternion_check.QuaternionCheck`.
    layout
        How they are stored, ``"scalar-first"`` or ``"scalar-last"``; ``"by name"`` where the
        components have names and no such order; ``""`` for other representations.
    meaning
        What the stored numbers mean.
    provenance
        How the attitudes were made, as their file says.
    representation
        ``"quaternion"`` or a key of :data:`quatprop.conventions.representations.REPRESENTATIONS`.
    poses
        Reads positions of the body in the reference frame beside them, shape ``(N, 3)``, m; None
        where there are none.
    covariances
        Reads stamps, quaternions, positions or None, and covariances about body axes, shape
        ``(N, 3, 3)``, rad^2; None where there are none.
    placeholder
        Whether it is the identity in every message of a sensor: never set.
    """

    rows: Callable[[], Rows]
    layout: str
    meaning: Meaning
    provenance: JsonObject
    representation: str = "quaternion"
    poses: Callable[[], Poses] | None = None
    covariances: Callable[[], Iterator[tuple[Any, ...]]] | None = None
    placeholder: bool = False


SignalT = TypeVar("SignalT", bound=Signal)
SelectionT = TypeVar("SelectionT", bound="SignalSelection")


@dataclass(frozen=True, slots=True)
class Candidate(Generic[SignalT]):
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


@dataclass(frozen=True, slots=True)
class SignalKind:
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


def choose(
    log: MessageLog | TableLog, candidates: Sequence[Candidate[SignalT]], kind: SignalKind
) -> SignalT:
    """Return the only signal among some candidates.

    Raises
    ------
    AmbiguousTopicError
        Several topics remain.
    UsageError
        Several fields of one topic remain.
    UnsupportedLogError
        One topic has several message definitions.
    LogError
        Something about the signal is not declared.
    """
    preferred = [candidate for candidate in candidates if candidate.preferred] or candidates
    topics = [candidate.topic for candidate in preferred]
    if len(set(topics)) > 1:
        raise AmbiguousTopicError(log.path, topics, kind.name)
    definitions = max(Counter(candidate.field for candidate in preferred).values())
    if definitions > 1:
        raise UnsupportedLogError(
            log.path,
            f"topic {quoted(topics[0])} was recorded with {definitions} different message "
            "definitions, which are not read together; write the messages of each to a log of its "
            "own, by their times with `mcap filter`, or with `rosbag filter`",
        )
    if len(preferred) > 1:
        raise UsageError(
            f"{plain(log.path)}: messages of topic {quoted(topics[0])} carry several {kind.name}: "
            f"{listed(candidate.field for candidate in preferred)}; choose one with ",
            Setting(kind.field),
        )
    signal = preferred[0].signal()
    ignored = [candidate.topic for candidate in candidates if candidate not in preferred]
    if not ignored:
        return signal
    remark = f"ignored {kind.secondary}: {listed(ignored)}"
    return replace(signal, remarks=(*signal.remarks, remark))


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
                Setting(name), f" is for tables, and {quoted(log.path)} holds messages"
            )
    channels = channels_of(log, selection.topic)
    if found := [one for channel in channels for one in find(log, channel, selection)]:
        return found
    if channels and (name := getattr(selection, kind.field)) is not None:
        if len(channels) == 1:
            message_type(channels[0], log.path)  # its definition may be what is missing
        known = [
            f"{candidate.field} ({channel.topic})"
            for channel in channels
            for candidate in find(log, channel, replace(selection, **{kind.field: None}))
        ]
        there = f"the {kind.name} that are recognised are {listed(known)}"
        if not known:
            there = f"the topics are {listed(f'{c.topic} ({c.type_name})' for c in channels)}"
        raise UsageError(f"{plain(log.path)}: no message has a field {quoted(name)}; {there}")
    if selection.topic is None:
        raise kind.none(log.path, [f"{c.topic} ({c.type_name})" for c in channels])
    anywhere = replace(selection, topic=None, **{kind.field: None})
    topics = [channel.topic for channel in channels_of(log) if find(log, channel, anywhere)]
    raise NoSuchTopicError(log.path, selection.topic, topics, kind.name)
