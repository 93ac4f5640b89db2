"""Plausibility of rates: implausible data are reported, never corrected.

Rates in the wrong unit, frozen, or clipped by the sensor's range give a series of wrong attitudes
that looks right. No sample is changed here; each finding is one sentence with the way out.
"""

from __future__ import annotations

import math
from itertools import permutations, product
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from quatprop.base.errors import QuatpropError
from quatprop.base.text import Remark, Setting
from quatprop.base.times import utc_text
from quatprop.kinematics.conventions import mounting
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, geodesic_angle, log, multiply, shorter
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

GAP = 10
"""An interval longer than so many median ones is a gap: what happens in it is not compared."""

WHOLE_TURN = 2.5
"""rad: rotations of more are not compared by their axes, which turn over at half a turn."""

QUICK_SPAN_NS = 200_000_000
"""Rotations of a body that turns further than that are compared by their axes over this time."""

FEWEST = 50
"""Fewest rotations whose axes are compared."""

SAME_AXES = 0.8
"""Agreement, 1 for equal rotation vectors, above which the axes of rates are not in question."""

OTHER_AXES = 0.95
"""Agreement about other axes that shows that they are meant."""

DISTINCT_AXES = 0.1
"""Smallest lead, in agreement, over all other axes."""

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
    """Return a remark if the rates rotate otherwise than the log's own orientation.

    That is much less or more, or about other axes.

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
        turns = _turns(GyroSeries.joined(gyro), AttitudeSeries.joined(own), rates)
        moved = by_rates, by_orientation = _rms(turns[0]), _rms(turns[1])
        if min(moved) > MOVING and max(moved) < OFF_SCALE * min(moved):
            if rates != "body" or _agreement(*turns) > SAME_AXES:
                return None
            if remark := _other_axes(GyroSeries.joined(gyro), AttitudeSeries.joined(own)):
                return remark
    # Rates that are all zero have their own remark. An orientation that never changes was not
    # estimated: many drivers leave it at identity.
    if max(moved) < OFF_SCALE * min(moved):
        return None
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


def _turns(
    gyro: GyroSeries, own: AttitudeSeries, rates: str = "body", span_ns: int = COMPARED_SPAN_NS
) -> tuple[Float64, Float64]:
    """Return the rotations of rates and orientations in the time compared, shape ``(N, 3)``, rad.

    They are rotation vectors in body axes; none if they are unknown, or across a gap.
    """
    stamps, places, own_places = np.intersect1d(gyro.t_ns, own.t_ns, return_indices=True)
    if len(stamps) < 2 or not np.isfinite(gyro.rate).all() or (np.diff(gyro.t_ns) < 0).any():  # noqa: PLR2004
        return np.empty((0, 3)), np.empty((0, 3))
    intervals = np.diff(stamps)
    gaps = np.cumsum(np.append(0, intervals > GAP * np.median(intervals)))
    after = np.searchsorted(stamps, stamps + span_ns)
    begins = np.flatnonzero(after < len(stamps))
    begins = begins[gaps[begins] == gaps[after[begins]]]
    ends = after[begins]
    both = attitudes(gyro.t_ns, gyro.rate, rates=rates)[places], own.wxyz[own_places]
    by_rates, by_orientation = (log(shorter(multiply(conjugate(q[begins]), q[ends]))) for q in both)
    return by_rates, by_orientation


def _agreement(by_rates: Float64, by_orientation: Float64) -> float:
    """Return how well rotations agree: 1 if they are equal."""
    total = float((by_rates**2).sum() + (by_orientation**2).sum())
    return 2 * float((by_rates * by_orientation).sum()) / total if total else 1.0


def _other_axes(gyro: GyroSeries, own: AttitudeSeries) -> Remark | None:
    """Return a remark if only one choice of axes makes rates agree with orientations.

    Left-handed axes are not considered: an orientation from reference to body looks the same.
    """
    for span_ns in (COMPARED_SPAN_NS, QUICK_SPAN_NS):
        by_rates, by_orientation = _turns(gyro, own, span_ns=span_ns)
        angles = [np.linalg.norm(turns, axis=1) for turns in (by_rates, by_orientation)]
        known = np.maximum(*angles) < WHOLE_TURN
        if 2 * np.count_nonzero(known) > len(known):
            break
    if np.count_nonzero(known) < FEWEST:
        return None
    by_rates, by_orientation = by_rates[known], by_orientation[known]
    found = sorted(
        (_agreement(by_rates @ mounting(axes).T, by_orientation), axes)
        for axes in _right_handed_axes()
    )
    (second, _), (best, axes) = found[-2:]
    # Without rotations about all axes, left-handed ones are as likely.
    shares = np.linalg.eigvalsh(by_orientation.T @ by_orientation)
    weakest = float(shares[0] / max(shares.sum(), MOVING))
    is_shown = best > max(OTHER_AXES, 1 - weakest / 2) and best - second > DISTINCT_AXES
    if axes == "x,y,z" or not is_shown:
        return None
    _, places, own_places = np.intersect1d(gyro.t_ns, own.t_ns, return_indices=True)
    turned = attitudes(gyro.t_ns, gyro.rate)[places]
    meant = own.wxyz[own_places]
    since = (multiply(conjugate(q[0]), q) for q in (turned, meant))
    return Remark(
        "other-axes",
        f"the rates contradict the log's own orientation, by up to "
        f"{math.degrees(float(geodesic_angle(*since).max())):.3g} deg: they agree once the rates "
        f"are turned into its axes, with {Setting('mount', axes)}",
    )


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


def _rms(rotvec: Float64) -> float:
    return float(np.sqrt((rotvec**2).sum(axis=1).mean())) if len(rotvec) else 0.0


def _right_handed_axes() -> Iterator[str]:
    """Yield the 24 choices of axes, as mountings."""
    for order in permutations(range(3)):
        is_even = order[0] == (order[1] + 2) % 3
        for signs in product((False, True), repeat=3):
            if (sum(signs) % 2 == 0) == is_even:
                yield ",".join("-" * sign + "xyz"[k] for k, sign in zip(order, signs, strict=True))
