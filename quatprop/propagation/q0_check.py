"""The attitudes that an initial attitude is taken from, against the rates that follow it.

Nothing is changed here. They may contradict each other throughout, or agree only later: a filter
is still settling, or a tracker repeats its last attitude.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.rendering import degrees_text
from quatprop.base.text import Remark, Setting
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import IDENTITY, conjugate, geodesic_angle, multiply, rotate
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.propagation.orientation_check import COMPARED_SAMPLES, GAP, against_orientation

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Float64, Int64


SPAN_NS = 1_000_000_000
"""Rotations are compared over this time."""

APART = math.radians(10.0)
"""rad: a smaller difference in that time may be a bias."""

APART_SHARE, SAME_SHARE = 0.5, 0.3
"""Difference, as a share of the angle through which the body goes meanwhile, of rotations that
contradict each other, and of those that agree."""

SAME = math.radians(2.0)
"""rad: a smaller difference is none."""

CONSTANT, LONGEST = 1e-6, 1.2
"""Attitudes that differ by less, rad, are equal; and a time compared is at most so many times
:data:`SPAN_NS`."""

SETTLED, SETTLED_RATIO = math.radians(0.5), 2.0
"""An orientation is settled where rotations differ by less than this, rad, or less than so many
times as usual."""

LATE_S = 0.2
"""s: what a body turns in this time may be due to a delay at both ends."""

THINNED_NS = 100_000_000
"""Attitudes are compared at most as often."""

MOSTLY = 0.5
"""Share of rotations that agree where an orientation is settled later."""

FEWEST = 20
"""Fewest rotations that are compared."""

BODIES = (2, 3, 4)
"""Numbers of bodies that may take turns on one topic."""

ONE_BODY = math.radians(1.0)
"""rad: smaller steps from one attitude to the next are those of one body."""

BY_TURNS = 5.0
"""Where bodies take turns, the step from one to another is larger than theirs by this factor."""


class OverlappingAttitudes:
    """Keeps the attitudes of a series beside the first samples that are propagated.

    `t_ns`: the stamps of these samples
    """

    def __init__(self, t_ns: Int64) -> None:
        self._first_ns, self._last_ns = int(t_ns.min()), int(t_ns.max())
        self._kept: list[AttitudeSeries] = []
        self._room = COMPARED_SAMPLES

    def watched(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield batches, and keep what is beside the samples."""
        for series in batches:
            t_ns = series.t_ns
            inside = np.flatnonzero((t_ns >= self._first_ns) & (t_ns <= self._last_ns))
            inside = inside[: self._room]
            if len(inside):
                self._room -= len(inside)
                self._kept.append(AttitudeSeries(t_ns[inside], series.wxyz[inside]))
            yield series

    @property
    def are_headings(self) -> bool:
        """Whether all that was kept has neither roll nor pitch."""
        flat = (np.abs(each.wxyz[:, 1:3]).max() <= CONSTANT for each in self._kept)
        return bool(self._kept) and all(flat)

    def read_on(self, batches: Iterator[AttitudeSeries]) -> None:
        """Read a series until all is kept that is compared."""
        for series in batches:
            if not self._room or int(series.t_ns[-1]) > self._last_ns:
                return

    def turned(self, wxyz: Float64) -> AttitudeSeries:
        """Return what was kept, turned from the axes of its frame to those of the body."""
        kept = AttitudeSeries.joined([AttitudeSeries(np.empty(0, np.int64), np.empty((0, 4)))])
        if self._kept:
            kept = AttitudeSeries.joined(self._kept)
        return AttitudeSeries(kept.t_ns, multiply(kept.wxyz, wxyz))


