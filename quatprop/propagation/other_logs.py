"""Read from other logs: the attitude for ``--q0``, and the times of ``--at``."""

from __future__ import annotations

import math
import re
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from quatprop.base.errors import (
    DamagedLogError,
    LogError,
    NoAttitudesError,
    NoRatesError,
    NoSamplesError,
    NoSuchTopicError,
    NotRotationsError,
    TimelineError,
    UndeclaredError,
    UsageError,
)
from quatprop.base.rendering import degrees_text
from quatprop.base.text import Remark, Setting, plain, quoted
from quatprop.base.times import NS_PER_UNIT, absolute_ns, duration_text
from quatprop.kinematics.quaternion import IDENTITY, geodesic_angle, normalize, slerp
from quatprop.kinematics.series import AttitudeSeries
from quatprop.propagation.attitude_input import AttitudeInput, RecordedAttitudes
from quatprop.propagation.conditioning.correction_inputs import own_orientation
from quatprop.propagation.conditioning.frames import body_frame
from quatprop.propagation.recording import errors_of, stated_in_header
from quatprop.readers.attitude_quality import QuaternionCheck
from quatprop.readers.clock_difference import stamps_and_log_times
from quatprop.readers.matching import ColumnMatcher, Found, first_batch
from quatprop.readers.odd_clocks import NO_DURATION
from quatprop.readers.row_stamps import choose_time, stamp_at
from quatprop.readers.tables.exact_times import from_text
from quatprop.readers.tables.table_log import parse_name
from quatprop.readers.tables.time_units import is_time_unit
from quatprop.readers.vocabulary import GENERIC, STAMPS
from quatprop.settings.reading import AttitudeSelection, SignalSelection
from quatprop.timeline.stamps import GAP_FACTOR, MEDIAN_WINDOW, gap_limit_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.propagation.q0_check import OverlappingAttitudes
    from quatprop.propagation.recording import Recording
    from quatprop.readers.signal import RateSignal
    from quatprop.readers.tables.model import Column, Log, RowBatch, Table

    Row = tuple[int, Float64]


OTHER_Q0 = f"give another {Setting('q0')}"
"""The way out if there is no initial attitude."""

_JUMP, _JUMP_RATIO = math.radians(1.0), 10
"""A jump is a turn of more than this, rad, and than so many times those that follow."""

_FOLLOWING, _FEWEST_FOLLOWING = 20, 4
"""Number of attitudes after a jump that are compared with it."""

AHEAD_NS = 200_000_000
"""Times of messages that are later than those of their recording by more are of another clock."""

MAX_INTERPOLATION_NS = 10 * NS_PER_UNIT["s"]
"""Maximum interval that is interpolated, ns."""


def attitude_at(
    source: Path | str, t_ns: int, recording: Recording, overlap: OverlappingAttitudes
) -> tuple[Float64, str]:
    """Return the attitude of a series, in a file or a topic of the recording, at a time.

    `t_ns`: the time, ns
    `overlap`: keeps the attitudes that follow
    `Returns`: wxyz, Hamilton, body -> reference, shape ``(4,)``. At a timestamp of the series the
        stored quaternion, else a unit quaternion on the shortest arc between its neighbours. And
        the name of the body's frame, empty if it is not known
    """
    otherwise = f"{Setting('q0')} {plain(str(source))} is not four numbers W,X,Y,Z, level, log, "
    with recording.second_input(str(source), otherwise, "q0") as opened:
        # Invalid rows elsewhere in the series do not matter.
        wanted = AttitudeInput(opened.name, drop=True, otherwise=OTHER_Q0)
        attitudes = RecordedAttitudes(opened, wanted)
        batches = overlap.watched(attitudes.batches())
        try:
            wxyz = attitude_in(batches, t_ns, opened.name, recording.other_remarks)
        except NotRotationsError:
            raise NotRotationsError(
                opened.name,
                f"{quoted(attitudes.signal.name)} has no orientation: {attitudes.counts.summary}",
            ) from None
        # To its end, so that what is lost of it does not depend on the time.
        deque(batches, maxlen=0)
        return wxyz, body_frame(attitudes.signal.match)


