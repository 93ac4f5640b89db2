"""The noise of a gyroscope, as values with their units."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.sensor_noise.fit import BOUND, SHOWN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.arrays import Float64
    from quatprop.sensor_noise.fit import TermFit
    from quatprop.tables.log import Loss
    from quatprop.text import Remark


class NoiseTerm(NamedTuple):
    """One term of the noise, or how large it is at most.

    Parameters
    ----------
    value
        Its size, in the unit of the term; None where the recording does not show it.
    sigma
        Standard deviation of the value; None where there is none.
    at_most
        What a term that is not shown is at most, with 95 % confidence; None where it is shown, or
        where the recording is too short to tell.
    """

    value: float | None = None
    sigma: float | None = None
    at_most: float | None = None

    @property
    def relative(self) -> float:
        """The standard deviation as a share of the value; NaN where there is no value."""
        return math.nan if self.value is None or self.sigma is None else self.sigma / self.value


class NoiseTerms(NamedTuple):
    """The noise of one axis, or that of all axes together.

    Parameters
    ----------
    quantisation
        Of angles, rad: the standard deviation of the white noise in the angle.
    angle_random_walk
        White noise of the rate, rad/s/sqrt(Hz).
    bias_instability
        Flicker noise of the rate, rad/s: the coefficient B, whose deviation is 0.664 B at any time.
    rate_random_walk
        Random walk of the rate, rad/s^2/sqrt(Hz).
    from_s
        The shortest averaging time that the terms explain, s; None where they explain nothing.
    """

    quantisation: NoiseTerm = NoiseTerm()
    angle_random_walk: NoiseTerm = NoiseTerm()
    bias_instability: NoiseTerm = NoiseTerm()
    rate_random_walk: NoiseTerm = NoiseTerm()
    from_s: float | None = None


UNITS = {
    "quantisation": "rad",
    "angle_random_walk": "rad/s/sqrt(Hz)",
    "bias_instability": "rad/s",
    "rate_random_walk": "rad/s^2/sqrt(Hz)",
}
"""The units of the terms."""


class Noise(NamedTuple):
    """The noise of a gyroscope at rest.

    Parameters
    ----------
    source
        The log, and what was read of it.
    topic
        The topic of the rates; empty for a table.
    samples
        How many samples were at rest.
    rests
        First and last timestamp of each period at rest, ns.
    pieces
        Into how many pieces rests and gaps divide the samples; nothing is taken across.
    interval_s
        Mean interval between samples, s: they are taken as equally spaced.
    tau_s
        Averaging times, shape ``(T,)``, s.
    deviation
        Overlapping Allan deviation of x, y and z, shape ``(T, 3)``, rad/s.
    low, high
        Its confidence interval of 68 %, shape ``(T, 3)``, rad/s; NaN where no terms explain it.
    axes
        The noise of x, y and z.
    combined
        The value to use for all axes: the root of their mean square.
    dropped
        Samples that were read and not used, by `on_backwards` and `on_nonfinite`.
    remarks
        What a reader should know.
    losses
        What of the log could not be read.
    """

    source: str
    topic: str
    samples: int
    rests: tuple[tuple[int, int], ...]
    pieces: int
    interval_s: float
    tau_s: Float64
    deviation: Float64
    low: Float64
    high: Float64
    axes: tuple[NoiseTerms, ...]
    combined: NoiseTerms
    dropped: int = 0
    remarks: tuple[Remark, ...] = ()
    losses: tuple[Loss, ...] = ()


def terms_of(fits: Sequence[TermFit | None], interval_s: float, tau_s: Float64) -> NoiseTerms:
    """Return the root mean square of the terms of some axes, or the terms of one."""
    found = [each for each in fits if each is not None]
    if not found:
        return NoiseTerms()
    units = (interval_s, math.sqrt(interval_s), 1.0, 1 / math.sqrt(interval_s))
    squares = np.mean([each.terms for each in found], axis=0)
    sigmas = np.sqrt(np.sum([each.sigmas**2 for each in found], axis=0)) / len(found)
    terms = {
        name: _term(float(square), float(sigma), unit)
        for name, square, sigma, unit in zip(UNITS, squares, sigmas, units, strict=False)
    }
    return NoiseTerms(**terms, from_s=float(tau_s[max(each.first for each in found)]))


def _term(square: float, sigma: float, unit: float) -> NoiseTerm:
    """Return a term from its square and the standard deviation of that."""
    if math.isnan(sigma):
        return NoiseTerm()
    if square < SHOWN * sigma:
        return NoiseTerm(at_most=unit * math.sqrt(max(square, 0.0) + BOUND * sigma))
    return NoiseTerm(unit * math.sqrt(square), unit * sigma / (2 * math.sqrt(square)))
