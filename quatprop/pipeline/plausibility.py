"""What looks wrong with rates, said and never mended.

Rates that are in the wrong unit, frozen, or cut off by the sensor's range give a perfectly good
series of the wrong attitudes. Nothing here changes a sample; each finding is one sentence with
the way out.
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
from quatprop.times import utc_text

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
"""rad/s: gyroscopes that are sold do not measure more."""

SMALLEST_RANGE = math.radians(125.0)
"""rad/s: the narrowest range of common gyroscopes; smaller extremes are no saturation."""

SATURATED_RUN = 3
"""So many neighbouring samples at the very same extreme are no coincidence."""

FROZEN_SAMPLES = 100
"""So many equal rates come from no sensor that works: it would have noise."""

STEP_LIMIT = math.radians(30.0)
"""rad: a body that turns further between two samples is sampled too slowly for any method."""

COMPARED_SAMPLES = 20_000
"""Rates are held against the log's own orientation over so many samples from its beginning."""

COMPARED_SPAN_NS = 1_000_000_000
"""Rotations are compared over this time: long enough for noise, short enough for drift."""

MOVING = math.radians(1.0)
"""rad: an orientation that turns less than this in that time does not tell."""

OFF_SCALE = 20.0
"""A factor beyond this between rates and orientation is a unit (180/pi = 57.3), not a drift."""


OTHER_CLOCK_NS = 3_600_000_000_000
"""Stamps further from the time of recording are of another clock, not late."""

_NONE = np.empty(0, dtype=np.int64)


