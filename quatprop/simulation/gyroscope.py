"""A motion sampled by a gyroscope with noise and bias, and the truth at the same times."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import UsageError
from quatprop.series import AttitudeSeries
from quatprop.simulation.motion import hamilton
from quatprop.times import NS_PER_S, regular_stamps

if TYPE_CHECKING:
    from collections.abc import Iterator
    from fractions import Fraction

    from quatprop.arrays import Float64
    from quatprop.simulation.motion import Motion

START_NS = 1_700_000_000_000_000_000
"""Default first timestamp: 2023-11-14T22:13:20Z. Fixed, so that logs are reproducible."""

BATCH = 1 << 16
"""Samples in a batch."""

NOISE_DECIMALS = 9
"""Noise is rounded to 1e-9 rad/s: its far tails are computed with a logarithm, whose last bits may
differ between machines."""


@dataclass(frozen=True, slots=True)
class Gyroscope:
    """A gyroscope, and the number of samples.

    `sample_rate`: samples per second, Hz. Sample k is taken at the whole ns at or before ``k /
        sample_rate``, and its timestamp is exact
    `start_ns`: first timestamp, ns
    `noise`: angle random walk, rad/s/sqrt(Hz): each sample of each axis has white noise of standard
        deviation ``noise * sqrt(sample_rate)``
    `bias`: added to the rate, rad/s
    """

    sample_rate: Fraction
    samples: int
    start_ns: int = START_NS
    noise: float = 0.0
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seed: int = 0

    def __post_init__(self) -> None:
        if BATCH * NS_PER_S * self.sample_rate.denominator > np.iinfo(np.int64).max:
            raise UsageError(
                f"a sample rate of {float(self.sample_rate)} Hz has too many digits to keep its "
                "timestamps exact; give it to three decimals"
            )

    @property
    def deviation(self) -> float:
        """Standard deviation of a sample's noise, rad/s."""
        return self.noise * math.sqrt(self.sample_rate)


def record(
    motion: Motion, gyroscope: Gyroscope, q0: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
) -> Iterator[AttitudeSeries]:
    """Yield batches of true attitudes with measured rates.

    `q0`: true attitude at the first sample, body -> reference, wxyz; it is normalised
    """
    if not 0 < np.linalg.norm(q0) < np.inf:
        raise UsageError("q0 must be four finite numbers W,X,Y,Z, not all zero")
    random = np.random.default_rng(gyroscope.seed)
    first = np.array(q0, np.float64)
    for begin in range(0, gyroscope.samples, BATCH):
        end = min(begin + BATCH, gyroscope.samples)
        elapsed = regular_stamps(begin, end, gyroscope.sample_rate)
        rate, wxyz = motion(elapsed)
        if gyroscope.noise:
            noise = random.standard_normal(rate.shape) * gyroscope.deviation
            rate = rate + np.round(noise, NOISE_DECIMALS)
        t_ns = elapsed + gyroscope.start_ns
        measured = rate + np.array(gyroscope.bias)
        yield AttitudeSeries(t_ns, _unit(hamilton(first, wxyz)), rate=measured)


def samples_in(duration_ns: int, sample_rate: Fraction) -> int:
    """Return the number of samples in a duration, at least one."""
    return max(1, math.ceil(duration_ns * sample_rate / NS_PER_S))


def _unit(wxyz: Float64) -> Float64:
    """Return rows scaled to unit length, with -0.0 replaced by 0.0."""
    w, x, y, z = wxyz.T
    length = np.sqrt(w * w + x * x + y * y + z * z)
    unit: Float64 = wxyz / length[:, None] + 0.0
    return unit
