"""What two series of mean rates have in common at every lag, over all rotations and mirrors.

The cross-covariance C of both, for every lag at once by FFT, is 3 by 3. The best agreement over all
rotations is the sum of its singular values, the last one with the sign of the determinant; over all
mirrors with the other sign. Kabsch's solution gives the rotation.

References
----------
Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Cryst. A32, 1976.
Bartlett, "An introduction to stochastic processes", 1955: the variance of the cross-covariance of
unrelated series, which have fewer independent samples than samples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64, Int64, Intp
    from quatprop.estimation.cells import Cells

MIN_CELLS: Final = 20
"""Minimum number of cells in common."""

MIN_OVERLAP: Final = 0.3
"""Minimum overlap, as a share of the shorter series."""

WORTH_A_LOOK: Final = 0.8
"""Share of the score, or of the gain, of the highest peak that others need to be examined."""

MAX_PEAKS: Final = 12
"""Maximum number of peaks that are examined."""

PARTS: Final = 20
"""Parts of equal motion in which two candidates are compared."""

DIFFERENT: Final = 3.0
"""Standard deviations by which one candidate must explain the motion better than another."""

ABOVE_NOISE: Final = 30.0
"""Gain at one lag, of all cells, below which noise would choose the rotation."""

ROTATION: Final = 3.0
"""Independent cells that the rotation takes: it fits any motion of fewer."""

BIAS: Final = 0.15
"""Constant rates well above this, rad/s, are not biases, and show the rotation too."""

VALLEY: Final = 0.7
"""Peaks are different ones if the gain between them falls below this share of the lower one."""

FLAT: Final = 0.1
"""B shows one axis alone if it agrees about all others by less than this share of that."""

FAINT: Final = 0.05
"""Share of the mean square of A's rates below which its motion about an axis shows little."""

MIN_VARIATION: Final = 1e-6
"""Minimum relative variation of rates; rounding errors of constant ones are below it."""

TINY: Final = float(np.finfo(float).tiny)

BY_CHANCE: Final = 4.0
"""What relates two axes shows the rotation above this many standard deviations of noise."""

LARGEST: Final = 2
"""Number of cells below which an offset must beat chance."""

UNDECIDED: Final = 2e-3
"""Weight of the given mounting where the motion leaves the rotation free."""


class Candidate(NamedTuple):
    """One offset, and the rotation that fits best there.

    `offset_ns`: offset to add to the timestamps of B, ns
    `turn`: the orthogonal matrix that takes the axes of A to those of B, shape ``(3, 3)``; its
        determinant is -1 if the axes are mirrored
    `score`: agreement of the changing parts of both rates, 0 to 1
    `gain`: -n log(1 - score^2) for n + 3 independent cells: twice the gain of log likelihood
    `spread_ns`: standard deviation of the offset by the curvature of the peak, ns
    `margin`: of the best candidate: what any other one leaves, divided by what this one leaves
    """

    offset_ns: int
    turn: Float64
    score: float
    gain: float
    spread_ns: float
    margin: float = 1.0


