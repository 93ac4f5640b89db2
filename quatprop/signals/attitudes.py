"""Attitudes of a log, as Hamilton quaternions body -> reference at stamps in ns.

The layout is taken from names, definitions or metadata; where none of them says it, it is asked
for.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.conventions import HAMILTON, Meaning
from quatprop.errors import LogError, UsageError
from quatprop.kinematics.quaternion import IDENTITY, conjugate
from quatprop.kinematics.uncertainty import reference_covariance
from quatprop.logs.matching import Match, field_name, find, marks_of, matching, sets_of
from quatprop.logs.reading import read_attitudes
from quatprop.logs.stamps import are_all, choose_stamp
from quatprop.logs.vocabulary import RATE_PARTS
from quatprop.signals.attitude_convention import (
    in_order,
    meaning_of,
    message_layout,
    recorded_convention,
)
from quatprop.signals.choice import ATTITUDES, Candidate, choose, message_candidates
from quatprop.signals.signal import AttitudeSignal, stamps_of
from quatprop.tables.base import AnyLog, TableLog

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.containers.topics import TopicTable
    from quatprop.logs.matching import Found
    from quatprop.selection import AttitudeSelection
    from quatprop.signals.signal import Rows


COVARIANCE_SIZES = (9, 36)
"""Numbers in the covariance of an orientation, and of a position and an orientation."""

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
    return [
        Candidate(
            found.table.name,
            found.field,
            partial(_signal, found, selection),
            preferred=not found.table.is_secondary,
        )
        for found in message_candidates(log, selection, ATTITUDES)
    ]


def _signal(found: Found, selection: AttitudeSelection) -> AttitudeSignal:
    """Return attitudes of a topic with their meaning and their time."""
    provenance = found.table.provenance()
    recorded = recorded_convention(provenance)
    layout = message_layout(found, selection.from_layout, recorded.get("layout"))
    found = found._replace(table=found.table.of_frames(selection.frame))
    found = found._replace(sets=(in_order(found, layout),))
    table, row, part = found.table, found.row, found.part
    meaning = meaning_of(table.path, selection, recorded)
    stamp, remarks = choose_stamp(found, selection)
    match = Match(found, stamp, marks=marks_of(found))
    position = sets_of(table, part, RATE_PARTS, row.position)[:1]
    covariance = tuple(k for k, _ in matching(table, part, row.covariance))
    may_have_covariances = len(covariance) in COVARIANCE_SIZES and meaning == HAMILTON

    def read(*, positions: bool = False, covariances: bool = False) -> Rows:
        beside = (*(position if positions else ()), *([covariance] if covariances else ()))
        rows: Iterator[tuple[Any, ...]] = (one.values for one in read_attitudes(match, beside))
        if covariances:
            # What this package wrote is of no driver.
            rows = _known(table, rows, may_be_constant=bool(provenance))
        return _in_terms(rows, meaning, positions=positions, covariances=covariances)

    is_beside_rate = row.rate != "" and any(one.part == part for one in find(table, "rate"))
    placeholder = is_beside_rate and are_all(
        (np.abs(wxyz) for _, wxyz, *_ in read()), IDENTITY, CONSTANT_MESSAGES
    )
    if placeholder:
        remarks = ("it is the identity in every message: a placeholder, not an attitude", *remarks)
    if row.frames:
        remarks = (f"by its type {row.frames}", *remarks)
    return AttitudeSignal(
        name=table.name,
        type_name=table.type,
        field=field_name(table, found.sets),
        layout=layout,
        meaning=meaning,
        clock=stamp.clock,
        remarks=remarks,
        provenance=provenance,
        read=read,
        stamps=lambda: stamps_of(read_attitudes(match)),
        has_positions=bool(position),
        may_have_covariances=may_have_covariances,
        placeholder=placeholder,
    )


def _in_terms(
    values: Iterator[tuple[Any, ...]], meaning: Meaning, *, positions: bool, covariances: bool
) -> Rows:
    """Yield attitudes body -> reference, and what is beside them."""
    for t_ns, stored, *beside in values:
        wxyz = meaning.converted(stored)
        covariance = beside[-1] if covariances else None
        if covariance is not None:
            # Quaternions are not checked yet.
            with np.errstate(over="ignore", invalid="ignore"):
                covariance = reference_covariance(conjugate(wxyz), covariance)
        yield t_ns, wxyz, beside[0] if positions else None, covariance


def _known(
    table: TopicTable, rows: Iterator[tuple[Any, ...]], *, may_be_constant: bool
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
        table.remark(
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
        table.remark(
            f"the covariances of {in_part} messages are known in part, which is not kept: they "
            "are taken as unknown",
        )
