"""Plausibility of a recording: its header timestamps, its frame, and its own orientation.

Nothing is changed here; each finding is one sentence with the way out.
"""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from quatprop.base.errors import (
    LogError,
    NoAttitudesError,
    QuatpropError,
    UndeclaredError,
    UsageError,
)
from quatprop.base.text import Remark, Setting, quoted
from quatprop.base.times import NS_PER_S, duration_text, utc_text
from quatprop.kinematics.conventions import HAMILTON, SCALAR_FIRST, SCALAR_LAST
from quatprop.kinematics.series import GyroSeries
from quatprop.propagation.clock_watch import ClockWatch
from quatprop.propagation.conditioning.accelerations import forces_of
from quatprop.propagation.conditioning.correction_inputs import own_orientation
from quatprop.propagation.orientation_check import (
    AGREEING_SAMPLES,
    COMPARED_SAMPLES,
    against_orientation,
    agree_only_mounted,
)
from quatprop.readers.attitude_quality import QuaternionCheck, QuaternionCounts
from quatprop.readers.clock_difference import stamps_and_log_times
from quatprop.readers.column_readings import vectors_of
from quatprop.readers.matching import first_batch, sets_of
from quatprop.readers.row_stamps import stamp_at
from quatprop.readers.vocabulary import NUMBERED_QUATERNION

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized

    from quatprop.base.arrays import Float64, Int64
    from quatprop.kinematics.series import AttitudeSeries
    from quatprop.readers.signal import RateSignal
    from quatprop.readers.tables.model import Group, Log, RowBatch, Table
    from quatprop.settings.reading import GyroCorrection, RateSelection


Batch = TypeVar("Batch", bound="Sized")

SIMULATED_CLOCK = "rosgraph_msgs/msg/Clock"
"""Type of the messages that tell the nodes of a simulation its time."""

LEAST_S = 1.0
"""Shortest time over which two clocks are compared, s."""

SPEED, DELAY_S = 0.02, 0.1
"""Clocks of equal speed agree within this share, and this time, s, by delays of messages."""

MOST_ROWS = 20_000
"""Rows of a clock that are compared."""

AHEAD_NS = NS_PER_S
"""Timestamps that are later than their recording by more are of another clock."""

OTHER_CLOCK_NS = 3_600_000_000_000
"""Timestamps further from the time of recording are of another clock, not delayed."""


def log_remarks(
    log: Log | None, source: RateSignal, selection: RateSelection, rates: str = "body"
) -> list[Remark]:
    """Return remarks on the stamps, and on the orientation next to the rates.

    `log`: None for rates in memory
    `selection`: how the rates were chosen, and their clock
    `rates`: ``"body"`` or ``"inertial"``: the frame in which they are resolved
    """
    if log is None:
        return []
    of_stamps = stamp_remarks(source)
    if is_simulated(log):
        # Simulated time begins at zero, and the times of recording are not those of the rates.
        of_stamps = [one for one in of_stamps if one.code != "other-clock"]
    return [
        *of_stamps,
        *_simulation_remarks(log, source),
        *frame_remarks(source, rates),
        *orientation_remarks(log, source, selection, rates),
        *gravity_remarks(source, rates),
    ]


def stamp_remarks(source: RateSignal) -> list[Remark]:
    """Return remarks on header timestamps, compared with the times of recording."""
    if source.clock != "header":
        return []
    stamped, logged = stamps_and_log_times(source.rows(at_first=True))
    if not len(stamped):
        return []
    zeros = int(np.count_nonzero(stamped == 0))
    remedy = f"for the time of recording choose {Setting('clock', 'log')}"
    if zeros:
        text = f"{zeros} of the first {len(stamped)} header timestamps are zero; {remedy}"
        return [Remark("zero-stamps", text)]
    if not logged.any() or abs(int(stamped[0]) - int(logged[0])) <= OTHER_CLOCK_NS:
        return []
    begin, recorded = utc_text(int(stamped[0])), utc_text(int(logged[0]))
    how = "another clock, or recorded again later" if stamped[0] < logged[0] else "another clock"
    text = f"header timestamps begin at {begin} and the recording at {recorded}: {how}; {remedy}"
    return [Remark("other-clock", text)]