class Covariances(NamedTuple):
    """Cross-covariances of two series at those lags with enough overlap.

    `lags`: cell k of B corresponds to cell k + lag of A, ``(L,)``
    `matrices`: sums of b a^T, shape ``(L, 3, 3)``
    `singular`: their singular values; the last with the sign of the determinant, ``(L, 3)``
    `common`: number of common cells, ``(L,)``
    `energy`: root of the product of both sums of squares over these, ``(L,)``
    `a`, `b`: rates without their mean, 0 where they are not known, ``(N, 3)``
    `known_a`, `known_b`: which are known
    `constant`: the outer product of the means that are no biases, ``(3, 3)``
    `power`: the same of A with itself, and its mean square, ``(3, 3)``
    `offset_ns`: the offset of lag 0
    `cell_ns`: length of the cells
    """

    lags: Int64
    matrices: Float64
    singular: Float64
    common: Float64
    energy: Float64
    a: Float64
    b: Float64
    known_a: Bool
    known_b: Bool
    constant: Float64
    power: Float64
    offset_ns: int
    cell_ns: int

    @classmethod
    def between(cls, a: Cells, b: Cells) -> Covariances:
        """Return those of two series of cells of one length."""
        (x, mean_a), (y, mean_b) = map(_centred, (a, b))
        size = 1 << (len(a) + len(b)).bit_length()
        lags = np.arange(1 - len(b), len(a))

        def correlated(of_a: Float64, of_b: Float64) -> Float64:
            product = np.fft.rfft(of_a, size, axis=0) * np.fft.rfft(of_b, size, axis=0).conj()
            return np.asarray(np.fft.irfft(product, size, axis=0)[lags])

        in_a, in_b = a.known.astype(float), b.known.astype(float)
        count = correlated(in_a, in_b).round()
        enough = count >= max(MIN_CELLS, MIN_OVERLAP * min(in_a.sum(), in_b.sum()))
        # About the means over the common part, which differ from the means of all.
        sums = [correlated(x, in_b[:, None]), correlated(in_a[:, None], y)]
        powers = [correlated((x**2).sum(axis=1), in_b), correlated(in_a, (y**2).sum(axis=1))]
        each = np.maximum(count, 1.0)
        powers = [
            power - (total**2).sum(axis=1) / each for power, total in zip(powers, sums, strict=True)
        ]
        rounding = np.finfo(float).eps * (x**2).sum() * (y**2).sum()
        product = np.maximum(powers[0], 0.0) * np.maximum(powers[1], 0.0)
        energy = np.sqrt(np.maximum(product, rounding) + TINY)
        columns = [[correlated(x[:, j], y[:, i])[enough] for j in range(3)] for i in range(3)]
        matrices = np.moveaxis(np.array(columns), 2, 0)
        of_a, of_b = (total[enough] for total in sums)
        matrices -= of_b[:, :, None] * of_a[:, None, :] / count[enough, None, None]
        singular = np.linalg.svd(matrices, compute_uv=False)
        singular[:, 2] *= np.sign(np.linalg.det(matrices))
        turning = float(np.linalg.norm(mean_a) * np.linalg.norm(mean_b))
        is_turning = turning / (turning + BIAS**2)
        constant = np.outer(mean_b, mean_a) * is_turning
        power = x.T @ x / max(in_a.sum(), 1.0) + np.outer(mean_a, mean_a) * is_turning
        return cls(
            lags[enough], matrices, singular, count[enough], energy[enough], x, y, a.known,
            b.known, constant, power, a.start_ns - b.start_ns, a.length_ns,
        )  # fmt: skip

    def score(self, hand: int) -> Float64:
        """Return the agreement at every lag, 0 to 1, shape ``(L,)``; `hand`: 1, or -1: mirrors."""
        total = self.singular[:, 0] + self.singular[:, 1] + hand * self.singular[:, 2]
        return np.clip(total / self.energy, 0.0, 1 - 1e-12)

    def gain(self, hand: int, share: float) -> Float64:
        """Return the gain at every lag; `share`: of the cells that are independent."""
        cells = np.maximum(share * self.common - ROTATION, 0.1 * share * self.common)
        return np.asarray(-cells * np.log(1 - self.score(hand) ** 2))

    def best(self, hand: int, share: float, mount: Float64) -> tuple[Candidate, ...]:
        """Return the best candidate, and those that explain the motion as well."""
        gain = self.gain(hand, share)
        high = np.pad(gain, 1, constant_values=-1.0)
        is_peak = (gain >= high[:-2]) & (gain > high[2:])
        score = self.score(hand)
        enough = WORTH_A_LOOK * float(score[np.argmax(gain)])
        is_peak &= (gain >= WORTH_A_LOOK * gain.max()) | (score >= enough)
        (peaks,) = np.nonzero(is_peak)
        peaks = peaks[np.argsort(-gain[peaks], kind="stable")]
        peaks = peaks[_separate(gain, peaks)][:MAX_PEAKS]
        if not len(peaks):
            peaks = np.array([np.argmax(gain)])
        found = [self.candidate(int(at), hand, gain, mount) for at in peaks]
        equal, ratio = self._as_good(found)
        # What peaks leave that are not looked at.
        ratio = min(ratio, float((1 - enough**2) / (1 - found[0].score ** 2)))
        alone = self._without_largest(int(self.lags[peaks[0]]), found[0].turn, share)
        first = found[0]._replace(margin=ratio, gain=min(found[0].gain, alone))
        return (first, *(one for one, keep in zip(found[1:], equal, strict=True) if keep))

    def candidate(self, at: int, hand: int, gain: Float64, mount: Float64) -> Candidate:
        """Return the candidate at the lag of an index."""
        before, peak, after = (float(gain[np.clip(at + k, 0, len(gain) - 1)]) for k in (-1, 0, 1))
        curvature = 2 * peak - before - after
        shift = 0.5 * (after - before) / curvature if curvature > 0 else 0.0
        spread = np.sqrt(2 / curvature) if curvature > 0 else float(len(gain))
        lag = float(self.lags[at]) + float(np.clip(shift, -0.5, 0.5))
        both = self.constant
        if self.score(hand)[at] ** 2 * self.common[at] > ABOVE_NOISE:
            both = both + self.matrices[at] / self.common[at]
            left = np.sqrt((1 - self.score(hand)[at] ** 2) / self.common[at])
            chance = BY_CHANCE * left * self.energy[at]
            if self.singular[at, 1] < max(FLAT * self.singular[at, 0], chance):
                both = self._one_axis(both)
        return Candidate(
            self.offset_ns + round(lag * self.cell_ns),
            kabsch(both, mount, mirrored=hand < 0),
            float(self.score(hand)[at]),
            peak,
            float(spread * self.cell_ns),
        )

    def _without_largest(self, lag: int, turn: Float64, share: float) -> float:
        """Return the gain without those few cells that agree most, which may do so by chance.

        `share`: of the cells that are independent
        """
        (at_b,) = np.nonzero(self.known_b)
        at_b = at_b[(at_b + lag >= 0) & (at_b + lag < len(self.a))]
        at_b = at_b[self.known_a[at_b + lag]]
        x, y = self.a[at_b + lag] @ turn.T, self.b[at_b]
        common = ((x - x.mean(axis=0)) * (y - y.mean(axis=0))).sum(axis=1)
        keep = np.argsort(common)[:-LARGEST]
        x, y = (each[keep] - each[keep].mean(axis=0) for each in (x, y))
        power = (x**2).sum() * (y**2).sum()
        score = np.clip((x * y).sum() / np.sqrt(power + TINY), 0.0, 1 - 1e-12)
        cells = max(share * len(keep) - ROTATION, 0.1 * share * len(keep))
        return float(-cells * np.log(1 - score**2))

    def _one_axis(self, both: Float64) -> Float64:
        """Return the axis of A that corresponds to the single axis of B, as a matrix of rank 1.

        By least squares: what B does not follow may be larger than what it does.
        """
        mean = float(np.trace(self.power)) / 3 + TINY
        by_power = np.linalg.solve(self.power / mean + FAINT * np.eye(3), both.T / mean).T
        left, sizes, right = np.linalg.svd(by_power)
        return np.asarray(sizes[0] * np.outer(left[:, 0], right[0]))

    def _as_good(self, found: list[Candidate]) -> tuple[list[bool], float]:
        """Return which of the further candidates leave as little of the motion as the first one.

        In parts of equal motion: what they leave differs by less than it scatters.

        `Returns`: which; and the smallest ratio of what they leave to what the first one leaves
        """
        left = [
            self._residuals((one.offset_ns - self.offset_ns) / self.cell_ns, one.turn)
            for one in found
        ]
        equal, ratio = [], np.inf
        for other in left[1:]:
            (both,) = np.nonzero(np.isfinite(left[0]) & np.isfinite(other))
            if len(both) < MIN_CELLS:
                equal.append(True)
                ratio = 1.0
                continue
            motion = np.cumsum((self.b[both] ** 2).sum(axis=1))
            part = np.minimum(PARTS * motion / motion[-1], PARTS - 1).astype(int)
            more = np.bincount(part, other[both] - left[0][both], PARTS)
            error = more.std(ddof=1) / np.sqrt(PARTS)
            equal.append(bool(more.mean() <= DIFFERENT * error))
            least = float(left[0][both].sum()) + TINY
            ratio = min(ratio, float(other[both].sum()) / least)
        return equal, ratio

    def _residuals(self, lag: float, turn: Float64) -> Float64:
        """Return the squared difference of each cell of B from A's, ``(N,)``; NaN without one.

        What a small shift explains is left out, to second order, and a small rotation, which
        trade for each other.

        `lag`: in cells, of any fraction
        """
        whole = round(lag)
        at = np.arange(len(self.b)) + whole
        inside = (at > 0) & (at < len(self.a) - 1) & self.known_b
        at = np.clip(at, 1, len(self.a) - 2)
        moved = _moved(self.a, lag - whole) @ turn.T
        before, here, after = (moved[at + k] for k in (-1, 0, 1))
        for k in (-1, 0, 1):
            inside &= self.known_a[at + k]
        left = (self.b - here)[inside]
        turned = [np.cross(axis, here) for axis in np.eye(3)]
        slopes = [after - before, after - 2 * here + before, *turned]
        basis = np.stack([slope[inside].ravel() for slope in slopes], axis=1)
        by = np.linalg.lstsq(basis, left.ravel(), rcond=None)[0]
        squares = np.full(len(self.b), np.nan)
        squares[inside] = ((left.ravel() - basis @ by).reshape(-1, 3) ** 2).sum(axis=1)
        return squares


