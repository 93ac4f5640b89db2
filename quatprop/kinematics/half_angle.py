"""Cosine and sine of half an angle, for steps of any size."""

from __future__ import annotations

from math import factorial
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64 = NDArray[np.float64]

TERMS = 5
"""Of the series for cosine and sine: enough for steps of 11 degrees; libm is for longer steps."""

_COSINE = [(-1) ** k / (4**k * factorial(2 * k)) for k in range(TERMS)]
_RATIO = [(-1) ** k / (2 * 4**k * factorial(2 * k + 1)) for k in range(TERMS)]
_REACH = 4 * (2.0**-55 * factorial(2 * TERMS)) ** (1 / TERMS)
"""Square of the largest angle for which the series leave out less than a quarter ulp."""


def half_angle(square: Float64) -> tuple[Float64, Float64]:
    """Return cos(a/2) and sin(a/2)/a from the squares of the angles a.

    Both are power series in a squared, smooth through zero; beyond their reach libm takes over.
    Each result depends on its own angle only, to the bit.

    Parameters
    ----------
    square
        Squares of angles, rad^2, any shape.

    Returns
    -------
    cosine, ratio : ndarray
        cos(a/2) and sin(a/2)/a, the latter 1/2 at zero; 1/rad.
    """
    square = np.asarray(square)
    with np.errstate(over="ignore", invalid="ignore"):
        cosine, ratio = _series(_COSINE, square), _series(_RATIO, square)
    beyond = square > _REACH
    if beyond.any():
        angle = np.sqrt(square[beyond])
        cosine[beyond] = np.cos(angle / 2)
        ratio[beyond] = np.sin(angle / 2) / angle
    return cosine, ratio


def _series(coefficients: list[float], x: Float64) -> Float64:
    """Return the polynomial with these coefficients, lowest first, by Horner's rule."""
    *lower, last = coefficients
    total = np.full_like(x, last)
    for coefficient in reversed(lower):
        total *= x
        total += coefficient
    return total
