"""The accelerations of a recording: next to its rates, or of a topic of their own."""

from __future__ import annotations

from contextlib import suppress
from itertools import takewhile
from operator import eq
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import LogError, UsageError
from quatprop.base.text import Remark, quoted
from quatprop.kinematics.quaternion import rotate
from quatprop.propagation.conditioning.frames import StaticTransforms, frame_of, sensor_frame
from quatprop.readers.column_readings import Reading, rates_of, read_vectors, vectors_of
from quatprop.readers.matching import (
    ENOUGH_ROWS,
    ColumnMatcher,
    Found,
    Match,
    find,
    marks_of,
    same_message_signals,
    sets_of,
)
from quatprop.readers.rate_signals import match_rates
from quatprop.readers.vocabulary import PARTS, REVERSED_FORCE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.base.arrays import Float64
    from quatprop.propagation.conditioning.static_period import Rows
    from quatprop.propagation.recording import Recording
    from quatprop.readers.signal import RateSignal
    from quatprop.settings.reading import RateSelection


class Forces(NamedTuple):
    """Specific forces of a recording.

    `rows`: timestamps, ns, and forces in sensor axes, shape ``(N, 3)``
    `is_beside`: whether they stand in the rows of the rates
    """

    rows: Rows
    is_beside: bool


def specific_forces(recording: Recording, source: RateSignal) -> Forces | None:
    """Return the specific forces; None if there are none.

    Some drivers publish the accelerometer on a topic of its own, in messages without rates. It is
    used, with a remark, if those next to the rates are absent or zero: the one with their frame, or
    whose name shares most with theirs, turned by the static transforms between other frames.
    """
    selection = recording.selection

    def read(matches: Sequence[Match]) -> Rows:
        return read_vectors(matches, in_sequence=source.in_sequence)

    if selection.accel_cols is not None:
        named = [_named(match, selection) for match in source.matches]
        return Forces(read(named), is_beside=True)
    own = [force for match in source.matches for force in forces_of(match)]
    if any(map(_are_measured, map(vectors_of, own))):
        if own[0].factor < 0:
            names = quoted(own[0].table.field_of(own[0].sets[0]))
            text = f"the signs of {names} are reversed: iOS gives minus the force that is measured"
            recording.other_remarks += {Remark("reversed-forces", text)} - {
                *recording.other_remarks
            }
        return Forces(read(own), is_beside=True)
    frame = sensor_frame(source)
    name, others = _most_similar(source.name, frame, _accelerometers(recording, source))
    if not others:
        return Forces(read(own), is_beside=True) if own else None
    own_frame = frame_of(others[0])
    axes, turn = f"whose axes are assumed to be those of {quoted(source.name)}", None
    if frame and own_frame and frame != own_frame:
        axes, turn = _in_frame(recording, own_frame, frame)
    text = f"accelerations are those of {quoted(name)}, {axes}"
    if (remark := Remark("other-accelerometer", text)) not in recording.other_remarks:
        recording.other_remarks.append(remark)
    rows = read(others)
    if turn is not None:
        rows = ((t_ns, rotate(turn, force)) for t_ns, force in rows)
    return Forces(rows, is_beside=False)


def _in_frame(recording: Recording, begin: str, end: str) -> tuple[str, Float64 | None]:
    """Return a phrase on the axes of another frame, and the rotation into the wanted one."""
    found = None
    with suppress(LogError, UsageError):
        found = StaticTransforms(recording.tables).rotation(begin, end)
    if found is None:
        return f"and the axes of {quoted(begin)} are assumed to be those of {quoted(end)}", None
    phrase = f"turned from the axes of {quoted(begin)} into those of {quoted(end)} by /tf_static"
    return phrase, found[0]


def _named(match: Match, selection: RateSelection) -> Match:
    """Return the columns that the user named, in the rows of rates."""
    found = Found(match.table, match.row, match.part)
    columns = ColumnMatcher(found, selection, "accel_cols").named(selection.accel_cols or ())
    return Match(*found._replace(sets=(columns,)), match.stamp)


def forces_of(match: Match) -> list[Match]:
    """Return the specific force in the rows of rates, if there is one."""
    found = same_message_signals(match, "force")[:1]
    return [Match(*force, match.stamp, sign_of(force), marks=marks_of(force)) for force in found]


def sign_of(force: Found) -> float:
    """Return -1 for columns of a program that writes minus the specific force, else 1."""
    reversed_sets = sets_of(force.table, force.part, PARTS["force"], REVERSED_FORCE)
    return -1.0 if force.sets[0] in reversed_sets else 1.0


def _are_measured(reading: Reading) -> bool:
    """Return whether rates or forces are neither absent nor zero at the beginning."""
    count = 0
    for rows in reading.first():
        vectors = rows.values[1]
        if (np.isfinite(vectors) & (vectors != 0)).any():
            return True
        count += len(rows)
        if count >= ENOUGH_ROWS:
            break
    return False


def _accelerometers(recording: Recording, source: RateSignal) -> dict[str, list[Match]]:
    """Return other topics with accelerations and without rates, one match for each file."""
    topics: dict[str, list[Match]] = {}
    with_rates = {source.name}
    for table in recording.tables.tables():
        if table.is_typed and table.name not in with_rates:
            with suppress(LogError, UsageError):
                for found in find(table, "rate"):
                    match = match_rates(found, recording.selection)
                    forces = forces_of(match)
                    if any(map(_are_measured, map(vectors_of, forces))):
                        topics.setdefault(table.name, []).extend(forces)
                    if _are_measured(rates_of(match)):
                        with_rates.add(table.name)
    return {name: forces for name, forces in topics.items() if name not in with_rates}


def _most_similar(
    name: str, frame: str, topics: dict[str, list[Match]]
) -> tuple[str, Sequence[Match]]:
    """Return the topic with the frame of another, or whose name begins most like its name.

    None if several do.
    """

    def shared(other: str) -> int:
        alike = map(eq, name.split("/"), other.split("/"))
        return sum(takewhile(bool, alike))

    same = [other for other, matches in topics.items() if frame and frame_of(matches[0]) == frame]
    known = same or [*topics]
    most = max(map(shared, known), default=0)
    nearest = [other for other in known if shared(other) == most]
    return (nearest[0], topics[nearest[0]]) if len(nearest) == 1 else ("", ())
