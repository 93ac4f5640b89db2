"""Rotations over windows by rates and by a reference, and how they depend on a calibration.

The rotation over a window is free of the reference frame. Windows end at samples of the reference
and the next begins at the sample after that, so that no noise is in two of them.
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
"""Windows that gaps of the reference make longer than so many usual ones are left out."""


class Windows(NamedTuple):
    """Windows of a reference, in the order of time.

    `t_ns`: when they begin and end, in the clock of the reference, shape ``(M, 2)``, int64 ns
    `turn`: the rotation over each, resolved in the body at its begin, wxyz, shape ``(M, 4)``
    """

    t_ns: Int64
    turn: Float64

    def __len__(self) -> int:
        return len(self.t_ns)

    def where(self, chosen: Bool) -> Windows:
        """Return some of the windows."""
        return Windows(self.t_ns[chosen], self.turn[chosen])


def windows_of(reference: AttitudeSeries, length_ns: int) -> Windows:
    """Return windows of about a length, of which none overlap."""
    t_ns = reference.t_ns
    edges = np.searchsorted(t_ns, np.arange(t_ns[0], t_ns[-1], length_ns))
    begin, end = edges[:-1], edges[1:] - 1
    span_ns = t_ns[end] - t_ns[begin]
    usual = (span_ns > 0) & (span_ns <= LONGEST * length_ns) & (2 * span_ns >= length_ns)
    begin, end = begin[usual], end[usual]
    turn = multiply(conjugate(reference.wxyz[begin]), reference.wxyz[end])
    return Windows(np.stack([t_ns[begin], t_ns[end]], axis=1), turn)


class Errors(NamedTuple):
    """How the rotations by calibrated rates differ from those of the reference.

    `vectors`: what takes the rotation by the rates to that of the reference, rotation vectors in
        the body at the ends of windows, shape ``(M, 3)``, rad
    `slope`: how they change with each parameter, shape ``(M, 3, 14)``
    """

    vectors: Float64
    slope: Float64


def covered(rates: GyroSeries, windows: Windows, model: Model, spare_ns: int) -> Windows:
    """Return the windows that have rates from begin to end, also if the clock is off a bit."""
    t_ns = model.times_of(windows.t_ns) + np.array([-spare_ns, spare_ns])
    steps = np.diff(rates.t_ns)
    gaps = np.flatnonzero(steps > GAP_FACTOR * np.median(steps))
    # The number of gaps before a time is another behind it, and inside.
    begun, ended = (np.searchsorted(rates.t_ns[at], t_ns) for at in (gaps, gaps + 1))
    inside = (t_ns[:, 0] >= rates.t_ns[0]) & (t_ns[:, 1] <= rates.t_ns[-1])
    return windows.where(inside & (begun[:, 1] == ended[:, 0]))


def errors_of(rates: GyroSeries, windows: Windows, model: Model) -> Errors:
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
    """Return where rates lead to at some times, beginning anywhere.

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
    # Rows of R, its columns, and by what it is multiplied.
    return q, rate, sums.reshape(-1, 3, 3, 4).swapaxes(2, 3)
