"""Plausibility of rates: implausible data are reported, never corrected.

Rates in the wrong unit, frozen, or clipped by the sensor's range give a series of wrong attitudes
that looks right. No sample is changed here; each finding is one sentence with the way out.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from quatprop.base.errors import QuatpropError
from quatprop.base.text import Remark, Setting
from quatprop.base.times import utc_text
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.propagation.rate_checks import other_unit
from quatprop.readers.attitude_quality import QuaternionCheck, QuaternionCounts
from quatprop.readers.attitude_signals import choose_attitudes
from quatprop.settings.reading import AttitudeSelection

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Float64, Int64
    from quatprop.readers.signal import RateSignal
    from quatprop.readers.tables.model import Log


Series = TypeVar("Series", GyroSeries, AttitudeSeries)

COMPARED_SAMPLES = 20_000
"""Samples from the beginning of the log that are compared with its own orientation."""

AGREEING_SAMPLES = 2_000
"""Enough samples if both move and agree, or if no orientation is valid."""

COMPARED_SPAN_NS = 1_000_000_000
"""Rotations are compared over this time: long enough for noise, short enough for drift."""

MOVING = math.radians(1.0)
"""rad: an orientation that rotates less than this in that time is not compared."""

OFF_SCALE = 20.0
"""A larger ratio of rates and orientation is due to the unit (180/pi = 57.3), not to drift."""

FARTHEST = 57.3**2 / OFF_SCALE
"""As far above 180/pi as :data:`OFF_SCALE` is below it; a larger ratio is not due to the unit."""

OTHER_CLOCK_NS = 3_600_000_000_000
"""Timestamps further from the time of recording are of another clock, not delayed."""


def log_remarks(log: Log | None, source: RateSignal, rates: str = "body") -> list[Remark]:
    """Return remarks on the stamps, and on the orientation beside the rates.

    `log`: None for rates in memory
    `rates`: ``"body"`` or ``"inertial"``: the frame in which they are resolved
    """
    if log is None:
        return []
    return [
        *stamp_remarks(source),
        *orientation_remarks(log, source, rates),
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
    way_out = f"for the time of recording choose {Setting('clock', 'log')}"
    if zeros:
        text = f"{zeros} of the first {len(stamped)} header timestamps are zero; {way_out}"
        return [Remark("zero-stamps", text)]
    if not logged.any() or abs(int(stamped[0]) - int(logged[0])) <= OTHER_CLOCK_NS:
        return []
    begin, recorded = utc_text(int(stamped[0])), utc_text(int(logged[0]))
    how = "another clock, or recorded again later" if stamped[0] < logged[0] else "another clock"
    text = f"header timestamps begin at {begin} and the recording at {recorded}: {how}; {way_out}"
    return [Remark("other-clock", text)]


def orientation_remarks(log: Log, source: RateSignal, rates: str) -> list[Remark]:
    """Return remarks on a comparison of the rates with the orientation in the log, if any."""
    topic = next((match.table.name for match in source.matches), None) or None
    try:
        own = choose_attitudes(log, AttitudeSelection(topic=topic))
        check = QuaternionCheck(log.path, drop=True)
        rows = check.apply(_beginning(own.first(), check.counts))
        batches = source.batches(at_first=True)
        remark = against_orientation(batches, rows, rates, source.unit)
    except QuatpropError:
        # Without an orientation, or with one that cannot be read, there is nothing to compare.
        return []
    remarks: list[Remark] = [] if remark is None else [remark]
    counts = check.counts
    if counts.zero or counts.not_unit:
        text = f"the log's own orientation is not used: {counts.summary}"
        remarks.append(Remark("orientation-invalid", text))
    return remarks


def against_orientation(
    batches: Iterable[GyroSeries],
    orientations: Iterable[AttitudeSeries],
    rates: str = "body",
    unit: str = "rad/s",
) -> Remark | None:
    """Return a remark if the rates rotate much less or more than the log's own orientation.

    `batches`: rates from the beginning of the log, rad/s
    `rates`: ``"body"`` or ``"inertial"``: the frame in which the rates are resolved
    `unit`: their unit in the log
    """
    gyro: list[GyroSeries] = []
    own: list[AttitudeSeries] = []
    batches, orientations = iter(batches), iter(orientations)
    for samples in (AGREEING_SAMPLES, COMPARED_SAMPLES):
        _extend(own, orientations, samples)
        if own:
            _extend(gyro, batches, samples)
        if not gyro:
            return None
        moved = _rotations(GyroSeries.joined(gyro), AttitudeSeries.joined(own), rates)
        by_rates, by_orientation = moved
        if min(moved) > MOVING and max(moved) < OFF_SCALE * min(moved):
            return None
    # Rates that are all zero have their own remark. An orientation that never changes was not
    # estimated: many drivers leave it at identity.
    if by_rates and by_orientation > MOVING and by_orientation > OFF_SCALE * by_rates:
        times, what = by_orientation / by_rates, "the log's own orientation rotates {} its rates"
    elif by_orientation > MOVING / OFF_SCALE and by_rates > OFF_SCALE * by_orientation:
        times, what = by_rates / by_orientation, "the rates rotate {} the log's own orientation"
    else:
        return None
    why = "are both of the same sensor?"
    if times < FARTHEST:
        why = other_unit(unit, are_too_large=by_rates > by_orientation)
    return Remark("rates-off-scale", f"{what.format(f'{times:.3g} times as far as')}: {why}")


def _rotations(gyro: GyroSeries, own: AttitudeSeries, rates: str) -> tuple[float, float]:
    """Return RMS rotations of rates and orientations in the time compared, rad; 0 if unknown."""
    stamps, places, own_places = np.intersect1d(gyro.t_ns, own.t_ns, return_indices=True)
    if not np.isfinite(gyro.rate).all() or (np.diff(gyro.t_ns) < 0).any():
        return 0.0, 0.0
    after = np.searchsorted(stamps, stamps + COMPARED_SPAN_NS)
    begins = np.flatnonzero(after < len(stamps))
    ends = after[begins]
    turns = attitudes(gyro.t_ns, gyro.rate, rates=rates)[places], own.wxyz[own_places]
    by_rates, by_orientation = (_rms(geodesic_angle(q[begins], q[ends])) for q in turns)
    return by_rates, by_orientation


def _extend(read: list[Series], batches: Iterator[Series], samples: int) -> None:
    """Read batches until they have a number of samples."""
    while sum(map(len, read)) < samples and (batch := next(batches, None)) is not None:
        read.append(batch)


def _beginning(
    batches: Iterable[tuple[Int64, Float64]], checked: QuaternionCounts
) -> Iterator[tuple[Int64, Float64]]:
    """Yield the rows that are compared, fewer if none of them is valid."""
    for batch in batches:
        yield batch
        if checked.read >= (COMPARED_SAMPLES if checked.used else AGREEING_SAMPLES):
            return


def _rms(angles: Float64) -> float:
    return float(np.sqrt(np.mean(angles**2))) if len(angles) else 0.0
