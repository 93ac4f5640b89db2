"""Rotations over windows, from rates and from a reference, and their derivatives.

The rotation over a window does not depend on the reference frame. Windows end at samples of the
reference and the next one begins at the sample after that, so that no two share its noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.calibration.model import OF_GROUP, Model
from quatprop.conditioning import conditioned
from quatprop.kinematics.elements import rotation_elements
from quatprop.kinematics.propagate import Propagation
from quatprop.kinematics.quaternion import (
    IDENTITY,
    conjugate,
    log,
    multiply,
    rotation_matrix,
    shorter,
)
from quatprop.kinematics.resample import Listed, at_times
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.series.blocks import blocks
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Bool, Float64, Int64

METHOD: Final = "coning"
"""The rule by which rates are integrated."""

LONGEST: Final = 1.5
"""Windows longer than this many times the nominal length, because of gaps, are omitted."""


class RotationWindows(NamedTuple):
    """Windows of a reference in order of time.

    `t_ns`: first and last time of each, in the clock of the reference, shape ``(M, 2)``, int64 ns
    `turn`: the rotation over each, in the body axes at its beginning, wxyz, shape ``(M, 4)``
    """

    t_ns: Int64
    turn: Float64

    def __len__(self) -> int:
        return len(self.t_ns)

    def where(self, chosen: Bool) -> RotationWindows:
        """Return some of the windows."""
        return RotationWindows(self.t_ns[chosen], self.turn[chosen])


def windows_of(reference: AttitudeSeries, length_ns: int) -> RotationWindows:
    """Return consecutive windows of about a length."""
    t_ns = reference.t_ns
    edges = np.searchsorted(t_ns, np.arange(t_ns[0], t_ns[-1], length_ns))
    begin, end = edges[:-1], edges[1:] - 1
    span_ns = t_ns[end] - t_ns[begin]
    usual = (span_ns > 0) & (span_ns <= LONGEST * length_ns) & (2 * span_ns >= length_ns)
    begin, end = begin[usual], end[usual]
    turn = multiply(conjugate(reference.wxyz[begin]), reference.wxyz[end])
    return RotationWindows(np.stack([t_ns[begin], t_ns[end]], axis=1), turn)


class Errors(NamedTuple):
    """Differences between the rotations of calibrated rates and those of the reference.

    `vectors`: rotation vectors from the rates' rotation to the reference's, in the body axes at the
        ends of windows, shape ``(M, 3)``, rad
    `slope`: derivatives with respect to each parameter, shape ``(M, 3, 14)``
    """

    vectors: Float64
    slope: Float64


def covered(
    rates: GyroSeries, windows: RotationWindows, model: Model, spare_ns: int
) -> RotationWindows:
    """Return the windows that rates cover without a gap, with a margin of `spare_ns`."""
    t_ns = model.times_of(windows.t_ns) + np.array([-spare_ns, spare_ns])
    steps = np.diff(rates.t_ns)
    gaps = np.flatnonzero(steps > GAP_FACTOR * np.median(steps))
    # A window has no gap if as many gaps begin before its end as end before its beginning.
    begun, ended = (np.searchsorted(rates.t_ns[at], t_ns) for at in (gaps, gaps + 1))
    inside = (t_ns[:, 0] >= rates.t_ns[0]) & (t_ns[:, 1] <= rates.t_ns[-1])
    return windows.where(inside & (begun[:, 1] == ended[:, 0]))


def errors_of(rates: GyroSeries, windows: RotationWindows, model: Model) -> Errors:
    """Return the errors of rates over windows.

    `rates`: raw rates in order of time
    """
    (calibrated,) = conditioned([rates], bias=model.bias, matrix=model.matrix)
    times = np.clip(model.times_of(windows.t_ns), rates.t_ns[0], rates.t_ns[-1])
    q, rate, sums = _reached(calibrated, times.ravel())
    begin, end = q[::2], q[1::2]
    turn = multiply(conjugate(begin), end)
    vectors = log(shorter(multiply(conjugate(turn), windows.turn)))
    to_body = rotation_matrix(conjugate(end))
    by_rate = np.einsum("minj,pjn->mip", (sums[1::2] - sums[::2]), model.by_rate())
    at_begin = np.einsum("mji,mj->mi", rotation_matrix(turn), rate[::2])
    since = (windows.t_ns - model.middle_ns)[..., None] / NS_PER_S
    at_end = rate[1::2]
    slope = to_body @ by_rate
    slope[..., OF_GROUP == "offset"] = (at_end - at_begin)[..., None]
    slope[..., OF_GROUP == "drift"] = (since[:, 1] * at_end - since[:, 0] * at_begin)[..., None]
    return Errors(vectors, -slope)


def _reached(rates: GyroSeries, t_ns: Int64) -> tuple[Float64, Float64, Float64]:
    """Return the attitudes and integrals that rates lead to at some times, from any initial one.

    `t_ns`: rising times within those of the rates, shape ``(K,)``
    `Returns`: attitudes, ``(K, 4)``; rates, ``(K, 3)``; and the integral of R times 1 and times
        each component of the rate, ``(K, 3, 4, 3)``
    """
    pairs = list(Propagation(IDENTITY, METHOD, "body").run([rates]))
    wanted = at_times(pairs, Listed(t_ns), method=METHOD, rates="body")
    q = AttitudeSeries.joined([*wanted]).wxyz
    wxyz = AttitudeSeries.joined([attitudes for _, attitudes in pairs]).wxyz
    before = np.clip(np.searchsorted(rates.t_ns, t_ns, side="right") - 1, 0, len(rates) - 2)
    steps = np.diff(rates.t_ns)
    part = (t_ns - rates.t_ns[before]) / steps[before]
    rate = rates.rate[before] + part[:, None] * (rates.rate[before + 1] - rates.rate[before])
    sums, total = np.empty((len(t_ns), 36)), np.zeros((36, 1))
    for rows in blocks(len(steps)):
        several = slice(rows.start, min(rows.stop, len(steps)) + 1)
        turn = rotation_elements(wxyz[several])
        every = np.concatenate([np.ones((1, turn.shape[1])), rates.rate[several].T])
        middle = (turn[:, 1:] + turn[:, :-1]) / 2
        after = every[:, 1:] if rates.is_integrated(METHOD) else (every[:, 1:] + every[:, :-1]) / 2
        each = (middle[:, None] * (after * (steps[rows] / NS_PER_S))).reshape(36, -1)
        so_far = np.cumsum(np.concatenate([total, each], axis=1), axis=1)
        here = (before >= rows.start) & (before < rows.stop)
        at = before[here] - rows.start
        sums[here] = (so_far[:, at] + part[here] * each[:, at]).T
        total = so_far[:, -1:]
    # rows of R, factors, columns of R
    return q, rate, sums.reshape(-1, 3, 3, 4).swapaxes(2, 3)