class RateChecks:
    """Looks at rates as they pass.

    The findings do not depend on where batches end.
    """

    def __init__(self) -> None:
        self._highest = np.full(3, -np.inf)
        self._lowest = np.full(3, np.inf)
        self._runs = np.zeros((2, 3), dtype=np.int64)
        self._samples = 0
        self._before: Float64 = np.empty((0, 3))

    def passing(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the batches as they are, having looked at them."""
        for batch in batches:
            self._look(batch.rate)
            yield batch

    def _look(self, rate: Float64) -> None:
        self._samples += len(rate)
        # Runs may go on from the batch before.
        rows = np.concatenate([self._before, rate])
        self._before = rows[1 - SATURATED_RUN :]
        for side, extreme in enumerate((np.fmax, np.fmin)):
            reached = extreme.reduce(rows, axis=0)
            known = (self._highest, self._lowest)[side]
            beyond = extreme(reached, known) != known
            self._runs[side][beyond] = 0
            known[beyond] = reached[beyond]
            for axis in np.flatnonzero(reached == known):
                self._runs[side, axis] += _runs(rows[:, axis] == known[axis])

    def remarks(self, median_dt_ns: int | None) -> list[str]:
        """Return one sentence for each finding.

        Parameters
        ----------
        median_dt_ns
            The usual interval between samples, ns.
        """
        largest = float(np.max([self._highest, -self._lowest]))
        if not math.isfinite(largest):
            return []
        if largest == 0.0 and not self._lowest.any():
            return ["every rate is zero: is this the right topic?"]
        said = []
        if largest > WIDEST_RANGE:
            said.append(
                f"rates up to {largest:.4g} rad/s are beyond any gyroscope; if they are in deg/s, "
                "say --rate-unit deg/s"
            )
        elif median_dt_ns is not None and largest * median_dt_ns * 1e-9 > STEP_LIMIT:
            said.append(
                f"the body turns up to {math.degrees(largest * median_dt_ns * 1e-9):.3g} deg "
                "between two samples: sampled too slowly for this motion"
            )
        if (self._highest == self._lowest).all():
            if self._samples >= FROZEN_SAMPLES:
                rate = self._highest.tolist()
                said.append(f"every rate is the same, {rate} rad/s: frozen, or simulated?")
            return said
        said += list(self._saturation())
        return said

    def _saturation(self) -> Iterator[str]:
        moving = self._highest != self._lowest
        for sign, values, runs in zip("+-", (self._highest, self._lowest), self._runs, strict=True):
            for axis in np.flatnonzero(moving & (runs > 0) & (np.abs(values) >= SMALLEST_RANGE)):
                yield (
                    f"axis {sign}{'xyz'[axis]} stays at its extreme of {values[axis]:.6g} rad/s "
                    f"over {SATURATED_RUN} samples and more: saturated, so what was beyond is lost"
                )


def _runs(hit: NDArray[np.bool_]) -> int:
    """Return how many samples end a run of at least :data:`SATURATED_RUN` hits."""
    if len(hit) < SATURATED_RUN:
        return 0
    window = np.lib.stride_tricks.sliding_window_view(hit, SATURATED_RUN)
    return int(window.all(axis=1).sum())


def log_remarks(log: MessageLog | TableLog, source: RateSignal) -> list[str]:
    """Return what stamps and orientation beside the rates tell; see the two functions below."""
    return [*stamp_remarks(source), *orientation_remarks(log, source)]


def stamp_remarks(source: RateSignal) -> list[str]:
    """Return what is remarkable about header stamps beside the times of recording.

    Only the beginning of the log is read.
    """
    if source.clock != "header":
        return []
    stamped, logged = next(source.stamps(), (_NONE, _NONE))
    zeros = int(np.count_nonzero(stamped == 0))
    way_out = "; for the time of recording choose --clock log"
    if zeros:
        return [f"{zeros} of the first {len(stamped)} header stamps are zero{way_out}"]
    if not logged.any():
        return []
    if abs(int(stamped[0]) - int(logged[0])) <= OTHER_CLOCK_NS:
        return []
    begin, recorded = utc_text(int(stamped[0])), utc_text(int(logged[0]))
    said = f"header stamps begin at {begin} and the recording at {recorded}: another clock"
    return [said + way_out]


def orientation_remarks(log: MessageLog | TableLog, source: RateSignal) -> list[str]:
    """Return what the orientation beside the rates tells, if the log has one.

    Only the beginning of the log is read.

    Parameters
    ----------
    log
        An open log that can be read again.
    source
        The rates.
    """
    topic = None if is_table(log) else source.name
    try:
        own = choose_attitudes(log, AttitudeSelection(topic=topic))
        check = QuaternionCheck(log.path, drop=True)
        remark = against_orientation(source.batches(), check.apply(own.rows()))
    except QuatpropError:
        # Without an orientation, or with one that cannot be read, there is nothing to compare.
        return []
    said = [] if remark is None else [remark]
    counts = check.counts
    if counts.zero or counts.not_unit:
        said.append(
            f"the log's own orientation is no rotation in {counts.zero + counts.not_unit} of "
            f"{counts.read} samples looked at ({counts.zero} are zero, {counts.not_unit} off unit "
            f"length by up to {counts.worst:.3g}); it is not used"
        )
    return said


def against_orientation(
    rates: Iterable[GyroSeries], orientations: Iterable[AttitudeSeries]
) -> str | None:
    """Return a sentence if the rates turn much less or more than the log's own orientation.

    Parameters
    ----------
    rates
        Body rates from the beginning of the log, rad/s.
    orientations
        The orientation that the same messages carry, body -> reference.

    Returns
    -------
    str or None
        None where they agree, where nothing moves, or where there is too little to tell.
    """
    gyro_ns, rate = _beginning((batch.t_ns, batch.rate) for batch in rates)
    own_ns, own = _beginning((batch.t_ns, batch.wxyz) for batch in orientations)
    stamps, places, own_places = np.intersect1d(gyro_ns, own_ns, return_indices=True)
    if len(stamps) < 2 or not np.isfinite(rate).all() or (np.diff(gyro_ns) < 0).any():  # noqa: PLR2004  # two ends
        return None
    after = np.searchsorted(stamps, stamps + COMPARED_SPAN_NS)
    begins = np.flatnonzero(after < len(stamps))
    ends = after[begins]
    propagated = attitudes(gyro_ns, rate)[places]
    turned = geodesic_angle(propagated[begins], propagated[ends])
    own_turned = geodesic_angle(own[own_places][begins], own[own_places][ends])
    by_rates, by_orientation = _rms(turned), _rms(own_turned)
    if by_orientation > MOVING and by_orientation > OFF_SCALE * by_rates:
        return (
            f"the log's own orientation turns {by_orientation / max(by_rates, 1e-9):.3g} times as "
            "far as its rates: were they scaled by pi/180 once too often?"
        )
    # An orientation that stands still was never estimated: many drivers leave it at identity.
    if by_orientation > MOVING / OFF_SCALE and by_rates > OFF_SCALE * by_orientation:
        return (
            f"the rates turn {by_rates / max(by_orientation, 1e-9):.3g} times as far as the log's "
            "own orientation: if they are in deg/s, say --rate-unit deg/s"
        )
    return None


def _beginning(batches: Iterable[tuple[Int64, Float64]]) -> tuple[Int64, Float64]:
    stamps: list[Int64] = []
    values: list[Float64] = []
    for t_ns, rows in batches:
        stamps.append(t_ns)
        values.append(rows)
        if sum(map(len, stamps)) >= COMPARED_SAMPLES:
            break
    if not stamps:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    return np.concatenate(stamps), np.concatenate(values)


def _rms(angles: Float64) -> float:
    return float(np.sqrt(np.mean(angles**2))) if len(angles) else 0.0
