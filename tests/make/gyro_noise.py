"""Gyroscopes at rest whose noise is known: white, flicker, random walk, angles in steps, ramps."""

from typing import NamedTuple

import numpy as np

HZ = 100
BURN_IN = 2
"""Lengths of a log for which flicker noise is made before it begins."""


class Truth(NamedTuple):
    """The noise of a gyroscope.

    Q in rad, N in rad/s/sqrt(Hz), B in rad/s, K in rad/s^2/sqrt(Hz), a ramp R in rad/s^2.
    """

    Q: float = 0.0
    N: float = 0.0
    B: float = 0.0
    K: float = 0.0
    R: float = 0.0

    def deviation(self, tau):
        """Return the Allan deviation at some times, s; IEEE Std 952-2020, Annex C."""
        terms = (
            3 * self.Q**2 / tau**2,
            self.N**2 / tau,
            2 * np.log(2) / np.pi * self.B**2 + 0 * tau,
            self.K**2 * tau / 3,
            self.R**2 * tau**2 / 2,
        )
        return np.sqrt(sum(terms))


def rates(truth, samples, random, columns=3):
    """Return rates at rest, ``(samples, columns)``, rad/s."""
    shape = (samples, columns)
    rate = truth.N * np.sqrt(HZ) * random.standard_normal(shape)
    if truth.Q:
        angle = truth.Q * random.standard_normal((samples + 1, columns))
        rate += np.diff(angle, axis=0) * HZ
    if truth.B:
        rate += truth.B * _flicker(shape, random)
    steps = truth.K / np.sqrt(HZ) * random.standard_normal(shape)
    # Averages over the intervals, as the closed form has them.
    walk = np.cumsum(steps, axis=0)
    shares = random.standard_normal(shape) * truth.K / np.sqrt(12 * HZ)
    rate += walk - steps / 2 + shares
    return rate + truth.R * np.arange(samples)[:, None] / HZ


def _flicker(shape, random):
    """Return noise of the density 1 / (2 pi f), two-sided, of unit B (Kasdin and Walter, 1992)."""
    length = BURN_IN * shape[0]
    k = np.arange(1, length)
    response = np.cumprod(np.concatenate([[1.0], (k - 0.5) / k]))
    spectrum = np.fft.rfft(response, 2 * length)[:, None]
    white = np.fft.rfft(random.standard_normal((length, shape[1])), 2 * length, axis=0)
    return np.fft.irfft(spectrum * white, axis=0)[length - shape[0] : length]


SHARES = (
    (0, 0, 0), (1, 0, 0), (3, 0, 0), (0, 1, 0), (0, 1.5, 0),
    (0, 0, 1), (0, 0, 3), (0, 0, 10), (2, 0, 3), (1, 1, 0),
)  # fmt: skip
"""Quantisation relative to N at one sample; flicker and a random walk relative to N at 1 s."""

DENSITY = 1.7e-4
"""Of usual MEMS, rad/s/sqrt(Hz); the fit of unit/sensor_noise/test_fit.py is the same at any."""


def models():
    """Return ten gyroscopes, whose terms a log of some minutes shows."""
    return [
        Truth(Q=q * DENSITY / np.sqrt(HZ), N=DENSITY, B=b * DENSITY, K=k * DENSITY)
        for q, b, k in SHARES
    ]
