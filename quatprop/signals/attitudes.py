"""Attitudes of a log, as Hamilton quaternions body -> reference at stamps in ns.

The layout is taken from names, definitions or metadata; where none of them says it, it is asked
for.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from quatprop.conventions import HAMILTON, Meaning
from quatprop.conventions.layout import SCALAR_FIRST, SCALAR_LAST, layout_named
from quatprop.errors import LogError, UsageError
from quatprop.kinematics.quaternion import IDENTITY, conjugate
from quatprop.kinematics.uncertainty import reference_covariance
from quatprop.messages.message_types import TRANSFORM_LISTS, OrientationField
from quatprop.messages.signal_fields import orientation_field_at, orientation_fields, signal_fields
from quatprop.messages.ulog import is_secondary
from quatprop.signals.attitude_convention import meaning_of, message_layout, recorded_convention
from quatprop.signals.choice import ATTITUDES, Candidate, choose, message_candidates
from quatprop.signals.clock import are_all, choose_clock, zero_stamps
from quatprop.signals.message_values import field_reader, logged_values, stamps_of, timed_values
from quatprop.signals.signal import AttitudeSignal
from quatprop.tables.base import AnyLog, TableLog
from quatprop.text import Setting, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.containers.base import Channel, MessageLog
    from quatprop.selection import AttitudeSelection
    from quatprop.signals.signal import Rows


CONSTANT_MESSAGES = 20_000
"""An orientation that is the identity in so many messages was never set, and a covariance that is
the same in all of them is a constant."""


def choose_attitudes(log: AnyLog, selection: AttitudeSelection) -> AttitudeSignal:
    """Return the only attitudes that a selection leaves.

    Raises
    ------
    NoAttitudesError
        Nothing in the log carries attitudes.
    NoSuchTopicError
        The topic is not there, or carries none.
    AmbiguousTopicError
        Several topics carry attitudes.
    UndeclaredError
        The layout, a column or the time is declared nowhere.
    UsageError
        Settings contradict each other or the log.
    """
    candidates = attitude_candidates(log, selection)
    if len(candidates) > 1:
        # Neither a placeholder nor what is absent in every message competes with an attitude.
        attitudes = [candidate for candidate in candidates if not _is_placeholder(candidate)]
        candidates = attitudes or candidates
    return choose(log, candidates, ATTITUDES)


def _is_placeholder(candidate: Candidate[AttitudeSignal]) -> bool:
    if candidate.field == "transforms":
        return False
    try:
        signal = candidate.signal()
        present = (np.isfinite(wxyz) for _, wxyz, *_ in signal.read())
        return signal.placeholder or are_all(present, value=False)
    except (LogError, UsageError):
        return False


def attitude_candidates(
    log: AnyLog, selection: AttitudeSelection
) -> list[Candidate[AttitudeSignal]]:
    """Return the attitudes that a selection leaves, at least one.

    Raises
    ------
    LogError
        As for :func:`choose_attitudes`, but for the ambiguity; what is not declared about a
        candidate is refused when its signal is asked for.
    """
    if isinstance(log, TableLog):
        from quatprop.signals.attitude_tables import of_table

        return [Candidate("", "", partial(of_table, log, selection))]
    return message_candidates(log, selection, ATTITUDES, _candidates)


def _candidates(
    log: MessageLog, channel: Channel, selection: AttitudeSelection
) -> list[Candidate[AttitudeSignal]]:
    if selection.quat_field is not None:
        named = orientation_field_at(channel, selection.quat_field, log.path)
        fields = [] if named is None else [named]
    elif channel.type_name in TRANSFORM_LISTS:
        signal = partial(_of_transforms, log, channel, selection)
        return [Candidate(channel.topic, "transforms", signal)]
    else:
        fields = orientation_fields(channel, log.path)
    return [
        Candidate(
            channel.topic,
            field.name,
            partial(_of_field, log, channel, field, selection),
            preferred=not is_secondary(channel),
        )
        for field in fields
    ]


def _of_field(
    log: MessageLog, channel: Channel, field: OrientationField, selection: AttitudeSelection
) -> AttitudeSignal:
    if selection.frame is not None:
        raise UsageError(
            f"{plain(log.path)}: {Setting('frame')} chooses from a list of transforms, and "
            f"messages of topic {quoted(channel.topic)} have one attitude each; leave it out"
        )
    provenance = log.provenance(channel.topic)
    recorded = recorded_convention(provenance)
    layout = message_layout(log.path, channel, field, selection.from_layout, recorded.get("layout"))
    # Fields with names are fetched in the order w, x, y, z.
    order = layout_named(layout).order if len(field.fields) == 1 else SCALAR_FIRST.order
    meaning = meaning_of(log.path, selection, recorded)
    clock = choose_clock(log, channel, field.stamps, selection)
    reader = partial(field_reader, log, channel, clock, field.fields, [field.absent])

    def read(*, positions: bool = False, covariances: bool = False, logged: bool = False) -> Rows:
        position = [field.position] if positions else []
        covariance = [field.covariance] if covariances else []
        rows = timed_values(log, channel, reader(position, covariance), logged=logged)
        if covariances:
            # What this package wrote is of no driver.
            rows = _known(log, rows, may_be_constant=bool(provenance))
        beside = _Beside(positions=positions, covariances=covariances, logged=logged)
        return _in_terms(rows, order, meaning, beside)

    remarks: tuple[str, ...] = (f"by its type {field.frames}",) if field.frames else ()
    placeholder = _is_beside_rate(channel, field, log.path) and are_all(
        (np.abs(wxyz) for _, wxyz, *_ in read()), IDENTITY, CONSTANT_MESSAGES
    )
    if placeholder:
        remarks += ("it is the identity in every message: a placeholder, not an attitude",)
    return AttitudeSignal(
        name=channel.topic,
        type_name=channel.type_name,
        field=field.name,
        layout=layout,
        meaning=meaning,
        clock=clock.name,
        remarks=remarks + clock.remarks,
        provenance=provenance,
        read=read,
        stamps=lambda: stamps_of(logged_values(log, channel, reader())),
        has_positions=field.position is not None,
        may_have_covariances=field.covariance is not None and meaning == HAMILTON,
        placeholder=placeholder,
    )


def _is_beside_rate(channel: Channel, field: OrientationField, path: Path | str) -> bool:
    """Tell whether a message has a rate beside its orientation, as that of an IMU has."""
    return any(
        fields.rate is not None and fields.orientation == field
        for fields in signal_fields(channel, path, "orientation")
    )


def _of_transforms(
    log: MessageLog, channel: Channel, selection: AttitudeSelection
) -> AttitudeSignal:
    from quatprop.signals.transforms import chosen_frames, transform_reader

    layout = selection.from_layout
    if layout is not None and layout_named(layout) is not SCALAR_LAST:
        raise UsageError(
            f"{plain(log.path)}: {Setting('from_layout')} says {layout}, but transforms are "
            "scalar-last by definition; leave it out"
        )
    provenance = log.provenance(channel.topic)
    clock = choose_clock(log, channel, (), selection, has_stamp=True)
    frames = chosen_frames(log, channel, selection.frame)
    meaning = meaning_of(log.path, selection, recorded_convention(provenance))
    reader = transform_reader(log, channel, frames, clock)

    def read(*, positions: bool = False, covariances: bool = False, logged: bool = False) -> Rows:
        rows = timed_values(log, channel, reader, logged=logged)
        order = SCALAR_FIRST.order
        beside = _Beside(positions=positions, covariances=covariances, logged=logged)
        return _in_terms(rows, order, meaning, beside)

    if clock.name == "header" and are_all(
        (t_ns for t_ns, *_ in timed_values(log, channel, reader)), 0
    ):
        raise zero_stamps(log, channel)
    return AttitudeSignal(
        name=channel.topic,
        type_name=channel.type_name,
        field=f"{frames.parent} <- {frames.child}",
        layout=SCALAR_LAST.name,
        meaning=meaning,
        clock=clock.name,
        provenance=provenance,
        read=read,
        stamps=lambda: stamps_of(logged_values(log, channel, reader)),
        has_positions=True,
    )


class _Beside(NamedTuple):
    """What is read beside stamps and attitudes."""

    positions: bool
    covariances: bool
    logged: bool


def _in_terms(
    values: Iterator[tuple[Any, ...]], order: tuple[int, ...], meaning: Meaning, wanted: _Beside
) -> Rows:
    """Yield attitudes that are stored in the order `order`, and what is wanted beside them."""
    places = [order.index(part) for part in range(4)]
    for t_ns, stored, *beside in values:
        log_ns = beside.pop(0) if wanted.logged else None
        wxyz = meaning.converted(stored[:, places])
        covariance = beside[-1] if wanted.covariances else None
        if covariance is not None:
            # Quaternions are not checked yet.
            with np.errstate(over="ignore", invalid="ignore"):
                covariance = reference_covariance(conjugate(wxyz), covariance)
        row = t_ns, wxyz, beside[0] if wanted.positions else None, covariance
        yield row if log_ns is None else (*row, None, log_ns)


def _known(
    log: MessageLog, rows: Iterator[tuple[Any, ...]], *, may_be_constant: bool
) -> Iterator[tuple[Any, ...]]:
    """Yield rows with their covariances, NaN where these are marked as unknown.

    With None where all of the first messages have the same: that is a constant of the sensor's
    driver, not what is known of each attitude; and where it is zero, it is not set.
    """
    first: list[tuple[Any, ...]] = []
    count, varies = 0, False
    while not varies and count < CONSTANT_MESSAGES and (batch := next(rows, None)) is not None:
        first.append(batch)
        count += len(batch[0])
        constant = 0.0 if may_be_constant else first[0][-1][:1]
        varies = bool((batch[-1] != constant).any())
    if not varies and first and first[0][-1][:1].any():
        _add_remark(
            log,
            f"the covariance of the orientation does not change in {count} messages, so it "
            "is taken as a constant of the driver, not as what is known of each attitude",
        )
    in_part = 0
    for *row, numbers in chain(first, rows):
        if not varies:
            yield (*row, None)
            continue
        size = math.isqrt(numbers.shape[1])
        of_rotation = numbers.reshape(-1, size, size)[:, -3:, -3:]
        variances = np.diagonal(of_rotation, axis1=1, axis2=2)
        is_known = np.isfinite(of_rotation).all(axis=(1, 2)) & (variances >= 0).all(axis=1)
        in_part += int(np.count_nonzero(~is_known & (variances > 0).any(axis=1)))
        of_rotation[~is_known] = np.nan
        yield (*row, of_rotation)
    if in_part:
        _add_remark(
            log,
            f"the covariances of {in_part} messages are known in part, which is not kept: they "
            "are taken as unknown",
        )


def _add_remark(log: MessageLog, remark: str) -> None:
    """Add a remark on what is read, once however often that is."""
    log.remarks = [*(one for one in log.remarks if one != remark), remark]