def kabsch(covariance: Float64, mount: Float64, *, mirrored: bool = False) -> Float64:
    """Return the orthogonal matrix R with the largest trace of R^T C.

    What C leaves free is taken as near to `mount` as can be; between halves of a turn, which are
    equally near, the x axis is turned about before y, and y before z.

    `covariance`: C, sum of b a^T, shape ``(3, 3)``
    `Returns`: A's axes to B's, shape ``(3, 3)``; its determinant is -1 if `mirrored`
    """
    prior = mount @ np.diag([1.0, 0.98, 0.96])
    size = np.linalg.norm(covariance) or 1.0
    left, _, right = np.linalg.svd(covariance + UNDECIDED * size * prior)
    sign = np.sign(np.linalg.det(left @ right)) * (-1 if mirrored else 1)
    return np.asarray(left @ np.diag([1.0, 1.0, sign]) @ right)


def _separate(gain: Float64, peaks: Intp) -> list[int]:
    """Return which peaks, from the highest on, are apart from all higher ones by a valley."""
    kept: list[int] = []
    for number, at in enumerate(peaks):
        others = [sorted((int(at), int(peaks[k]))) for k in kept]
        if all(gain[a : b + 1].min() < VALLEY * gain[at] for a, b in others):
            kept.append(number)
        if len(kept) == MAX_PEAKS:
            break
    return kept