def first_orientation(
    log: Log, source: RateSignal, recording: Recording, t_ns: int, overlap: OverlappingAttitudes
) -> Float64:
    """Return the orientation that a recording, open as `log`, has next to its rates at a time.

    `overlap`: keeps the orientations that follow
    `Returns`: wxyz, Hamilton, body -> reference, as stored, shape ``(4,)``
    """
    try:
        with errors_of("q0"):
            signal = own_orientation(log, source, recording.selection)
        signal.refuse_placeholder(log.path, OTHER_Q0)
        batches = overlap.watched(QuaternionCheck(log.path, drop=True).apply(signal.rows()))
        wxyz = attitude_in(batches, t_ns, log.path, recording.other_remarks)
    except NoSamplesError:
        absent = f"the orientation of {quoted(source.name)} is absent or invalid throughout"
    except (NoAttitudesError, NoSuchTopicError):
        absent = f"there is no orientation next to the rates of {quoted(source.name)}"
    else:
        overlap.read_on(batches)
        return wxyz
    raise LogError(log.path, f"{absent}; {OTHER_Q0}, such as a file of attitudes")


def attitude_in(
    batches: Iterable[AttitudeSeries],
    t_ns: int,
    path: Path | str,
    remarks: list[Remark] | None = None,
) -> Float64:
    """Return the attitude of a series at a time; see :func:`attitude_at`.

    `t_ns`: the time, ns
    `remarks`: receives a remark if it is interpolated across a gap
    """
    check = _PlaceholderCheck()
    before, after, limit_ns = _around(batches, t_ns, check)
    check.refuse_placeholder(path, t_ns)
    if before is not None and before[0] == t_ns:
        return before[1]
    if before is None and after is None:
        raise NoSamplesError(path, "its attitudes")
    if before is None or after is None:
        if before is None:
            stamp, word, side, remedy = cast("Row", after)[0], "first", "after", ""
            if stamp - t_ns < 24 * NS_PER_UNIT["h"]:  # the log may reach so far
                remedy = f" If so, begin there with {Setting('start', str(stamp))}"
        else:
            stamp, word, side, remedy = before[0], "last", "before", ""
        raise TimelineError(
            path,
            f"its {word} attitude is {duration_text(abs(stamp - t_ns))} {side} the first sample "
            f"that is used ({stamp} and {t_ns} ns); are both on the same clock?{remedy}",
        )
    if after[0] - before[0] > MAX_INTERPOLATION_NS:
        raise TimelineError(
            path,
            f"{t_ns} ns is in a gap of {duration_text(after[0] - before[0])} between its "
            f"attitudes; interpolation reaches over at most {duration_text(MAX_INTERPOLATION_NS)}",
        )
    if remarks is not None and after[0] - before[0] > limit_ns:
        remarks.append(_across_gap(before, after, limit_ns))
    fraction = (t_ns - before[0]) / (after[0] - before[0])
    return slerp(normalize(before[1]), normalize(after[1]), fraction)


def _around(
    batches: Iterable[AttitudeSeries], t_ns: int, check: _PlaceholderCheck
) -> tuple[Row | None, Row | None, int]:
    """Return the rows before and after a time, or one at it twice, and the limit of gaps, ns."""
    before: Row | None = None
    after: Row | None = None
    first = np.zeros(0, np.int64)
    for series in check.watched(batches):
        stamps = series.t_ns
        if len(first) < MEDIAN_WINDOW:
            first = np.append(first, stamps)
        earlier, later = stamps <= t_ns, stamps >= t_ns
        if earlier.any():
            row = int(np.argmax(np.where(earlier, stamps, np.iinfo(np.int64).min)))
            if before is None or stamps[row] > before[0]:
                before = int(stamps[row]), series.wxyz[row]
        if later.any():
            row = int(np.argmin(np.where(later, stamps, np.iinfo(np.int64).max)))
            if after is None or stamps[row] < after[0]:
                after = int(stamps[row]), series.wxyz[row]
        # An identity may be a placeholder.
        if before and before[0] == t_ns and (check.is_over or not _is_identity(before[1])):
            break
    if before is not None and before[0] == t_ns:
        return before, before, 0
    return before, after, gap_limit_ns(first)


def _is_identity(wxyz: Float64) -> Bool:
    is_identity: Bool = (np.abs(wxyz) == IDENTITY).all(axis=-1)
    return is_identity


