"""The offset between two clocks and the rotation between two bodies, by search over all of both.

A peak of the agreement counts if unrelated motion would not reach it, and peaks that explain the
motion equally are all returned: then the offset is not determined.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.estimation.cells import Cells, cells_of_attitudes, cells_of_rates
from quatprop.estimation.covariances import MIN_CELLS, TINY, Candidate, Covariances, independent

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64
    from quatprop.kinematics.series import AttitudeSeries, GyroSeries

CELL_NS: Final = 40_000_000
"""Length of the shortest cells, ns."""

FACTORS: Final = (1, 3, 8, 20)
"""Longer cells, in these: noise of the attitudes dominates short ones."""

MAX_CELLS: Final = 1 << 16
"""Maximum number of cells of either series."""

CHANCE: Final = 1e-3
"""Probability with which unrelated motion is to reach a peak anywhere."""

MIRRORED: Final = 0.4
"""Mirrored axes must reduce the residuals to this share of those of the best rotation."""

SHARED: Final = 0.5
"""Minimum agreement of two series of one motion."""

BY_FAR: Final = 4.0
"""Others leave this many times as much: one offset of a motion that nearly repeats itself."""

RANK: Final = 0.5
"""B follows a rotation of A if it shows this share of it."""


class OffsetSearch(NamedTuple):
    """The result of a search.

    `rotated`: candidates of determinant 1, the best one first, then those that fit as well
    `mirrored`: the same of determinant -1
    `chance`: the gain that unrelated motion may reach
    `common`: number of common cells at the best offset
    `cell_ns`: length of the cells, ns
    """

    rotated: tuple[Candidate, ...]
    mirrored: tuple[Candidate, ...]
    chance: float
    common: int
    cell_ns: int

    @property
    def is_mirrored(self) -> bool:
        """Whether mirrored axes explain far more of the motion than any rotation."""
        best, other = self.rotated[0].score, self.mirrored[0].score
        is_better = 1 - other**2 < MIRRORED * (1 - best**2)
        return bool(is_better and self.mirrored[0].gain > self.chance)

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Those of the hand that explains more, the best one first."""
        return self.mirrored if self.is_mirrored else self.rotated

    @property
    def is_found(self) -> bool:
        """Whether one offset beats chance, and all others; or all others by far."""
        best = self.candidates[0]
        return len(self.candidates) == 1 and (best.gain > self.chance or best.margin > BY_FAR)

    @property
    def is_repeating(self) -> bool:
        """Whether both series share a motion that does not single out one offset."""
        score = self.candidates[0].score
        is_shared = score > SHARED and -np.log(1 - score**2) * self.common > self.chance
        return bool(is_shared) and not self.is_found


def search_series(
    rates: GyroSeries, reference: AttitudeSeries, mount: Float64 | None = None
) -> OffsetSearch | None:
    """Search the offset of a reference; None if the series are too short.

    `rates`, `reference`: in order of time, finite
    `mount`: rotation matrix from the axes of the rates to those of the reference, which is taken
        where the motion does not distinguish them; None: the identity
    """
    spans = [int(series.t_ns[-1]) - int(series.t_ns[0]) for series in (rates, reference)]
    intervals = [float(np.median(np.diff(series.t_ns))) for series in (rates, reference)]
    shortest = max(CELL_NS, int(1.5 * max(intervals)), max(spans) // MAX_CELLS)
    found = [
        search(cells_of_rates(rates, each), cells_of_attitudes(reference, each), mount)
        for each in (factor * shortest for factor in FACTORS)
        if each == shortest or each <= NS_PER_S
    ]
    return max(
        (one for one in found if one is not None),
        key=lambda one: one.candidates[0].gain,
        default=None,
    )


def search(a: Cells, b: Cells, mount: Float64 | None = None) -> OffsetSearch | None:
    """Search all lags, rotations and mirrors; None if the series are too short.

    Where B does not follow all rotations of A, such as a heading alone, once more without those.

    `a`, `b`: cells of one length
    `mount`: as for :func:`search_series`
    """
    mount = np.eye(3) if mount is None else mount
    found = _search(a, b, mount)
    if found is None or found.is_found:
        return found
    followed = _followed(a, b, found.candidates[0])
    if followed is None:
        return found
    again = _search(Cells(a.start_ns, a.length_ns, a.rate @ followed, a.known), b, mount)
    return again if again is not None and again.is_found else found


def _search(a: Cells, b: Cells, mount: Float64) -> OffsetSearch | None:
    both = Covariances.between(a, b)
    if not len(both.lags):
        return None
    share = independent(both.a, both.b)
    tries = np.log(len(both.lags) / CHANCE)
    rotated, mirrored = (both.best(hand, share, mount) for hand in (1, -1))
    # The tail of chi-squared: by one degree of freedom, as the motion may have one axis.
    chance = 1 + 2 * tries + 2 * np.sqrt(tries)
    common = int(both.common[np.argmax(both.gain(1, share))])
    return OffsetSearch(rotated, mirrored, float(chance), common, a.length_ns)


def _followed(a: Cells, b: Cells, best: Candidate) -> Float64 | None:
    """Return the projection of A's rates on what B follows, ``(3, 3)``; None if that is all."""
    lag = round((best.offset_ns - (a.start_ns - b.start_ns)) / a.length_ns)
    (at_b,) = np.nonzero(b.known)
    at_b = at_b[(at_b + lag >= 0) & (at_b + lag < len(a))]
    at_b = at_b[a.known[at_b + lag]]
    x, y = a.rate[at_b + lag] @ best.turn.T, b.rate[at_b]
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    _, axes = np.linalg.eigh(y.T @ y)
    share = (x @ axes * (y @ axes)).sum(axis=0) / (((x @ axes) ** 2).sum(axis=0) + TINY)
    shows = share > RANK
    if shows.all() or not shows.any():
        return None
    in_a = best.turn.T @ axes
    return np.asarray(in_a * shows @ in_a.T)


def candidate_at(
    a: Cells, b: Cells, offset_ns: int, mount: Float64 | None = None, *, mirrored: bool = False
) -> Candidate | None:
    """Return the best rotation, or mirror, at a given offset; None without common cells."""
    both = Covariances.between(a, b)
    lag = round((offset_ns - (a.start_ns - b.start_ns)) / a.length_ns)
    at = int(np.searchsorted(both.lags, lag))
    if at == len(both.lags) or both.lags[at] != lag:
        return None
    hand = -1 if mirrored else 1
    mount = np.eye(3) if mount is None else mount
    found = both.candidate(at, hand, both.gain(hand, independent(both.a, both.b)), mount)
    return found._replace(offset_ns=offset_ns)


def agreement(a: Cells, b: Cells) -> float:
    """Return the agreement of cells that begin with each other, 0 to 1, over all rotations."""
    first = (a.start_ns - b.start_ns) // b.length_ns
    begin, end = max(first, 0), min(first + len(a), len(b))
    if end - begin < MIN_CELLS:
        return 0.0
    of_a, of_b = slice(begin - first, end - first), slice(begin, end)
    known = a.known[of_a] & b.known[of_b]
    if known.sum() < MIN_CELLS:
        return 0.0
    x, y = (rate[known] - rate[known].mean(axis=0) for rate in (a.rate[of_a], b.rate[of_b]))
    sizes = np.linalg.svd(y.T @ x, compute_uv=False)
    return float(sizes.sum() / np.sqrt((x**2).sum() * (y**2).sum() + TINY))
