"""The covariance of estimates of the Allan variance.

Of Gaussian noise the covariance of two such means of squares is 2 / (N1 N2) times the sum of
R(i - k)^2 over all pairs of second differences that they are made of. R follows from the
generalised covariance of the angle, which each kind of noise has in closed form. The equivalent
degrees of freedom are 2 / (relative variance).

References
----------
C. A. Greenhall and W. J. Riley, "Uncertainty of Stability Variances Based on Finite Differences",
35th Precise Time and Time Interval Meeting, 2003.

N. El-Sheimy, H. Hou and X. Niu, "Analysis and Modeling of Inertial Sensors Using Allan Variance",
IEEE Transactions on Instrumentation and Measurement 57(1), 2008.
"""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.sensor_noise.allan import stride

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.arrays import Float64, Int64

RELATED: Final = 8
"""Variances more octaves apart than this count as independent."""

RANDOM: Final = 4
"""Number of random terms; the last term, the ramp, is deterministic."""

SECOND: Final = ((0, 1), (1, -2), (2, 1))
"""The second difference: multiples of m, and their weights."""


class Covariances(NamedTuple):
    """The covariance of variances as a quadratic form of the terms of noise.

    `m`: numbers of averaged samples, ``(T,)``
    `laws`: the variance at each m for a term of size 1, ``(T, 5)``: quantisation, angle random
        walk, bias instability, rate random walk, ramp; for a time of 1 between samples
    `forms`: shape ``(5, 5, T, T)``
    """

    m: Int64
    laws: Float64
    forms: Float64

    def of(self, terms: Float64) -> Float64:
        """Return the covariance, ``(T, T)``, for the sizes of the terms, ``(5,)``, not negative."""
        return np.asarray(np.einsum("i,j,ijkl->kl", terms, terms, self.forms))


def laws(m: Float64) -> Float64:
    """Return the variances due to each term, ``(T, 5)``; IEEE Std 952-2020, Annex C."""
    flat = np.full(len(m), 2 * math.log(2) / math.pi)
    return np.stack([3 / m**2, 1 / m, flat, m / 3, m**2 / 2], axis=1)


def covariances(m: Int64, lengths: Sequence[int]) -> Covariances:
    """Return the covariances for pieces with these numbers of samples."""
    room = _Room(lengths)
    forms = np.zeros((RANDOM + 1, RANDOM + 1, len(m), len(m)))
    for one in range(len(m)):
        for two in range(one, min(one + RELATED + 1, len(m))):
            pair = _form(int(m[one]), int(m[two]), room)
            forms[:, :, one, two] = forms[:, :, two, one] = pair
    return Covariances(m, laws(m.astype(np.float64)), forms)


class _Room:
    """Counts positions in pieces: a piece of N samples has N + 1 angles."""

    def __init__(self, lengths: Sequence[int]) -> None:
        self._sizes = np.sort(np.array(lengths, np.float64)) + 1
        self._totals = np.append(np.cumsum(self._sizes[::-1])[::-1], 0.0)

    def of(self, span: Float64) -> Float64:
        """Return the number of positions for an interval of this many samples."""
        first = np.searchsorted(self._sizes, span, side="right")
        return np.asarray(self._totals[first] - span * (len(self._sizes) - first))


def _form(m: int, longer: int, room: _Room) -> Float64:
    """Return the form of one pair of variances, ``(5, 5)``."""
    step = stride(m)
    short, long = m // step, longer // step
    lags = np.arange(-2 * (short + long), 4 * long + 1, dtype=np.float64)
    related = np.zeros((RANDOM, len(lags)))
    for (p, first), (q, second) in product(SECOND, SECOND):
        related += first * second * _generalised(lags + p * short - q * long)
    related *= float(step) ** np.arange(RANDOM)[:, None]
    spans = np.maximum(2 * m, 2 * longer - lags * step) + np.maximum(lags * step, 0)
    places = room.of(np.array([2 * m, 2 * longer]))
    weights = step * room.of(spans) / (places[0] * places[1])
    form = np.zeros((RANDOM + 1, RANDOM + 1))
    form[:RANDOM, :RANDOM] = (related * weights) @ related.T / (2.0 * m**2 * longer**2)
    # The ramp r leaves the mean r m^2 in each difference: 4 r^2 m1^2 m2^2 R beside 2 R^2.
    form[:RANDOM, RANDOM] = form[RANDOM, :RANDOM] = (related * weights).sum(axis=1) / 2
    return form


def _generalised(lags: Float64) -> Float64:
    """Return the generalised covariances of the angle, a row for each random term."""
    t = np.abs(lags)
    flicker = t**2 * np.log(np.where(t > 0, t, 1.0)) / (2 * math.pi)
    return np.stack([(t == 0).astype(np.float64), -t / 2, flicker, t**3 / 12])
