"""Plausibility of rates: what looks wrong is reported, never corrected.

Rates in the wrong unit, frozen, or clipped by the sensor's range give a series of wrong attitudes
that looks right. Nothing here changes a sample; each finding is one sentence with the way out.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import QuatpropError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.selection import AttitudeSelection
from quatprop.signals.attitudes import choose_attitudes
from quatprop.signals.quaternion_check import QuaternionCheck
from quatprop.tables.base import is_table
from quatprop.text import Setting, Text
from quatprop.times import NS_PER_S, utc_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from quatprop.containers.base import MessageLog
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.signals.signal import RateSignal
    from quatprop.tables.base import TableLog

    Float64 = NDArray[np.float64]
    Int64 = NDArray[np.int64]

WIDEST_RANGE = math.radians(4000.0)
"""rad/s: no common gyroscope measures more."""

SMALLEST_RANGE = math.radians(125.0)
"""rad/s: the narrowest range of common gyroscopes; smaller extremes are not saturation."""

SATURATED_RUN = 3
"""This many neighbouring samples at exactly the same extreme are no coincidence."""

FROZEN_SAMPLES = 100
"""This many equal rates come from no working sensor: it would have noise."""

STEP_LIMIT = math.radians(30.0)
"""rad: a larger rotation between two samples is too large for any integration rule."""

COMPARED_SAMPLES = 20_000
"""Rates are compared with the log's own orientation over so many samples from its beginning."""

COMPARED_SPAN_NS = 1_000_000_000
"""Rotations are compared over this time: long enough for noise, short enough for drift."""

MOVING = math.radians(1.0)
"""rad: an orientation that rotates less than this in that time shows nothing."""

OFF_SCALE = 20.0
"""A factor beyond this between rates and orientation is a unit (180/pi = 57.3), not a drift."""

OTHER_CLOCK_NS = 3_600_000_000_000
"""Stamps further from the time of recording are of another clock, not delayed."""

_COLUMN = 16_384
"""Samples checked together."""

_NONE = np.empty(0, dtype=np.int64)