def q0_remarks(  # noqa: PLR0913  # both series, and what is known of the rates
    gyro: GyroSeries,
    own: AttitudeSeries,
    rates: str,
    unit: str,
    mount: Float64 | None,
    *,
    is_of_log: bool,
    force: Float64 | None = None,
) -> list[Remark]:
    """Return remarks on attitudes that contradict the rates beside them.

    `gyro`: the first samples that are propagated
    `own`: attitudes of the same body beside them
    `rates`: ``"body"`` or ``"inertial"``
    `unit`: that of the rates in the log
    `mount`: by which the rates were turned already
    `is_of_log`: whether they are the log's own orientation, of which :mod:`.plausibility` tells
    `force`: the specific force at the first sample, body axes, if they are headings alone
    """
    if len(gyro) <= FEWEST or len(own) <= FEWEST or (np.diff(gyro.t_ns) < 0).any():
        return []
    name = "the log's own orientation" if is_of_log else f"the orientation of {Setting('q0')}"
    if not is_of_log and (remark := _of_several_bodies(gyro, own, name)):
        return [remark]
    if rates == "body" and (remark := _lacks_tilt(gyro, own, name, force)):
        return [remark]
    own = _thinned(own)
    gyro = _with_stamps(gyro, own.t_ns)
    if remark := _agrees_later(gyro, own, rates, name):
        return [remark]
    found = None
    if not is_of_log:
        found = against_orientation([gyro], [own], rates, unit, name=name, mount=mount)
    return [] if found is None else [found]


def _with_stamps(gyro: GyroSeries, t_ns: Int64) -> GyroSeries:
    """Return rates also at other times, outside of gaps, where the rate before holds."""
    steps = np.diff(gyro.t_ns)
    at = np.searchsorted(gyro.t_ns, t_ns, side="right") - 1
    inside = (at >= 0) & (at < len(steps))
    inside[inside] &= steps[at[inside]] <= GAP * np.median(steps)
    stamps = np.union1d(gyro.t_ns, t_ns[inside])
    return GyroSeries(stamps, gyro.rate[np.searchsorted(gyro.t_ns, stamps, side="right") - 1])


def _thinned(own: AttitudeSeries) -> AttitudeSeries:
    """Return fewer attitudes, so that their noise is small against what the body turns between."""
    usual_ns = float(np.median(np.abs(np.diff(own.t_ns))))
    step = max(int(THINNED_NS / max(usual_ns, 1.0)), 1)
    return AttitudeSeries(own.t_ns[::step], own.wxyz[::step])


def _of_several_bodies(gyro: GyroSeries, own: AttitudeSeries, name: str) -> Remark | None:
    """Return a remark on bodies that take turns, unless one turns so fast."""
    wxyz = own.wxyz
    interval_s = float(np.median(np.abs(np.diff(own.t_ns)))) * 1e-9
    by_rates = interval_s * float(np.median(np.linalg.norm(gyro.rate, axis=1)))
    step, *others = (
        float(np.median(geodesic_angle(wxyz[:-lag], wxyz[lag:]))) for lag in (1, *BODIES)
    )
    bodies = BODIES[int(np.argmin(others))]
    if step <= max(ONE_BODY, BY_TURNS * min(others), BY_TURNS * by_rates):
        return None
    text = (
        f"{name} goes to and fro by {degrees_text(step, 3)} from each attitude to the next, but "
        f"hardly from each to the {bodies}. after it: that of {bodies} bodies? the initial "
        "attitude is between them; write each to its own log"
    )
    return Remark("q0-of-several-bodies", text)


