"""Interpolation between the attitudes of a series, with a polynomial through the neighbours.

The rotation at the constant rate from sample k to sample k + 1 is extrapolated to the neighbouring
samples. The deviations of their attitudes from it, as rotation vectors, are zero at k and k + 1; a
polynomial through all of them is added to the rotation at the constant rate. So the polynomial is
of small rotations, whatever the rate, and without neighbours the result is slerp.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.kinematics.quaternion import (
    conjugate,
    exp,
    geodesic_angle,
    log,
    multiply,
    normalize,
    shorter,
)
from quatprop.kinematics.quintic import SAMPLES, windows_over
from quatprop.series.blocks import blocks

if TYPE_CHECKING:
    from quatprop.arrays import Bool, Float64, Int64, Intp
    from quatprop.kinematics.quintic import Windows
    from quatprop.series import AttitudeSeries

MAX_DEVIATION: Final = 1.0
"""Larger deviations, rad, are not of smooth motion: the rate is then held constant."""

MAX_SPEED_RATIO: Final = 4.0
"""An interval in which the motion is faster than in its neighbours by a larger factor is a jump.
Smooth motion had up to 2.7, with frequencies up to a third of the sample rate."""

FAR_NS: Final = np.iinfo(np.int64).max


class Interpolated(NamedTuple):
    """Attitudes between samples.

    `wxyz`: unit quaternions, shape ``(N, 4)``
    `floor_rad`: estimate of the largest error: the difference from two neighbours fewer or, if the
        rate is held constant, the effect of a steady change of the rate
    """

    wxyz: Float64
    floor_rad: float


def interpolate(series: AttitudeSeries, t_ns: Int64) -> Interpolated:
    """Return the attitudes of a series at times within it.

    `t_ns`: times, shape ``(N,)``, int64 ns; outside the series the nearest interval is continued
    `Returns`: the attitudes; at a timestamp exactly that of the sample
    """
    wxyz, floor = np.empty((len(t_ns), 4)), 0.0
    steps = np.diff(series.t_ns)
    # For the polynomials a jump is a gap: they end on both sides of it.
    windows = windows_over(np.where(_jumps(series, steps), FAR_NS, steps), steps, FAR_NS - 1)
    for rows in blocks(len(t_ns)):
        wxyz[rows], part = _interpolated(series, windows, t_ns[rows])
        floor = max(floor, part)
    return Interpolated(wxyz, floor)


def _jumps(series: AttitudeSeries, steps: Int64) -> Bool:
    """Return which intervals are far faster than the two neighbours on either side."""
    speed = geodesic_angle(series.wxyz[:-1], series.wxyz[1:]) / steps
    near = np.pad(speed, 2)
    beside = np.max([near[k : k + len(speed)] for k in (0, 1, 3, 4)], axis=0)
    return np.asarray(speed > MAX_SPEED_RATIO * beside)


def _interpolated(series: AttitudeSeries, windows: Windows, t_ns: Int64) -> Interpolated:
    before = np.clip(np.searchsorted(series.t_ns, t_ns, side="right") - 1, 0, len(series) - 2)
    start, stop = series.t_ns[before], series.t_ns[before + 1]
    fraction = (t_ns - start) / (stop - start)
    rotvec = _between(series.wxyz[before], series.wxyz[before + 1])
    inside = (fraction > 0) & (fraction < 1)
    chosen = np.flatnonzero(inside & windows.usable[before])
    six, four, smooth = _corrections(
        series, before[chosen], windows.start[before[chosen]], fraction[chosen], rotvec[chosen]
    )
    correction = np.zeros((len(t_ns), 3))
    correction[chosen] = six
    left = np.linalg.norm(six - four, axis=1).max(initial=0.0)
    inside[chosen[smooth]] = False
    held = np.flatnonzero(inside)
    held_error = _constant_rate_error(series, before[held], fraction[held], rotvec[held])
    step = multiply(exp(fraction[:, None] * rotvec), exp(correction))
    wxyz = normalize(multiply(series.wxyz[before], step))
    wxyz[t_ns == stop] = normalize(series.wxyz[before + 1][t_ns == stop])
    return Interpolated(wxyz, max(left, float(held_error.max(initial=0.0))))


def _constant_rate_error(
    series: AttitudeSeries, before: Intp, fraction: Float64, rotvec: Float64
) -> Float64:
    """Return the error of a constant rate, estimated from both neighbouring samples, rad, (N,).

    With a steadily changing rate, deviations are proportional to the product of the times since
    both ends of the interval.
    """
    begin, length = series.t_ns[before], series.t_ns[before + 1] - series.t_ns[before]
    error = np.zeros(len(before))
    for beside in (-1, 2):
        node = np.clip(before + beside, 0, len(series) - 1)
        at = (series.t_ns[node] - begin) / length
        held = multiply(series.wxyz[before], exp(at[:, None] * rotvec))
        size = np.linalg.norm(_between(held, series.wxyz[node]), axis=1)
        # At the ends of the series the node is an end of the interval itself.
        apart = np.where((at < 0) | (at > 1), at * (at - 1), np.inf)
        error = np.maximum(error, size * fraction * (1 - fraction) / apart)
    return error


def _corrections(
    series: AttitudeSeries, before: Intp, start: Intp, fraction: Float64, rotvec: Float64
) -> tuple[Float64, Float64, Bool]:
    """Return corrections of attitudes at a constant rate, as rotation vectors ``(N, 3)``.

    `before`, `fraction`: indices of the samples before the wanted times, and the elapsed fractions
        of the intervals, ``(N,)``
    `start`: index of the first of the six samples, ``(N,)``
    `rotvec`: the rotation vectors of the intervals, ``(N, 3)``
    `Returns`: by all six samples, by the nearest four, and whether the motion is smooth, ``(N,)``;
        otherwise both corrections are zero
    """
    begin, length = series.t_ns[before], series.t_ns[before + 1] - series.t_ns[before]
    at = [(series.t_ns[start + node] - begin) / length for node in range(SAMPLES)]
    inner = np.clip(before - 1, start, start + 2) - start
    near = [(inner <= node) & (node < inner + 4) for node in range(SAMPLES)]
    (six, four), smooth = np.zeros((2, *rotvec.shape)), np.ones(len(rotvec), np.bool_)
    for node in range(SAMPLES):
        held = multiply(series.wxyz[before], exp(at[node][:, None] * rotvec))
        deviation = _between(held, series.wxyz[start + node])
        smooth &= np.linalg.norm(deviation, axis=1) <= MAX_DEVIATION
        weights = np.ones(len(rotvec)), near[node].astype(float)
        for other in set(range(SAMPLES)) - {node}:
            factor = (fraction - at[other]) / (at[node] - at[other])
            weights[0][:] *= factor
            weights[1][near[other]] *= factor[near[other]]
        six += weights[0][:, None] * deviation
        four += weights[1][:, None] * deviation
    six[~smooth] = four[~smooth] = 0.0
    return six, four, smooth


def _between(p: Float64, q: Float64) -> Float64:
    """Return the rotation vectors of the shorter rotations from p to q, ``(N, 3)``, rad."""
    return log(shorter(multiply(conjugate(p), q)))
