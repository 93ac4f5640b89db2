"""The terms of noise that explain Allan variances: generalised least squares.

The variances are a sum of terms with different slopes. All terms are fitted together, so that none
absorbs another; the weights are those of the fit itself. A term counts as
shown if chance explains it in one of a hundred cases; of others there is a bound.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from quatprop.arrays import Float64
    from quatprop.sensor_noise.covariance import Covariances

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

    `terms`: their squares in units of samples, ``(5,)``; any may be below 0 by chance; NaN where it
        is not fitted
    `sigmas`: standard deviations, of terms that are not shown those at their bound
    `first`: index of the first variance that the terms explain
    `above`: whether one before it is larger than they explain
    `freedoms`: equivalent degrees of freedom of each variance, ``(T,)``
    """

    terms: Float64
    sigmas: Float64
    first: int
    above: bool
    freedoms: Float64


def fit(variances: Float64, covariances: Covariances) -> TermFit | None:
    """Return the terms that explain variances, ``(T,)``; None if none do.

    Variances at the shortest times are left out where they follow no slope. Of what a filter or a
    vibration does there, longer times keep something that falls like quantisation, of either sign:
    it is fitted, and is none.
    """
    for first in range(len(variances) - SPARE):
        found = _fit_from(first, variances, covariances)
        if found is not None:
            return found
    return None


def _fit_from(first: int, variances: Float64, covariances: Covariances) -> TermFit | None:
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
    model, scatter = covariances.laws @ terms, np.sqrt(covariances.of(terms).diagonal())
    above = (variances > model + UNLIKELY * scatter)[:first].any()
    return TermFit(solved, sigmas, first, bool(above), 2 * (model / scatter) ** 2)


def _solved(
    variances: Float64, covariances: Covariances, first: int, chosen: list[int]
) -> tuple[Float64, Float64, Float64, float]:
    """Return the fit of some terms to the variances from one on.

    `Returns`: the terms, ``(5,)``, none below 0; the same as they come out, NaN where they are not
        chosen; their standard deviations; and the sum of squared residuals
    """
    y, laws = variances[first:], covariances.laws[first:, chosen]
    # To begin with, the relative errors are those of white noise.
    scales = y * np.sqrt(covariances.m[first:])
    terms, (solved, sigmas) = np.zeros(covariances.laws.shape[1]), np.full((2, 5), np.nan)
    terms[chosen] = np.maximum(np.linalg.lstsq(laws / scales[:, None], y / scales)[0], 0.0)
    for _ in range(ROUNDS):
        solved[chosen], sigmas[chosen], residual = _weighted(
            y, laws, covariances.of(terms)[first:, first:]
        )
        terms = (terms + np.maximum(np.nan_to_num(solved), 0.0)) / 2
    return terms, solved, sigmas, residual


def _at_bound(
    term: int,
    solved: Float64,
    terms: Float64,
    covariances: Covariances,
    part: tuple[int, list[int]],
) -> float:
    """Return the standard deviation of a term if it were as large as it may be.

    `part`: from which variance on, and which terms are fitted
    """
    first, chosen = part
    at, sigma, laws = terms.copy(), 0.0, covariances.laws[first:, chosen]
    for _ in range(ROUNDS):
        at[term] = max(solved[term], 0.0) + BOUND * sigma
        spread = _weighted(laws[:, 0], laws, covariances.of(at)[first:, first:])[1]
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


def chi_square(freedoms: Float64 | int, deviations: float) -> Float64:
    """Return the quantile of chi-square where the normal one is so many deviations.

    References
    ----------
    E. B. Wilson and M. M. Hilferty, "The distribution of chi-square", PNAS 17, 1931.
    """
    part = 2 / (9 * np.asarray(freedoms, np.float64))
    return np.asarray(freedoms * np.maximum(1 - part + deviations * np.sqrt(part), 0.0) ** 3)