def _moved(rate: Float64, by: float) -> Float64:
    """Return rates at later times, by a part of a cell: the series of that band."""
    size = 1 << len(rate).bit_length()
    phase = np.exp(2j * np.pi * by * np.fft.rfftfreq(size))
    return np.asarray(np.fft.irfft(np.fft.rfft(rate, size, axis=0) * phase[:, None], size, axis=0))


def _centred(cells: Cells) -> tuple[Float64, Float64]:
    """Return the rates without their mean, 0 where they are not known, and the mean."""
    if not cells.known.any():
        return np.zeros_like(cells.rate), np.zeros(3)
    mean = cells.rate[cells.known].mean(axis=0)
    rate = np.where(cells.known[:, None], cells.rate - mean, 0.0)
    is_steady = np.abs(rate).max() <= MIN_VARIATION * np.abs(mean).max()
    return rate * (not is_steady), mean


def independent(a: Float64, b: Float64) -> float:
    """Return the share of the cells that are independent if the motions are unrelated."""
    count = min(len(a), len(b))
    size = 1 << (2 * max(len(a), len(b))).bit_length()
    total = np.ones(count)
    for rate in (a, b):
        power = (np.abs(np.fft.rfft(rate, size, axis=0)) ** 2).sum(axis=1)
        covariance = np.fft.irfft(power, size)[:count]
        total *= covariance / (covariance[0] or 1.0)
    return float(1 / max(1.0, 2 * total.sum() - total[0]))