class RateChecks:
    """Checks rates as they pass.

    The findings do not depend on where batches end.
    """

    def __init__(self) -> None:
        self._highest = np.full(3, -np.inf)
        self._lowest = np.full(3, np.inf)
        self._saturated = np.zeros((2, 3), dtype=np.bool_)
        self._samples = 0
        self._columns = np.empty((3, _COLUMN))
        self._filled = 0

    def observe(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the batches unchanged, and check them."""
        for batch in batches:
            self._add(batch.rate)
            yield batch

    def _add(self, rate: Float64) -> None:
        """Gather rates in contiguous columns, and check them when the columns are full."""
        self._samples += len(rate)
        start = 0
        while start < len(rate):
            stop = min(len(rate), start + _COLUMN - self._filled)
            filled = self._filled + stop - start
            self._columns[:, self._filled : filled] = rate[start:stop].T
            self._filled, start = filled, stop
            if filled == _COLUMN:
                self._check()

    def _check(self) -> None:
        columns = self._columns[:, : self._filled]
        for side, extreme in enumerate((np.fmax, np.fmin)):
            reached = extreme.reduce(columns, axis=1)
            limit = (self._highest, self._lowest)[side]
            beyond = extreme(reached, limit) != limit
            self._saturated[side, beyond] = False
            limit[beyond] = reached[beyond]
            for axis in np.flatnonzero((reached == limit) & (np.abs(limit) >= SMALLEST_RANGE)):
                self._saturated[side, axis] |= _has_run(columns[axis] == limit[axis])
        # A run may continue in the samples that come next.
        last = columns[:, 1 - SATURATED_RUN :].copy()
        self._filled = last.shape[1]
        self._columns[:, : self._filled] = last

    def remarks(self, median_dt_ns: int | None) -> list[Text]:
        """Return a sentence for each finding.

        Parameters
        ----------
        median_dt_ns
            The usual interval between samples, ns.
        """
        if self._filled:
            self._check()
        largest = float(np.max([self._highest, -self._lowest]))
        if not math.isfinite(largest):
            return []
        if largest == 0.0 and not self._lowest.any():
            return [Text("every rate is zero: is this the right topic?")]
        remarks = []
        if largest > WIDEST_RANGE:
            remarks.append(
                Text(
                    f"rates up to {largest:.4g} rad/s are beyond any gyroscope; if they are in "
                    "deg/s, use ",
                    Setting("rate_unit", "deg/s"),
                )
            )
        elif median_dt_ns is not None and largest * median_dt_ns > STEP_LIMIT * NS_PER_S:
            step = math.degrees(largest * median_dt_ns / NS_PER_S)
            remarks.append(
                Text(
                    f"the body rotates by up to {step:.3g} deg between two samples: the sample "
                    "rate is too low for this motion"
                )
            )
        if (self._highest == self._lowest).all():
            if self._samples >= FROZEN_SAMPLES:
                rate = self._highest.tolist()
                remarks.append(Text(f"every rate is the same, {rate} rad/s: frozen, or simulated?"))
            return remarks
        return [*remarks, *self._saturation()]

    def _saturation(self) -> Iterator[Text]:
        moving = self._highest != self._lowest
        for sign, limit, saturated in zip(
            "+-", (self._highest, self._lowest), self._saturated, strict=True
        ):
            for axis in np.flatnonzero(moving & saturated):
                yield Text(
                    f"axis {sign}{'xyz'[axis]} stays at its extreme of {limit[axis]:.6g} rad/s "
                    f"for {SATURATED_RUN} samples or more: saturated, so larger rates are missing"
                )


def _has_run(hit: NDArray[np.bool_]) -> bool:
    """Tell whether :data:`SATURATED_RUN` neighbouring samples are hits."""
    run = hit
    for shift in range(1, SATURATED_RUN):
        run = run[:-1] & hit[shift:]
    return bool(run.any())


def log_remarks(log: MessageLog | TableLog, source: RateSignal) -> list[Text]:
    """Return remarks on the stamps and the orientation beside the rates.

    Parameters
    ----------
    log
        An open log that can be read again; only its beginning is read.
    source
        The rates.
    """
    return [*stamp_remarks(source), *orientation_remarks(log, source)]


def stamp_remarks(source: RateSignal) -> list[Text]:
    """Return remarks on header stamps, compared with the times of recording."""
    if source.clock != "header":
        return []
    stamped, logged = next(source.stamps(), (_NONE, _NONE))
    zeros = int(np.count_nonzero(stamped == 0))
    way_out = Text("; for the time of recording choose ", Setting("clock", "log"))
    if zeros:
        return [Text(f"{zeros} of the first {len(stamped)} header stamps are zero", way_out)]
    if not logged.any() or abs(int(stamped[0]) - int(logged[0])) <= OTHER_CLOCK_NS:
        return []
    begin, recorded = utc_text(int(stamped[0])), utc_text(int(logged[0]))
    return [
        Text(
            f"header stamps begin at {begin} and the recording at {recorded}: another clock",
            way_out,
        )
    ]


def orientation_remarks(log: MessageLog | TableLog, source: RateSignal) -> list[Text]:
    """Return remarks on the rates, compared with the orientation beside them, if there is one."""
    topic = None if is_table(log) else source.name
    try:
        own = choose_attitudes(log, AttitudeSelection(topic=topic))
        check = QuaternionCheck(log.path, drop=True)
        remark = against_orientation(source.batches(), check.apply(_beginning(own.rows())))
    except QuatpropError:
        # Without an orientation, or with one that cannot be read, there is nothing to compare.
        return []
    remarks = [] if remark is None else [remark]
    counts = check.counts
    if counts.zero or counts.not_unit:
        remarks.append(
            Text(
                f"the log's own orientation is invalid in {counts.zero + counts.not_unit} of the "
                f"first {counts.read} samples ({counts.zero} are zero, {counts.not_unit} off unit "
                f"length by up to {counts.worst:.3g}); it is not used"
            )
        )
    return remarks


def against_orientation(
    rates: Iterable[GyroSeries], orientations: Iterable[AttitudeSeries]
) -> Text | None:
    """Return a remark if the rates rotate much less or more than the log's own orientation.

    Parameters
    ----------
    rates
        Body rates from the beginning of the log, rad/s.
    orientations
        The orientation that the same messages carry, body -> reference.

    Returns
    -------
    Text or None
        None where they agree, where nothing moves, or where there is too little to compare.
    """
    gyro_ns, rate = _joined((batch.t_ns, batch.rate) for batch in rates)
    own_ns, own = _joined((batch.t_ns, batch.wxyz) for batch in orientations)
    stamps, places, own_places = np.intersect1d(gyro_ns, own_ns, return_indices=True)
    if len(stamps) < 2 or not np.isfinite(rate).all() or (np.diff(gyro_ns) < 0).any():  # noqa: PLR2004  # two ends
        return None
    after = np.searchsorted(stamps, stamps + COMPARED_SPAN_NS)
    begins = np.flatnonzero(after < len(stamps))
    ends = after[begins]
    propagated, own = attitudes(gyro_ns, rate)[places], own[own_places]
    by_rates = _rms(geodesic_angle(propagated[begins], propagated[ends]))
    by_orientation = _rms(geodesic_angle(own[begins], own[ends]))
    if by_orientation > MOVING and by_orientation > OFF_SCALE * by_rates:
        return Text(
            f"the log's own orientation rotates {by_orientation / max(by_rates, 1e-9):.3g} times "
            "as far as its rates: were they scaled by pi/180 once too often?"
        )
    # An orientation that stands still was never estimated: many drivers leave it at identity.
    if by_orientation > MOVING / OFF_SCALE and by_rates > OFF_SCALE * by_orientation:
        return Text(
            f"the rates rotate {by_rates / max(by_orientation, 1e-9):.3g} times as far as the "
            "log's own orientation: if they are in deg/s, use ",
            Setting("rate_unit", "deg/s"),
        )
    return None


def _beginning(batches: Iterable[tuple[Int64, Float64]]) -> Iterator[tuple[Int64, Float64]]:
    """Yield batches until they hold :data:`COMPARED_SAMPLES` rows."""
    rows = 0
    for t_ns, values in batches:
        yield t_ns, values
        rows += len(t_ns)
        if rows >= COMPARED_SAMPLES:
            return


def _joined(batches: Iterable[tuple[Int64, Float64]]) -> tuple[Int64, Float64]:
    """Return the stamps and rows at the beginning of a stream."""
    parts = list(_beginning(batches))
    if not parts:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    return np.concatenate([t_ns for t_ns, _ in parts]), np.concatenate([rows for _, rows in parts])


def _rms(angles: Float64) -> float:
    return float(np.sqrt(np.mean(angles**2))) if len(angles) else 0.0
