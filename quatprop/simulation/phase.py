"""Phases that are exact for any duration, and sines that are the same on every machine.

The phase ``f t`` of a rational frequency and an integer time is a ratio of integers, so whole turns
are removed without rounding: after a day the phase is as accurate as in the first second. For the
remainder, at most an eighth of a turn, a polynomial of IEEE additions and multiplications is used,
which are rounded alike everywhere. The sines of math libraries differ between processors in the
last place, and simulated logs must be reproducible to the byte.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import UsageError
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from fractions import Fraction

    from quatprop.arrays import Float64, Int64


_COSINE = [(-1) ** k / math.factorial(2 * k) for k in range(9)]
_SINE = [(-1) ** k / math.factorial(2 * k + 1) for k in range(9)]
"""Taylor coefficients; at an eighth of a turn the first omitted term is 5e-19 and 3e-20."""

# By number of quarter turns: cos = (c, -s, -c, s) and sin = (s, c, -s, -c).
_COSINE_SIGN = np.array([1.0, -1.0, -1.0, 1.0])
_SINE_SIGN = np.array([1.0, 1.0, -1.0, -1.0])


def of_time(elapsed_ns: Int64, frequency: Fraction) -> tuple[Float64, Float64]:
    """Return cosine and sine of the angle ``2 pi f t``.

    `elapsed_ns`: times, any shape, int64, ns
    `Returns`: two arrays of the shape of `elapsed_ns`, within 3e-16 of the true values
    """
    period = frequency.denominator * NS_PER_S
    if period * max(8, abs(frequency.numerator)) > np.iinfo(np.int64).max:
        raise UsageError(
            f"a frequency of {float(frequency)} Hz has too many digits to keep its phase exact; "
            "give it to three decimals"
        )
    return _of_ratio(elapsed_ns % period * frequency.numerator % period, period)


def of_degrees(angle: Fraction) -> tuple[float, float]:
    """Return cosine and sine of one angle in degrees."""
    turns = angle / 360 % 1
    cosine, sine = _of_ratio(np.array([turns.numerator]), turns.denominator)
    return float(cosine[0]), float(sine[0])


def _of_ratio(turns: Int64, period: int) -> tuple[Float64, Float64]:
    """Return cosine and sine of ``2 pi turns / period`` for ``0 <= turns < period``."""
    quarter = (8 * turns + period) // (2 * period)  # nearest number of quarter turns
    angle = (4 * turns - quarter * period) / period * (math.pi / 2)
    square = angle * angle
    cosine, sine = _polynomial(_COSINE, square), angle * _polynomial(_SINE, square)
    odd, quarter = quarter % 2 == 1, quarter % 4
    return (
        np.where(odd, sine, cosine) * _COSINE_SIGN[quarter] + 0.0,  # zeros lose their sign
        np.where(odd, cosine, sine) * _SINE_SIGN[quarter] + 0.0,
    )


def _polynomial(coefficients: list[float], square: Float64) -> Float64:
    total = np.full_like(square, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * square + coefficient
    return total
