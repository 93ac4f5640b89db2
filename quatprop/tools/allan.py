"""Overlapping Allan variance of a stream, its covariance, and the fit of noise terms.

Of the angle S, the sum of the rates, the variance over m samples is the mean of
(S[k + 2m] - 2 S[k + m] + S[k])^2 / (2 m^2) over all k, or, for large m, over every (m / 16)-th k,
which tells as much. Only the angles that later differences need are kept.

References
----------
IEEE Std 952-2020, Annex C.

W. J. Riley, Handbook of Frequency Stability Analysis, NIST Special Publication 1065, 2008, 5.2.4.
"""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.base.arrays import Float64, Int64


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
        """Return the averaging factors m, ``(T,)``, and the variances, ``(T, 3)``, (rad/s)^2.

        Each m has at least m differences, so a short log has few.
        """
        m = 1 << np.arange(LEVELS)
        room = np.maximum(np.array(self.lengths)[:, None] + 1 - 2 * m, 0).sum(axis=0)
        m = m[room >= m]
        some = slice(len(m))
        return m, self._sums[some] / self._counts[some, None] / (2 * m[:, None] ** 2)


# The covariance of estimates of the Allan variance.
#
# Of Gaussian noise the covariance of two such means of squares is 2 / (N1 N2) times the sum of
# R(i - k)^2 over all pairs of second differences that they are made of. R follows from the
# generalised covariance of the angle, which each kind of noise has in closed form. The equivalent
# degrees of freedom are 2 / (relative variance).
#
# Reference: C. A. Greenhall and W. J. Riley, "Uncertainty of Stability Variances Based on Finite
# Differences", 35th Precise Time and Time Interval Meeting, 2003.
#
# N. El-Sheimy, H. Hou and X. Niu, "Analysis and Modeling of Inertial Sensors Using Allan Variance",
# IEEE Transactions on Instrumentation and Measurement 57(1), 2008.


RELATED: Final = 8
"""Variances more octaves apart than this count as independent."""

RANDOM: Final = 4
"""Number of random terms; the last term, the ramp, is deterministic."""

SECOND: Final = ((0, 1), (1, -2), (2, 1))
"""The second difference: multiples of m, and their weights."""


class AllanCovariances(NamedTuple):
    """The covariance of variances as a quadratic form of the terms of noise.

    `m`: numbers of averaged samples, ``(T,)``
    `laws`: the variance at each m for a term of size 1, ``(T, 5)``: quantisation, angle random
        walk, bias instability, rate random walk, ramp; for a time of 1 between samples
    `forms`: shape ``(5, 5, T, T)``
    """

    m: Int64
    laws: Float64
    forms: Float64

    def for_terms(self, terms: Float64) -> Float64:
        """Return the covariance, ``(T, T)``, for the sizes of the terms, ``(5,)``, not negative."""
        return np.asarray(np.einsum("i,j,ijkl->kl", terms, terms, self.forms))


def laws(m: Float64) -> Float64:
    """Return the variances due to each term, ``(T, 5)``; IEEE Std 952-2020, Annex C."""
    flat = np.full(len(m), 2 * math.log(2) / math.pi)
    return np.stack([3 / m**2, 1 / m, flat, m / 3, m**2 / 2], axis=1)


def covariances(m: Int64, lengths: Sequence[int]) -> AllanCovariances:
    """Return the covariances for pieces with these numbers of samples."""
    room = _Positions(lengths)
    forms = np.zeros((RANDOM + 1, RANDOM + 1, len(m), len(m)))
    for one in range(len(m)):
        for two in range(one, min(one + RELATED + 1, len(m))):
            pair = _form(int(m[one]), int(m[two]), room)
            forms[:, :, one, two] = forms[:, :, two, one] = pair
    return AllanCovariances(m, laws(m.astype(np.float64)), forms)


class _Positions:
    """Counts positions in pieces: a piece of N samples has N + 1 angles."""

    def __init__(self, lengths: Sequence[int]) -> None:
        self._sizes = np.sort(np.array(lengths, np.float64)) + 1
        self._totals = np.append(np.cumsum(self._sizes[::-1])[::-1], 0.0)

    def count(self, span: Float64) -> Float64:
        """Return the number of positions for an interval of this many samples."""
        first = np.searchsorted(self._sizes, span, side="right")
        return np.asarray(self._totals[first] - span * (len(self._sizes) - first))


