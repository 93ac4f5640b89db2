"""From what a log holds to attitudes at stamps in ns.

The counterpart of :mod:`quatprop.signals.rates` for quaternions: a topic or a set of columns is
chosen, the clock read, and the numbers are brought into the terms that hold inside quatprop. The
layout is taken from names, definitions or metadata; where none of them says it, it is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from quatprop.conventions import Meaning
from quatprop.conventions.layout import LAYOUTS, SCALAR_FIRST, SCALAR_LAST, layout_named
from quatprop.errors import (
    AmbiguousTopicError,
    NoAttitudesError,
    NoSuchTopicError,
    UndeclaredError,
    UsageError,
    listed,
    plain,
    quoted,
)
from quatprop.messages.orientations import orientation_field_at, orientation_fields
from quatprop.messages.stamps import Stamp
from quatprop.messages.transforms import TRANSFORM_LISTS
from quatprop.readers.attitude_columns import choose_quaternion
from quatprop.readers.base import is_table
from quatprop.selection import Selection
from quatprop.signals.channel_values import (
    ABSENT,
    FieldReading,
    channels_of,
    clock_of,
    stamps_logged,
    timed_values,
)
from quatprop.signals.transforms import TransformReading, chosen_frames

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from quatprop.messages.orientations import FoundOrientation
    from quatprop.readers.base import Channel, MessageLog, TableLog, TimedColumns
    from quatprop.signals.channel_values import Reading

    Rows = Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]

ATTITUDES = "attitudes"

BY_NAME = "by name"
"""The layout of components that stand in neither order, but have names."""


@dataclass(frozen=True, slots=True)
class AttitudeSelection:
    """The options that choose attitudes; None means "not said".

    Parameters
    ----------
    samples
        Topic, time and clock; what it says about rates is not looked at.
    quat_field
        Dotted path of the quaternion in a message.
    quat_cols
        The four columns of a table as stored, by name or number from 0.
    frame
        Of a list of transforms, ``"child"`` or ``"parent:child"``.
    layout, convention, direction
        What the user says about the stored numbers.
    """

    samples: Selection = field(default_factory=Selection)
    quat_field: str | None = None
    quat_cols: tuple[str, ...] | None = None
    frame: str | None = None
    layout: str | None = None
    convention: str | None = None
    direction: str | None = None


@dataclass(frozen=True, slots=True)
class AttitudeSource:
    """One series of attitudes in a log.

    Parameters
    ----------
    name
        The topic, or the names of the columns.
    type_name
        The message type, or the dialect of a table; ``""`` where there is none.
    quaternion
        The field, the columns, or the frames that are the attitude.
    layout
        How it is stored, ``"scalar-first"`` or ``"scalar-last"``; ``"by name"`` where it is
        neither.
    meaning
        What the stored numbers mean.
    clock
        Whose stamps: ``"header"``, ``"log"``, ``"publish"``, or the name of a column.
    remarks
        What was inferred.
    provenance
        How a table came about, as written beside it.
    rows
        Reads stamps in ns and numbers, scalar first and in the terms of :data:`HAMILTON
        <quatprop.conventions.HAMILTON>`, batch after batch in the order of the log. They are not
        checked: see :class:`quatprop.signals.rotation_check.RotationCheck`.
    stamps
        Reads the stamps of messages and when they were logged, ns, as `rows` reads the attitudes;
        None for a table.
    """

    name: str
    type_name: str
    quaternion: str
    layout: str
    meaning: Meaning
    clock: str
    remarks: tuple[str, ...]
    provenance: dict[str, Any]
    rows: Callable[[], Rows]
    stamps: Callable[[], Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]] | None = None


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
    if is_table(log):
        return _of_table(log, selection)
    found = _of_messages(cast("MessageLog", log), selection)
    if len(found) == 1:
        return found[0].source()
    topics = [candidate.topic for candidate in found]
    if len(set(topics)) > 1:
        raise AmbiguousTopicError(log.path, topics, ATTITUDES)
    raise UsageError(
        f"{plain(log.path)}: messages of topic {quoted(topics[0])} carry several attitudes: "
        f"{listed(candidate.field for candidate in found)}; choose one with --quat-field"
    )


# Tables.


def _of_table(log: TableLog, selection: AttitudeSelection) -> AttitudeSource:
    for option, value in (("--quat-field", selection.quat_field), ("--frame", selection.frame)):
        if value is not None:
            raise UsageError(f"{option} is for messages, and {quoted(log.path)} is a table")
    provenance = log.provenance()
    recorded = _recorded(provenance)
    columns = choose_quaternion(
        log,
        selection.samples,
        quat_cols=selection.quat_cols,
        layout=selection.layout,
        recorded=recorded.get("layout"),
    )
    meaning = Meaning(
        _agreed(log, "convention", selection.convention, recorded) or "hamilton",
        _agreed(log, "direction", selection.direction, recorded) or "body-to-ref",
    )
    names = log.columns()
    timed = columns.timed
    stored = ",".join(names[position] for position in sorted(timed.numbers[:4]))
    counted = "" if timed.sample_rate is None else f"{timed.sample_rate:g} Hz"
    return AttitudeSource(
        name=stored,
        type_name=columns.dialect,
        quaternion=stored,
        layout=columns.layout or BY_NAME,
        meaning=meaning,
        clock=",".join(names[position] for position in timed.time) or counted,
        remarks=(),
        provenance=provenance,
        rows=partial(_table_rows, log, timed, meaning),
    )


def _recorded(provenance: dict[str, Any]) -> dict[str, str]:
    """Return what a file says about its numbers; only words that are known."""
    said = provenance.get("convention")
    if not isinstance(said, dict):
        return {}
    layout = said.get("layout")
    known = {name: said[name] for name in ("convention", "direction") if name in said}
    return {**known, "layout": layout_named(layout).name} if layout in LAYOUTS else known


def _agreed(log: TableLog, what: str, said: str | None, recorded: dict[str, str]) -> str | None:
    there = recorded.get(what)
    if said is not None and there is not None and said != there:
        raise UsageError(
            f"{plain(log.path)}: --from-{what} says {said}, but the metadata of the file says "
            f"{plain(there)}; leave the option out"
        )
    return said or there


def _table_rows(log: TableLog, timed: TimedColumns, meaning: Meaning) -> Rows:
    for t_ns, numbers in log.rows(timed):
        wxyz = numbers[:, :4]
        for absent in numbers[:, 4:].T:
            wxyz[absent == ABSENT] = np.nan
        yield t_ns, meaning.restated(wxyz)


# Messages.


class _Candidate(NamedTuple):
    """An attitude of a channel, not yet looked at closely."""

    topic: str
    field: str
    source: Callable[[], AttitudeSource]


def _of_messages(log: MessageLog, selection: AttitudeSelection) -> list[_Candidate]:
    """Return every attitude that the options leave; at least one."""
    samples = selection.samples
    for option, value in (("--quat-cols", selection.quat_cols), ("--time-col", samples.time_col),
                          ("--sample-rate", samples.sample_rate)):  # fmt: skip
        if value is not None:
            raise UsageError(f"{option} is for tables, and {quoted(log.path)} holds messages")
    wanted = channels_of(log, samples.topic)
    found = [one for channel in wanted for one in _candidates(log, channel, selection)]
    if found:
        return found
    if samples.topic is None or (wanted and selection.quat_field is not None):
        raise NoAttitudesError(log.path, [f"{c.topic} ({c.type_name})" for c in wanted])
    named = [c.topic for c in channels_of(log) if _candidates(log, c, AttitudeSelection())]
    raise NoSuchTopicError(log.path, samples.topic, named, ATTITUDES)


def _candidates(
    log: MessageLog, channel: Channel, selection: AttitudeSelection
) -> list[_Candidate]:
    if selection.quat_field is not None:
        named = orientation_field_at(channel, selection.quat_field, log.path)
        fields = [] if named is None else [named]
    elif channel.type_name in TRANSFORM_LISTS:
        source = partial(_of_transforms, log, channel, selection)
        return [_Candidate(channel.topic, "transforms", source)]
    else:
        fields = orientation_fields(channel, log.path)
    return [
        _Candidate(channel.topic, one.name, partial(_of_field, log, channel, one, selection))
        for one in fields
    ]


def _of_field(
    log: MessageLog, channel: Channel, found: FoundOrientation, selection: AttitudeSelection
) -> AttitudeSource:
    if selection.frame is not None:
        raise UsageError(
            f"{plain(log.path)}: --frame chooses from a list of transforms, and messages of topic "
            f"{quoted(channel.topic)} have one attitude each; leave it out"
        )
    layout = _message_layout(log, channel, found, selection.layout)
    # Fields that are named are fetched in the order w, x, y, z.
    order = layout_named(layout).order if len(found.fields) == 1 else SCALAR_FIRST.order
    meaning = _said(selection)
    clock = clock_of(log, channel, found.stamp, selection.samples)
    reading = FieldReading(log, channel, found.fields, clock, found.absent)
    return AttitudeSource(
        name=channel.topic,
        type_name=channel.type_name,
        quaternion=found.name,
        layout=layout,
        meaning=meaning,
        clock=clock.name,
        remarks=(f"by its type {found.frames}",) if found.frames else (),
        provenance={},
        rows=partial(_message_rows, log, channel, reading, order, meaning),
        stamps=partial(stamps_logged, log, channel, reading),
    )


def _message_layout(
    log: MessageLog, channel: Channel, found: FoundOrientation, said: str | None
) -> str:
    """Return how a message stores a quaternion; its definition knows, or else the user."""
    said = said and layout_named(said).name
    if found.layout is not None:
        if said not in (None, found.layout.name):
            raise UsageError(
                f"{plain(log.path)}: --from-layout says {said}, but {quoted(found.name)} of "
                f"{quoted(channel.type_name)} is {found.layout.name} by definition; leave it out"
            )
        return found.layout.name
    if said is None and len(found.fields) == 1:
        raise UndeclaredError(
            log.path,
            f"which of the four numbers in {quoted(found.name)} is the scalar",
            "--from-layout scalar-first|scalar-last",
        )
    return said or BY_NAME


def _of_transforms(
    log: MessageLog, channel: Channel, selection: AttitudeSelection
) -> AttitudeSource:
    if selection.layout is not None and layout_named(selection.layout) is not SCALAR_LAST:
        raise UsageError(
            f"{plain(log.path)}: --from-layout says {selection.layout}, but transforms are "
            "scalar-last by definition; leave it out"
        )
    clock = clock_of(log, channel, Stamp.of_time("header.stamp"), selection.samples)
    frames = chosen_frames(log, channel, selection.frame)
    meaning = _said(selection)
    reading = TransformReading(log, channel, frames, clock)
    return AttitudeSource(
        name=channel.topic,
        type_name=channel.type_name,
        quaternion=f"{frames.parent} <- {frames.child}",
        layout=SCALAR_LAST.name,
        meaning=meaning,
        clock=clock.name,
        remarks=(),
        provenance={},
        rows=partial(_message_rows, log, channel, reading, SCALAR_FIRST.order, meaning),
        stamps=partial(stamps_logged, log, channel, reading),
    )


def _message_rows(
    log: MessageLog,
    channel: Channel,
    reading: Reading,
    order: tuple[int, ...],
    meaning: Meaning,
) -> Rows:
    """Yield the attitudes that a channel stores in the order `order` and means as `meaning`."""
    places = [order.index(part) for part in range(4)]
    for t_ns, stored in timed_values(log, channel, reading):
        yield t_ns, meaning.restated(stored[:, places])


def _said(selection: AttitudeSelection) -> Meaning:
    """Return what the user says of messages; by their definitions they say the default."""
    return Meaning(selection.convention or "hamilton", selection.direction or "body-to-ref")