class _PlaceholderCheck:
    """Watches for attitudes that are the identity until a filter starts, with a jump.

    `is_over`: whether no more attitudes matter
    """

    def __init__(self) -> None:
        self._rows: list[AttitudeSeries] = []
        self.is_over = False

    def watched(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield batches, and keep the last identity with what follows."""
        for series in batches:
            if not self.is_over:
                self._add(series)
            yield series

    def _add(self, series: AttitudeSeries) -> None:
        known = sum(map(len, self._rows))
        if known <= 1:
            count = int(np.argmin(np.append(_is_identity(series.wxyz), [False])))
            if count:
                self._rows, series = [series[count - 1 : count]], series[count:]
            self.is_over = not self._rows
        self._rows.append(series[: _FOLLOWING + 1 - known])
        self.is_over |= known + len(series) > _FOLLOWING

    def refuse_placeholder(self, path: Path | str, t_ns: int) -> None:
        """Refuse a time before the jump."""
        if sum(map(len, self._rows)) <= _FEWEST_FOLLOWING:
            return
        rows = AttitudeSeries.joined(self._rows)
        if t_ns >= rows.t_ns[1] or not _is_identity(rows.wxyz[0]):
            return
        turns, steps = geodesic_angle(rows.wxyz[:-1], rows.wxyz[1:]), np.diff(rows.t_ns)
        is_jump = turns[0] > max(_JUMP, _JUMP_RATIO * float(turns[1:].max()))
        # What happens in a gap is no jump.
        if is_jump and steps[0] <= GAP_FACTOR * np.median(steps[1:]):
            start = int(rows.t_ns[1])
            raise LogError(
                path,
                f"its attitudes are the identity until they jump by "
                f"{degrees_text(float(turns[0]), 3)} at {start} ns: placeholders, not attitudes; "
                f"begin there with {Setting('start', str(start))}, or {OTHER_Q0}",
            )


def _across_gap(before: Row, after: Row, limit_ns: int) -> Remark:
    turn = degrees_text(float(geodesic_angle(before[1], after[1])), 3)
    q0, start = Setting("q0"), Setting("start", str(after[0]))
    return Remark(
        "q0-across-gap",
        f"the attitude of {q0} is interpolated across a gap of "
        f"{duration_text(after[0] - before[0])} ({duration_text(limit_ns)} is the limit of its "
        f"series), from {before[0]} to {after[0]} ns, in which it turns by at least {turn}; "
        f"{start} begins at an attitude",
    )


# Times at which attitudes are requested: the timestamps of a file or of a topic of the log.


NARROW = 2
"""Maximum number of columns of a text table that only lists times."""

_LEAST_EPOCH_NS = 10**18
"""Whole numbers from here on are ns since 1970, of 2001 or later; smaller ones have any unit."""


def stamps_in(source: str, recording: Recording) -> Int64:
    """Return the sorted timestamps of a file or of a topic, ``(N,)``, int64 ns."""
    if (t_ns := _narrow_table(source)) is not None:
        return np.sort(t_ns)
    otherwise = f"{Setting('at')} {plain(source)} is not "
    with recording.second_input(source, otherwise, "at") as opened:
        stamps = np.sort(np.concatenate([np.zeros(0, np.int64), *_stamps_of(opened)]))
        if opened.log is recording.log is not None:
            recording.other_remarks += _ahead(opened, recording.rate_signal())
        return stamps


def _ahead(opened: Recording, source: RateSignal) -> list[Remark]:
    """Return a remark on times of a topic that are later than their recording; those of rates not.

    `source`: the rates of the same log
    """
    tables = opened.tables.tables(opened.selection.topic)
    if len(tables) != 1 or not tables[0].is_typed or source.clock != "header":
        return []
    stamp = next(filter(None, (stamp_at(tables[0], place) for place in STAMPS)), None)
    if stamp is None:
        return []
    lead, of_rates = (
        _lead(rows)
        for rows in (first_batch(tables[0], [stamp]).read([stamp], ()), source.rows(at_first=True))
    )
    if lead <= max(AHEAD_NS, of_rates + AHEAD_NS):
        return []
    text = (
        f"the times of {quoted(tables[0].name)} for {Setting('at')} are {duration_text(lead)} "
        "later than those of their recording, and the times of the rates are not: another clock? "
        f"for the times of recording of both choose {Setting('clock', 'log')}"
    )
    return [Remark("at-other-clock", text)]


def _lead(rows: Iterable[RowBatch]) -> int:
    """Return by how much the first timestamps are later than their times of recording, ns."""
    stamps, log_ns = stamps_and_log_times(rows)
    return int(np.median(stamps - log_ns)) if log_ns.any() else 0


def _stamps_of(opened: Recording) -> Iterator[Int64]:
    """Yield the timestamps of attitudes, or else of rates, or else of whatever there is."""
    try:
        attitudes = opened.attitude_signal(AttitudeSelection(clock=opened.selection.clock))
        yield from [t_ns for t_ns, _ in attitudes.rows()]
    except (NoAttitudesError, NoSuchTopicError, UndeclaredError) as error:
        try:
            yield from [batch.t_ns for batch in opened.rate_signal().batches()]
        except (DamagedLogError, NoRatesError, NoSuchTopicError, UndeclaredError):
            tables = opened.tables.tables(opened.selection.topic)
            if isinstance(error, UndeclaredError) or len(tables) != 1:
                raise error from None
            try:
                yield from _of_table(tables[0], SignalSelection(clock=opened.selection.clock))
            except UndeclaredError as undeclared:
                if tables[0].is_typed or tables[0].columns[0].text.isdecimal():
                    raise error from None  # no names to state it in
                raise stated_in_header(undeclared) from None
            except (LogError, UsageError):
                # Without timestamps, the first error is more helpful.
                raise error from None


def _of_table(table: Table, selection: SignalSelection) -> Iterator[Int64]:
    """Yield the timestamps of a table, whatever its other columns."""
    found = Found(table, GENERIC, table.parts[0], ((),))
    stamp, table = choose_time(ColumnMatcher(found, selection, "at"), found)
    for rows in table.read(stamp, (), lambda rows: rows):
        yield rows.values[0]


def _narrow_table(path: str) -> Int64 | None:
    """Return the timestamps in a narrow text table; None if it is not one."""
    if Path(path).suffix.lower() not in {".csv", ".txt"} or not Path(path).is_file():
        return None
    with Path(path).open(encoding="utf-8-sig", errors="replace") as file:
        lines = ((number, line.strip()) for number, line in enumerate(file, 1))
        rows = [(number, line.split(",")) for number, line in lines if line]
    if not rows or len(rows[0][1]) > NARROW:
        return None
    names = [cell.strip() for cell in rows[0][1]]
    k, unit, name = 0, "", ""
    if has_header := not any(character.isdecimal() for character in names[0]):
        headers = [*map(parse_name, names)]
        times = [k for k, one in enumerate(headers) if _may_be_time(one)]
        if not times:
            return None
        k = min(times, key=lambda k: not _is_time(headers[k].key))  # the first if none is named so
        unit, name = headers[k].unit, f" {quoted(names[k])}"
    stamps = [
        _stamp(path, name, number, cells[k].strip() if cells[k:] else "", unit)
        for number, cells in rows[has_header:]
    ]
    return np.array(stamps, np.int64)


def _may_be_time(column: Column) -> bool:
    is_point = re.fullmatch(NO_DURATION, column.key) is not None
    return is_point and (is_time_unit(column.unit) or _is_time(column.key))


def _is_time(key: str) -> bool:
    return re.fullmatch("t|.*(time|stamp).*", key) is not None


def _stamp(path: str, name: str, number: int, cell: str, unit: str) -> int:
    """Return a timestamp, ns; without a unit, the cell is a date or whole ns since 1970."""
    try:
        if unit:
            return from_text(cell, unit)
        t_ns = absolute_ns(cell)
    except (ValueError, UsageError):
        t_ns = None
    if t_ns is None:
        raise LogError(
            path,
            f"line {number}: {quoted(cell)} is not a timestamp; write RFC 3339 or whole ns since "
            "1970, or name the column with its unit, as t_s",
        )
    if cell.isdecimal() and t_ns < _LEAST_EPOCH_NS:
        unknown = f"the unit of the time{name} (line {number}: {quoted(cell)})"
        raise stated_in_header(UndeclaredError(path, unknown, ""))
    return t_ns