def _lacks_tilt(
    gyro: GyroSeries, own: AttitudeSeries, name: str, force: Float64 | None
) -> Remark | None:
    """Return a remark on an orientation that is constant, or a heading, unlike the body.

    The vertical is then constant in body axes, but not by the rates, or not that of gravity.
    """
    up = rotate(conjugate(own.wxyz), np.array([0.0, 0.0, 1.0]))
    is_beside = (gyro.t_ns >= own.t_ns.min()) & (gyro.t_ns <= own.t_ns.max())
    t_ns, rate = gyro.t_ns[is_beside], gyro.rate[is_beside]
    after = np.searchsorted(t_ns, t_ns + SPAN_NS)
    begins = np.flatnonzero(after < len(t_ns))
    # How the body turns in a gap is unknown.
    begins = begins[t_ns[after[begins]] - t_ns[begins] < LONGEST * SPAN_NS]
    if np.ptp(up, axis=0).max() > CONSTANT or not len(begins) or not np.isfinite(rate).all():
        return None
    wxyz = attitudes(t_ns, rate)
    turns = multiply(conjugate(wxyz[begins]), wxyz[after[begins]])
    turned = float(geodesic_angle(turns, IDENTITY).max())
    if geodesic_angle(own.wxyz, own.wxyz[0]).max() <= CONSTANT and turned > APART:
        text = (
            f"{name} is the same {len(own)} times, while the body turns by up to "
            f"{degrees_text(turned, 3)} in a second: a placeholder, not an attitude?"
        )
        return Remark("q0-constant", text)
    tilts = {"turns by {} in a second about level axes": _between(rotate(turns, up[0]), up[0])}
    if force is not None:
        apart = _between(force, up[0])
        tilts["is tilted by {} against gravity"] = min(apart, math.pi - apart)
    what = max(tilts, key=tilts.__getitem__)
    if tilts[what] <= APART:
        return None
    x, y, _ = rotate(own.wxyz[0], np.array([1.0, 0.0, 0.0])).tolist()
    heading = Setting("heading", f"{math.degrees(math.atan2(y, x)):.6g}")
    text = (
        f"{name} is a heading, without roll and pitch, and the body "
        f"{what.format(degrees_text(tilts[what], 3))}: the tilt of the initial attitude is wrong. "
        f"For that by gravity use {Setting('q0', 'level')} and {heading}; if the sensor has other "
        f"axes than the body, give {Setting('mount')}"
    )
    return Remark("q0-without-tilt", text)


def _between(a: Float64, b: Float64) -> float:
    """Return the largest angle between vectors, rad."""
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    return float(np.arctan2(sine, (a * b).sum(axis=-1)).max())


def _agrees_later(gyro: GyroSeries, own: AttitudeSeries, rates: str, name: str) -> Remark | None:
    """Return a remark if an orientation contradicts the rates at first, and later agrees."""
    stamps, places, own_places = np.intersect1d(gyro.t_ns, own.t_ns, return_indices=True)
    after = np.searchsorted(stamps, stamps + SPAN_NS)
    begins = np.flatnonzero(after < len(stamps))
    if len(begins) < FEWEST or not np.isfinite(gyro.rate).all():
        return None
    after = after[begins]
    by_rates, by_own = attitudes(gyro.t_ns, gyro.rate, rates=rates)[places], own.wxyz[own_places]
    # It is constant as long as both rotate alike.
    between = multiply(by_own, conjugate(by_rates))
    if rates == "inertial":
        between = multiply(conjugate(by_rates), by_own)
    apart = geodesic_angle(between[begins], between[after])
    steps = np.diff(gyro.t_ns)
    path = np.append(0.0, np.cumsum(np.linalg.norm(gyro.rate[:-1], axis=1) * steps * 1e-9))[places]
    own_path = np.append(0.0, np.cumsum(geodesic_angle(by_own[:-1], by_own[1:])))
    paths = np.maximum(*(one[after] - one[begins] for one in (path, own_path)))
    gaps = np.append(0, np.cumsum(steps > GAP * np.median(steps)))[places]
    is_gap = gaps[after] > gaps[begins]
    agree = (apart <= np.maximum(SAME, SAME_SHARE * paths)) | is_gap
    fastest = np.linalg.norm(gyro.rate[: places[after[0]] + 1], axis=1).max()
    least = max(APART, APART_SHARE * paths[0], LATE_S * fastest)
    if is_gap[0] or apart[0] <= least or agree.mean() < MOSTLY:
        return None
    # From there on, they agree for as long as they are compared at once.
    settled = agree & (apart <= max(SETTLED, SETTLED_RATIO * float(np.median(apart))))
    disagreeing = np.append(0, np.cumsum(~(settled | is_gap)))
    ends = np.minimum(after, len(agree))
    lasting = np.flatnonzero((disagreeing[ends] == disagreeing[begins]) & (after <= len(agree)))
    if not len(lasting):
        return None
    start = int(lasting[0])
    text = (
        f"{name} agrees with the rates only from {stamps[start]} ns on, and until then turns by "
        f"{degrees_text(float(geodesic_angle(between[0], between[start])), 3)} otherwise than "
        "they: was it still settling, or an old one repeated? begin where they agree, with "
        f"{Setting('start', str(stamps[start]))}"
    )
    return Remark("q0-settles-later", text)