def range_remarks(source: RateSignal, wanted: GyroCorrection) -> list[Remark]:
    """Return a remark on absolute times for a log whose stamps are later than their recording."""
    ends = {"start": wanted.start, "end": wanted.end}
    names = [name for name, one in ends.items() if one is not None and one.origin == "clock"]
    if not names or source.clock != "header":
        return []
    stamped, logged = stamps_and_log_times(source.rows(at_first=True))
    if not len(stamped) or not logged.all():
        return []
    lead_ns = int(np.sort(stamped - logged)[len(stamped) // 2])
    if not AHEAD_NS < lead_ns <= OTHER_CLOCK_NS:
        return []
    text = (
        f"the header timestamps are {duration_text(lead_ns)} later than the times of recording, so "
        "of another clock (that of GPS is 18 s ahead of UTC), and "
        f"{' and '.join(str(Setting(name)) for name in names)} "
        f"{'are times' if names[1:] else 'is a time'} of that clock: for times of recording choose "
        f"{Setting('clock', 'log')}"
    )
    return [Remark("range-of-other-clock", text)]


def clock_watch_of(
    log: Log | None, source: RateSignal, start_ns: int | None = None, end_ns: int | None = None
) -> ClockWatch | None:
    """Return what compares header timestamps with the times of recording, if these are as fast.

    Those of a simulation, and those that were remarked on at the beginning, are not compared.
    """
    is_said = any(one.code in {"unlike-log-times", "shared-stamps"} for one in source.remarks)
    are_messages = all(match.table.is_typed for match in source.matches) and source.matches
    if source.clock != "header" or not are_messages or is_said or is_simulated(log):
        return None
    return None if source.in_sequence else ClockWatch(source.name, start_ns, end_ns)


def is_simulated(log: Log | None) -> bool:
    """Return whether a log has the time of a simulation."""
    return log is not None and bool(_simulated_clocks(log))


def _simulated_clocks(log: Log) -> list[Table]:
    """Return the topics with the time of a simulation."""
    return [table for table in log.tables() if table.is_typed and table.type == SIMULATED_CLOCK]


def _simulation_remarks(log: Log, source: RateSignal) -> list[Remark]:
    """Return a remark if simulated time goes otherwise than the timestamps of the rates."""
    clocks = _simulated_clocks(log)
    if len(clocks) != 1 or source.clock not in {"header", "log"}:
        return []
    used = times = (np.empty(0, np.int64),) * 2
    with suppress(LogError, UsageError):
        times = _first_times(clocks[0])
        used = _paired(source.rows(at_first=True))
    first = max(each[1][0] if len(each[1]) else np.iinfo(np.int64).max for each in (used, times))
    last = min(each[1][-1] if len(each[1]) else 0 for each in (used, times))
    if last - first < LEAST_S * NS_PER_S:
        return []
    by_header, by_clock = (_lapse(each, first, last) for each in (used, times))
    speed = by_clock / by_header if by_header > 0 else 1.0
    if abs(speed - 1) <= SPEED + DELAY_S * NS_PER_S / by_header:
        return []
    used_are, way = "times of recording", f"use {Setting('clock', 'header')}"
    if source.clock == "header":
        used_are, way = "header timestamps", "record them with use_sim_time"
    return [
        Remark(
            "not-simulated-time",
            f"the time of the simulation, on topic {quoted(clocks[0].name)}, goes {speed:.3g} "
            f"times as fast as the {used_are} of topic {quoted(source.name)}, which are used: if "
            "the rates are those of the simulation, the attitudes are wrong, and only stamps in "
            f"its time give right ones: {way}",
        )
    ]


def _first_times(table: Table) -> tuple[Int64, Int64]:
    """Return the first times of a topic of clocks, and those of recording, ns."""
    stamp = stamp_at(table, "clock")
    return _paired(first_batch(table, [stamp]).read([stamp], ()) if stamp else ())


def _paired(batches: Iterable[RowBatch]) -> tuple[Int64, Int64]:
    """Return times, and those of recording, ns, in order of the latter."""
    times, log_ns = stamps_and_log_times(batches, MOST_ROWS)
    order = np.argsort(log_ns, kind="stable")
    return times[order], log_ns[order]


def _lapse(pairs: tuple[Int64, Int64], first: int, last: int) -> float:
    """Return how much time passed on a clock between two times of recording, ns."""
    times, log_ns = pairs
    ends = np.interp([0.0, float(last - first)], log_ns - first, times - times[0])
    return float(ends[1] - ends[0])


WORLD_FRAME = r"(.*/)?(world|map|odom|earth|ecef|ned|enu|nwu|local_origin)(_(ned|enu|nwu))?"
"""Names of frames that are no body's."""


def frame_remarks(source: RateSignal, rates: str) -> list[Remark]:
    """Return a remark on rates of messages whose header names a frame of the world."""
    if rates != "body":
        return []
    for match in source.matches:
        table = match.table
        fields = table.frame_fields(match.field)
        # With the frame of a body next to it, rates are about axes of that body.
        frames: list[str] = []
        with suppress(LogError):
            frames = table.texts(fields[0]) if len(fields) == 1 else []
        for frame in frames:
            if re.fullmatch(WORLD_FRAME, frame):
                text = (
                    f"the frame of the messages is {quoted(frame)}, and the rates are read as "
                    "those about axes of the body; if they are about axes of that frame, use "
                    f"{Setting('rates', 'inertial')}"
                )
                return [Remark("frame-in-header", text)]
    return []


def orientation_remarks(
    log: Log, source: RateSignal, selection: RateSelection, rates: str
) -> list[Remark]:
    """Return remarks on a comparison of the rates with the orientation in the log, if any."""

    def compared(*told: Any) -> tuple[Remark | None, QuaternionCounts]:
        rows, counts = _own_orientation(log, source, selection, *told)
        batches = source.batches(at_first=True)
        return against_orientation(batches, rows, rates, source.unit), counts

    try:
        remark, counts = compared()
    except (NoAttitudesError, UndeclaredError):
        columns = _numbered_quaternion(source)
        with suppress(QuatpropError):
            layouts = (SCALAR_FIRST.name, SCALAR_LAST.name) if columns else ()
            return _in_any_layout({layout: compared(columns, layout)[0] for layout in layouts})
        return []
    except QuatpropError:
        # Without an orientation, or with one that cannot be read, there is nothing to compare.
        return []
    remarks: list[Remark] = [] if remark is None else [remark]
    if counts.zero or counts.not_unit:
        text = f"the log's own orientation is not used: {counts.summary}"
        remarks.append(Remark("orientation-invalid", text))
    return remarks


def _numbered_quaternion(source: RateSignal) -> list[str]:
    """Return the columns of a table that may be a quaternion in an unknown layout; empty: none."""
    table = source.matches[0].table
    if table.is_typed or source.matches[1:]:
        return []
    sets = sets_of(table, table.parts[0], "0123", NUMBERED_QUATERNION)
    return [table.columns[k].text for k in sets[0]] if len(sets) == 1 else []


def _in_any_layout(found: Mapping[str, Remark | None]) -> list[Remark]:
    """Return the remark on rates that agree with an orientation in no layout as they are read.

    `found`: the remark on an orientation in each layout; None: it agrees, or cannot be compared
    """
    every = [one for one in found.values() if one is not None]
    if len(every) < len(found):
        return []
    if len({one.code for one in every}) == 1:
        return [one for one in every[:1] if one.code != "rates-contradict"]
    return [
        Remark(one.code, f"if its quaternions are {layout}, {one}")
        for layout, one in zip(found, every, strict=True)
        if one.code != "rates-contradict"
    ]


def gravity_remarks(source: RateSignal, rates: str) -> list[Remark]:
    """Return a remark if gravity, in the messages or rows of the rates, turns otherwise."""
    forces = [force for match in source.matches[:1] for force in forces_of(match)]
    if rates != "body" or not forces:
        return []
    from quatprop.propagation.gravity_check import against_gravity

    with suppress(QuatpropError):
        gyro = [*_first_samples(source.batches(at_first=True))]
        rows = [each.values for each in _first_samples(vectors_of(forces[0]).first())]
        if gyro and rows:
            t_ns, force = (np.concatenate(column) for column in zip(*rows, strict=True))
            remark = against_gravity(GyroSeries.joined(gyro), t_ns, force, source.unit)
            return [] if remark is None else [remark]
    return []


def columns_of_forces(source: RateSignal) -> Sequence[Group]:
    """Return the columns of the forces in the rows of the rates, of each match; empty: none."""
    found = [
        (force.sets[0], match)
        for match in source.matches
        for force in forces_of(match)[:1]
        if force.table.are_decoded_with(force.sets[0], match.sets[0])
    ]
    is_whole = len(found) == len(source.matches) and all(one.row.burst is None for _, one in found)
    return [columns for columns, _ in found] if is_whole else ()


def _first_samples(batches: Iterable[Batch]) -> Iterator[Batch]:
    """Yield batches until they have enough samples."""
    count = 0
    for batch in batches:
        yield batch
        count += len(batch)
        if count >= COMPARED_SAMPLES:
            return


def columns_of_orientation(
    log: Log | None, source: RateSignal, selection: RateSelection
) -> Sequence[Group]:
    """Return the columns of the orientation beside the rates, wxyz, of each match.

    Empty if there is none, or if it is not known to be one that can be compared at any place.
    """
    if log is None or source.increments or any(one.row.burst for one in source.matches):
        return ()
    with suppress(QuatpropError):
        own = own_orientation(log, source, selection)
        pairs = [*zip(own.matches, source.matches, strict=False)]
        is_plain = own.representation == "quaternion" and own.meaning == HAMILTON
        are_beside = [
            theirs.table is ours.table
            and theirs.stamp == ours.stamp
            and ours.table.are_decoded_with(theirs.sets[0], ours.sets[0])
            for theirs, ours in pairs
        ]
        is_whole = len(pairs) == len(source.matches) and all(are_beside)
        if is_plain and not own.placeholder and is_whole:
            return [theirs.sets[0] for theirs, _ in pairs]
    return ()


def is_of_body(log: Log, source: RateSignal, selection: RateSelection, mount: Float64) -> bool:
    """Return whether rates agree with the log's own orientation only in the axes of the body.

    `mount`: sensor axes to body axes, shape ``(3, 3)``
    """
    with suppress(QuatpropError):
        rows, _ = _own_orientation(log, source, selection)
        return agree_only_mounted(source.batches(at_first=True), rows, mount)
    return False


def _own_orientation(
    log: Log, source: RateSignal, selection: RateSelection, *told: Any
) -> tuple[Iterator[AttitudeSeries], QuaternionCounts]:
    """Return the valid orientations beside the first rates, and the counts of both kinds."""
    own = own_orientation(log, source, selection, *told)
    check = QuaternionCheck(log.path, drop=True)
    return check.apply(_beginning(own.first(), check.counts)), check.counts


def _beginning(
    batches: Iterable[tuple[Int64, Float64]], checked: QuaternionCounts
) -> Iterator[tuple[Int64, Float64]]:
    """Yield the rows that are compared, fewer if none of them is valid."""
    for batch in batches:
        yield batch
        if checked.samples_read >= (COMPARED_SAMPLES if checked.samples_used else AGREEING_SAMPLES):
            return
