"""Cosine and sine of half an angle of any size, rounded alike on every processor.

The sines of math libraries differ in the last place between processors, so only additions,
multiplications, divisions and square roots are used here.
"""

from __future__ import annotations

from math import factorial, pi
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from quatprop.arrays import Float64


TERMS = 5
"""Number of terms of the series for cosine and ratio: enough for steps of 11 degrees."""

_COSINE = [(-1) ** k / (4**k * factorial(2 * k)) for k in range(TERMS)]
_RATIO = [(-1) ** k / (2 * 4**k * factorial(2 * k + 1)) for k in range(TERMS)]
_REACH = 4 * (2.0**-55 * factorial(2 * TERMS)) ** (1 / TERMS)
"""Square of the largest angle, rad^2, at which the series are exact to a quarter ulp."""

_LONG_COSINE = [(-1) ** k / factorial(2 * k) for k in range(2, 9)]
_LONG_SINE = [(-1) ** k / factorial(2 * k + 1) for k in range(1, 9)]
"""Taylor coefficients of all but the leading terms. At an eighth of a turn the first omitted term
is 5e-19 and 3e-20."""

_QUARTER = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
"""A quarter turn, rad, in parts: multiples of the first two, up to 2**20, are exact."""

_MANY_TURNS = 2 * pi * 2**17
"""Multiples of this angle, rad, are removed from longer ones, within their own rounding."""


def half_angle(square: Float64) -> tuple[Float64, Float64]:
    """Return cos(a/2) and sin(a/2)/a from the squares of the angles a.

    Both are power series in a squared, smooth through zero; for larger angles, in the remainder of
    quarter turns. Each result depends only on its own angle, to the bit.

    `square`: squares of angles, rad^2, any shape
    `Returns`: cos(a/2) and sin(a/2)/a, the latter 1/2 at zero; 1/rad
    """
    square = np.asarray(square)
    with np.errstate(over="ignore", invalid="ignore"):
        cosine, ratio = _series(_COSINE, square), _series(_RATIO, square)
        beyond = square > _REACH
        if beyond.any():
            angle = np.sqrt(square[beyond])
            cosine[beyond], sine = _cosine_and_sine(angle / 2)
            ratio[beyond] = sine / angle
    return cosine, ratio


def _cosine_and_sine(angle: Float64) -> tuple[Float64, Float64]:
    """Return cosine and sine of angles of any size, rad.

    References
    ----------
    fdlibm, Sun Microsystems, 1993: the rounding errors of the leading terms are added to the
    smaller ones.
    """
    angle = np.fmod(angle, _MANY_TURNS)
    quarters = np.rint(angle / (pi / 2))
    high, middle, low = (quarters * part for part in _QUARTER)
    angle -= high
    x = angle - middle
    rounding = (angle - x - middle) - low
    square = x * x
    half = square / 2
    leading = 1 - half
    small = square * square * _series(_LONG_COSINE, square) - x * rounding
    cosine = leading + (1 - leading - half + small)
    sine = x + (x * (square * _series(_LONG_SINE, square)) + leading * rounding)
    odd, sign = quarters % 2 == 1, np.where(quarters % 4 >= 2, -1.0, 1.0)  # noqa: PLR2004  # halves
    return sign * np.where(odd, -sine, cosine), sign * np.where(odd, cosine, sine)


def _series(coefficients: list[float], x: Float64) -> Float64:
    """Return the polynomial with these coefficients, lowest first, by Horner's rule."""
    lowest, *middle, highest = coefficients
    total = np.multiply(x, highest, out=np.empty_like(x))
    for coefficient in reversed(middle):
        total += coefficient
        total *= x
    total += lowest
    return total
