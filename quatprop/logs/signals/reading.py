"""Read matched columns: rates in rad/s, attitudes, biases and forces, with timestamps in ns."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.conventions.representations import REPRESENTATIONS
from quatprop.errors import MessageError, TimelineError
from quatprop.logs.clocks.stamps import are_all
from quatprop.logs.matching.find import column_beside
from quatprop.logs.matching.first_batch import first_batch
from quatprop.messages.times import to_ns
from quatprop.tables.batches import RowBatch, without_misfits
from quatprop.tables.column_names import as_option
from quatprop.text import Setting, quoted
from quatprop.times import NS_PER_S, NS_PER_UNIT

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.arrays import AnyArray, Float64, Int64
    from quatprop.logs.matching.find import Match
    from quatprop.logs.vocabulary.rows import Burst
    from quatprop.tables.model import Convert, Group, Within

ABSENT = -1.0
"""First element of a covariance that marks the quantity as not measured."""

MAX_SPACING_NS = NS_PER_S
"""Maximum spacing of the samples of a burst, ns; otherwise the message is damaged."""


class Reading(NamedTuple):
    """Groups of columns of a match to read, and how their rows are converted."""

    match: Match
    groups: Sequence[Group]
    convert: Convert

    def rows(self, within: Within = None) -> Iterator[RowBatch]:
        """Yield all rows, or those in parts of the log; see :meth:`Table.read`."""
        table, stamp = self.match.table, self.match.stamp
        return table.read(stamp, self.groups, self.convert, within)

    def first(self) -> Iterator[RowBatch]:
        """Yield rows for checks: the first ones are decoded once, and no losses are noted."""
        table, stamp = self.match.table, self.match.stamp
        rows = first_batch(table, [stamp]).read([stamp], self.groups)
        return table.in_order(without_misfits(self.convert, batch, _left_out) for batch in rows)


def _left_out(rows: RowBatch, error: MessageError) -> RowBatch:
    return rows.without(error.positions)


def rates_of(match: Match) -> Reading:
    """Return the reading of timestamps, ns, rates, ``(N, 3)``, rad/s, and integration times, ns."""
    row, sets = match.row, match.sets
    if row.burst is not None:
        return _bursts_of(match, row.burst)
    groups: tuple[Group, ...] = (sets[0],)
    if row.span:
        groups += (column_beside(match.table, match.part, row.span),)
    elif match.marks:
        groups += (match.marks,)

    def convert(rows: RowBatch) -> RowBatch:
        t_ns, rate, *beside = rows.values
        values: tuple[AnyArray, ...] = (t_ns, rate)
        if row.span:
            integration_time_ns = to_ns(beside, [row.time_unit], quoted(row.span), match.table.path)
            # An increment over no time gives a non-finite rate, which policies handle.
            with np.errstate(divide="ignore", invalid="ignore"):
                rate /= (integration_time_ns / NS_PER_S)[:, None]
            values = (t_ns, rate, integration_time_ns)
        elif beside and match.is_named:
            _note_marked(match, rate, beside[0])
        elif beside:
            without_absent(rate, beside[0])
        if match.factor != 1.0:
            np.multiply(rate, match.factor, out=rate)
        return RowBatch(rows.log_ns, values, rows.watermark_ns)

    return Reading(match, groups, convert)


def _bursts_of(match: Match, burst: Burst) -> Reading:
    """Return the reading of bursts: evenly spaced samples up to the timestamp, one per row."""
    table, part = match.table, match.part
    axes = [tuple(axis) for axis in zip(*match.sets, strict=True)]
    groups = [*axes, *(column_beside(table, part, name) for name in burst)]
    ns_per_unit = NS_PER_UNIT[match.row.time_unit]

    def convert(rows: RowBatch) -> RowBatch:
        stamp_ns, x, y, z, samples, scale, spacing = rows.values
        stored = np.stack((x, y, z), axis=-1).reshape(len(x), -1, 3)
        counts, room = samples.astype(np.int64), stored.shape[1]
        spacing_ns = spacing.astype(np.float64) * ns_per_unit
        # Written so that NaN is refused too.
        good = (counts <= room) & (spacing_ns >= 0) & (spacing_ns <= MAX_SPACING_NS)
        if not good.all():
            bad = np.flatnonzero(~good)
            raise MessageError(
                table.path,
                f"a message of topic {quoted(table.name)} counts {counts[bad[0]]} samples, "
                f"{spacing_ns[bad[0]]:g} ns apart, and has room for {room}; the log is damaged",
                bad.tolist(),
            )
        message = np.repeat(np.arange(len(counts)), counts)
        position = np.arange(len(message)) - np.repeat(np.cumsum(counts) - counts, counts)
        rate = stored[message, position] * scale.astype(np.float64)[message, None]
        if match.factor != 1.0:
            np.multiply(rate, match.factor, out=rate)
        # Rounded last: the spacing need not be a whole number of nanoseconds.
        before = np.rint((counts[message] - 1 - position) * spacing_ns[message]).astype(np.int64)
        values = (stamp_ns[message] - before, rate)
        return RowBatch(rows.log_ns[message], values, rows.watermark_ns)

    return Reading(match, groups, convert)


def refuse_marked(match: Match) -> None:
    """Refuse finite rates that are all marked as absent, unless the user named them.

    Some drivers, such as NovAtel's for /gps/imu, also mark rates that they measured.
    """
    if match.is_named or not match.marks:
        return
    table, (columns, *_) = match.table, match.sets
    stamps = [match.stamp] if match.stamp.series else []
    first = first_batch(table, [match.stamp]).read(stamps, (columns, match.marks))
    pairs = (rows.values[-2:] for rows in first)
    marked = ((mark == ABSENT) & np.isfinite(rate).all(axis=1) for rate, mark in pairs)
    if are_all(marked, value=True):
        setting = Setting("rate_field", match.field)
        if not table.is_typed:
            names = [column.text for column in table.columns]
            setting = Setting("rate_cols", ",".join(as_option(names, k) for k in columns))
        raise TimelineError(
            table.path,
            f"all rates are marked as absent, by a covariance of -1 in {_place_of_marks(match)}; "
            f"if they were measured anyway, read them with {setting}",
        )


def _note_marked(match: Match, rates: Float64, mark: AnyArray) -> None:
    """Remark on finite rates that are read although marked as absent."""
    if np.isfinite(rates[mark == ABSENT]).all(axis=1).any():
        match.table.remark(
            "marked-rates",
            f"rates that a covariance of -1 in {_place_of_marks(match)} marks as absent are "
            "read anyway, as requested",
        )


def _place_of_marks(match: Match) -> str:
    if match.table.is_typed:
        return f"topic {quoted(match.table.name)}"
    return f"column {quoted(match.table.columns[match.marks[0]].text)}"


def attitudes_of(match: Match, beside: Sequence[Group] = ()) -> Reading:
    """Return the reading of timestamps, ns, quaternions wxyz, ``(N, 4)``, and further groups."""
    marks, form = [match.marks] if match.marks else [], match.representation

    def convert(rows: RowBatch) -> RowBatch:
        t_ns, stored, *others = rows.values
        if marks:
            without_absent(stored, others.pop(0))
        if form != "quaternion":
            stored = np.radians(stored) if match.unit == "deg" else stored
            # Rows that are not finite are reported later.
            with np.errstate(invalid="ignore", over="ignore"):
                stored = REPRESENTATIONS[form].attitudes(stored)
        return RowBatch(rows.log_ns, (t_ns, stored, *others), rows.watermark_ns)

    return Reading(match, (*match.sets, *marks, *beside), convert)


def read_vectors(match: Match) -> Iterator[tuple[Int64, Float64]]:
    """Yield timestamps, ns, and specific forces or biases, ``(N, 3)``, NaN if absent."""
    groups = (*match.sets, *([match.marks] if match.marks else ()))

    def convert(rows: RowBatch) -> RowBatch:
        t_ns, vectors, *marks = rows.values
        for mark in marks:
            if match.row.valid:
                vectors = np.where(mark[:, None] != 0, vectors, np.nan)
            else:
                without_absent(vectors, mark)
        if match.factor != 1.0:
            vectors = vectors * match.factor
        return RowBatch(rows.log_ns, (t_ns, vectors), rows.watermark_ns)

    for rows in Reading(match, groups, convert).rows():
        t_ns, vectors = rows.values
        yield t_ns, vectors


def without_absent(rows: Float64, mark: AnyArray) -> None:
    """Set rows that are marked as absent to NaN."""
    if count := np.count_nonzero(is_absent := mark == ABSENT):
        # Setting all rows is much faster without a mask.
        rows[is_absent if count < len(mark) else ...] = np.nan