def _form(m: int, longer: int, room: _Positions) -> Float64:
    """Return the form of one pair of variances, ``(5, 5)``."""
    step = stride(m)
    short, long = m // step, longer // step
    lags = np.arange(-2 * (short + long), 4 * long + 1, dtype=np.float64)
    related = np.zeros((RANDOM, len(lags)))
    for (p, first), (q, second) in product(SECOND, SECOND):
        related += first * second * _generalised(lags + p * short - q * long)
    related *= float(step) ** np.arange(RANDOM)[:, None]
    spans = np.maximum(2 * m, 2 * longer - lags * step) + np.maximum(lags * step, 0)
    places = room.count(np.array([2 * m, 2 * longer]))
    weights = step * room.count(spans) / (places[0] * places[1])
    form = np.zeros((RANDOM + 1, RANDOM + 1))
    form[:RANDOM, :RANDOM] = (related * weights) @ related.T / (2.0 * m**2 * longer**2)
    # The ramp r leaves the mean r m^2 in each difference: 4 r^2 m1^2 m2^2 R next to 2 R^2.
    form[:RANDOM, RANDOM] = form[RANDOM, :RANDOM] = (related * weights).sum(axis=1) / 2
    return form


def _generalised(lags: Float64) -> Float64:
    """Return the generalised covariances of the angle, a row for each random term."""
    t = np.abs(lags)
    flicker = t**2 * np.log(np.where(t > 0, t, 1.0)) / (2 * math.pi)
    return np.stack([(t == 0).astype(np.float64), -t / 2, flicker, t**3 / 12])


# The terms of noise that explain Allan variances: generalised least squares.
#
# The variances are a sum of terms with different slopes. All terms are fitted together, so that
# none absorbs another; the weights are those of the fit itself. A term counts as shown if chance
# explains it in one of a hundred cases; of others there is a bound.


SHOWN: Final = 2.33
"""Significance, in standard deviations, from which a term is stated: 1 in 100 by chance."""

BOUND: Final = 1.645
"""Standard deviations of a one-sided 95 % bound."""

UNLIKELY, DOUBTFUL = 3.09, 2.33
"""Residuals beyond this quantile of the normal distribution, one in a thousand, show that the terms
do not explain all variances; beyond this one, one in a hundred, not those that are left."""

ROUNDS: Final = 20

SMALLEST: Final = 0.01
"""Minimum eigenvalue of the correlations: smaller ones come from neglected covariances."""

PRIORITY: Final = (1, 0, 3, 2, 4)
"""Order in which terms are fitted if there are few variances."""

SPARE: Final = 2
"""Minimum degrees of freedom of the residuals."""


LEFT: Final = 0.3
"""Share of the first variance that the effect of a filter or a vibration may leave."""


WHITE: Final = 0.5
"""Share of it that is white noise if only short times were affected."""


class TermFit(NamedTuple):
    """The terms of one axis.

    `terms`: squared coefficients, with tau in samples, ``(5,)``; any may be below 0 by chance; NaN
        for a term that is not fitted
    `sigmas`: their standard deviations; for a term that is not significant, that at its bound
    `first`: index of the first variance that the terms explain
    `has_unexplained_short_term`: whether a variance before it is larger than the terms explain
    `degrees_of_freedom`: equivalent degrees of freedom of each variance, ``(T,)``
    """

    terms: Float64
    sigmas: Float64
    first: int
    has_unexplained_short_term: bool
    degrees_of_freedom: Float64


def fit(variances: Float64, covariances: AllanCovariances) -> TermFit | None:
    """Return the terms that explain variances, ``(T,)``; None if none do.

    Variances at the shortest times are left out where they follow no slope. Of what a filter or a
    vibration does there, longer times keep something that falls like quantisation, of either sign:
    a term for that is fitted, and not stated.
    """
    for first in range(len(variances) - SPARE):
        found = _fit_from(first, variances, covariances)
        if found is not None:
            return found
    return None


