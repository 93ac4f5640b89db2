"""Rotations over windows, from rates and from a reference, and their derivatives.

The rotation over a window does not depend on the reference frame. Windows end at samples of the
reference and the next one begins at the sample after that, so that no two share its noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.calibration.model import OF_GROUP, Model
from quatprop.comparison.windows import over_gap
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
from quatprop.series.blocks import reblock
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.arrays import Bool, Float64, Int64

METHOD: Final = "cubic"
"""The rule by which rates are integrated."""

LONGEST: Final = 1.5
"""Windows longer than this many times the nominal length, because of gaps, are omitted."""

MAX_WINDOWS: Final = 200_000
"""Of more windows every second one is used, or fewer, which bounds memory."""

SPARE_NS: Final = 200_000_000
"""Margin around each window for a clock offset that is still unknown."""


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


def windows_of(
    rates: GyroSeries, reference: AttitudeSeries, model: Model, length_ns: int
) -> RotationWindows:
    """Return consecutive windows of about a length that rates cover without a gap."""
    t_ns = reference.t_ns
    edges = np.searchsorted(t_ns, np.arange(t_ns[0], t_ns[-1], length_ns))
    rows = np.stack([edges[:-1], edges[1:] - 1], axis=1)
    span_ns = np.diff(t_ns[rows])[:, 0]
    usual = (span_ns > 0) & (span_ns <= LONGEST * length_ns) & (2 * span_ns >= length_ns)
    need_ns = model.times_of(t_ns[rows]) + np.array([-SPARE_NS, SPARE_NS])
    inside = (need_ns[:, 0] >= rates.t_ns[0]) & (need_ns[:, 1] <= rates.t_ns[-1])
    rows = rows[usual & inside & ~over_gap(rates.t_ns, *need_ns.T)]
    begin, end = rows[:: len(rows) // MAX_WINDOWS + 1].T
    turn = multiply(conjugate(reference.wxyz[begin]), reference.wxyz[end])
    return RotationWindows(np.stack([t_ns[begin], t_ns[end]], axis=1), turn)


def errors_of(rates: GyroSeries, windows: RotationWindows, model: Model) -> tuple[Float64, Float64]:
    """Return the differences between the rotations of calibrated rates and of the reference.

    `rates`: raw rates in order of time
    `Returns`: rotation vectors from the rates' rotation to the reference's, in the body axes at the
        ends of windows, shape ``(M, 3)``, rad; and their derivatives with respect to each
        parameter, shape ``(M, 3, 14)``
    """
    calibrated = conditioned(reblock([rates]), bias=model.bias, matrix=model.matrix)
    times = np.clip(model.times_of(windows.t_ns), rates.t_ns[0], rates.t_ns[-1])
    q, rate, sums = _reached(calibrated, times.ravel())
    begin, end = q[::2], q[1::2]
    turn = multiply(conjugate(begin), end)
    vectors = log(shorter(multiply(conjugate(turn), windows.turn)))
    by_rate = np.einsum("minj,pjn->mip", sums[1::2] - sums[::2], model.by_rate())
    slope = rotation_matrix(conjugate(end)) @ by_rate
    at_begin = np.einsum("mji,mj->mi", rotation_matrix(turn), rate[::2])
    since = (windows.t_ns - model.middle_ns)[..., None] / NS_PER_S
    slope[..., OF_GROUP == "offset"] = (rate[1::2] - at_begin)[..., None]
    drift = since[:, 1] * rate[1::2] - since[:, 0] * at_begin
    slope[..., OF_GROUP == "drift"] = drift[..., None]
    return vectors, -slope


def _reached(rates: Iterable[GyroSeries], t_ns: Int64) -> tuple[Float64, Float64, Float64]:
    """Return the attitudes and integrals that rates lead to at some times, from any initial one.

    `t_ns`: rising times within those of the rates, shape ``(K,)``
    `Returns`: attitudes, ``(K, 4)``; rates, ``(K, 3)``; and the integral of R times 1 and times
        each component of the rate, ``(K, 3, 4, 3)``
    """
    found = np.empty((39, len(t_ns)))

    def passing() -> Iterator[tuple[GyroSeries, AttitudeSeries]]:
        before, total, first = None, np.zeros((36, 1)), 0
        for block, attitudes in Propagation(IDENTITY, METHOD, "body").run(rates):
            yield block, attitudes
            samples, q = block, attitudes
            if before is not None:
                # The interval between blocks belongs to the later one.
                samples = GyroSeries.joined([before[0], block])
                q = AttitudeSeries.joined([before[1], attitudes])
            before = block[-1:], attitudes[-1:]
            turn = rotation_elements(q.wxyz)
            every = np.concatenate([np.ones((1, len(samples))), samples.rate.T])
            after = every[:, 1:]
            if not samples.is_integrated(METHOD):
                after = (after + every[:, :-1]) / 2
            since_s = (samples.t_ns - samples.t_ns[0]) / NS_PER_S
            middle = (turn[:, 1:] + turn[:, :-1]) / 2
            steps = (middle[:, None] * (after * np.diff(since_s))).reshape(36, -1)
            sums = np.cumsum(np.concatenate([total, steps], axis=1), axis=1)
            total = sums[:, -1:]
            last = int(np.searchsorted(t_ns, samples.t_ns[-1], side="right"))
            at_s = (t_ns[first:last] - samples.t_ns[0]) / NS_PER_S
            for row, values in zip(found, (*samples.rate.T, *sums), strict=True):
                row[first:last] = np.interp(at_s, since_s, values)
            first = last

    wanted = at_times(passing(), Listed(t_ns), method=METHOD, rates="body")
    q = AttitudeSeries.joined([*wanted]).wxyz
    # rows of R, factors, columns of R
    return q, found[:3].T, found[3:].T.reshape(-1, 3, 3, 4).swapaxes(2, 3)
