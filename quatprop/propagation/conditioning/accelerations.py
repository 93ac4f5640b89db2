"""The accelerations of a recording: beside its rates, or of a topic of their own."""

from __future__ import annotations

from contextlib import suppress
from itertools import takewhile
from operator import eq
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import LogError, UsageError
from quatprop.base.text import Remark, quoted
from quatprop.readers.matching import (
    ENOUGH_ROWS,
    ColumnMatcher,
    Found,
    Match,
    beside,
    find,
    marks_of,
)
from quatprop.readers.rate_signals import match_rates
from quatprop.readers.signal import Reading, rates_of, read_vectors, vectors_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.propagation.conditioning.static_period import Rows
    from quatprop.propagation.recording import Recording
    from quatprop.readers.signal import RateSignal
    from quatprop.settings.reading import RateSelection


def specific_forces(recording: Recording, source: RateSignal) -> Rows | None:
    """Return timestamps, ns, and specific forces, sensor axes, ``(N, 3)``; None if there are none.

    Some drivers publish the accelerometer on a topic of its own, in messages without rates. It is
    used, with a remark, if those beside the rates are absent or zero, as is the one whose name
    shares most with that of the rates.
    """
    selection = recording.selection
    if selection.accel_cols is not None:
        return read_vectors([_named(match, selection) for match in source.matches])
    own = [force for match in source.matches for force in _forces_beside(match)]
    if any(map(_are_measured, map(vectors_of, own))):
        return read_vectors(own)
    name, others = _nearest(source.name, _accelerometers(recording, source))
    if not others:
        return read_vectors(own) if own else None
    text = (
        f"accelerations are those of {quoted(name)}, whose axes are assumed to be those of "
        f"{quoted(source.name)}"
    )
    if (remark := Remark("other-accelerometer", text)) not in recording.beside_remarks:
        recording.beside_remarks.append(remark)
    return read_vectors(others)


def _named(match: Match, selection: RateSelection) -> Match:
    """Return the columns that the user named, in the rows of rates."""
    found = Found(match.table, match.row, match.part)
    columns = ColumnMatcher(found, selection, "accel_cols").named(selection.accel_cols or ())
    return Match(*found._replace(sets=(columns,)), match.stamp)


def _forces_beside(match: Match) -> list[Match]:
    """Return the specific force in the rows of rates, if there is one."""
    found = beside(match, "force")[:1]
    return [Match(*force, match.stamp, marks=marks_of(force)) for force in found]


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
                    forces = _forces_beside(match)
                    if any(map(_are_measured, map(vectors_of, forces))):
                        topics.setdefault(table.name, []).extend(forces)
                    if _are_measured(rates_of(match)):
                        with_rates.add(table.name)
    return {name: forces for name, forces in topics.items() if name not in with_rates}


def _nearest(name: str, topics: dict[str, list[Match]]) -> tuple[str, Sequence[Match]]:
    """Return the topic whose name begins most like another one; none if several do."""

    def shared(other: str) -> int:
        alike = map(eq, name.split("/"), other.split("/"))
        return sum(takewhile(bool, alike))

    most = max(map(shared, topics), default=0)
    nearest = [other for other in topics if shared(other) == most]
    return (nearest[0], topics[nearest[0]]) if len(nearest) == 1 else ("", ())