def _fit_from(first: int, variances: Float64, covariances: AllanCovariances) -> TermFit | None:
    """Return the terms that explain the variances from one on; None if they do not."""
    count = len(variances) - first
    chosen = sorted(PRIORITY[: count - SPARE])
    terms, solved, sigmas, residual = _solved(variances, covariances, first, chosen)
    shares = solved * covariances.laws[first] / variances[first]
    ways = np.nan_to_num(solved / sigmas)
    if first:
        ways[0] = 0.0
    limit = DOUBTFUL if first else UNLIKELY
    if (
        # Every gyroscope has white noise, unless the steps of its angles hide it.
        (ways[:2] < SHOWN).all()
        or (ways < -limit).any()
        or residual > chi_square(count - len(chosen), limit)
        or (first and (abs(shares[0]) > LEFT or shares[1] < WHITE))
    ):
        return None
    for term in chosen:
        if ways[term] < SHOWN:
            sigmas[term] = _at_bound(term, solved, terms, covariances, (first, chosen))
    if first:
        solved[0] = sigmas[0] = np.nan
    model, scatter = covariances.laws @ terms, np.sqrt(covariances.for_terms(terms).diagonal())
    above = (variances > model + UNLIKELY * scatter)[:first].any()
    return TermFit(solved, sigmas, first, bool(above), 2 * (model / scatter) ** 2)


def _solved(
    variances: Float64, covariances: AllanCovariances, first: int, chosen: list[int]
) -> tuple[Float64, Float64, Float64, float]:
    """Return the fit of some terms to the variances from one on.

    `Returns`: the terms, ``(5,)``, none below 0; the same as they come out, NaN where they are not
        chosen; their standard deviations; and the sum of squared residuals
    """
    y, laws = variances[first:], covariances.laws[first:, chosen]
    # To begin with, the relative errors are those of white noise.
    scales = y * np.sqrt(covariances.m[first:])
    terms, (solved, sigmas) = np.zeros(covariances.laws.shape[1]), np.full((2, 5), np.nan)
    terms[chosen] = np.maximum(
        np.linalg.lstsq(laws / scales[:, None], y / scales, rcond=None)[0], 0.0
    )
    for _ in range(ROUNDS):
        solved[chosen], sigmas[chosen], residual = _weighted(
            y, laws, covariances.for_terms(terms)[first:, first:]
        )
        terms = (terms + np.maximum(np.nan_to_num(solved), 0.0)) / 2
    return terms, solved, sigmas, residual


def _at_bound(
    term: int,
    solved: Float64,
    terms: Float64,
    covariances: AllanCovariances,
    part: tuple[int, list[int]],
) -> float:
    """Return the standard deviation of a term if it were as large as it may be.

    `part`: from which variance on, and which terms are fitted
    """
    first, chosen = part
    at, sigma, laws = terms.copy(), 0.0, covariances.laws[first:, chosen]
    for _ in range(ROUNDS):
        at[term] = max(solved[term], 0.0) + BOUND * sigma
        spread = _weighted(laws[:, 0], laws, covariances.for_terms(at)[first:, first:])[1]
        sigma = float(spread[chosen.index(term)])
    return sigma


def _weighted(y: Float64, laws: Float64, covariance: Float64) -> tuple[Float64, Float64, float]:
    """Return the terms, their standard deviations and the sum of squared residuals."""
    scales = np.sqrt(covariance.diagonal())
    values, vectors = np.linalg.eigh(covariance / np.outer(scales, scales))
    # Of variances far apart, whose covariance is neglected, values may come out below 0.
    half = vectors / np.sqrt(np.maximum(values, SMALLEST))
    white = half.T @ np.column_stack([laws / scales[:, None], y / scales])
    sizes = np.linalg.norm(white[:, :-1], axis=0)
    q, r = np.linalg.qr(white[:, :-1] / sizes)
    part = q.T @ white[:, -1]
    inverse = np.linalg.inv(r)
    spread = np.sqrt((inverse**2).sum(axis=1)) / sizes
    return inverse @ part / sizes, spread, float((white[:, -1] ** 2).sum() - (part**2).sum())


def chi_square(degrees_of_freedom: Float64 | int, deviations: float) -> Float64:
    """Return the quantile of chi-square where the normal one is so many deviations.

    References
    ----------
    E. B. Wilson and M. M. Hilferty, "The distribution of chi-square", PNAS 17, 1931.
    """
    part = 2 / (9 * np.asarray(degrees_of_freedom, np.float64))
    return np.asarray(
        degrees_of_freedom * np.maximum(1 - part + deviations * np.sqrt(part), 0.0) ** 3
    )
