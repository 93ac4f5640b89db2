"""Integrals of the rotation rate of a source, in body and in reference axes, at any time.

The mean rate over a window is the difference of two integrals: it does not depend on the sample
rate, and rates and attitudes become the same thing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.kinematics.propagate import rotation_vectors_between

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64, Int64

GAP: Final = 10.0
"""Intervals longer than this many median ones are gaps."""

MAX_POINTS: Final = 1 << 20
"""Maximum number of integrals that are kept."""

BODY, REFERENCE = "body", "reference"
"""The axes in which a rotation rate is resolved."""


class Turning(NamedTuple):
    """The integrals of one source.

    `seconds`: times since a common zero, shape ``(N,)``, s
    `body`: integral of the rate in body axes, shape ``(N, 3)``, rad
    `reference`: the same in reference axes; None for rates, of which they are unknown
    `wxyz`: attitudes at `seconds`, shape ``(N, 4)``; None for rates
    `interval`: the median interval, s
    `gap_begins`, `gap_ends`: intervals that are left out: gaps and jumps, s
    `shown`: which body axes are measured, shape ``(3,)``
    """

    seconds: Float64
    body: Float64
    reference: Float64 | None
    wxyz: Float64 | None
    interval: float
    gap_begins: Float64
    gap_ends: Float64
    shown: Bool

    def axes(self) -> tuple[str, ...]:
        """Return the axes in which the rate is known."""
        return (BODY,) if self.reference is None else (BODY, REFERENCE)

    def shown_in(self, axes: str) -> Bool:
        """Return which of the given axes are measured."""
        return self.shown if axes == BODY else np.ones(3, np.bool_)

    def mean_rate(self, axes: str, begin: Float64, length: float) -> Float64:
        """Return the mean rates over windows, shape ``(M, 3)``, rad/s."""
        total = self.body if axes == BODY or self.reference is None else self.reference
        return (self._at(total, begin + length) - self._at(total, begin)) / length

    def _at(self, total: Float64, times: Float64) -> Float64:
        """Return integrals at the given times, shape ``(M, 3)``, held before and after all."""
        times = np.clip(times, self.seconds[0], self.seconds[-1])
        after = np.clip(np.searchsorted(self.seconds, times), 1, len(self.seconds) - 1)
        first, last = self.seconds[after - 1], self.seconds[after]
        part = ((times - first) / (last - first))[:, None]
        before = total[after - 1]
        return np.asarray(before + part * (total[after] - before))

    def is_clear(self, begin: Float64, end: Float64) -> Bool:
        """Return which windows contain no part of a gap."""
        begun = np.searchsorted(self.gap_begins, end)
        ended = np.searchsorted(self.gap_ends, begin, side="right")
        return np.asarray(begun <= ended)

    def attitude_near(self, times: Float64) -> Float64 | None:
        """Return the attitudes next to the given times, shape ``(M, 4)``; None for rates."""
        if self.wxyz is None:
            return None
        return self.wxyz[np.clip(np.searchsorted(self.seconds, times), 0, len(self.wxyz) - 1)]


def turning_of_rates(
    t_ns: Int64, rate: Float64, zero_ns: int, shown: Bool, *, is_average: bool = False
) -> Turning:
    """Return the integrals of body rates.

    `zero_ns`: the common zero of time
    `is_average`: whether each rate is the average over the interval before its timestamp
    """
    seconds, steps, interval, gap = _times(t_ns, zero_ns)
    after = rate[1:] if is_average else (rate[1:] + rate[:-1]) / 2
    kept = _kept(len(seconds))
    return Turning(
        seconds[kept], _total(after * steps[:, None])[kept], None, None, interval,
        seconds[:-1][gap], seconds[1:][gap], shown,
    )  # fmt: skip


def turning_of_attitudes(
    t_ns: Int64, wxyz: Float64, zero_ns: int, shown: Bool, jumps: Bool | None = None
) -> Turning:
    """Return the integrals of attitudes.

    `jumps`: intervals in which the frame jumps, shape ``(N - 1,)``
    """
    seconds, _, interval, gap = _times(t_ns, zero_ns)
    left_out = gap if jumps is None else gap | jumps
    used = np.where(left_out, 0.0, 1.0)[:, None]
    body, reference = (
        _total(rotation_vectors_between(wxyz, rates=axes) * used) for axes in ("body", "inertial")
    )
    kept = _kept(len(seconds))
    return Turning(
        seconds[kept], body[kept], reference[kept], wxyz[kept], interval,
        seconds[:-1][left_out], seconds[1:][left_out], shown,
    )  # fmt: skip


def _times(t_ns: Int64, zero_ns: int) -> tuple[Float64, Float64, float, Bool]:
    """Return times and steps, s, the median step, and which steps are gaps."""
    seconds = (t_ns - zero_ns) / NS_PER_S
    steps = np.diff(t_ns) / NS_PER_S
    interval = float(np.median(steps))
    return seconds, steps, interval, np.asarray(steps > GAP * interval)


def _total(turns: Float64) -> Float64:
    total = np.zeros((len(turns) + 1, 3))
    np.cumsum(turns, axis=0, out=total[1:])
    return total


def _kept(count: int) -> slice:
    """Return every n-th of the integrals, which stay exact at these times."""
    return slice(None, None, -(-count // MAX_POINTS))
