"""Overlapping Allan variance of a stream of samples, in constant memory.

Of the angle S, the sum of the rates, the variance over m samples is the mean of
(S[k + 2m] - 2 S[k + m] + S[k])^2 / (2 m^2) over all k, or, for large m, over every (m / 16)-th k,
which tells as much. Only the angles that later differences need are kept.

References
----------
IEEE Std 952-2020, Annex C.

W. J. Riley, Handbook of Frequency Stability Analysis, NIST Special Publication 1065, 2008, 5.2.4.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64

OVERLAP: Final = 16
"""Minimum number of differences that begin within m samples."""

LEVELS: Final = 40
"""Maximum number of octaves of m: more than any log has."""

ROWS: Final = 1 << 15
"""Samples processed at a time, so that intermediate results stay in the cache."""


def stride(m: int) -> int:
    """Return the number of samples between the beginnings of differences over m samples."""
    return max(m // OVERLAP, 1)


class AllanSums:
    """Running sums of the squared second differences of the angle.

    `lengths`: samples of each piece; differences do not extend across pieces
    """

    def __init__(self) -> None:
        self.lengths: list[int] = []
        self._sums = np.zeros((LEVELS, 3))
        self._counts = np.zeros(LEVELS)
        self.begin_piece()

    def begin_piece(self) -> None:
        """Begin a new piece, after a gap."""
        self._angles: list[Float64] = [np.zeros((3, 0))] * LEVELS
        self._last = np.zeros((3, 1))
        self._seen = 0

    def add(self, rate: Float64) -> None:
        """Add the next samples of a piece, ``(N, 3)``, rad/s."""
        for start in range(0, len(rate), ROWS):
            self._add(rate[start : start + ROWS])

    def _add(self, rate: Float64) -> None:
        if not self._seen:
            # A constant rate cancels in the differences, but would add rounding errors.
            self._first = rate[:1].T
            self.lengths.append(0)
        self.lengths[-1] += len(rate)
        angles = np.cumsum(rate.T - self._first, axis=1) + self._last
        self._last = angles[:, -1:].copy()
        if not self._seen:
            angles = np.hstack([np.zeros((3, 1)), angles])
        first, self._seen = self._seen, self._seen + angles.shape[1]
        step = 1
        for level in range(LEVELS):
            m = 1 << level
            if stride(m) > step:
                # Every second one: those at multiples of the longer stride.
                angles = angles[:, (-first) % (2 * step) // step :: 2]
                step *= 2
                first = -(-first // step) * step
            self._add_level(level, m // step, angles)

    def _add_level(self, level: int, width: int, angles: Float64) -> None:
        """Add angles to the sums of a level with differences over this many of them."""
        if not angles.shape[1]:
            return
        angles = np.hstack([self._angles[level], angles])
        self._angles[level] = angles[:, -2 * width :].copy()
        if angles.shape[1] > 2 * width:
            turned = angles[:, width:] - angles[:, :-width]
            apart = turned[:, width:] - turned[:, :-width]
            self._sums[level] += (apart * apart).sum(axis=1)
            self._counts[level] += apart.shape[1]

    def variances(self) -> tuple[Int64, Float64]:
        """Return m, ``(T,)``, and the variances, ``(T, 3)``, (rad/s)^2; few m of a short log.

        Every m has differences enough to reach over one more m.
        """
        m = 1 << np.arange(LEVELS)
        room = np.maximum(np.array(self.lengths)[:, None] + 1 - 2 * m, 0).sum(axis=0)
        m = m[room >= m]
        some = slice(len(m))
        return m, self._sums[some] / self._counts[some, None] / (2 * m[:, None] ** 2)
