"""Plausibility of a recording: its header timestamps, and its own orientation next to the rates.

Nothing is changed here; each finding is one sentence with the way out.
"""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import LogError, QuatpropError
from quatprop.base.text import Remark, Setting, quoted
from quatprop.base.times import utc_text
from quatprop.propagation.conditioning.correction_inputs import own_orientation
from quatprop.propagation.orientation_check import (
    AGREEING_SAMPLES,
    COMPARED_SAMPLES,
    against_orientation,
    agree_only_mounted,
)
from quatprop.propagation.simulated_time import simulation_remarks
from quatprop.readers.attitude_quality import QuaternionCheck, QuaternionCounts

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Float64, Int64
    from quatprop.kinematics.series import AttitudeSeries
    from quatprop.readers.signal import RateSignal
    from quatprop.readers.tables.model import Log
    from quatprop.settings.reading import RateSelection


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
    return [
        *stamp_remarks(source),
        *simulation_remarks(log, source),
        *frame_remarks(source, rates),
        *orientation_remarks(log, source, selection, rates),
    ]


def stamp_remarks(source: RateSignal) -> list[Remark]:
    """Return remarks on header timestamps, compared with the times of recording."""
    if source.clock != "header":
        return []
    first = next(source.rows(at_first=True), None)
    if first is None:
        return []
    stamped, logged = first.values[0], first.log_ns
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
    try:
        rows, counts = _own_orientation(log, source, selection)
        batches = source.batches(at_first=True)
        remark = against_orientation(batches, rows, rates, source.unit)
    except QuatpropError:
        # Without an orientation, or with one that cannot be read, there is nothing to compare.
        return []
    remarks: list[Remark] = [] if remark is None else [remark]
    if counts.zero or counts.not_unit:
        text = f"the log's own orientation is not used: {counts.summary}"
        remarks.append(Remark("orientation-invalid", text))
    return remarks


def is_of_body(log: Log, source: RateSignal, selection: RateSelection, mount: Float64) -> bool:
    """Return whether rates agree with the log's own orientation only in the axes of the body.

    `mount`: sensor axes to body axes, shape ``(3, 3)``
    """
    with suppress(QuatpropError):
        rows, _ = _own_orientation(log, source, selection)
        return agree_only_mounted(source.batches(at_first=True), rows, mount)
    return False


def _own_orientation(
    log: Log, source: RateSignal, selection: RateSelection
) -> tuple[Iterator[AttitudeSeries], QuaternionCounts]:
    """Return the valid orientations beside the first rates, and the counts of both kinds."""
    own = own_orientation(log, source, selection)
    check = QuaternionCheck(log.path, drop=True)
    return check.apply(_beginning(own.first(), check.counts)), check.counts


def _beginning(
    batches: Iterable[tuple[Int64, Float64]], checked: QuaternionCounts
) -> Iterator[tuple[Int64, Float64]]:
    """Yield the rows that are compared, fewer if none of them is valid."""
    for batch in batches:
        yield batch
        if checked.read >= (COMPARED_SAMPLES if checked.used else AGREEING_SAMPLES):
            return
