"""Matched columns as samples: rates in rad/s, attitudes, biases and forces, with times in ns."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import MessageError, TimelineError
from quatprop.base.text import Setting, quoted
from quatprop.base.times import NS_PER_S, NS_PER_UNIT
from quatprop.kinematics.conventions import REPRESENTATIONS
from quatprop.readers.matching import ENOUGH_ROWS, first_batch, scalar_column
from quatprop.readers.messages.blocks import to_ns
from quatprop.readers.row_stamps import are_all
from quatprop.readers.tables.model import RowBatch, merge_by_time, without_misfits
from quatprop.readers.tables.running_times import unwrapped
from quatprop.readers.tables.table_log import as_option

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.base.arrays import AnyArray, Float64, Int64
    from quatprop.base.text import Remark
    from quatprop.readers.matching import Match
    from quatprop.readers.tables.model import Convert, Group, Within
    from quatprop.readers.vocabulary import Burst


ABSENT = -1.0
"""First element of a covariance that marks the quantity as not measured."""

MAX_SPACING_NS = NS_PER_S
"""Maximum spacing of the samples of a burst, ns; otherwise the message is damaged."""


class Reading(NamedTuple):
    """Groups of columns of a match to read, and how their rows are converted.

    `is_watched`: whether series of messages must not take turns in them
    `beside`: columns that are read as the last value, if they fit
    """

    match: Match
    groups: Sequence[Group]
    convert: Convert
    is_watched: bool = False
    beside: Group = ()

    def rows(self, within: Within = None) -> Iterator[RowBatch]:
        """Yield all rows, or those in parts of the log; see :meth:`Table.read`."""
        return continued(self.match, self.stored(within))

    def stored(self, within: Within = None) -> Iterator[RowBatch]:
        """Yield rows with their times as they are stored, where counters may wrap around."""
        table, stamp = self.match.table, self.match.stamp
        watched = self.match.field if self.is_watched else ""
        return table.read(stamp, self.groups, self.convert, within, watched, self.beside)

    def first(self) -> Iterator[RowBatch]:
        """Yield rows for checks: the first ones are decoded once, and no losses are noted."""
        table, stamp = self.match.table, self.match.stamp
        rows = first_batch(table, [stamp]).read([stamp], self.groups)
        return table.in_order(without_misfits(self.convert, batch, _left_out) for batch in rows)


def may_wrap(match: Match) -> bool:
    """Return whether the times of messages are numbers of a counter, which may wrap around."""
    table, stamp = match.table, match.stamp
    is_number = stamp.clock == "header" and len(stamp.columns) == 1
    return table.is_typed and is_number and table.columns[stamp.columns[0]].code[:1] != "M"


def continued(match: Match, batches: Iterator[RowBatch]) -> Iterator[RowBatch]:
    """Yield rows of messages with the times of a counter that wraps around continued."""
    if not may_wrap(match):
        return batches

    def times() -> Iterator[tuple[Int64, RowBatch]]:
        return ((rows.values[0], rows) for rows in batches)

    every = unwrapped(times(), match.stamp.units[0], match.table)
    return (
        RowBatch(rows.log_ns, (t_ns, *rows.values[1:]), rows.watermark_ns) for t_ns, rows in every
    )


def _left_out(rows: RowBatch, error: MessageError) -> RowBatch:
    return rows.without(error.positions)


def rates_of(match: Match, beside: Group = ()) -> Reading:
    """Return the reading of timestamps, ns, rates, ``(N, 3)``, rad/s, and integration times, ns.

    `beside`: columns that are read as well, as the last value
    """
    row, sets = match.row, match.sets
    if row.burst is not None:
        return _bursts_of(match, row.burst)
    groups: tuple[Group, ...] = (sets[0],)
    if row.span:
        groups += (scalar_column(match.table, match.part, row.span),)
    elif match.marks:
        groups += (match.marks,)

    def convert(rows: RowBatch) -> RowBatch:
        t_ns, rate, *scalars = rows.values
        others = (scalars.pop(),) if beside else ()
        values: tuple[AnyArray, ...] = (t_ns, rate)
        if row.span:
            integration_time_ns = to_ns(
                scalars, [row.time_unit], quoted(row.span), match.table.path
            )
            # An increment over no time gives a non-finite rate, which policies handle.
            with np.errstate(divide="ignore", invalid="ignore"):
                rate /= (integration_time_ns / NS_PER_S)[:, None]
            values = (t_ns, rate, integration_time_ns)
        elif scalars and match.is_named:
            _note_marked(match, rate, scalars[0])
        elif scalars:
            without_absent(rate, scalars[0])
        if match.factor != 1.0:
            np.multiply(rate, match.factor, out=rate)
        return RowBatch(rows.log_ns, (*values, *others), rows.watermark_ns)

    return Reading(match, groups, convert, is_watched=True, beside=beside)


def _bursts_of(match: Match, burst: Burst) -> Reading:
    """Return the reading of bursts: evenly spaced samples up to the timestamp, one per row."""
    table, part = match.table, match.part
    axes = [tuple(axis) for axis in zip(*match.sets, strict=True)]
    groups = [*axes, *(scalar_column(table, part, name) for name in burst)]
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

    return Reading(match, groups, convert, is_watched=True)


def are_marked(match: Match) -> bool:
    """Return whether rates are finite and all marked as absent, and the user did not name them."""
    if match.is_named or not match.marks:
        return False
    stamps = [match.stamp] if match.stamp.series else []
    first = first_batch(match.table, [match.stamp]).read(stamps, (match.sets[0], match.marks))
    pairs = (rows.values[-2:] for rows in first)
    marked = ((mark == ABSENT) & np.isfinite(rate).all(axis=1) for rate, mark in pairs)
    return are_all(marked, value=True)


def absent_at_first(match: Match) -> str:
    """Return how far rates are absent from the beginning on, such as "all absent"; else empty."""
    count = 0
    for rows in rates_of(match).first():
        # Exactly as many, wherever batches end.
        rates = rows.values[1][: ENOUGH_ROWS - count]
        if np.isfinite(rates).all(axis=1).any():
            return ""
        count += len(rates)
        if count == ENOUGH_ROWS:
            return f"absent in the first {count} samples"
    return "all absent" if count else ""


def refuse_marked(match: Match) -> None:
    """Refuse finite rates that are all marked as absent, unless the user named them.

    Some drivers, such as NovAtel's for /gps/imu, also mark rates that they measured.
    """
    if are_marked(match):
        table, (columns, *_) = match.table, match.sets
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


def attitudes_of(match: Match, scalars: Sequence[Group] = ()) -> Reading:
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

    return Reading(match, (*match.sets, *marks, *scalars), convert)


def read_vectors(
    matches: Sequence[Match], *, in_sequence: bool = False
) -> Iterator[tuple[Int64, Float64]]:
    """Yield timestamps, ns, and specific forces or biases, ``(N, 3)``, NaN if absent."""
    for rows in in_order([*map(vectors_of, matches)], matches, in_sequence=in_sequence):
        t_ns, vectors = rows.values
        yield t_ns, vectors


def vectors_of(match: Match) -> Reading:
    """Return the reading of timestamps, ns, and specific forces or biases, ``(N, 3)``."""
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

    return Reading(match, groups, convert)


def without_absent(rows: Float64, mark: AnyArray) -> None:
    """Set rows that are marked as absent to NaN."""
    if count := np.count_nonzero(is_absent := mark == ABSENT):
        # Setting all rows is much faster without a mask.
        rows[is_absent if count < len(mark) else ...] = np.nan


def in_order(
    readings: Sequence[Reading],
    matches: Sequence[Match],
    within: Within = None,
    *,
    in_sequence: bool = False,
) -> Iterator[RowBatch]:
    """Yield the rows of all readings, one for each match, in order of time.

    `in_sequence`: whether several files are set one after another, whatever their times
    """
    if len(readings) <= 1:  # none in memory
        return readings[0].rows(within) if readings else iter(())
    from quatprop.readers import several_files

    paths = [match.table.path for match in matches]
    one_file = len({*paths}) == 1
    if in_sequence and not one_file:
        return several_files.in_sequence([one.rows(within) for one in readings], paths)
    # A counter may wrap around between two files.
    streams = [one.stored(within) for one in readings]
    if one_file:
        return continued(matches[0], merge_by_time(streams))

    def note(remark: Remark) -> None:
        matches[0].table.remark(remark.code, remark)

    return continued(matches[0], several_files.merged(streams, paths, note))
