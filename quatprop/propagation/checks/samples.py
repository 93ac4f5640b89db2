"""Samples as the checks of rates see them, what they find in them, and whether they have noise."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64, Int64

    Unit = tuple[str, float]
    """The name of a unit of rates, and its size, rad/s."""


FROZEN_SAMPLES = 100
"""This many equal rates do not come from a working sensor, which would have noise."""

CHANGING = 0.5
"""Share of neighbours that differ on an axis whose noise is larger than its step."""

SMALLEST_RANGE = math.radians(124.95)
"""rad/s: the narrowest range of common gyroscopes, 125 deg/s less a step; smaller extremes are not
saturation."""

NEIGHBOURS = 64
"""Neighbouring samples that show whether rates have noise."""

WHITE = 2.0
"""Ratio of sixth and fourth differences above which rates have noise: white noise has 3.6, a motion
less than 1."""

MEDIAN_SIXTH = 20.5
"""Median magnitude of the sixth differences of white noise, in units of the noise."""

LEAST_NOISE = 1e-6
"""Smallest noise, relative to the rates; less is the rounding of a simulation."""

LEAST_STEPS = 1.0
"""Smallest noise, in steps of the rates; rounding has 0.29."""


class Samples(NamedTuple):
    """Neighbouring samples.

    `columns`: rates of the three axes, shape ``(3, N)``, rad/s
    `t_ns`: timestamps, shape ``(N,)``
    """

    columns: Float64 = np.empty((3, 0))
    t_ns: Int64 = np.empty(0, np.int64)

    @property
    def size(self) -> int:
        """Number of samples."""
        return len(self.t_ns)

    def after(self, earlier: Samples) -> Samples:
        """Return earlier samples and these, with contiguous columns, which are checked faster."""
        columns = np.empty((3, earlier.size + self.size))
        columns[:, : earlier.size], columns[:, earlier.size :] = earlier.columns, self.columns
        return Samples(columns, np.concatenate([earlier.t_ns, self.t_ns]))

    def part(self, begin: int, end: int | None = None) -> Samples:
        """Return the samples between two places, not copied."""
        return Samples(self.columns[:, begin:end], self.t_ns[begin:end])

    def kept(self, begin: int) -> Samples:
        """Return a copy of the samples from a place on, which may be counted from the end."""
        return Samples(self.columns[:, begin:].copy(), self.t_ns[begin:].copy())


class Stretch(NamedTuple):
    """Successive samples in which something was found; of several stretches the longest.

    `samples`: number of samples
    `times`: number of such stretches
    `value`: the rate that is repeated, rad/s
    `origin_ns`: where the rows begin that are repeated
    """

    begin_ns: int
    end_ns: int
    samples: int
    times: int = 1
    value: float = 0.0
    origin_ns: int = 0

    def after(self, earlier: Stretch | None) -> Stretch:
        """Return the longest of all, some of which were found earlier."""
        if earlier is None:
            return self
        longest = max(earlier, self, key=lambda one: one.samples)
        return longest._replace(times=earlier.times + 1)

    @property
    def often(self) -> str:
        """How often there was one, for a sentence; empty if once."""
        return f" (the longest of {self.times} times)" if self.times > 1 else ""


def has_noise(rates: Float64) -> Bool:
    """Return whether neighbouring rates, shape ``(..., N)``, have noise of more than a step."""
    # Medians, so that a quick motion in a part of them does not matter.
    with np.errstate(invalid="ignore", over="ignore"):
        second, fourth, sixth = (np.abs(np.diff(rates, order)) for order in (2, 4, 6))
        rounding = LEAST_NOISE * np.abs(rates).max(axis=-1)
        step = np.where(second > rounding[..., None], second, np.inf).min(axis=-1)
        least = np.maximum(rounding, LEAST_STEPS * step)
        size = _median(sixth)
        is_white = size > WHITE * _median(fourth)
        noisy: Bool = is_white & (size > MEDIAN_SIXTH * least)
    return noisy


def _median(values: Float64) -> Float64:
    """Return the medians over the last axis; NumPy's own would import masked arrays."""
    half = values.shape[-1] // 2
    middle = [half] if values.shape[-1] % 2 else [half - 1, half]
    medians: Float64 = np.partition(values, middle, axis=-1)[..., middle].mean(axis=-1)
    return medians
