"""The terms of noise that explain Allan variances: generalised least squares.

The variances are a sum of terms, each with a slope of its own. All of them are fitted together, so
that no term takes what is another's; the weights are those of the fit itself. A term counts as
shown if chance explains it in one of a hundred cases; of others there is a bound.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from quatprop.arrays import Float64
    from quatprop.sensor_noise.covariance import Covariances

SHOWN: Final = 2.33
"""Standard deviations from which a term is shown: by chance, one in a hundred is."""

BOUND: Final = 1.645
"""Standard deviations of the bound that holds in 95 % of all cases."""

UNLIKELY: Final = 2.33
"""Residuals that are beyond this quantile of the normal distribution, one in a hundred, show that
the terms do not explain the variances."""

ROUNDS: Final = 20

SMALLEST: Final = 0.01
"""Eigenvalue of the correlations; smaller ones are neglected covariances."""

PRIORITY: Final = (1, 3, 2, 0, 4)
"""Which terms are fitted where the variances are few."""

SPARE: Final = 2
"""Variances beyond the number of terms, for the residuals to tell something."""


class Fit(NamedTuple):
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


def fit(variances: Float64, covariances: Covariances) -> Fit | None:
    """Return the terms that explain variances, ``(T,)``; None if none do.

    Variances at the shortest times are left out where they follow no slope, as behind a filter.
    """
    count = len(variances)
    for first in range(max(count - SPARE, 0)):
        # What is left of quantisation is at the shortest times, or it is something else.
        chosen = [term for term in PRIORITY if term or not first][: count - first - SPARE]
        found = _solved(variances, covariances, first, sorted(chosen))
        if found is not None:
            return found
    return None


def _solved(
    variances: Float64, covariances: Covariances, first: int, chosen: list[int]
) -> Fit | None:
    """Return the fit of some terms to the variances from one on; None if they do not fit."""
    y, laws = variances[first:], covariances.laws[first:, chosen]
    # To begin with, the relative errors are those of white noise.
    scales = y * np.sqrt(covariances.m[first:])
    terms = np.zeros(covariances.laws.shape[1])
    terms[chosen] = np.maximum(np.linalg.lstsq(laws / scales[:, None], y / scales)[0], 0.0)
    if not terms.any():
        terms[1] = y[0] * covariances.m[first]
    for _ in range(ROUNDS):
        solved, spread, residual = _weighted(y, laws, covariances.of(terms)[first:, first:])
        terms[chosen] = (terms[chosen] + np.maximum(solved, 0.0)) / 2
    # Nor is it explained by what has to be below 0.
    is_negative = (solved < -SHOWN * spread).any()
    if is_negative or residual > chi_square(len(y) - len(chosen), UNLIKELY):
        return None
    sigmas = np.full(len(terms), np.nan)
    for place, term in enumerate(chosen):
        at = terms.copy()
        sigmas[term] = spread[place]
        for _ in range(ROUNDS if solved[place] < SHOWN * spread[place] else 0):
            at[term] = max(solved[place], 0.0) + BOUND * sigmas[term]
            _, wider, _ = _weighted(y, laws, covariances.of(at)[first:, first:])
            sigmas[term] = wider[place]
    found = np.full(len(terms), np.nan)
    found[chosen] = solved
    model, spreads = covariances.laws @ terms, np.sqrt(covariances.of(terms).diagonal())
    above = (variances > model + UNLIKELY * spreads)[:first].any()
    return Fit(found, sigmas, first, bool(above), 2 * (model / spreads) ** 2)


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
