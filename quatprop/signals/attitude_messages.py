"""Attitudes in messages: in fields of known types, in fields that are named, in transforms."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from quatprop.conventions.layout import SCALAR_FIRST, SCALAR_LAST, layout_named
from quatprop.errors import NoAttitudesError, NoSuchTopicError, UndeclaredError, UsageError
from quatprop.messages.orientations import orientation_field_at, orientation_fields
from quatprop.messages.stamps import Stamp
from quatprop.messages.transforms import TRANSFORM_LISTS
from quatprop.selection import AttitudeSelection
from quatprop.signals.attitude_source import BY_NAME, AttitudeSource, meaning_of, recorded_in
from quatprop.signals.channel_values import (
    FieldReading,
    channels_of,
    clock_of,
    stamps_logged,
    timed_values,
)
from quatprop.signals.transforms import TransformReading, chosen_frames
from quatprop.text import plain, quoted

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.containers.base import Channel, MessageLog
    from quatprop.conventions import Meaning
    from quatprop.messages.orientations import FoundOrientation
    from quatprop.signals.attitude_source import Rows
    from quatprop.signals.channel_values import Reading


class Candidate(NamedTuple):
    """An attitude of a log, not yet looked at closely.

    Parameters
    ----------
    topic, field
        Where it is in messages; ``""`` in a table.
    source
        Gives it, or refuses what is not said about it.
    """

    topic: str
    field: str
    source: Callable[[], AttitudeSource]


def of_messages(log: MessageLog, selection: AttitudeSelection) -> list[Candidate]:
    """Return every attitude that the options leave; at least one."""
    for option, value in (("--quat-cols", selection.quat_cols), ("--time-col", selection.time_col),
                          ("--sample-rate", selection.sample_rate)):  # fmt: skip
        if value is not None:
            raise UsageError(f"{option} is for tables, and {quoted(log.path)} holds messages")
    wanted = channels_of(log, selection.topic)
    found = [one for channel in wanted for one in _candidates(log, channel, selection)]
    if found:
        return found
    if selection.topic is None or (wanted and selection.quat_field is not None):
        raise NoAttitudesError(log.path, [f"{c.topic} ({c.type_name})" for c in wanted])
    named = [c.topic for c in channels_of(log) if _candidates(log, c, AttitudeSelection())]
    raise NoSuchTopicError(log.path, selection.topic, named, "attitudes")


def _candidates(log: MessageLog, channel: Channel, selection: AttitudeSelection) -> list[Candidate]:
    if selection.quat_field is not None:
        named = orientation_field_at(channel, selection.quat_field, log.path)
        fields = [] if named is None else [named]
    elif channel.type_name in TRANSFORM_LISTS:
        source = partial(_of_transforms, log, channel, selection)
        return [Candidate(channel.topic, "transforms", source)]
    else:
        fields = orientation_fields(channel, log.path)
    return [
        Candidate(channel.topic, one.name, partial(_of_field, log, channel, one, selection))
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
    provenance = log.provenance(channel.topic)
    recorded = recorded_in(provenance)
    layout = _layout(log, channel, found, selection.from_layout, recorded.get("layout"))
    # Fields that are named are fetched in the order w, x, y, z.
    order = layout_named(layout).order if len(found.fields) == 1 else SCALAR_FIRST.order
    meaning = meaning_of(log.path, selection, recorded)
    clock = clock_of(log, channel, found.stamp, selection)
    reading = FieldReading(log, channel, found.fields, clock, found.absent)
    return AttitudeSource(
        name=channel.topic,
        type_name=channel.type_name,
        quaternion=found.name,
        layout=layout,
        meaning=meaning,
        clock=clock.name,
        remarks=(f"by its type {found.frames}",) if found.frames else (),
        provenance=provenance,
        rows=partial(_message_rows, log, channel, reading, order, meaning),
        stamps=partial(stamps_logged, log, channel, reading),
    )


def _layout(
    log: MessageLog,
    channel: Channel,
    found: FoundOrientation,
    said: str | None,
    recorded: str | None,
) -> str:
    """Return how a message stores a quaternion; its definition knows, or else the user."""
    said = said and layout_named(said).name
    if found.layout is not None:
        if said is None and recorded not in (None, found.layout.name):
            raise UsageError(
                f"{plain(log.path)}: the metadata of topic {quoted(channel.topic)} say "
                f"{recorded}, but {quoted(found.name)} of {quoted(channel.type_name)} is "
                f"{found.layout.name} by definition; settle it with --from-layout "
                f"{found.layout.name}"
            )
        if said not in (None, found.layout.name):
            raise UsageError(
                f"{plain(log.path)}: --from-layout says {said}, but {quoted(found.name)} of "
                f"{quoted(channel.type_name)} is {found.layout.name} by definition; leave it out"
            )
        return found.layout.name
    said = said or recorded
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
    if selection.from_layout is not None and layout_named(selection.from_layout) is not SCALAR_LAST:
        raise UsageError(
            f"{plain(log.path)}: --from-layout says {selection.from_layout}, but transforms are "
            "scalar-last by definition; leave it out"
        )
    provenance = log.provenance(channel.topic)
    recorded = recorded_in(provenance)
    clock = clock_of(log, channel, Stamp.of_time("header.stamp"), selection)
    frames = chosen_frames(log, channel, selection.frame)
    meaning = meaning_of(log.path, selection, recorded)
    reading = TransformReading(log, channel, frames, clock)
    return AttitudeSource(
        name=channel.topic,
        type_name=channel.type_name,
        quaternion=f"{frames.parent} <- {frames.child}",
        layout=SCALAR_LAST.name,
        meaning=meaning,
        clock=clock.name,
        remarks=(),
        provenance=provenance,
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
        yield t_ns, meaning.converted(stored[:, places])
